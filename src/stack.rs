//! What was captured of one object: images, lights, mask and (where known) true normals.
//!
//! A [`RawStack`] holds the code values as published; a protocol ([`crate::eval::protocol`]) turns it
//! into a linear [`Stack`], which planners and solvers work on. Both store mask pixels only, in
//! row-major order.

use crate::image::Image;
use glam::Vec3;

/// The pixels that belong to the object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    width: u32,
    height: u32,
    indices: Vec<u32>,
}

/// Why a mask or stack can't be made.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum StackError {
    /// No pixel belongs to the object.
    #[error("the mask is empty: none of its {width}×{height} pixels belongs to the object")]
    EmptyMask {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
    },
    /// A list has the wrong length.
    #[error("{what}: {found} values where {expected} are needed")]
    Length {
        /// Which list.
        what: String,
        /// Its length.
        found: usize,
        /// The length it must have.
        expected: usize,
    },
}

impl Mask {
    /// The mask of the pixels for which `inside` (row-major, `width × height`) is true.
    ///
    /// # Errors
    /// [`StackError::Length`] if `inside` has another size, [`StackError::EmptyMask`] if none is true.
    pub fn new(width: u32, height: u32, inside: &[bool]) -> Result<Self, StackError> {
        let expected = width as usize * height as usize;
        if inside.len() != expected {
            return Err(StackError::Length { what: "mask".into(), found: inside.len(), expected });
        }
        let indices: Vec<u32> = (0u32..).zip(inside).filter_map(|(i, &m)| m.then_some(i)).collect();
        if indices.is_empty() {
            return Err(StackError::EmptyMask { width, height });
        }
        Ok(Self { width, height, indices })
    }

    /// The mask that an image shows: its brightest value (the largest channel of a pixel) marks the object. An all-black
    /// image marks nothing.
    ///
    /// # Errors
    /// [`StackError::EmptyMask`] for an all-black image, [`StackError::Length`] for one that lacks pixels.
    pub fn from_image(image: &Image) -> Result<Self, StackError> {
        let value = |p: &[u16; 3]| p[0].max(p[1]).max(p[2]);
        let brightest = image.rgb.iter().map(value).max().unwrap_or(0).max(1);
        let inside: Vec<bool> = image.rgb.iter().map(|p| value(p) == brightest).collect();
        Self::new(image.width, image.height, &inside)
    }

    /// Every pixel of a `width × height` image.
    ///
    /// # Errors
    /// [`StackError::EmptyMask`] if there is no pixel.
    pub fn full(width: u32, height: u32) -> Result<Self, StackError> {
        Self::new(width, height, &vec![true; width as usize * height as usize])
    }

    /// Width of the image in pixels.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height of the image in pixels.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Number of pixels of the object, |Ω| (never 0).
    #[must_use]
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        self.indices.len()
    }

    /// Row-major positions of the object's pixels, ascending.
    #[must_use]
    pub fn indices(&self) -> &[u32] {
        &self.indices
    }

    /// Column and row of mask pixel `p`.
    #[must_use]
    pub fn position(&self, p: usize) -> (u32, u32) {
        let i = self.indices[p];
        (i % self.width, i / self.width)
    }

    /// One value a mask pixel, laid into the whole image; `background` elsewhere.
    #[must_use]
    pub fn scatter<T: Copy>(&self, values: &[T], background: T) -> Vec<T> {
        let mut image = vec![background; self.width as usize * self.height as usize];
        for (&i, &v) in self.indices.iter().zip(values) {
            image[i as usize] = v;
        }
        image
    }

    /// The mask pixels of a whole image (row-major, `width × height`).
    #[must_use]
    pub fn gather<T: Copy>(&self, image: &[T]) -> Vec<T> {
        self.indices.iter().map(|&i| image[i as usize]).collect()
    }

    /// Smallest rectangle that holds the mask: (left, top, width, height) in pixels.
    #[must_use]
    pub fn bounds(&self) -> (u32, u32, u32, u32) {
        let (mut x0, mut x1, mut y0, mut y1) = (u32::MAX, 0, u32::MAX, 0);
        for p in 0..self.len() {
            let (x, y) = self.position(p);
            (x0, x1) = (x0.min(x), x1.max(x));
            (y0, y1) = (y0.min(y), y1.max(y));
        }
        (x0, y0, x1 - x0 + 1, y1 - y0 + 1)
    }
}

/// Bits a channel of the stored images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(into = "u8", try_from = "u8")]
pub enum BitDepth {
    /// 0..=255.
    Eight,
    /// 0..=65535.
    Sixteen,
}

impl BitDepth {
    /// 8 or 16.
    #[must_use]
    pub fn bits(self) -> u8 {
        match self {
            Self::Eight => 8,
            Self::Sixteen => 16,
        }
    }

    /// Largest code value.
    #[must_use]
    pub fn max(self) -> u16 {
        match self {
            Self::Eight => 255,
            Self::Sixteen => 65535,
        }
    }
}

impl From<BitDepth> for u8 {
    fn from(depth: BitDepth) -> u8 {
        depth.bits()
    }
}

impl TryFrom<u8> for BitDepth {
    type Error = String;
    fn try_from(bits: u8) -> Result<Self, String> {
        match bits {
            8 => Ok(Self::Eight),
            16 => Ok(Self::Sixteen),
            other => Err(format!("bit depth {other}: images have 8 or 16 bits a channel")),
        }
    }
}

/// One object as published: code values, light directions and intensities, nothing normalised.
#[derive(Clone, Debug)]
pub struct RawStack {
    /// Object name, as "ball" or "bear".
    pub name: String,
    /// The object's pixels.
    pub mask: Mask,
    /// Bits a channel of the images.
    pub bits: BitDepth,
    /// For each image the RGB code values of the mask pixels (grey images: three equal channels).
    pub images: Vec<Vec<[u16; 3]>>,
    /// File name of each image.
    pub names: Vec<String>,
    /// Unit direction towards the light of each image.
    pub lights: Vec<Vec3>,
    /// Gain of each image's light, per RGB channel; positive.
    pub intensities: Vec<[f32; 3]>,
    /// True unit normals of the mask pixels. A zero vector marks a pixel without ground truth.
    pub truth: Option<Vec<Vec3>>,
}

impl RawStack {
    /// The stack without the images for which `keep` is false.
    #[must_use]
    pub fn subset(&self, mut keep: impl FnMut(usize) -> bool) -> Self {
        let kept: Vec<usize> = (0..self.images.len()).filter(|&k| keep(k)).collect();
        Self {
            name: self.name.clone(),
            mask: self.mask.clone(),
            bits: self.bits,
            images: kept.iter().map(|&k| self.images[k].clone()).collect(),
            names: kept.iter().map(|&k| self.names[k].clone()).collect(),
            lights: kept.iter().map(|&k| self.lights[k]).collect(),
            intensities: kept.iter().map(|&k| self.intensities[k]).collect(),
            truth: self.truth.clone(),
        }
    }
}

/// One object ready for planners and solvers: linear values, light intensity divided out.
#[derive(Clone, Debug)]
pub struct Stack {
    /// Object name.
    pub name: String,
    /// The object's pixels, at the protocol's resolution.
    pub mask: Mask,
    /// Bits a channel of the images it came from.
    pub bits: BitDepth,
    /// Linear grey value of every mask pixel, for each image.
    pub grey: Vec<Vec<f32>>,
    /// Linear RGB of every mask pixel, for each image.
    pub rgb: Vec<Vec<[f32; 3]>>,
    /// Which mask pixels are saturated, for each image; an empty list for an image where none is.
    pub saturated: Vec<Vec<bool>>,
    /// Unit direction towards the light of each image.
    pub lights: Vec<Vec3>,
    /// File name of each image.
    pub names: Vec<String>,
    /// True unit normals of the mask pixels; a zero vector where unknown.
    pub truth: Option<Vec<Vec3>>,
}

/// Flags of an image's pixels, an empty list where none is set.
pub(crate) fn flags(set: impl Iterator<Item = bool>) -> Vec<bool> {
    let flags: Vec<bool> = set.collect();
    if flags.contains(&true) { flags } else { Vec::new() }
}

impl Stack {
    /// Number of images.
    #[must_use]
    pub fn len(&self) -> usize {
        self.lights.len()
    }

    /// Whether the stack has no image.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.lights.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scatter_and_gather_are_inverse() {
        let mask = Mask::new(3, 2, &[false, true, true, false, false, true]).unwrap();
        assert_eq!(mask.indices(), [1, 2, 5]);
        assert_eq!(mask.position(2), (2, 1));
        let image = mask.scatter(&[7, 8, 9], 0);
        assert_eq!(image, [0, 7, 8, 0, 0, 9]);
        assert_eq!(mask.gather(&image), [7, 8, 9]);
        assert_eq!(mask.bounds(), (1, 0, 2, 2));
    }

    #[test]
    fn empty_and_misshapen_masks_are_errors() {
        assert_eq!(Mask::new(2, 1, &[false, false]), Err(StackError::EmptyMask { width: 2, height: 1 }));
        assert!(matches!(Mask::new(2, 2, &[true]), Err(StackError::Length { found: 1, expected: 4, .. })));
        assert!(Mask::full(0, 5).is_err());
    }

    #[test]
    fn the_brightest_value_of_an_image_marks_the_object() {
        let image =
            |rgb: &[[u16; 3]]| Image { width: 3, height: 1, bits: BitDepth::Sixteen, rgb: rgb.to_vec() };
        // Of any brightness and colour, and nothing in between counts.
        let mask = Mask::from_image(&image(&[[0, 9, 0], [8, 8, 8], [9, 9, 9]])).unwrap();
        assert_eq!(mask.indices(), [0, 2]);
        assert_eq!(
            Mask::from_image(&image(&[[0; 3]; 3])),
            Err(StackError::EmptyMask { width: 3, height: 1 })
        );
    }
}
