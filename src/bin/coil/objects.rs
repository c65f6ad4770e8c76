//! What `coil eval` and `coil study` work on: every object under the paths given, made ready one at a time.

use crate::files;
use crate::output::safe;
use anyhow::{Context, bail};
use coil_ps::dataset::Limits;
use coil_ps::eval::{Protocol, Subject, protocol};
use coil_ps::render::mesh::MeshError;
use coil_ps::render::worlds;
use coil_ps::render::{Material, Mesh, Options, RenderError, Scene, SceneCamera, Shape, Tolerances};
use coil_ps::stack::{RawStack, Stack};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// An object, ready to plan on.
pub enum Object {
    /// Stored images.
    Stack(Box<Stack>),
    /// Rendered under any direction.
    Scene {
        /// What is seen.
        scene: Box<Scene>,
        /// With what errors.
        rig: Option<Tolerances>,
    },
}

/// The names of objects so far. Results and files go by name: none may be there twice.
#[derive(Default)]
pub struct Names(HashSet<String>);

impl Names {
    /// `name`, or where an object has it already, `name-2` and so on.
    pub fn distinct(&mut self, name: &str) -> String {
        let numbered = (2..).map(|i| format!("{name}-{i}"));
        let mut free = std::iter::once(name.to_owned()).chain(numbered).filter(|n| self.0.insert(safe(n)));
        free.next().unwrap_or_default()
    }
}

impl Object {
    fn named(mut self, name: &str) -> Self {
        match &mut self {
            Self::Stack(stack) => stack.name = name.into(),
            Self::Scene { scene, .. } => scene.name = name.into(),
        }
        self
    }

    /// Calls `f` with the object as the evaluator takes it; a rendered one may be lit up to `reach` radians.
    pub fn with_subject<T>(&self, reach: f32, f: impl FnOnce(&Subject) -> T) -> T {
        match self {
            Self::Stack(stack) => f(&Subject::Stack(stack)),
            Self::Scene { scene, rig } => {
                let camera = match rig {
                    None => SceneCamera::new(scene),
                    Some(rig) => SceneCamera::real(scene, *rig, 1),
                };
                f(&Subject::Scene { name: &scene.name, camera: &camera, truth: Some(scene.truth()), reach })
            }
        }
    }
}

/// What is asked for by a path or name on the command line.
#[derive(clap::Args)]
pub struct Selection {
    /// A DiLiGenT object, a folder or .zip with some; or rendered objects: worlds-v1 (or worlds-v1:0..9 of its hundred),
    /// worlds-train:0..49, worlds-validate:0..49, a sculpture as blob:7 or a mesh (.obj, .ply, .stl), these two also
    /// with a material: blob:7+nylon.
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<String>,
    /// Take DiLiGenT's bear without its first 20 images, which are known to be bad (protocol 128 always does).
    #[arg(long)]
    bear76: bool,
    /// Side of rendered pictures, pixels.
    #[arg(long, default_value_t = 128)]
    size: u32,
    /// Largest slant of the light on rendered objects, degrees; a fixed set's lights beyond it are taken there.
    #[arg(long, default_value_t = 90.0, value_parser = degrees)]
    pub reach: f32,
    /// See rendered objects without a rig's errors (noise, 0.5° of the light's direction, 1 % of its brightness).
    #[arg(long)]
    ideal: bool,
    /// Distance of the light from rendered objects, in half widths of the object; without it infinitely far.
    #[arg(long, conflicts_with = "ideal", value_parser = distance)]
    distance: Option<f32>,
}

fn distance(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(v) if v >= 3.0 => Ok(v),
        _ => Err("a number of half widths, at least 3".into()),
    }
}

fn degrees(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(v) if v > 0.0 && v <= 90.0 => Ok(v),
        _ => Err("degrees above 0 and up to 90".into()),
    }
}

impl Selection {
    /// Calls `each(name, object)` for every object, an unreadable one with its error. No name comes twice.
    ///
    /// # Errors
    /// Only those of `each`.
    pub fn for_each(
        &self,
        protocol: Protocol,
        mut each: impl FnMut(&str, anyhow::Result<Object>) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        let mut names = Names::default();
        let mut each = |name: &str, object: anyhow::Result<Object>| {
            let distinct = names.distinct(name);
            each(&distinct, object.map(|o| o.named(&distinct)))
        };
        for path in &self.paths {
            let rendered = if is_mesh(path) {
                rendered(path)
            } else if Path::new(path).exists() {
                self.datasets(path, protocol, &mut each)?;
                continue;
            } else {
                rendered(path).context("no such folder, archive or rendered object")
            };
            match rendered {
                Ok(objects) => {
                    for object in objects {
                        let scene = object.scene(&self.options()).map_err(anyhow::Error::from);
                        let ready = |s| Object::Scene { scene: Box::new(s), rig: self.rig() };
                        each(&object.name, scene.map(ready))?;
                    }
                }
                Err(error) => each(path, Err(error))?,
            }
        }
        Ok(())
    }

    fn rig(&self) -> Option<Tolerances> {
        let far = Tolerances::RIG.distance;
        (!self.ideal).then(|| Tolerances { distance: self.distance.unwrap_or(far), ..Tolerances::RIG })
    }

    fn options(&self) -> Options {
        Options { size: self.size, ..Options::default() }
    }

    fn datasets(
        &self,
        path: &str,
        protocol: Protocol,
        each: &mut impl FnMut(&str, anyhow::Result<Object>) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        let limits = Limits::default();
        let source = match files::open(Path::new(path), &limits) {
            Ok(source) => source,
            Err(error) => return each(path, Err(error)),
        };
        for dir in &source.objects {
            let object = files::read_object(source.files.as_ref(), dir, &limits)
                .map_err(anyhow::Error::from)
                .and_then(|(raw, warnings)| {
                    for warning in &warnings {
                        eprintln!("{}: {warning}", source.place(dir));
                    }
                    ready(raw, protocol, self.bear76)
                });
            let name = object.as_ref().map_or_else(|_| source.place(dir), |stack| stack.name.clone());
            each(&name, object.map(|s| Object::Stack(Box::new(s))))?;
        }
        Ok(())
    }
}

fn ready(raw: RawStack, protocol: Protocol, bear76: bool) -> anyhow::Result<Stack> {
    let raw = if bear76 && protocol::is_bear(&raw) {
        RawStack { name: protocol::BEAR76.into(), ..protocol::bear76(&raw) }
    } else {
        raw
    };
    protocol.apply(&raw).with_context(|| format!("protocol {protocol}"))
}

/// Whether that is the name of a mesh file, perhaps with a material after `+`.
pub fn is_mesh(name: &str) -> bool {
    let extension = Path::new(split_material(name).0).extension().and_then(|e| e.to_str());
    ["obj", "ply", "stl"].contains(&extension.unwrap_or_default().to_ascii_lowercase().as_str())
}

/// A mesh's file and what stands after its `+`; folders may have that character in their names.
fn split_material(path: &str) -> (&str, Option<&str>) {
    match path.rsplit_once('+') {
        Some((file, material)) if !material.contains(['/', '\\']) => (file, Some(material)),
        _ => (path, None),
    }
}

/// Reads a mesh file.
///
/// # Errors
/// Where it can't be read, or is no mesh.
pub fn read_mesh(file: &str) -> anyhow::Result<Mesh> {
    let bytes = std::fs::read(file).with_context(|| file.to_owned())?;
    Mesh::from_bytes(file, &bytes).with_context(|| file.to_owned())
}

/// The rendered objects of a name: a mesh file, or what [`worlds::objects`] knows.
///
/// # Errors
/// As [`mesh`], and for an unknown name.
pub fn rendered(name: &str) -> anyhow::Result<Vec<worlds::Object>> {
    if is_mesh(name) {
        return Ok(vec![mesh(name)?]);
    }
    // What looks like a file was not meant as a sculpture.
    let file = split_material(name).0;
    let ending = Path::new(file).extension().and_then(|e| e.to_str()).unwrap_or_default();
    let is_file = ending.contains(char::is_alphabetic) || Path::new(file).is_file();
    worlds::objects(name).map_err(|error| match error {
        RenderError::Sculpture(_) if is_file => MeshError::Format(file.into()).into(),
        error => error.into(),
    })
}

/// A mesh file, seen from the front, of a material after `+`.
///
/// # Errors
/// As [`read_mesh`], and where there is no such material.
fn mesh(path: &str) -> anyhow::Result<worlds::Object> {
    let (file, material) = split_material(path);
    let material: Material = material.unwrap_or(worlds::MATERIAL).parse()?;
    let shape = Shape::Mesh(read_mesh(file)?);
    let name = Path::new(file).file_stem().unwrap_or_default().to_string_lossy().into_owned();
    Ok(worlds::Object { name, rotation: shape.front(), shape, finish: material.into() })
}

/// The meshes of a folder, by name.
pub fn read_meshes(dir: &Path) -> anyhow::Result<Vec<(String, Mesh)>> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(dir).with_context(|| dir.display().to_string())? {
        files.push(entry?.path());
    }
    files.retain(|f| is_mesh(&f.to_string_lossy()));
    files.sort();
    if files.is_empty() {
        bail!("{}: no mesh (.obj, .ply, .stl)", dir.display());
    }
    let read = |file: &PathBuf| -> anyhow::Result<(String, Mesh)> {
        let name = file.display().to_string();
        let mesh = read_mesh(&name)?;
        Ok((name, mesh))
    };
    files.iter().map(read).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_comes_twice() {
        let mut names = Names::default();
        let got = ["cat", "cat", "cat", "dog-2", "dog", "dog", "a b", "a+b"].map(|n| names.distinct(n));
        // The last two would be one folder.
        assert_eq!(got, ["cat", "cat-2", "cat-3", "dog-2", "dog", "dog-3", "a b", "a+b-2"]);
    }
}
