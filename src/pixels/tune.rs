//! Chooses the parameters of the robust solvers on synthetic pixels.

use super::{Generator, Pixels};
use crate::error::unit_angle;
use crate::rng::Rng;
use crate::solve::{Measurements, SolveError, Solver};

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
        crate::solve::uncertainty::complete(solver.name(), &measurements, &mut solution)?;
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
            saturated: self.saturated.iter().map(Vec::as_slice).collect(),
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
}
