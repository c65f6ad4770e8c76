//! Datasets on disk, in an archive or in a browser: names and bytes in, a [`RawStack`](crate::stack::RawStack) out.
//!
//! Nothing here touches a file system. [`Files`] is what the readers ask; the command line implements
//! it for folders, the page fills a [`Memory`].

pub mod archive;
pub mod csv;
pub mod diligent;
pub mod diligent102;
pub mod lp;
pub mod mat;
mod text;

use crate::image::ImageError;
use mat::MatError;
use std::collections::BTreeMap;

pub use archive::Zip;
pub use diligent::{Header, Pixels, decode_pixels, find_objects, read_object, write_object};

/// Named files. Names are relative, with '/' between folders.
pub trait Files: Sync {
    /// All names, sorted.
    fn names(&self) -> &[String];

    /// The bytes of one of [`names`](Files::names).
    ///
    /// # Errors
    /// [`DatasetError::Missing`] for another name, or why the file can't be read.
    fn read(&self, name: &str) -> Result<Vec<u8>, DatasetError>;

    /// Name of what holds the files, where none of theirs begins with it: that of an object at the root. Empty where unknown.
    fn root(&self) -> &str {
        ""
    }

    /// Whether the name is there.
    fn has(&self, name: &str) -> bool {
        self.names().binary_search_by(|n| n.as_str().cmp(name)).is_ok()
    }
}

/// How much a dataset may ask for, so that a wrong or hostile file can't eat the memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Images of one object.
    pub images: usize,
    /// Pixels of one image.
    pub pixels: usize,
    /// Bytes of one object's code values in memory (6 for each mask pixel and image).
    pub object_bytes: u64,
    /// Bytes of one file, unpacked.
    pub file_bytes: u64,
    /// Bytes of all files of an archive, unpacked.
    pub archive_bytes: u64,
}

impl Default for Limits {
    /// 10 000 images of 64 Mi pixels, 3 GiB an object, 1 GiB a file, 64 GiB an archive: an object of
    /// DiLiGenT10² (100 × 1001×1001) takes at most 0.6 GB.
    fn default() -> Self {
        Self {
            images: 10_000,
            pixels: 1 << 26,
            object_bytes: 3 << 30,
            file_bytes: 1 << 30,
            archive_bytes: 64 << 30,
        }
    }
}

/// What is wrong with a dataset, and where.
#[derive(Clone, Debug, thiserror::Error, PartialEq)]
pub enum DatasetError {
    /// A file that must be there is not.
    #[error("{file}: missing ({needed})")]
    Missing {
        /// The file.
        file: String,
        /// What it is needed for.
        needed: String,
    },
    /// A listed image is not there.
    #[error("{list}:{line}: image '{file}' is missing")]
    MissingImage {
        /// The list that names it.
        list: String,
        /// Line of the list.
        line: usize,
        /// The image.
        file: String,
    },
    /// An image is listed twice.
    #[error("{list}:{line}: '{file}' stands already on line {first}")]
    Duplicate {
        /// The list.
        list: String,
        /// Line of the list.
        line: usize,
        /// The image.
        file: String,
        /// Line on which it stands first.
        first: usize,
    },
    /// A name that could lead out of the dataset.
    #[error("{list}: unsafe name '{name}': {problem}; names must be relative, with '/' between folders")]
    UnsafeName {
        /// The list (with its line) or archive that holds the name.
        list: String,
        /// The name.
        name: String,
        /// What is unsafe about it.
        problem: &'static str,
    },
    /// Text that is no number.
    #[error("{file}:{line}: '{text}' is not a number")]
    NotANumber {
        /// The file.
        file: String,
        /// Its line.
        line: usize,
        /// The text.
        text: String,
    },
    /// NaN or infinity.
    #[error("{file}:{line}: {text} is not finite")]
    NotFinite {
        /// The file.
        file: String,
        /// Its line, or pixel position.
        line: String,
        /// The value.
        text: String,
    },
    /// A line with too many or too few numbers.
    #[error("{file}:{line}: {found} numbers where {expected} are needed")]
    Columns {
        /// The file.
        file: String,
        /// Its line.
        line: usize,
        /// Numbers on the line.
        found: usize,
        /// Numbers needed, in words.
        expected: &'static str,
    },
    /// A file with a line too many or too few.
    #[error("{file}: {found} lines for {expected} {of}: there must be one for each")]
    Count {
        /// The file.
        file: String,
        /// Its lines (blank ones not counted).
        found: usize,
        /// What they must be.
        expected: usize,
        /// Of what.
        of: &'static str,
    },
    /// A light direction that is more than 1 % from unit length.
    #[error("{file}:{line}: the light direction has length {length:.4}, {:.1} % off: it must be a unit vector", 100.0 * (length - 1.0).abs())]
    NotUnit {
        /// The file.
        file: String,
        /// Its line.
        line: usize,
        /// Length of the vector.
        length: f64,
    },
    /// A light behind the image plane.
    #[error(
        "{file}:{line}: the light comes from behind the object (z = {z}): directions point from the object to the light, with z towards the camera"
    )]
    BehindObject {
        /// The file.
        file: String,
        /// Its line.
        line: usize,
        /// z of the direction.
        z: f64,
    },
    /// An intensity that can't be divided by.
    #[error("{file}:{line}: intensity {value} of channel {channel}: it must be positive")]
    Intensity {
        /// The file.
        file: String,
        /// Its line.
        line: usize,
        /// 0 red, 1 green, 2 blue.
        channel: usize,
        /// The value.
        value: f64,
    },
    /// No pixel belongs to the object.
    #[error("{file}: the mask is empty: none of its {width}×{height} pixels is set")]
    EmptyMask {
        /// The file.
        file: String,
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
    },
    /// An image that can't be decoded.
    #[error("{file}: {reason}")]
    Image {
        /// The file.
        file: String,
        /// Why.
        reason: ImageError,
    },
    /// An image of another size than the mask.
    #[error("{file}: {}×{} pixels where the mask has {}×{}", found.0, found.1, expected.0, expected.1)]
    ImageSize {
        /// The file.
        file: String,
        /// Its width and height.
        found: (u32, u32),
        /// Width and height of the mask.
        expected: (u32, u32),
    },
    /// Images of 8 and of 16 bits in one object.
    #[error("{file}: {found} bits a channel where {first} has {expected}: all images must have the same")]
    MixedBitDepth {
        /// The file.
        file: String,
        /// Its depth.
        found: u8,
        /// The first image.
        first: String,
        /// Depth of the first image.
        expected: u8,
    },
    /// A MAT file that can't be read.
    #[error("{file}: {reason}")]
    Mat {
        /// The file.
        file: String,
        /// Why.
        reason: MatError,
    },
    /// True normals of another size than the mask.
    #[error("{file}: an array of {found} where the mask needs {expected}")]
    TruthSize {
        /// The file.
        file: String,
        /// Its size.
        found: String,
        /// The size that fits.
        expected: String,
    },
    /// More than a limit allows.
    #[error("{file}: {found} {what}, more than the limit of {limit}")]
    Limit {
        /// The file.
        file: String,
        /// How many.
        found: u64,
        /// Of what.
        what: &'static str,
        /// The limit.
        limit: u64,
    },
    /// A file that would unpack to far more than it holds.
    #[error("{file}: refused as a zip bomb: {problem}")]
    ZipBomb {
        /// The file.
        file: String,
        /// What gives it away.
        problem: String,
    },
    /// Nothing in it looks like an object.
    #[error(
        "no object found: a folder with light_directions.txt, light_intensities.txt, filenames.txt, mask.png and the images is needed"
    )]
    NoObject,
    /// A file could not be read at all.
    #[error("{file}: {problem}")]
    Unreadable {
        /// The file.
        file: String,
        /// Why.
        problem: String,
    },
}

/// What a user should know of a dataset that can nevertheless be used.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Warning {
    /// No Normal_gt.mat and no normal.txt.
    NoTruth,
    /// Mask pixels whose true normal is zero.
    ZeroTruth {
        /// How many.
        pixels: usize,
    },
    /// More than half of the mask pixels have a zero true normal.
    LittleTruth {
        /// How many.
        pixels: usize,
        /// Of how many.
        of: usize,
    },
    /// Less than three lights.
    FewLights {
        /// How many.
        lights: usize,
    },
    /// Lights (nearly) in one plane through the object.
    FlatLights {
        /// How many.
        lights: usize,
    },
    /// Images that are 0 on the whole object.
    BlackImages {
        /// How many.
        images: usize,
        /// The first of them.
        first: String,
    },
    /// Images that have the largest code value on the whole object.
    SaturatedImages {
        /// How many.
        images: usize,
        /// The first of them.
        first: String,
    },
    /// True normals that were not of unit length (by more than 1 %) and have been normalised.
    TruthNormalised {
        /// How many.
        pixels: usize,
        /// The length furthest from 1.
        worst: f64,
    },
    /// True normals stored bottom row first (as harvest's normal.txt in the original release), turned over.
    TruthUpsideDown {
        /// The file.
        file: String,
    },
    /// Light directions off by more than 0.1 % (at most 1 %), normalised.
    LightsNormalised {
        /// How many.
        lights: usize,
        /// The length furthest from 1.
        worst: f64,
    },
    /// No list of images: all PNG files but mask and normals were taken, in the order of their names.
    NoFileList {
        /// How many.
        images: usize,
    },
    /// No light intensities: all were taken as 1.
    NoIntensities,
    /// DiLiGenT's bear: its first 20 images are known to be bad.
    BadFirstImages {
        /// How many.
        images: usize,
    },
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NoTruth => {
                write!(f, "no true normals (Normal_gt.mat or normal.txt): errors can't be measured")
            }
            Self::ZeroTruth { pixels } => {
                write!(f, "{pixels} mask pixels have a zero true normal: they count as 90°")
            }
            Self::LittleTruth { pixels, of } => write!(
                f,
                "{pixels} of {of} mask pixels have no true normal (they count as 90°): is it the truth of this mask?"
            ),
            Self::FewLights { lights } => {
                write!(f, "{lights} light(s): a normal needs at least 3 that do not lie in one plane")
            }
            Self::FlatLights { lights } => write!(
                f,
                "the {lights} lights lie (nearly) in one plane through the object: normals can't be told from them"
            ),
            Self::BlackImages { images, first } => {
                write!(f, "{images} image(s) are black on the whole object, {first} the first")
            }
            Self::SaturatedImages { images, first } => {
                write!(f, "{images} image(s) are saturated on the whole object, {first} the first")
            }
            Self::TruthNormalised { pixels, worst } => {
                write!(f, "{pixels} true normals were not of unit length (one has {worst:.3}): normalised")
            }
            Self::TruthUpsideDown { file } => {
                write!(f, "{file} fits the mask only upside down: its rows were taken in reverse")
            }
            Self::LightsNormalised { lights, worst } => {
                write!(
                    f,
                    "{lights} light directions were not unit vectors (one has length {worst:.4}): normalised"
                )
            }
            Self::NoFileList { images } => {
                write!(f, "no filenames.txt: took the {images} PNG files in the order of their names")
            }
            Self::NoIntensities => write!(f, "no light_intensities.txt: took all intensities as 1"),
            Self::BadFirstImages { images } => write!(
                f,
                "the first {images} images are known to be corrupted: learned methods leave them out"
            ),
        }
    }
}

/// Files in memory, as the page has them.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    names: Vec<String>,
    bytes: BTreeMap<String, Vec<u8>>,
}

impl Memory {
    /// No file yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a file, or replaces it.
    ///
    /// # Errors
    /// [`DatasetError::UnsafeName`].
    pub fn insert(&mut self, name: &str, bytes: Vec<u8>) -> Result<(), DatasetError> {
        self.list(name)?;
        self.bytes.insert(name.into(), bytes);
        Ok(())
    }

    /// Adds a file that is known to be there but whose bytes stay elsewhere (an image that another
    /// worker decodes). Reading it is an error.
    ///
    /// # Errors
    /// [`DatasetError::UnsafeName`].
    pub fn list(&mut self, name: &str) -> Result<(), DatasetError> {
        check_name("file", name)?;
        if let Err(at) = self.names.binary_search_by(|n| n.as_str().cmp(name)) {
            self.names.insert(at, name.into());
        }
        Ok(())
    }
}

impl Files for Memory {
    fn names(&self) -> &[String] {
        &self.names
    }

    fn read(&self, name: &str) -> Result<Vec<u8>, DatasetError> {
        let missing =
            || DatasetError::Missing { file: name.into(), needed: "its bytes were not given".into() };
        self.bytes.get(name).cloned().ok_or_else(missing)
    }
}

/// Refuses names that could lead out of a folder; `list` says where the name stands.
///
/// # Errors
/// [`DatasetError::UnsafeName`].
pub fn check_name(list: &str, name: &str) -> Result<(), DatasetError> {
    let drive = name.as_bytes().get(1) == Some(&b':') && name.as_bytes()[0].is_ascii_alphabetic();
    let problem = if name.starts_with('/') || drive {
        "it is absolute"
    } else if name.contains('\\') {
        "it has a backslash"
    } else if name.chars().any(char::is_control) {
        "it has a control character"
    } else if name.split('/').any(|part| part == "..") {
        "it goes up a folder"
    } else if name.split('/').any(|part| part.is_empty() || part == ".") {
        "it has an empty part"
    } else {
        return Ok(());
    };
    let shown = name.chars().take(100).collect::<String>().escape_default().to_string();
    Err(DatasetError::UnsafeName { list: list.into(), name: shown, problem })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_lead_out_are_refused() {
        for name in ["a", "a/b.png", "ballPNG/001.png", "a b", "..a/b..", "é"] {
            assert_eq!(check_name("x", name), Ok(()), "{name}");
        }
        for name in ["", "/a", "..", "a/../b", "a\\b", "C:/a", "c:a", "a//b", "./a", "a/", "a\0b", "a\nb"] {
            assert!(matches!(check_name("x", name), Err(DatasetError::UnsafeName { .. })), "{name:?}");
        }
    }

    #[test]
    fn memory_lists_sorted_and_reads_back() {
        let mut files = Memory::new();
        for name in ["b", "a/2", "a/1", "b"] {
            files.insert(name, name.into()).unwrap();
        }
        files.list("c").unwrap();
        assert_eq!(files.names(), ["a/1", "a/2", "b", "c"]);
        assert_eq!(files.read("a/2").unwrap(), b"a/2");
        assert!(files.has("c") && files.read("c").is_err() && !files.has("d"));
        assert!(files.insert("../x", vec![]).is_err());
    }
}
