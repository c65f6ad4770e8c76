//! Datasets: names and bytes in, an object out, with the images decoded wherever the caller likes.

use super::{directions, fail, flat, mask_of, stack::Stack};
use crate::dataset::archive::{self, Zip};
use crate::dataset::diligent::{self, Header};
use crate::dataset::{Files, Limits, Memory};
use crate::eval::{Protocol, protocol};
use crate::stack::{BitDepth, RawStack};
use wasm_bindgen::prelude::*;

/// The files of a dataset in DiLiGenT's layout: one object, or a folder of them.
#[wasm_bindgen]
pub struct ObjectFiles(Source);

enum Source {
    Folder(Memory),
    Archive(Zip),
}

impl ObjectFiles {
    fn files(&self) -> &dyn Files {
        match &self.0 {
            Source::Folder(files) => files,
            Source::Archive(files) => files,
        }
    }

    fn folder(&mut self) -> Result<&mut Memory, JsError> {
        match &mut self.0 {
            Source::Folder(files) => Ok(files),
            Source::Archive(_) => Err(fail("files can't be added to an archive")),
        }
    }
}

#[wasm_bindgen]
impl ObjectFiles {
    /// A folder without a file yet.
    #[wasm_bindgen(constructor)]
    #[must_use]
    pub fn new() -> Self {
        Self(Source::Folder(Memory::new()))
    }

    /// The files of a zip archive; `name` is that of the archive, for messages and for an object at its root.
    pub fn zip(bytes: Vec<u8>, name: &str) -> Result<ObjectFiles, JsError> {
        Zip::new(bytes, name, &Limits::default()).map(|zip| Self(Source::Archive(zip))).map_err(fail)
    }

    /// Adds a file with its bytes. Names are relative, with '/' between folders.
    pub fn add(&mut self, name: &str, bytes: Vec<u8>) -> Result<(), JsError> {
        self.folder()?.insert(name, bytes).map_err(fail)
    }

    /// Adds a file whose bytes stay elsewhere: an image that is decoded by `decodePixels`.
    pub fn list(&mut self, name: &str) -> Result<(), JsError> {
        self.folder()?.list(name).map_err(fail)
    }

    /// The bytes of a file.
    pub fn bytes(&self, name: &str) -> Result<Vec<u8>, JsError> {
        self.files().read(name).map_err(fail)
    }

    /// Folders of all objects, sorted.
    #[must_use]
    pub fn objects(&self) -> Vec<String> {
        diligent::find_objects(self.files())
    }

    /// Names of all objects that can be chosen: those of the folders in their order, and after DiLiGenT's bear its
    /// variant without the bad first 20 images, `bear76` (see `CapturedObject.bear76`).
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let mut names = Vec::new();
        for folder in self.objects() {
            let name = diligent::object_name(self.files(), &folder);
            let bear = name == "bear";
            names.push(name);
            if bear {
                names.push(protocol::BEAR76.into());
            }
        }
        names
    }

    /// Folder of the object `name` of `names`; of the first object where there is none of this name.
    #[wasm_bindgen(js_name = folderOf)]
    #[must_use]
    pub fn folder_of(&self, name: &str) -> String {
        let name = if name == protocol::BEAR76 { "bear" } else { name };
        let mut folders = self.objects();
        let place = folders.iter().position(|f| diligent::object_name(self.files(), f) == name).unwrap_or(0);
        // Where there is no object at all, reading the top folder says what is missing.
        if folders.is_empty() { String::new() } else { folders.swap_remove(place) }
    }

    /// Reads and checks everything of the object in `folder` but its images.
    pub fn header(&self, folder: &str) -> Result<ObjectHeader, JsError> {
        let header = Header::read(self.files(), folder, &Limits::default()).map_err(fail)?;
        let (images, pixels) = (header.images.len(), header.mask.len());
        if images.saturating_mul(pixels) > MOST_VALUES {
            return Err(fail(format!(
                "{images} images with {pixels} pixels of the object: a page's memory holds {} million of them in all; crop or scale the \
                 images, use fewer, or use the command line",
                MOST_VALUES / 1_000_000
            )));
        }
        let pixels = header.images.iter().map(|_| None).collect();
        Ok(ObjectHeader { header, pixels })
    }
}

/// Pixels of all images of an object together: 22 bytes each, as read and as solved, of the 4 GB that a module can have.
const MOST_VALUES: usize = 150_000_000;

/// Everything of one object but its images, and the images as they are put in.
#[wasm_bindgen]
pub struct ObjectHeader {
    header: Header,
    pixels: Vec<Option<diligent::Pixels>>,
}

#[wasm_bindgen]
impl ObjectHeader {
    /// Of images that are not in files. `mask` has a byte for each pixel of a `width × height` image, not 0 on the
    /// object; `names` are those of the images, `lights` and `intensities` have three numbers for each (towards the
    /// light; RGB gain), `truth` three for each mask pixel (the unit normal), or is left out.
    #[allow(clippy::too_many_arguments)]
    pub fn of(
        name: String,
        width: u32,
        height: u32,
        mask: &[u8],
        names: Vec<String>,
        lights: &[f32],
        intensities: &[f32],
        truth: Option<Vec<f32>>,
    ) -> Result<ObjectHeader, JsError> {
        let mask = mask_of(mask, width, height)?;
        let lights = directions(lights)?;
        let intensities = directions(intensities)?.iter().map(glam::Vec3::to_array).collect();
        let truth = truth.map(|t| directions(&t)).transpose()?;
        let pixels = names.iter().map(|_| None).collect();
        let (dir, warnings, images) = (String::new(), Vec::new(), names);
        let header = Header { dir, name, mask, images, lights, intensities, truth, warnings };
        Ok(Self { header, pixels })
    }

    /// Names of the image files, with their folder, in the order of the lights.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn images(&self) -> Vec<String> {
        (0..self.header.images.len()).map(|k| self.header.path(k)).collect()
    }

    /// Width of the images in pixels.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn width(&self) -> u32 {
        self.header.mask.width()
    }

    /// Height of the images in pixels.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn height(&self) -> u32 {
        self.header.mask.height()
    }

    /// The object's pixels: a byte for each pixel of the image, 1 or 0. `decodePixels` takes it.
    #[must_use]
    pub fn mask(&self) -> Vec<u8> {
        self.header.mask.scatter(&vec![1; self.header.mask.len()], 0)
    }

    /// What a user should know of the files, though they can be used.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn notes(&self) -> Vec<String> {
        self.header.warnings.iter().map(ToString::to_string).collect()
    }

    /// Puts in image `k`: bits a channel and RGB code values of the mask pixels, from `decodePixels`.
    pub fn put(&mut self, k: usize, bits: u8, rgb: &[u16]) -> Result<(), JsError> {
        let count = self.pixels.len();
        let slot = self.pixels.get_mut(k).ok_or_else(|| fail(format!("image {k} of {count}")))?;
        let bits = BitDepth::try_from(bits).map_err(fail)?;
        *slot = Some(diligent::Pixels { bits, rgb: rgb.as_chunks().0.to_vec() });
        Ok(())
    }

    /// The object, when all images are in.
    pub fn assemble(self) -> Result<CapturedObject, JsError> {
        self.header.assemble(self.pixels.into_iter().flatten().collect()).map(CapturedObject).map_err(fail)
    }
}

/// The mask pixels of one image.
#[wasm_bindgen]
pub struct Pixels(diligent::Pixels);

#[wasm_bindgen]
impl Pixels {
    /// Bits a channel.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn bits(&self) -> u8 {
        self.0.bits.bits()
    }

    /// RGB code values of the mask pixels, row by row.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn rgb(&self) -> Vec<u16> {
        self.0.rgb.as_flattened().to_vec()
    }
}

/// Decodes one PNG: the pixels for which `mask` (a byte a pixel, from `ObjectHeader.mask`) is not 0. `file` is its
/// name, for messages.
#[wasm_bindgen(js_name = decodePixels)]
pub fn decode_pixels(
    bytes: &[u8],
    mask: &[u8],
    width: u32,
    height: u32,
    file: &str,
) -> Result<Pixels, JsError> {
    let mask = mask_of(mask, width, height)?;
    diligent::decode_pixels(bytes, &mask, file).map(Pixels).map_err(fail)
}

/// One object as published: code values, light directions and intensities, and the true normals where they are known.
#[wasm_bindgen]
pub struct CapturedObject(pub(super) RawStack);

#[wasm_bindgen]
impl CapturedObject {
    /// Its name.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn name(&self) -> String {
        self.0.name.clone()
    }

    /// Bits a channel.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn bits(&self) -> u8 {
        self.0.bits.bits()
    }

    /// Number of images.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn images(&self) -> usize {
        self.0.images.len()
    }

    /// Width of the images in pixels.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn width(&self) -> u32 {
        self.0.mask.width()
    }

    /// Height of the images in pixels.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn height(&self) -> u32 {
        self.0.mask.height()
    }

    /// Number of pixels of the object.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.0.mask.len()
    }

    /// Whether the true normals are known.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn truth(&self) -> bool {
        self.0.truth.is_some()
    }

    /// The object's pixels: a byte for each pixel of the image, 1 or 0.
    #[must_use]
    pub fn mask(&self) -> Vec<u8> {
        self.0.mask.scatter(&vec![1; self.0.mask.len()], 0)
    }

    /// Names of the images.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        self.0.names.clone()
    }

    /// Directions towards the lights, three numbers for each image.
    #[must_use]
    pub fn lights(&self) -> Vec<f32> {
        flat(&self.0.lights)
    }

    /// RGB gains of the lights, three numbers for each image.
    #[must_use]
    pub fn intensities(&self) -> Vec<f32> {
        self.0.intensities.as_flattened().to_vec()
    }

    /// True normals, three numbers for each mask pixel, where they are known.
    #[wasm_bindgen(js_name = trueNormals)]
    #[must_use]
    pub fn true_normals(&self) -> Option<Vec<f32>> {
        self.0.truth.as_deref().map(flat)
    }

    /// RGB code values of the mask pixels of image `k`.
    pub fn image(&self, k: usize) -> Result<Vec<u16>, JsError> {
        let image =
            self.0.images.get(k).ok_or_else(|| fail(format!("image {k} of {}", self.0.images.len())))?;
        Ok(image.as_flattened().to_vec())
    }

    /// The object as the files of a DiLiGenT folder, in a zip archive that any reader of DiLiGenT can unpack.
    #[wasm_bindgen(js_name = toZip)]
    pub fn to_zip(&self) -> Result<Vec<u8>, JsError> {
        let files = diligent::write_object(&self.0).map_err(fail)?;
        archive::write_zip(&files).map_err(fail)
    }

    /// The variant of DiLiGenT's bear without its first 20 images, which are known to be bad; undefined for all else.
    #[must_use]
    pub fn bear76(&self) -> Option<CapturedObject> {
        let variant = || RawStack { name: protocol::BEAR76.into(), ..protocol::bear76(&self.0) };
        protocol::is_bear(&self.0).then(|| Self(variant()))
    }

    /// The linear stack that a protocol (`official` or `128`) makes of it.
    pub fn prepare(&self, protocol: &str) -> Result<Stack, JsError> {
        let protocol: Protocol = protocol.parse().map_err(fail)?;
        protocol.apply(&self.0).map(Stack::new).map_err(fail)
    }
}
