//! Chooses the parameters of the robust solvers on synthetic pixels, and calibrates their uncertainty.

use super::{Generator, Pixels};
use crate::camera::Camera as _;
use crate::error::unit_angle;
use crate::render::worlds::{self, Split};
use crate::render::{Options, SceneCamera};
use crate::rng::Rng;
use crate::solve::{Measurements, SolveError, Solver};
use glam::Vec3;

/// Pixels of one number of lights: many light sets, some pixels under each.
#[must_use]
pub fn bench(generator: &Generator, seed: u64, lights: usize, sets: usize, pixels: usize) -> Vec<Pixels> {
    (0..sets)
        .map(|s| {
            let mut rng = Rng::stream(seed, s as u64);
            let set = generator.lights(&mut rng, lights);
            generator.pixels(&mut rng, set, pixels)
        })
        .collect()
}

/// The pixels of `objects` training objects of the rendered worlds, each under `lights` lights.
///
/// # Errors
/// Why the first object that can't be rendered can't.
pub fn rendered(objects: usize, lights: usize, size: u32) -> Result<Vec<Pixels>, String> {
    let generator = Generator::new(Split::Train);
    let options = Options { size, ..Options::default() };
    (0..objects)
        .map(|number| {
            let scene = worlds::training(1, number).scene(&options).map_err(|e| e.to_string())?;
            let camera = SceneCamera::new(&scene);
            let set = generator.lights(&mut Rng::stream(9, number as u64), lights);
            let take = |&l: &Vec3| camera.capture(l, &[]).map(|o| o.grey).map_err(|e| e.to_string());
            let images = set.iter().map(take).collect::<Result<_, _>>()?;
            Ok(Pixels { lights: set, images, normals: scene.truth().to_vec(), saturation: None })
        })
        .collect()
}

/// What a solver did on a bench.
#[derive(Clone, Debug, Default)]
pub struct Score {
    /// Angular error of each pixel, degrees.
    pub errors: Vec<f32>,
    /// What the solver expected, degrees; empty where it doesn't say.
    pub expected: Vec<f32>,
}

impl Score {
    /// Mean angular error, degrees.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.errors.iter().map(|&e| f64::from(e)).sum::<f64>() / self.errors.len().max(1) as f64
    }

    /// Mean of what the solver expected, degrees.
    #[must_use]
    pub fn mean_expected(&self) -> f64 {
        self.expected.iter().map(|&e| f64::from(e)).sum::<f64>() / self.expected.len().max(1) as f64
    }

    /// Spearman's rank correlation of expected and true error.
    #[must_use]
    pub fn rank_correlation(&self) -> f64 {
        rank_correlation(&self.expected, &self.errors)
    }
}

/// Runs a solver over a bench.
///
/// # Errors
/// [`SolveError`] of the solver.
pub fn score(solver: &dyn Solver, bench: &[Pixels]) -> Result<Score, SolveError> {
    let mut score = Score::default();
    for group in bench {
        let measurements = group.measurements();
        let mut solution = solver.solve(&measurements)?;
        crate::solve::uncertainty::complete(&measurements, &mut solution)?;
        let errors =
            solution.normals.iter().zip(&group.normals).map(|(&n, &t)| unit_angle(n, t).to_degrees());
        score.errors.extend(errors);
        score.expected.extend(solution.uncertainty.unwrap_or_default());
    }
    Ok(score)
}

impl Pixels {
    /// As a solver takes them.
    #[must_use]
    pub fn measurements(&self) -> Measurements<'_> {
        Measurements {
            lights: self.lights.clone(),
            images: self.images.iter().map(Vec::as_slice).collect(),
            saturation: self.saturation,
        }
    }
}

/// Spearman's rank correlation (ties get their mean rank); 0 for less than two values.
#[must_use]
pub fn rank_correlation(a: &[f32], b: &[f32]) -> f64 {
    let (ra, rb) = (ranks(a), ranks(b));
    let n = ra.len().min(rb.len()) as f64;
    let mean = (n - 1.0) / 2.0;
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (x, y) in ra.iter().zip(&rb) {
        ab += (x - mean) * (y - mean);
        aa += (x - mean) * (x - mean);
        bb += (y - mean) * (y - mean);
    }
    if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 }
}

fn ranks(values: &[f32]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    let mut ranks = vec![0.0; values.len()];
    let mut i = 0;
    while i < order.len() {
        let tie = order[i..].iter().take_while(|&&j| values[j] == values[order[i]]).count();
        for &j in &order[i..i + tie] {
            ranks[j] = i as f64 + (tie as f64 - 1.0) / 2.0;
        }
        i += tie;
    }
    ranks
}

/// The power law `degrees = factor · x^exponent` through (x, error) pairs whose mean error it keeps, fitted
/// where the errors are small as well as where they are large: bins of equal count, in logarithms.
#[must_use]
pub fn power_law(x: &[f32], errors: &[f32]) -> (f32, f32) {
    let mut order: Vec<usize> = (0..x.len()).collect();
    order.sort_by(|&i, &j| x[i].total_cmp(&x[j]));
    let bins = 20;
    let (mut n, mut sx, mut sy, mut sxx, mut sxy) = (0.0f64, 0.0, 0.0, 0.0, 0.0);
    for bin in order.chunks(order.len().div_ceil(bins).max(1)) {
        let lx = bin.iter().map(|&i| f64::from(x[i].max(1e-9)).ln()).sum::<f64>() / bin.len() as f64;
        let ly = (bin.iter().map(|&i| f64::from(errors[i])).sum::<f64>() / bin.len() as f64).max(1e-9).ln();
        (n, sx, sy, sxx, sxy) = (n + 1.0, sx + lx, sy + ly, sxx + lx * lx, sxy + lx * ly);
    }
    let exponent = (n * sxy - sx * sy) / (n * sxx - sx * sx).max(1e-12);
    let predicted: f64 = x.iter().map(|&v| f64::from(v.max(1e-9)).powf(exponent)).sum();
    let factor = errors.iter().map(|&e| f64::from(e)).sum::<f64>() / predicted.max(1e-12);
    (factor as f32, exponent as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rank_correlation_is_spearmans() {
        assert!((rank_correlation(&[1.0, 2.0, 3.0], &[10.0, 20.0, 900.0]) - 1.0).abs() < 1e-12);
        assert!((rank_correlation(&[1.0, 2.0, 3.0], &[3.0, 2.0, 1.0]) + 1.0).abs() < 1e-12);
        // Ties: ranks (0.5, 0.5, 2) and (0, 1, 2).
        assert!((rank_correlation(&[1.0, 1.0, 2.0], &[1.0, 2.0, 3.0]) - 0.866_025_4).abs() < 1e-6);
    }

    #[test]
    fn power_law_is_recovered() {
        let x: Vec<f32> = (1..2000).map(|i| i as f32 * 1e-3).collect();
        let y: Vec<f32> = x.iter().map(|v| 30.0 * v.powf(0.7)).collect();
        let (factor, exponent) = power_law(&x, &y);
        assert!((factor - 30.0).abs() < 0.5 && (exponent - 0.7).abs() < 0.05, "{factor} {exponent}");
    }
}
