//! What `coil eval` and `coil study` work on: every object under the paths given, made ready one at a time.

use crate::files;
use anyhow::{Context, bail};
use coil_ps::dataset::Limits;
use coil_ps::eval::{Protocol, Subject, protocol};
use coil_ps::render::worlds::{self, Split};
use coil_ps::render::{self, Material, Mesh, Options, Pose, Scene, SceneCamera, Shape};
use coil_ps::stack::{RawStack, Stack};
use std::ops::Range;
use std::path::Path;

/// An object, ready to plan on.
pub enum Object {
    /// Stored images.
    Stack(Box<Stack>),
    /// Rendered under exactly the direction asked for.
    Scene(Box<Scene>),
}

impl Object {
    /// Calls `f` with the object as the evaluator takes it; a rendered one may be lit up to `reach` radians.
    pub fn with_subject<T>(&self, reach: f32, f: impl FnOnce(&Subject) -> T) -> T {
        match self {
            Self::Stack(stack) => f(&Subject::Stack(stack)),
            Self::Scene(scene) => {
                let camera = SceneCamera::new(scene);
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
    /// Largest slant of the light on rendered objects, degrees.
    #[arg(long, default_value_t = 90.0, value_parser = degrees)]
    pub reach: f32,
}

fn degrees(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(v) if v > 0.0 && v <= 90.0 => Ok(v),
        _ => Err("degrees above 0 and up to 90".into()),
    }
}

impl Selection {
    /// Calls `each(name, object)` for every object, an unreadable one with its error.
    ///
    /// # Errors
    /// Only those of `each`.
    pub fn for_each(
        &self,
        protocol: Protocol,
        mut each: impl FnMut(&str, anyhow::Result<Object>) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        for path in &self.paths {
            if let Some((split, numbers)) = worlds(path) {
                for number in numbers {
                    let object = match split {
                        Split::Train => worlds::training(1, number),
                        Split::Validation => worlds::validation(1, number),
                        Split::Test => worlds::test_object(number),
                    };
                    let scene = object.scene(&self.options()).map_err(anyhow::Error::from);
                    each(&object.name, scene.map(|s| Object::Scene(Box::new(s))))?;
                }
            } else if let Some(shape) = shape(path) {
                let scene = shape.and_then(|(shape, material)| self.scene(path, &shape, &material));
                each(path, scene.map(|s| Object::Scene(Box::new(s))))?;
            } else {
                self.datasets(path, protocol, &mut each)?;
            }
        }
        Ok(())
    }

    fn options(&self) -> Options {
        Options { size: self.size, ..Options::default() }
    }

    fn scene(&self, name: &str, shape: &Shape, material: &str) -> anyhow::Result<Scene> {
        let material: Material = material.parse()?;
        let pose = Pose::fit(shape, shape.front())?;
        Ok(Scene::new(name, shape, &pose, &material.into(), &self.options())?)
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
                        eprintln!("{dir}: {warning}");
                    }
                    ready(raw, protocol, self.bear76)
                });
            let name = object.as_ref().map_or_else(|_| dir.clone(), |stack| stack.name.clone());
            each(&name, object.map(|s| Object::Stack(Box::new(s))))?;
        }
        Ok(())
    }
}

fn ready(raw: RawStack, protocol: Protocol, bear76: bool) -> anyhow::Result<Stack> {
    let raw = if bear76 && protocol::is_bear(&raw) {
        RawStack { name: "bear76".into(), ..protocol::bear76(&raw) }
    } else {
        raw
    };
    protocol.apply(&raw).with_context(|| format!("protocol {protocol}"))
}

/// `worlds-v1`, `worlds-train:0..49` and the like: which split and which of its objects.
fn worlds(path: &str) -> Option<(Split, Range<usize>)> {
    let (name, numbers) = path.split_once(':').map_or((path, None), |(name, rest)| (name, Some(rest)));
    let (split, all) = match name {
        worlds::NAME => (Split::Test, worlds::TEST_OBJECTS),
        "worlds-train" => (Split::Train, 50),
        "worlds-validate" => (Split::Validation, 50),
        _ => return None,
    };
    let end = if split == Split::Test { worlds::TEST_OBJECTS } else { 1_000_000 };
    let range = match numbers {
        None => 0..all,
        Some(text) => match text.split_once("..") {
            Some((from, to)) => from.parse().ok()?..to.parse::<usize>().ok()?.checked_add(1)?,
            None => text.parse().ok()?..text.parse::<usize>().ok()?.checked_add(1)?,
        },
    };
    (range.start < range.end && range.end <= end).then_some((split, range))
}

/// A sculpture or mesh and its material, where `path` names one.
fn shape(path: &str) -> Option<anyhow::Result<(Shape, String)>> {
    if Path::new(path).exists() && !is_mesh(path) {
        return None;
    }
    let (name, material) = path.rsplit_once('+').unwrap_or((path, "nylon"));
    let shape = if is_mesh(name) {
        read_mesh(Path::new(name))
    } else if let Ok(shape) = render::named(name) {
        Ok(shape)
    } else {
        return None;
    };
    Some(shape.map(|s| (s, material.to_owned())))
}

fn is_mesh(name: &str) -> bool {
    let extension = Path::new(name).extension().and_then(|e| e.to_str()).unwrap_or_default();
    ["obj", "ply", "stl"].contains(&extension.to_ascii_lowercase().as_str())
}

fn read_mesh(path: &Path) -> anyhow::Result<Shape> {
    let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
    let Some(name) = path.file_name().and_then(|n| n.to_str()) else {
        bail!("{}: the file name is not UTF-8", path.display());
    };
    Ok(Shape::Mesh(Mesh::from_bytes(name, &bytes).with_context(|| path.display().to_string())?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worlds_are_named_with_ranges() {
        assert_eq!(worlds("worlds-v1"), Some((Split::Test, 0..100)));
        assert_eq!(worlds("worlds-v1:3"), Some((Split::Test, 3..4)));
        assert_eq!(worlds("worlds-train:0..49"), Some((Split::Train, 0..50)));
        for bad in ["worlds-v1:100", "worlds-v1:5..2", "worlds-v1:x", "worlds-v2", "ballPNG"] {
            assert_eq!(worlds(bad), None, "{bad}");
        }
    }

    #[test]
    fn sculptures_may_name_a_material() {
        assert!(shape("blob:7").is_some_and(|s| s.unwrap().1 == "nylon"));
        assert!(shape("blob:7+brass").is_some_and(|s| s.unwrap().1 == "brass"));
        assert!(shape("no-such-thing").is_none());
        assert!(shape("missing.obj").is_some_and(|s| s.is_err()));
    }
}
