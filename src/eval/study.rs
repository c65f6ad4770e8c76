//! The brute-force study over K: how much a finer choice of lights is worth to someone who sees the truth.
//!
//! K Fibonacci directions; each step takes the one that lowers the true error of least squares most (COIL-PS,
//! motivation for continuous light: 7.72° at K = 50, 6.95° at K = 1000 for T = 10).

use crate::camera::{Camera, CameraError};
use crate::error::unit_angle;
use crate::light::fibonacci_cap;
use crate::solve::least_squares::NormalEquations;
use glam::Vec3;
use serde::Serialize;
use std::collections::HashSet;

/// The greedy set of one K on one object.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Greedy {
    /// Number of candidates.
    pub k: usize,
    /// The directions in the order chosen.
    #[serde(skip)]
    pub chosen: Vec<Vec3>,
    /// True MAE in degrees after 1, 2, … lights. Below three lights it is that of a nearly singular system.
    pub mae: Vec<f64>,
}

/// Greedy search over K Fibonacci directions within `reach` (radians) for `lights` lights. Candidates that one stored photo
/// answers are one light: less than `lights` are chosen where there are less photos.
///
/// `stop` is asked once a step; true ends the search with what it has.
///
/// # Errors
/// [`CameraError`] where a candidate's picture can't be taken.
pub fn greedy(
    camera: &dyn Camera,
    truth: &[Vec3],
    k: usize,
    reach: f32,
    lights: usize,
    mut stop: impl FnMut() -> bool,
) -> Result<Greedy, CameraError> {
    let candidates = fibonacci_cap(k, reach);
    let mut free: Vec<(Vec3, Vec3, Vec<f32>)> = Vec::with_capacity(k);
    let mut photos = HashSet::new();
    for c in candidates {
        let o = camera.capture(c, &[])?;
        if o.index.is_none_or(|photo| photos.insert(photo)) {
            free.push((c, o.light, o.grey));
        }
    }
    let mut equations = NormalEquations::new(truth.len());
    let mut result = Greedy { k, chosen: Vec::new(), mae: Vec::new() };
    while result.chosen.len() < lights && !free.is_empty() && !stop() {
        let mut best = (0, f64::INFINITY);
        for (i, (_, light, image)) in free.iter().enumerate() {
            let mut sum = 0.0;
            equations.preview(*light, image, |p, n| sum += f64::from(unit_angle(n, truth[p])));
            if sum < best.1 {
                best = (i, sum);
            }
        }
        let (direction, light, image) = free.remove(best.0);
        equations.add(light, &image);
        result.chosen.push(direction);
        result.mae.push((best.1 / truth.len() as f64).to_degrees());
    }
    Ok(result)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::relight::{Lookup, StackCamera};
    use crate::stack::{BitDepth, Mask, Stack};

    #[test]
    fn no_photo_is_taken_twice() {
        let normals = fibonacci_cap(16, 1.0);
        let lights = fibonacci_cap(6, 0.8);
        let shade = |l: &Vec3| normals.iter().map(|n| n.dot(*l).max(0.0)).collect::<Vec<f32>>();
        let stack = Stack {
            name: "cap".into(),
            mask: Mask::full(4, 4).unwrap(),
            bits: BitDepth::Sixteen,
            grey: lights.iter().map(shade).collect(),
            rgb: vec![vec![[0.0; 3]; 16]; 6],
            names: (0..6).map(|k| k.to_string()).collect(),
            lights: lights.clone(),
            truth: None,
            saturated: vec![Vec::new(); 6],
        };
        let camera = StackCamera::new(&stack, Lookup::Nearest);
        let of = |k, lights| greedy(&camera, &normals, k, 0.8, lights, || false).unwrap();
        // All six photos are one set, however many candidates lead to them.
        let (few, many) = (of(6, 6), of(200, 8));
        assert_eq!((few.mae.len(), many.mae.len()), (6, 6));
        assert!((few.mae[5] - many.mae[5]).abs() < 1e-9, "{} {}", few.mae[5], many.mae[5]);
        // Blends of photos are as many as are asked for.
        let camera = StackCamera::new(&stack, Lookup::Soft { tau: 0.1 });
        assert_eq!(greedy(&camera, &normals, 50, 0.8, 8, || false).unwrap().mae.len(), 8);
    }
}
