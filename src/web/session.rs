//! The loop for a camera of the caller's: the planner names a direction, the caller takes the picture.

use super::{direction, directions, fail, flat, mask_of};
use crate::camera::{Domain, Observation};
use crate::image::luma;
use crate::planner::{self, Choice, Setup};
use crate::session::{self, Step};
use wasm_bindgen::prelude::*;

/// A capture of T lights in progress: `next` says where the light should be, `observe` takes in the picture.
#[wasm_bindgen]
pub struct Session(session::Session<'static>);

#[wasm_bindgen]
impl Session {
    /// A session for the pixels of `mask` (a byte for each pixel of a `width × height` image, not 0 on the object).
    /// `candidates` are the lights there are, three numbers each; where it is empty, any direction whose slant is at
    /// most `reach` degrees may be asked for.
    #[wasm_bindgen(constructor)]
    #[allow(clippy::too_many_arguments)]
    pub fn new(
        mask: &[u8],
        width: u32,
        height: u32,
        planner: &str,
        lights: usize,
        candidates: &[f32],
        reach: f32,
        seed: u32,
    ) -> Result<Self, JsError> {
        let mask = mask_of(mask, width, height)?;
        let fixed = planner::info(planner).map_err(fail)?.choice == Choice::Fixed;
        let domain = match directions(candidates)? {
            list if list.is_empty() || fixed => Domain::Hemisphere { reach: reach.to_radians() },
            list => Domain::Candidates(list),
        };
        let setup = Setup { lights, seed: seed.into(), draw: 0, camera: None, truth: None, learned: None };
        let planner = planner::build(planner, &setup).map_err(fail)?;
        Ok(Self(session::Session::new(mask, domain, planner, lights)))
    }

    /// The direction of the next light; undefined when all pictures are there. Asking again gives the same answer.
    #[wasm_bindgen(unchecked_return_type = "Float32Array | undefined")]
    pub fn next(&mut self) -> Result<Option<Vec<f32>>, JsError> {
        Ok(match self.0.step().map_err(fail)? {
            Step::Capture(direction) => Some(direction.to_array().to_vec()),
            Step::Done => None,
        })
    }

    /// Takes in the picture that was asked for: the direction of its light, and linear RGB of the mask pixels.
    pub fn observe(&mut self, light: &[f32], rgb: &[f32]) -> Result<(), JsError> {
        let light = direction(light)?;
        let Step::Capture(requested) = self.0.step().map_err(fail)? else {
            return Err(fail("the session is complete: it takes no further picture"));
        };
        let rgb: Vec<[f32; 3]> = rgb.as_chunks().0.to_vec();
        let grey = rgb.iter().map(|&c| luma(c)).collect();
        let picture = Observation::new(requested, light, grey, rgb);
        self.0.observe(picture).map_err(fail)
    }

    /// Unit normals of the mask pixels, three numbers each, from the pictures so far (at least three).
    pub fn normals(&self, solver: &str) -> Result<Vec<f32>, JsError> {
        let solver = super::solver(solver)?;
        let solution = self.0.solve(&*solver, usize::MAX).map_err(fail)?;
        Ok(flat(&solution.normals))
    }
}
