//! Solving an object in pieces, each wherever the caller likes: a coarse preview first, then the rest.
//!
//! Every solver treats pixels apart, so any number of workers gives what one call gives.

use super::stack::{Prepared, Solution};
use super::{directions, fail, flat};
use crate::camera::Observation;
use crate::error;
use crate::solve::tiles::{self, Piece};
use crate::solve::{self, Measurements, Validity, uncertainty};
use glam::Vec3;
use std::rc::Rc;
use wasm_bindgen::prelude::*;

/// Numbers a pixel in the result of [`solve_piece`]: normal (3), albedo, expected error in degrees, validity.
const NUMBERS: usize = 6;

/// A solution in the making.
#[wasm_bindgen]
pub struct Tiles {
    of: Rc<Prepared>,
    seen: Rc<Vec<Observation>>,
    /// Mask pixels, coarse to fine.
    order: Vec<u32>,
    /// Where the levels end in `order`.
    ends: [usize; 4],
    /// How many pixels of each level are not solved yet.
    left: [usize; 4],
    given: usize,
    out: solve::Solution,
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
    pub(super) fn new(of: &Rc<Prepared>, seen: &Rc<Vec<Observation>>) -> Result<Self, JsError> {
        let pixels = Measurements::of(seen).check().map_err(fail)?;
        let levels = tiles::coarse_to_fine(&of.stack.mask);
        let left = levels.each_ref().map(Vec::len);
        let mut end = 0;
        let ends = left.map(|count| {
            end += count;
            end
        });
        let out = solve::Solution {
            normals: vec![Vec3::Z; pixels],
            albedo: vec![0.0; pixels],
            validity: vec![Validity::Shadowed; pixels],
            uncertainty: Some(vec![90.0; pixels]),
            own: Vec::new(),
        };
        let (of, seen, order) = (Rc::clone(of), Rc::clone(seen), levels.concat());
        Ok(Self { of, seen, order, ends, left, given: 0, out })
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
        self.order.len()
    }

    /// Number of pixels that are solved.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn done(&self) -> usize {
        self.order.len() - self.left.iter().sum::<usize>()
    }

    /// How many of the four levels (every 8th pixel of every 8th row, every 4th, every 2nd, all) are solved.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn levels(&self) -> usize {
        self.left.iter().take_while(|&&left| left == 0).count()
    }

    /// The values of the next pixels, at most `most`; undefined when all were given.
    pub fn next(&mut self, most: usize) -> Option<Values> {
        let first = self.given;
        let level_end = *self.ends.iter().find(|&&end| end > first)?;
        let end = level_end.min(first + most.max(1));
        self.given = end;
        let piece = Piece::of(&Measurements::of(&self.seen), &self.order[first..end]);
        let count = end - first;
        let mut saturated = Vec::new();
        if piece.saturated.iter().any(|flags| flags.contains(&true)) {
            for flags in &piece.saturated {
                let at = saturated.len();
                saturated.extend(flags.iter().map(|&f| u8::from(f)));
                saturated.resize(at + count, 0);
            }
        }
        Some(Values { first, count, values: piece.images.concat(), saturated })
    }

    /// Takes in what `solvePiece` has made of the values that began at `first`.
    pub fn put(&mut self, first: usize, solved: &[f32]) -> Result<(), JsError> {
        let (rows, rest) = solved.as_chunks::<NUMBERS>();
        let pixels = self.order.get(first..first + rows.len()).filter(|_| rest.is_empty());
        let pixels = pixels.ok_or_else(|| fail(format!("{} numbers from pixel {first}", solved.len())))?;
        let level = self.ends.iter().position(|&end| end > first).unwrap_or(3);
        for (&p, &[x, y, z, albedo, degrees, validity]) in pixels.iter().zip(rows) {
            let p = p as usize;
            self.out.normals[p] = Vec3::new(x, y, z);
            self.out.albedo[p] = albedo;
            self.out.validity[p] = match validity {
                0.0 => Validity::Valid,
                1.0 => Validity::Shadowed,
                _ => Validity::Saturated,
            };
            if let Some(uncertainty) = &mut self.out.uncertainty {
                uncertainty[p] = degrees;
            }
        }
        self.left[level] = self.left[level].saturating_sub(rows.len());
        Ok(())
    }

    /// The solution: each pixel its own where all levels are solved, before that the next solved one's above and left.
    #[must_use]
    pub fn solution(&self) -> Solution {
        let levels = self.levels();
        let mut last = self.order.first().map_or(0, |&p| p as usize);
        let shown: Vec<usize> = tiles::shown_by(&self.of.stack.mask, levels.max(1) - 1)
            .into_iter()
            .map(|by| {
                last = by.map_or(last, |p| p as usize);
                last
            })
            .collect();
        let all = &self.out;
        let solution = solve::Solution {
            normals: shown.iter().map(|&p| all.normals[p]).collect(),
            albedo: shown.iter().map(|&p| all.albedo[p]).collect(),
            validity: shown.iter().map(|&p| all.validity[p]).collect(),
            uncertainty: all.uncertainty.as_ref().map(|u| shown.iter().map(|&p| u[p]).collect()),
            own: Vec::new(),
        };
        let errors = self.of.stack.truth.as_ref().map(|truth| {
            // A pixel shows another's error with that one's normal: its own would count the coarseness.
            let map = error::error_map(&all.normals, truth);
            let degrees: Vec<f32> = shown.iter().map(|&p| map.degrees[p]).collect();
            let mae = degrees.iter().map(|&d| f64::from(d)).sum::<f64>() / degrees.len().max(1) as f64;
            error::ErrorMap { degrees, mae, unknown: map.unknown }
        });
        Solution::of(&self.of, solution, errors)
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
