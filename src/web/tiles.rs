//! Solving an object in pieces, each wherever the caller likes: a coarse preview first, then the rest.
//!
//! Every solver treats pixels apart, so any number of workers gives what one call gives.

use super::stack::{Prepared, Solution};
use super::{directions, fail, flat};
use crate::camera::Observation;
use crate::error;
use crate::solve::tiles::{Assembly, Piece};
use crate::solve::{self, Measurements, Validity, near, uncertainty};
use glam::{Vec2, Vec3};
use std::rc::Rc;
use wasm_bindgen::prelude::*;

/// Numbers a pixel in the result of [`solve_piece`]: normal (3), albedo, expected error in degrees, validity.
const NUMBERS: usize = 6;

/// A solution in the making.
#[wasm_bindgen]
pub struct Tiles {
    of: Rc<Prepared>,
    seen: Rc<Vec<Observation>>,
    assembly: Assembly,
    solver: String,
    /// Of the lamps, taken out of the values; see [`solve::nearness`].
    nearness: f32,
}

/// The values of some pixels, for `solvePiece`.
#[wasm_bindgen]
pub struct Values {
    first: usize,
    count: usize,
    values: Vec<f32>,
    saturated: Vec<u8>,
}

#[wasm_bindgen]
impl Values {
    /// Its place in the order of the pieces: what `Tiles.put` takes.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn first(&self) -> usize {
        self.first
    }

    /// Number of pixels.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Grey values, image after image.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn values(&self) -> Vec<f32> {
        self.values.clone()
    }

    /// 1 for each value that is saturated, else 0; nothing where none is.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn saturated(&self) -> Vec<u8> {
        self.saturated.clone()
    }
}

impl Tiles {
    pub(super) fn new(of: &Rc<Prepared>, seen: &Rc<Vec<Observation>>, solver: &str) -> Result<Self, JsError> {
        let pictures = Measurements::of(seen);
        pictures.check().map_err(fail)?;
        let nearness = solve::nearness(solver, &pictures, &of.places).map_err(fail)?;
        let assembly = Assembly::new(&of.stack.mask);
        let solver = solver.to_owned();
        Ok(Self { of: Rc::clone(of), seen: Rc::clone(seen), assembly, solver, nearness })
    }
}

#[wasm_bindgen]
impl Tiles {
    /// Light directions of the pictures, three numbers each.
    #[must_use]
    pub fn lights(&self) -> Vec<f32> {
        flat(&Measurements::of(&self.seen).lights)
    }

    /// Number of pixels.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn total(&self) -> usize {
        self.assembly.total()
    }

    /// Number of pixels that are solved.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn done(&self) -> usize {
        self.assembly.done()
    }

    /// How many of the four levels (every 8th pixel of every 8th row, every 4th, every 2nd, all) are solved.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn levels(&self) -> usize {
        self.assembly.levels()
    }

    /// The values of the next pixels, at most `most`; undefined when all were given.
    pub fn next(&mut self, most: usize) -> Result<Option<Values>, JsError> {
        let Some((first, pixels)) = self.assembly.next(most) else { return Ok(None) };
        let whole = Measurements::of(&self.seen);
        let mut piece = Piece::of(&whole, pixels);
        if self.nearness > 0.0 {
            let places: Vec<Vec2> = pixels.iter().map(|&p| self.of.places[p as usize]).collect();
            piece.images =
                near::distant(&piece.measurements(&whole), &places, self.nearness).map_err(fail)?;
        }
        let count = pixels.len();
        let mut saturated = Vec::new();
        if piece.saturated.iter().any(|flags| flags.contains(&true)) {
            for flags in &piece.saturated {
                let at = saturated.len();
                saturated.extend(flags.iter().map(|&f| u8::from(f)));
                saturated.resize(at + count, 0);
            }
        }
        Ok(Some(Values { first, count, values: piece.images.concat(), saturated }))
    }

    /// Takes in what `solvePiece` has made of the values that began at `first`.
    pub fn put(&mut self, first: usize, solved: &[f32]) -> Result<(), JsError> {
        let (rows, rest) = solved.as_chunks::<NUMBERS>();
        if !rest.is_empty() {
            return Err(fail(format!("{} numbers: {NUMBERS} for each pixel are needed", solved.len())));
        }
        let validity = |row: &[f32; NUMBERS]| match row[5] {
            0.0 => Validity::Valid,
            1.0 => Validity::Shadowed,
            _ => Validity::Saturated,
        };
        let part = solve::Solution {
            normals: rows.iter().map(|&[x, y, z, ..]| Vec3::new(x, y, z)).collect(),
            albedo: rows.iter().map(|row| row[3]).collect(),
            validity: rows.iter().map(validity).collect(),
            uncertainty: Some(rows.iter().map(|row| row[4]).collect()),
            own: Vec::new(),
        };
        self.assembly.put(first, &part).map_err(fail)
    }

    /// The solution: each pixel its own where all levels are solved, before that the next solved one's above and left. Once it is whole, it is
    /// finished ([`solve::finish`]), as that of another `solver` of the same pieces where one is named.
    pub fn solution(&self, solver: Option<String>) -> Result<Solution, JsError> {
        let mask = &self.of.stack.mask;
        let shown = self.assembly.shown(mask);
        let mut solution = self.assembly.solution(&shown);
        let whole = self.assembly.done() == self.assembly.total();
        if whole {
            let solver = solver.as_ref().unwrap_or(&self.solver);
            solve::finish(solver, mask, &mut solution).map_err(fail)?;
        }
        let errors = self.of.stack.truth.as_ref().map(|truth| {
            if whole {
                return error::error_map(&solution.normals, truth);
            }
            // A pixel shows another's error with that one's normal: its own would count the coarseness.
            let map = error::error_map(&self.assembly.solved().normals, truth);
            let degrees: Vec<f32> = shown.iter().map(|&p| map.degrees[p]).collect();
            let mae = degrees.iter().map(|&d| f64::from(d)).sum::<f64>() / degrees.len().max(1) as f64;
            error::ErrorMap { degrees, mae, unknown: map.unknown }
        });
        Ok(Solution::of(&self.of, solution, errors, self.nearness))
    }
}

/// Solves the pixels of a piece: `lights` has three numbers for each image, `values` the grey values of `count` pixels
/// for one image after the other, `saturated` 1 for each of them that is saturated (or nothing where none is). Six numbers a pixel: normal (3), albedo, expected error in degrees, and 0 for a valid
/// pixel, 1 for one in shadow, 2 for a saturated one.
#[wasm_bindgen(js_name = solvePiece)]
pub fn solve_piece(
    solver: &str,
    lights: &[f32],
    values: &[f32],
    saturated: &[u8],
    count: usize,
) -> Result<Vec<f32>, JsError> {
    let count = count.max(1);
    let flags: Vec<bool> = saturated.iter().map(|&f| f != 0).collect();
    let measurements = Measurements {
        lights: directions(lights)?,
        images: values.chunks_exact(count).collect(),
        saturated: flags.chunks(count).collect(),
    };
    let solver = super::solver(solver)?;
    let mut solution = solver.solve(&measurements).map_err(fail)?;
    uncertainty::complete(solver.name(), &measurements, &mut solution).map_err(fail)?;
    let degrees = solution.uncertainty.unwrap_or_default();
    let rows = solution.normals.iter().zip(&solution.albedo).zip(&degrees).zip(&solution.validity);
    Ok(rows
        .flat_map(|(((n, &albedo), &degrees), validity)| {
            let validity = match validity {
                Validity::Valid => 0.0,
                Validity::Shadowed => 1.0,
                Validity::Saturated => 2.0,
            };
            [n.x, n.y, n.z, albedo, degrees, validity]
        })
        .collect())
}
