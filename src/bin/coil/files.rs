//! Folders and archives of this machine as [`Files`], and objects read with all cores.

use anyhow::{Context, bail};
use coil_ps::dataset::{
    DatasetError, Files, Header, Limits, Pixels, Warning, Zip, decode_pixels, find_objects,
};
use coil_ps::stack::RawStack;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Files and folders that a path may hold: enough for any dataset, too few for a whole disk by mistake.
const ENTRIES: usize = 500_000;
const DEPTH: usize = 12;

/// What lies under a path, and the objects among it.
pub struct Source {
    /// The files, named from the path's last part on.
    pub files: Box<dyn Files>,
    /// Folders of the objects.
    pub objects: Vec<String>,
    /// The path as it was given.
    path: PathBuf,
}

impl Source {
    /// Where the object in folder `dir` is, from the path as it was given: names of folders need not be unique.
    #[must_use]
    pub fn place(&self, dir: &str) -> String {
        // A folder's files begin with its own name, an archive's do not.
        let inside = match self.path.is_dir() {
            true => dir.split_once('/').map_or("", |(_, rest)| rest),
            false => dir,
        };
        if inside.is_empty() { self.path.clone() } else { self.path.join(inside) }.display().to_string()
    }
}

/// Opens a folder (an object, or anything above objects) or a zip archive and finds its objects.
///
/// # Errors
/// Where nothing can be read there, or no object is found.
pub fn open(path: &Path, limits: &Limits) -> anyhow::Result<Source> {
    let files: Box<dyn Files> = if path.is_dir() {
        Box::new(Folder::new(path, limits)?)
    } else if path.is_file() {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let size = std::fs::metadata(path)?.len();
        if size > 4 << 30 {
            bail!("{}: {size} bytes are too many to read at once: unpack it", path.display());
        }
        let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
        let end = path.extension().unwrap_or_default();
        if !bytes.starts_with(b"PK") && !end.eq_ignore_ascii_case("zip") {
            bail!("{}: neither a folder nor a zip archive: name the folder of the dataset", path.display());
        }
        Box::new(Zip::new(bytes, &name, limits)?)
    } else {
        bail!("{}: no such file or folder", path.display());
    };
    let objects = find_objects(files.as_ref());
    if objects.is_empty() {
        return Err(DatasetError::NoObject).with_context(|| path.display().to_string());
    }
    Ok(Source { files, objects, path: path.into() })
}

/// Reads the object in folder `dir`, its images in parallel.
///
/// # Errors
/// [`DatasetError`] for the first thing that is wrong.
pub fn read_object(
    files: &dyn Files,
    dir: &str,
    limits: &Limits,
) -> Result<(RawStack, Vec<Warning>), DatasetError> {
    let header = Header::read(files, dir, limits)?;
    let pixels = decode_all(files, &header).into_iter().collect::<Result<_, _>>()?;
    let warnings = header.warnings.clone();
    Ok((header.assemble(pixels)?, warnings))
}

/// Decodes every image of an object, in parallel.
pub fn decode_all(files: &dyn Files, header: &Header) -> Vec<Result<Pixels, DatasetError>> {
    (0..header.images.len())
        .into_par_iter()
        .map(|k| {
            let path = header.path(k);
            decode_pixels(&files.read(&path)?, &header.mask, &path)
        })
        .collect()
}

/// A folder of the file system.
struct Folder {
    /// The folder that the names start in: the parent of what was asked for.
    parent: PathBuf,
    names: Vec<String>,
    limits: Limits,
}

impl Folder {
    fn new(path: &Path, limits: &Limits) -> anyhow::Result<Self> {
        let path = path.canonicalize().with_context(|| path.display().to_string())?;
        let mut names = Vec::new();
        let root = path.file_name().map(|n| n.to_string_lossy().into_owned());
        let (parent, root) = match root {
            Some(root) => (path.parent().unwrap_or(&path).to_path_buf(), root),
            None => bail!("{}: name the folder of the dataset", path.display()),
        };
        walk(&path, &root, 0, &mut names)?;
        names.sort_unstable();
        Ok(Self { parent, names, limits: *limits })
    }
}

fn walk(folder: &Path, name: &str, depth: usize, names: &mut Vec<String>) -> anyhow::Result<()> {
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry.with_context(|| folder.display().to_string())?.path();
        let Some(last) = path.file_name().and_then(|n| n.to_str()) else { continue };
        if last.starts_with('.') {
            continue;
        }
        let name = format!("{name}/{last}");
        if path.is_dir() && depth < DEPTH {
            walk(&path, &name, depth + 1, names)?;
        } else if path.is_file() {
            names.push(name);
        }
        if names.len() > ENTRIES {
            bail!("{}: more than {ENTRIES} files: name the folder of the dataset", folder.display());
        }
    }
    Ok(())
}

impl Files for Folder {
    fn names(&self) -> &[String] {
        &self.names
    }

    fn read(&self, name: &str) -> Result<Vec<u8>, DatasetError> {
        let path = self.parent.join(name);
        let unreadable =
            |e: std::io::Error| DatasetError::Unreadable { file: name.into(), problem: e.to_string() };
        let (found, limit) = (std::fs::metadata(&path).map_err(unreadable)?.len(), self.limits.file_bytes);
        if found > limit {
            return Err(DatasetError::Limit { file: name.into(), found, what: "bytes", limit });
        }
        std::fs::read(&path).map_err(unreadable)
    }
}
