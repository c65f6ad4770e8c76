//! The layout of DiLiGenT (Shi et al. 2019), DiLiGenT10² (Ren et al. 2022) and our own renders.
//!
//! One folder an object: images named in `filenames.txt`, `light_directions.txt` (unit vectors),
//! `light_intensities.txt` (RGB gains), `mask.png` (its brightest value marks the object), and where known the true
//! normals as `Normal_gt.mat` or `normal.txt`. Frame: x right, y up (image row 0 is +y), z to the camera.
//!
//! Reading is split so that images can be decoded in parallel: [`Header::read`] reads everything but the
//! images, [`decode_pixels`] decodes one image, [`Header::assemble`] puts them together.

use super::text::{self, Row};
use super::{DatasetError, Files, Limits, Warning, check_name, mat};
use crate::image::{ImageError, PngReader, decode_png, encode_grey, encode_rgb};
use crate::solve::SolveError;
use crate::solve::least_squares::pseudo_inverse;
use crate::stack::{BitDepth, Mask, RawStack};
use glam::{DVec3, Vec3};
use std::collections::HashMap;

const FILENAMES: &str = "filenames.txt";
const DIRECTIONS: &str = "light_directions.txt";
const INTENSITIES: &str = "light_intensities.txt";
const MASK: &str = "mask.png";
const TRUTH_MAT: &str = "Normal_gt.mat";
const TRUTH_TXT: &str = "normal.txt";
const TRUTH_PNG: &str = "Normal_gt.png";

/// Everything of one object but its images.
#[derive(Clone, Debug)]
pub struct Header {
    /// Folder of the object; empty where it is the root.
    pub dir: String,
    /// Object name: the folder's or, at its root, the archive's name without DiLiGenT's "PNG".
    pub name: String,
    /// The object's pixels.
    pub mask: Mask,
    /// File name of each image, relative to the folder.
    pub images: Vec<String>,
    /// Unit direction towards the light of each image.
    pub lights: Vec<Vec3>,
    /// Gain of each image's light, per RGB channel; positive.
    pub intensities: Vec<[f32; 3]>,
    /// True unit normals of the mask pixels; a zero vector where unknown.
    pub truth: Option<Vec<Vec3>>,
    /// What a user should know.
    pub warnings: Vec<Warning>,
}

/// The mask pixels of one image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pixels {
    /// Bits a channel.
    pub bits: BitDepth,
    /// RGB code values of the mask pixels.
    pub rgb: Vec<[u16; 3]>,
}

impl Pixels {
    /// Whether every value is `value`.
    fn is_all(&self, value: u16) -> bool {
        self.rgb.iter().flatten().all(|&v| v == value)
    }
}

/// Folders of all objects among `files`, sorted; hidden folders and `__MACOSX` are passed over.
#[must_use]
pub fn find_objects(files: &dyn Files) -> Vec<String> {
    let mut dirs: Vec<String> = files
        .names()
        .iter()
        .filter(|name| !name.split('/').any(|part| part.starts_with('.') || part == "__MACOSX"))
        .filter_map(|name| {
            let (dir, file) = name.rsplit_once('/').unwrap_or(("", name));
            [DIRECTIONS, FILENAMES, INTENSITIES].contains(&file).then(|| dir.to_string())
        })
        .collect();
    dirs.sort_unstable();
    dirs.dedup();
    dirs
}

/// Reads the object in folder `dir`, one image after the other.
///
/// # Errors
/// [`DatasetError`] for the first thing that is wrong.
pub fn read_object(
    files: &dyn Files,
    dir: &str,
    limits: &Limits,
) -> Result<(RawStack, Vec<Warning>), DatasetError> {
    let header = Header::read(files, dir, limits)?;
    let pixels = (0..header.images.len())
        .map(|k| {
            let path = header.path(k);
            decode_pixels(&files.read(&path)?, &header.mask, &path)
        })
        .collect::<Result<Vec<_>, _>>()?;
    let warnings = header.warnings.clone();
    Ok((header.assemble(pixels)?, warnings))
}

/// Decodes one image: its mask pixels only. `file` is its name, for messages.
///
/// # Errors
/// [`DatasetError::Image`], or [`DatasetError::ImageSize`] where it does not fit the mask.
pub fn decode_pixels(bytes: &[u8], mask: &Mask, file: &str) -> Result<Pixels, DatasetError> {
    let image_error = |reason| DatasetError::Image { file: file.into(), reason };
    let reader = PngReader::new(bytes, usize::MAX).map_err(image_error)?;
    let info = reader.info();
    let (found, expected) = ((info.width, info.height), (mask.width(), mask.height()));
    if found != expected {
        return Err(DatasetError::ImageSize { file: file.into(), found, expected });
    }
    let mut rgb = Vec::with_capacity(mask.len());
    reader.pixels(mask.indices().iter().copied(), |p| rgb.push(p)).map_err(image_error)?;
    Ok(Pixels { bits: info.bits, rgb })
}

impl Header {
    /// Reads and checks all files of the object in folder `dir` but its images, which must be there.
    ///
    /// # Errors
    /// [`DatasetError`] for the first thing that is wrong.
    pub fn read(files: &dyn Files, dir: &str, limits: &Limits) -> Result<Self, DatasetError> {
        let folder = Folder { files, dir, limits };
        let mut warnings = Vec::new();
        let images = folder.image_names(&mut warnings)?;
        let lights = folder.lights(images.len(), &mut warnings)?;
        let intensities = folder.intensities(images.len(), &mut warnings)?;
        let mask = folder.mask()?;
        let bytes = images.len() as u64 * mask.len() as u64 * size_of::<[u16; 3]>() as u64;
        if bytes > limits.object_bytes {
            let what = "bytes of images";
            return Err(DatasetError::Limit {
                file: folder.path(""),
                found: bytes,
                what,
                limit: limits.object_bytes,
            });
        }
        let truth = folder.truth(&mask, &mut warnings)?;
        let name = object_name(files, dir);
        if name == "bear" && images.len() == 96 {
            warnings.push(Warning::BadFirstImages { images: 20 });
        }
        Ok(Self { dir: dir.into(), name, mask, images, lights, intensities, truth, warnings })
    }

    /// Full name of image `k`.
    #[must_use]
    pub fn path(&self, k: usize) -> String {
        join(&self.dir, &self.images[k])
    }

    /// What a user should know of the images, as numbers and pixels, which need not be all.
    #[must_use]
    pub fn image_warnings(&self, images: &[(usize, Pixels)]) -> Vec<Warning> {
        let of = |says: &dyn Fn(&Pixels) -> bool| {
            let mut found = images.iter().filter(|(_, pixels)| says(pixels)).map(|(k, _)| *k);
            let first = self.images[found.next()?].clone();
            Some((1 + found.count(), first))
        };
        let black = of(&|p| p.is_all(0)).map(|(images, first)| Warning::BlackImages { images, first });
        let white = of(&|p| p.is_all(p.bits.max()));
        let white = white.map(|(images, first)| Warning::SaturatedImages { images, first });
        black.into_iter().chain(white).collect()
    }

    /// The object with its images, in the order of [`images`](Self::images).
    ///
    /// # Errors
    /// [`DatasetError::Count`] where an image lacks, [`DatasetError::MixedBitDepth`].
    pub fn assemble(self, pixels: Vec<Pixels>) -> Result<RawStack, DatasetError> {
        if pixels.len() != self.images.len() {
            return Err(DatasetError::Count {
                file: join(&self.dir, FILENAMES),
                found: self.images.len(),
                expected: pixels.len(),
                of: "images",
            });
        }
        let bits = pixels.first().map_or(BitDepth::Sixteen, |p| p.bits);
        if let Some(k) = pixels.iter().position(|p| p.bits != bits) {
            return Err(DatasetError::MixedBitDepth {
                file: self.path(k),
                found: pixels[k].bits.bits(),
                first: self.path(0),
                expected: bits.bits(),
            });
        }
        Ok(RawStack {
            name: self.name,
            mask: self.mask,
            bits,
            images: pixels.into_iter().map(|p| p.rgb).collect(),
            names: self.images,
            lights: self.lights,
            intensities: self.intensities,
            truth: self.truth,
        })
    }
}

/// The files of an object in this layout, relative to its folder: everything [`read_object`] reads, and
/// the true normals as a picture (`Normal_gt.png`). What is read back is the same to the bit.
///
/// # Errors
/// [`DatasetError::UnsafeName`] for an image's name, [`DatasetError::Image`] where an image does not fill the mask.
pub fn write_object(stack: &RawStack) -> Result<Vec<(String, Vec<u8>)>, DatasetError> {
    let image_error = |file: &str, reason| DatasetError::Image { file: file.into(), reason };
    let mut files = Vec::new();
    for (name, rgb) in stack.names.iter().zip(&stack.images) {
        check_name("image", name)?;
        let bytes = encode_pixels(rgb, stack.bits, &stack.mask).map_err(|e| image_error(name, e))?;
        files.push((name.clone(), bytes));
    }
    let lines = |rows: Vec<[f32; 3]>| -> Vec<u8> {
        rows.iter().flat_map(|[a, b, c]| format!("{a} {b} {c}\n").into_bytes()).collect()
    };
    let list = stack.names.iter().flat_map(|n| format!("{n}\n").into_bytes()).collect();
    files.push((FILENAMES.into(), list));
    files.push((DIRECTIONS.into(), lines(stack.lights.iter().map(Vec3::to_array).collect())));
    files.push((INTENSITIES.into(), lines(stack.intensities.clone())));
    let (width, height) = (stack.mask.width(), stack.mask.height());
    let inside = stack.mask.scatter(&vec![255; stack.mask.len()], 0);
    files.push((MASK.into(), encode_grey(width, height, &inside).map_err(|e| image_error(MASK, e))?));
    if let Some(truth) = &stack.truth {
        files.push((TRUTH_MAT.into(), normals_mat("Normal_gt", &stack.mask, truth)));
        // rgb = (n + 1)/2; black where there is no normal.
        let colour = |n: &Vec3| match *n {
            Vec3::ZERO => [0; 3],
            n => ((n + 1.0) * 127.5).round().to_array().map(|v| v as u16),
        };
        let picture = stack.mask.scatter(&truth.iter().map(colour).collect::<Vec<_>>(), [0; 3]);
        let bytes = encode_rgb(width, height, BitDepth::Eight, &picture);
        files.push((TRUTH_PNG.into(), bytes.map_err(|e| image_error(TRUTH_PNG, e))?));
    }
    Ok(files)
}

/// A PNG of the mask pixels' code values, black around them.
///
/// # Errors
/// [`ImageError::Length`] where there is not one value a mask pixel.
pub fn encode_pixels(rgb: &[[u16; 3]], bits: BitDepth, mask: &Mask) -> Result<Vec<u8>, ImageError> {
    if rgb.len() != mask.len() {
        return Err(ImageError::Length { found: rgb.len(), width: mask.width(), height: mask.height() });
    }
    encode_rgb(mask.width(), mask.height(), bits, &mask.scatter(rgb, [0; 3]))
}

/// A MAT file with the normals of the mask pixels as an H×W×3 array `variable`, zero around them.
#[must_use]
pub fn normals_mat(variable: &str, mask: &Mask, normals: &[Vec3]) -> Vec<u8> {
    let (width, height) = (mask.width() as usize, mask.height() as usize);
    let plane = width * height;
    let mut values = vec![0.0; 3 * plane];
    for (p, n) in normals.iter().enumerate().take(mask.len()) {
        let (x, y) = mask.position(p);
        for (c, v) in n.to_array().into_iter().enumerate() {
            values[c * plane + x as usize * height + y as usize] = f64::from(v);
        }
    }
    mat::write_array(variable, &mat::Array { dims: vec![height, width, 3], values })
}

/// Name of the object in a folder of `files`: "pmsData/ballPNG" → "ball"; that of `files` themselves at their root.
#[must_use]
pub fn object_name(files: &dyn Files, dir: &str) -> String {
    let dir = if dir.is_empty() { files.root() } else { dir };
    let last = dir.rsplit('/').next().unwrap_or(dir);
    let name = last.strip_suffix("PNG").filter(|n| !n.is_empty()).unwrap_or(last);
    if name.is_empty() { "object".into() } else { name.into() }
}

fn join(dir: &str, name: &str) -> String {
    if dir.is_empty() { name.into() } else { format!("{dir}/{name}") }
}

/// Counts vectors that are not of unit length.
struct Lengths {
    off: usize,
    /// The length furthest from 1.
    worst: f64,
}

impl Default for Lengths {
    fn default() -> Self {
        Self { off: 0, worst: 1.0 }
    }
}

impl Lengths {
    fn add(&mut self, length: f64, tolerance: f64) {
        self.off += usize::from((length - 1.0).abs() > tolerance);
        if (length - 1.0).abs() > (self.worst - 1.0).abs() {
            self.worst = length;
        }
    }
}

/// One object's folder.
struct Folder<'a> {
    files: &'a dyn Files,
    dir: &'a str,
    limits: &'a Limits,
}

impl Folder<'_> {
    fn path(&self, name: &str) -> String {
        join(self.dir, name)
    }

    fn read(&self, name: &str, needed: &str) -> Result<Vec<u8>, DatasetError> {
        let file = self.path(name);
        if !self.files.has(&file) {
            return Err(DatasetError::Missing { file, needed: needed.into() });
        }
        let bytes = self.files.read(&file)?;
        let (found, limit) = (bytes.len() as u64, self.limits.file_bytes);
        if found > limit {
            return Err(DatasetError::Limit { file, found, what: "bytes", limit });
        }
        Ok(bytes)
    }

    /// Hands each line of numbers to `each`; blank lines are passed over.
    fn rows(
        &self,
        name: &str,
        needed: &str,
        each: impl FnMut(usize, Row) -> Result<(), DatasetError>,
    ) -> Result<(), DatasetError> {
        text::rows(&self.path(name), &self.read(name, needed)?, each)
    }

    fn check_count(&self, name: &str, found: usize, expected: usize) -> Result<(), DatasetError> {
        if found == expected {
            return Ok(());
        }
        Err(DatasetError::Count { file: self.path(name), found, expected, of: "images" })
    }

    fn image_names(&self, warnings: &mut Vec<Warning>) -> Result<Vec<String>, DatasetError> {
        let list = self.path(FILENAMES);
        let names = if self.files.has(&list) {
            let mut first = HashMap::new();
            let mut names = Vec::new();
            for (line, name) in text::lines(&String::from_utf8_lossy(&self.read(FILENAMES, "")?)) {
                let name = name.strip_prefix("./").unwrap_or(name).to_string();
                check_name(&format!("{list}:{line}"), &name)?;
                if let Some(&first) = first.get(&name) {
                    return Err(DatasetError::Duplicate { list, line, file: name, first });
                }
                if !self.files.has(&self.path(&name)) {
                    return Err(DatasetError::MissingImage { list, line, file: name });
                }
                first.insert(name.clone(), line);
                names.push(name);
            }
            names
        } else {
            let prefix = self.path("x");
            let prefix = &prefix[..prefix.len() - 1];
            let in_folder = self.files.names().iter().filter_map(|n| n.strip_prefix(prefix));
            let names: Vec<String> = in_folder
                .filter(|n| !n.contains('/') && !n.starts_with('.') && *n != MASK && *n != TRUTH_PNG)
                .filter(|n| n.rsplit_once('.').is_some_and(|(_, end)| end.eq_ignore_ascii_case("png")))
                .map(Into::into)
                .collect();
            warnings.push(Warning::NoFileList { images: names.len() });
            names
        };
        if names.is_empty() {
            return Err(DatasetError::Missing { file: list, needed: "it names no image".into() });
        }
        if names.len() > self.limits.images {
            let (found, limit) = (names.len() as u64, self.limits.images as u64);
            return Err(DatasetError::Limit { file: list, found, what: "images", limit });
        }
        Ok(names)
    }

    fn lights(&self, images: usize, warnings: &mut Vec<Warning>) -> Result<Vec<Vec3>, DatasetError> {
        let file = self.path(DIRECTIONS);
        let (mut lights, mut lengths) = (Vec::new(), Lengths::default());
        self.rows(DIRECTIONS, "a unit vector towards the light for each image", |line, row| {
            let v = row.vector(&file, line)?;
            lights.push(text::light_direction(v, &file, line)?);
            lengths.add(v.length(), 1e-3); // files have four decimals: what they round is no finding
            Ok(())
        })?;
        self.check_count(DIRECTIONS, lights.len(), images)?;
        if lengths.off > 0 {
            warnings.push(Warning::LightsNormalised { lights: lengths.off, worst: lengths.worst });
        }
        match pseudo_inverse(&lights) {
            Err(SolveError::TooFew(lights)) => warnings.push(Warning::FewLights { lights }),
            Err(_) => warnings.push(Warning::FlatLights { lights: lights.len() }),
            Ok(_) => {}
        }
        Ok(lights)
    }

    fn intensities(&self, images: usize, warnings: &mut Vec<Warning>) -> Result<Vec<[f32; 3]>, DatasetError> {
        let file = self.path(INTENSITIES);
        if !self.files.has(&file) {
            warnings.push(Warning::NoIntensities);
            return Ok(vec![[1.0; 3]; images]);
        }
        let mut intensities = Vec::new();
        self.rows(INTENSITIES, "", |line, row| {
            let file = || file.clone();
            let rgb = match row.values() {
                Some(&[r, g, b]) => [r, g, b],
                Some(&[grey]) => [grey; 3],
                _ => {
                    let (found, expected) = (row.count, "3 (or 1)");
                    return Err(DatasetError::Columns { file: file(), line, found, expected });
                }
            };
            // Judged as f32, as which it divides: 1e-50 would be zero, 1e50 infinite.
            for (channel, &value) in rgb.iter().enumerate() {
                if (value as f32) < f32::MIN_POSITIVE {
                    return Err(DatasetError::Intensity { file: file(), line, channel, value });
                }
                if (value as f32).is_infinite() {
                    let (line, text) = (line.to_string(), value.to_string());
                    return Err(DatasetError::NotFinite { file: file(), line, text });
                }
            }
            intensities.push(rgb.map(|v| v as f32));
            Ok(())
        })?;
        self.check_count(INTENSITIES, intensities.len(), images)?;
        Ok(intensities)
    }

    fn mask(&self) -> Result<Mask, DatasetError> {
        let file = self.path(MASK);
        let bytes = self.read(MASK, "its brightest value marks the pixels of the object")?;
        let image = decode_png(&bytes, self.limits.pixels)
            .map_err(|reason| DatasetError::Image { file: file.clone(), reason })?;
        let (width, height) = (image.width, image.height);
        Mask::from_image(&image).map_err(|_| DatasetError::EmptyMask { file, width, height })
    }

    fn truth(&self, mask: &Mask, warnings: &mut Vec<Warning>) -> Result<Option<Vec<Vec3>>, DatasetError> {
        let (file, normals) = if self.files.has(&self.path(TRUTH_MAT)) {
            (TRUTH_MAT, self.truth_mat(mask)?)
        } else if self.files.has(&self.path(TRUTH_TXT)) {
            (TRUTH_TXT, self.truth_txt(mask, warnings)?)
        } else {
            warnings.push(Warning::NoTruth);
            return Ok(None);
        };
        let (mut zero, mut lengths) = (0, Lengths::default());
        let mut truth = Vec::with_capacity(mask.len());
        for (p, n) in normals.into_iter().enumerate() {
            let length = n.length();
            if !length.is_finite() {
                let (x, y) = mask.position(p);
                return Err(DatasetError::NotFinite {
                    file: self.path(file),
                    line: format!("column {x}, row {y}"),
                    text: format!("normal ({}, {}, {})", n.x, n.y, n.z),
                });
            }
            if length < 1e-6 {
                zero += 1;
                truth.push(Vec3::ZERO);
            } else {
                lengths.add(length, 0.01);
                truth.push(text::normalised(n));
            }
        }
        if 2 * zero > mask.len() {
            warnings.push(Warning::LittleTruth { pixels: zero, of: mask.len() });
        } else if zero > 0 {
            warnings.push(Warning::ZeroTruth { pixels: zero });
        }
        if lengths.off > 0 {
            warnings.push(Warning::TruthNormalised { pixels: lengths.off, worst: lengths.worst });
        }
        Ok(Some(truth))
    }

    fn truth_mat(&self, mask: &Mask) -> Result<Vec<DVec3>, DatasetError> {
        let file = self.path(TRUTH_MAT);
        let bytes = self.read(TRUTH_MAT, "")?;
        let array = mat::read_array(&bytes, "Normal_gt", self.limits.pixels.saturating_mul(3))
            .map_err(|reason| DatasetError::Mat { file: file.clone(), reason })?;
        let (width, height) = (mask.width() as usize, mask.height() as usize);
        if array.dims != [height, width, 3] {
            let found = array.dims.iter().map(ToString::to_string).collect::<Vec<_>>().join("×");
            let expected = format!("{height}×{width}×3");
            return Err(DatasetError::TruthSize { file, found, expected });
        }
        // Column-major: row runs fastest, then column, then component.
        let plane = width * height;
        Ok((0..mask.len())
            .map(|p| {
                let (x, y) = mask.position(p);
                let i = y as usize + x as usize * height;
                DVec3::new(array.values[i], array.values[i + plane], array.values[i + 2 * plane])
            })
            .collect())
    }

    /// `normal.txt`: a line a pixel, row by row from the top left.
    fn truth_txt(&self, mask: &Mask, warnings: &mut Vec<Warning>) -> Result<Vec<DVec3>, DatasetError> {
        let file = self.path(TRUTH_TXT);
        let (width, height) = (mask.width() as usize, mask.height() as usize);
        let size = |found: String| {
            let (file, expected) = (file.clone(), format!("{} ({width}×{height})", width * height));
            DatasetError::TruthSize { file, found, expected }
        };
        let mut normals = Vec::with_capacity(width * height);
        // Like a MAT file's, they may be NaN where no object is.
        text::any_rows(&file, &self.read(TRUTH_TXT, "")?, |line, row| {
            // However many there are: they need not be kept to know that.
            if normals.len() == width * height {
                return Err(size(format!("more than {} lines", normals.len())));
            }
            normals.push(row.vector(&file, line)?);
            Ok(())
        })?;
        if normals.len() != width * height {
            return Err(size(format!("{} lines", normals.len())));
        }
        // The right way up, (nearly) every mask pixel has a normal.
        let upright = mask.gather(&normals);
        let turned: Vec<DVec3> = (0..mask.len())
            .map(|p| {
                let (x, y) = mask.position(p);
                normals[(height - 1 - y as usize) * width + x as usize]
            })
            .collect();
        let missing = |n: &[DVec3]| n.iter().filter(|n| **n == DVec3::ZERO || !n.is_finite()).count();
        if missing(&turned) < missing(&upright) {
            warnings.push(Warning::TruthUpsideDown { file });
            return Ok(turned);
        }
        Ok(upright)
    }
}
