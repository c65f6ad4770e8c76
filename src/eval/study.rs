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

/// Greedy search over K Fibonacci directions within `reach` (radians) for `lights` lights.
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
    for c in candidates {
        let o = camera.capture(c, &[])?;
        free.push((c, o.light, o.grey));
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
