//! Stacks, the pictures a run takes of them, what solvers make of these.

use super::picture::Picture;
use super::tiles::Tiles;
use super::{direction, directions, fail, flat, mask_of};
use crate::camera::{Camera, Observation};
use crate::dataset::lp::write_lp;
use crate::error;
use crate::eval::{Score, plot};
use crate::light;
use crate::relight::{Lookup, StackCamera};
use crate::solve::{self, Measurements, Validity, near, uncertainty};
use crate::stack::{BitDepth, Mask};
use crate::surface::{self, Integration};
use crate::view::{self, Tone};
use glam::{Vec2, Vec3};
use std::rc::Rc;
use wasm_bindgen::prelude::*;

/// One object ready for planners and solvers: linear values, light intensity divided out.
#[wasm_bindgen]
pub struct Stack(pub(super) Rc<Prepared>);

/// A stack with what its pictures need.
pub(super) struct Prepared {
    pub(super) stack: crate::stack::Stack,
    pub(super) tone: Tone,
    tint: Vec<[f32; 3]>,
    /// Of the pixels, see [`near::places`].
    pub(super) places: Vec<Vec2>,
}

impl Prepared {
    pub(super) fn photo(&self, o: &Observation, size: u32) -> Picture {
        Picture(view::photo(&self.stack.mask, &o.grey, &o.rgb, &self.tone).within(size))
    }
}

impl Stack {
    pub(super) fn new(stack: crate::stack::Stack) -> Self {
        let (tone, tint) = (Tone::of(&stack), view::tint(&stack));
        let places = near::places(&stack.mask);
        Self(Rc::new(Prepared { stack, tone, tint, places }))
    }
}

#[wasm_bindgen]
impl Stack {
    /// Width of the images in pixels.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn width(&self) -> u32 {
        self.0.stack.mask.width()
    }

    /// Height of the images in pixels.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn height(&self) -> u32 {
        self.0.stack.mask.height()
    }

    /// Number of pixels of the object.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.0.stack.mask.len()
    }

    /// The object's pixels: a byte for each pixel of the image, 1 or 0. `integrateNormals` takes it.
    #[must_use]
    pub fn mask(&self) -> Vec<u8> {
        self.0.stack.mask.scatter(&vec![1; self.0.stack.mask.len()], 0)
    }

    /// Light directions, three numbers for each image.
    #[must_use]
    pub fn lights(&self) -> Vec<f32> {
        flat(&self.0.stack.lights)
    }

    /// File names of the images.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        self.0.stack.names.clone()
    }

    /// Largest slant of its lights, degrees.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn reach(&self) -> f32 {
        light::reach(&self.0.stack.lights).to_degrees()
    }

    /// Whether the true normals are known.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn truth(&self) -> bool {
        self.0.stack.truth.is_some()
    }

    /// Image `k`, as a picture whose sides are at most `size` pixels.
    pub fn photo(&self, k: usize, size: u32) -> Result<Picture, JsError> {
        let Prepared { stack, tone, .. } = &*self.0;
        match (stack.grey.get(k), stack.rgb.get(k)) {
            (Some(grey), Some(rgb)) => Ok(Picture(view::photo(&stack.mask, grey, rgb, tone).within(size))),
            _ => Err(fail(format!("image {k}: the stack has {}", stack.len()))),
        }
    }

    /// The pictures under these directions (three numbers each), one after the other. `lookup` is `nearest` (no photo
    /// is given twice) or `soft:TAU`.
    pub fn observe(&self, requested: &[f32], lookup: &str) -> Result<Observations, JsError> {
        let lookup: Lookup = lookup.parse().map_err(fail)?;
        let camera = StackCamera::new(&self.0.stack, lookup);
        let mut seen = Vec::new();
        for d in directions(requested)? {
            let picture = camera.capture(d, &seen).map_err(fail)?;
            seen.push(picture);
        }
        Ok(Observations { of: Rc::clone(&self.0), seen: Rc::new(seen) })
    }
}

/// Pictures of one object, in the order in which they were taken.
#[wasm_bindgen]
pub struct Observations {
    pub(super) of: Rc<Prepared>,
    pub(super) seen: Rc<Vec<Observation>>,
}

#[wasm_bindgen]
impl Observations {
    /// How many.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn count(&self) -> usize {
        self.seen.len()
    }

    /// Picture `i`, with sides of at most `size` pixels.
    pub fn photo(&self, i: usize, size: u32) -> Result<Picture, JsError> {
        let o = self.seen.get(i).ok_or_else(|| fail(format!("picture {i} of {}", self.seen.len())))?;
        Ok(self.of.photo(o, size))
    }

    /// Their light directions and image names in the `.lp` format.
    #[wasm_bindgen(js_name = lightList)]
    #[must_use]
    pub fn light_list(&self) -> String {
        let name = |(i, o): (usize, &Observation)| {
            o.index.map_or_else(|| format!("{:03}.png", i + 1), |k| self.of.stack.names[k].clone())
        };
        let names: Vec<String> = self.seen.iter().enumerate().map(name).collect();
        let lights = self.seen.iter().map(|o| o.light.normalize_or(Vec3::Z));
        write_lp(names.iter().map(String::as_str).zip(lights))
    }

    /// Normals from all of them.
    pub fn solve(&self, solver: &str) -> Result<Solution, JsError> {
        let solver = super::solver(solver)?;
        let pictures = Measurements::of(&self.seen);
        let solve::Whole { solution, nearness } =
            solve::whole(&*solver, pictures, &self.of.stack.mask, true).map_err(fail)?;
        let errors = self.of.stack.truth.as_ref().map(|truth| error::error_map(&solution.normals, truth));
        Ok(Solution::of(&self.of, solution, errors, nearness))
    }

    /// The same in pieces, for a solver that takes seconds.
    pub fn tiles(&self, solver: &str) -> Result<Tiles, JsError> {
        Tiles::new(&self.of, &self.seen, solver)
    }
}

/// Normals of one object.
#[wasm_bindgen]
pub struct Solution {
    of: Rc<Prepared>,
    solution: solve::Solution,
    errors: Option<error::ErrorMap>,
    /// Of the lamps, taken out of the pictures.
    nearness: f32,
}

impl Solution {
    pub(super) fn of(
        of: &Rc<Prepared>,
        solution: solve::Solution,
        errors: Option<error::ErrorMap>,
        nearness: f32,
    ) -> Self {
        Self { of: Rc::clone(of), solution, errors, nearness }
    }

    pub(super) fn score(&self) -> Score {
        let mae = self.mae();
        Score { mae, predicted: if mae.is_none() { self.expected_error() } else { None } }
    }

    fn mask(&self) -> &Mask {
        &self.of.stack.mask
    }

    /// The mask pixel at a position of the cropped pictures.
    fn at(&self, x: u32, y: u32) -> Option<usize> {
        let (mask, frame) = (self.mask(), view::Frame::around(self.mask()));
        if x >= frame.width || y >= frame.height {
            return None;
        }
        let position = (y + frame.top) * mask.width() + x + frame.left;
        mask.indices().binary_search(&position).ok()
    }
}

#[wasm_bindgen]
impl Solution {
    /// Unit normals of the object's pixels, three numbers each.
    #[must_use]
    pub fn normals(&self) -> Vec<f32> {
        flat(&self.solution.normals)
    }

    /// Albedo of the object's pixels, in the images' units.
    #[must_use]
    pub fn albedo(&self) -> Vec<f32> {
        self.solution.albedo.clone()
    }

    /// Mean angular error, degrees, where the truth is known.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn mae(&self) -> Option<f64> {
        self.errors.as_ref().map(|e| e.mae)
    }

    /// Pixels without a true normal; they count as 90°.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn unknown(&self) -> usize {
        self.errors.as_ref().map_or(0, |e| e.unknown)
    }

    /// Pixels with too few usable values.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn invalid(&self) -> usize {
        self.solution.validity.iter().filter(|&&v| v != Validity::Valid).count()
    }

    /// Angular error of the object's pixels, degrees, where the truth is known.
    #[must_use]
    pub fn errors(&self) -> Option<Vec<f32>> {
        self.errors.as_ref().map(|e| e.degrees.clone())
    }

    /// The normals as colours.
    #[wasm_bindgen(js_name = normalsPicture)]
    #[must_use]
    pub fn normals_picture(&self) -> Picture {
        Picture(view::normals(self.mask(), &self.solution.normals))
    }

    /// The error map in colours, from 0 to `scale` degrees, where the truth is known.
    #[wasm_bindgen(js_name = errorPicture)]
    #[must_use]
    pub fn error_picture(&self, scale: f32) -> Option<Picture> {
        self.errors.as_ref().map(|e| Picture(view::errors(self.mask(), &e.degrees, scale)))
    }

    /// The expected error in colours, from 0 to `scale` degrees, where the solver gives one.
    #[wasm_bindgen(js_name = uncertaintyPicture)]
    #[must_use]
    pub fn uncertainty_picture(&self, scale: f32) -> Option<Picture> {
        let degrees = self.solution.uncertainty.as_ref()?;
        Some(Picture(view::errors(self.mask(), degrees, scale)))
    }

    /// Mean of the expected error over the object, degrees, where the solver gives one.
    #[wasm_bindgen(getter, js_name = expectedError)]
    #[must_use]
    pub fn expected_error(&self) -> Option<f64> {
        uncertainty::predicted_mae(&self.solution).map(f64::from)
    }

    /// How far away the lamps seem to be, half widths of the object, where their nearness was taken out of the pictures.
    #[wasm_bindgen(getter, js_name = lampDistance)]
    #[must_use]
    pub fn lamp_distance(&self) -> Option<f32> {
        (self.nearness > 0.0).then(|| 1.0 / self.nearness)
    }

    /// Column and row in the image, normal, expected error and (where known) error of the pixel at a position of the
    /// pictures.
    #[must_use]
    pub fn pixel(&self, x: u32, y: u32) -> Option<Vec<f32>> {
        let p = self.at(x, y)?;
        let (column, row) = self.mask().position(p);
        let mut values = vec![column as f32, row as f32];
        values.extend(self.solution.normals[p].to_array());
        values.push(self.solution.uncertainty.as_ref().map_or(f32::NAN, |u| u[p]));
        values.extend(self.errors.as_ref().map(|e| e.degrees[p]));
        Some(values)
    }

    /// The normals as a 16-bit RGB PNG of the whole image: (n + 1)/2 · 65535, black outside the object.
    #[wasm_bindgen(js_name = normalsPng)]
    pub fn normals_png(&self) -> Result<Vec<u8>, JsError> {
        plot::normal_map(self.mask(), &self.solution.normals, BitDepth::Sixteen).map_err(fail)
    }

    /// The error map with its colour bar as a PNG, from 0 to `scale` degrees, where the truth is known.
    #[wasm_bindgen(js_name = errorPng)]
    pub fn error_png(&self, scale: f32) -> Result<Option<Vec<u8>>, JsError> {
        self.errors.as_ref().map(|e| plot::error_map(self.mask(), e, scale).map_err(fail)).transpose()
    }

    /// The surface whose normals these are, from the heights that `integrateNormals` gives for them; left open where it
    /// breaks by more than `cliff` pixels.
    pub fn surface(&self, heights: &[f32], cliff: f32) -> Result<Surface, JsError> {
        let (normals, albedo) = (&self.solution.normals, &self.solution.albedo);
        if heights.len() != normals.len() {
            return Err(fail(format!("{} heights for {} pixels", heights.len(), normals.len())));
        }
        Ok(Surface(surface::Surface::new(self.mask(), heights, normals, albedo, cliff)))
    }

    /// The solved object, ready for any light.
    #[must_use]
    pub fn relit(&self) -> Relit {
        let Prepared { stack, tone, tint, .. } = &*self.of;
        let Self { solution, .. } = self;
        Relit(view::Relit::new(&stack.mask, &solution.normals, &solution.albedo, tint, tone.clone()))
    }
}

/// Heights of the object's pixels towards the camera, in pixels, from their unit normals (three numbers each). `mask` has a
/// byte for each pixel of a `width × height` image, not 0 on the object. Takes seconds for large objects.
#[wasm_bindgen(js_name = integrateNormals)]
pub fn integrate_normals(mask: &[u8], width: u32, height: u32, normals: &[f32]) -> Result<Vec<f32>, JsError> {
    let mask = mask_of(mask, width, height)?;
    let depth = surface::integrate(&mask, &directions(normals)?, &Integration::default(), || false);
    Ok(depth.map_err(fail)?.heights)
}

/// A solved object's surface: one vertex a pixel, x right, y up, z towards the camera, in pixels.
#[wasm_bindgen]
pub struct Surface(surface::Surface);

#[wasm_bindgen]
impl Surface {
    /// Seen from the side, turned by `yaw` and `tilt` degrees: `size × size` pixels.
    #[must_use]
    pub fn picture(&self, yaw: f32, tilt: f32, size: u32) -> Picture {
        Picture(view::surface(&self.0, yaw.to_radians(), tilt.to_radians(), size))
    }

    /// A mesh file: `ply`, `obj` or `glb`.
    pub fn write(&self, format: &str) -> Result<Vec<u8>, JsError> {
        Ok(self.0.write(format.parse().map_err(fail)?))
    }
}

/// A solved object under any light, shaded as Lambert would.
#[wasm_bindgen]
pub struct Relit(view::Relit);

#[wasm_bindgen]
impl Relit {
    /// The picture under a direction.
    pub fn under(&self, light: &[f32]) -> Result<Picture, JsError> {
        Ok(Picture(self.0.under(direction(light)?)))
    }
}
