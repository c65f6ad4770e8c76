//! What a pixel's neighbours tell of its error.
//!
//! Where surfaces meet, light goes from one to the other and values agree on a wrong normal: a pixel by itself looks well. Its neighbours
//! tell: normals that change fast or fold inwards, albedo that isn't that of the rest, expected errors all around. A small network
//! over such [`CUES`] shares the object's expected error out among its pixels anew. Their mean, the predicted MAE, stays what
//! it was: it does not depend on which pixels are asked.

use super::perceptron::Perceptron;
use super::smooth::Smoother;
use super::{Solution, SolveError};
use crate::stack::Mask;
use glam::Vec3;

/// Number of values that describe a pixel among others.
pub const CUES: usize = 22;

/// Standard deviations of the means over neighbours, in half widths of the object; at least [`NARROWEST`] pixels.
const SCALES: [f32; 4] = [0.02, 0.05, 0.12, 0.25];
const NARROWEST: f32 = 0.6;
/// Albedo counts as at least this fraction of its mean.
const DARKEST: f32 = 1e-3;
/// Expected errors are divided or multiplied by at most e to this.
const MOST: f32 = 3.0;

/// What a solver found, of all pixels of the mask.
#[derive(Clone, Copy, Debug)]
pub struct Found<'a> {
    /// Unit normals.
    pub normals: &'a [Vec3],
    /// Albedo.
    pub albedo: &'a [f32],
    /// Error expected of each pixel by itself, degrees.
    pub degrees: &'a [f32],
}

impl<'a> Found<'a> {
    /// What a solution of all pixels of `mask` has; `None` without expected errors.
    ///
    /// # Errors
    /// [`SolveError::Places`] where it isn't one of all pixels.
    pub fn of(mask: &Mask, solution: &'a Solution) -> Result<Option<Self>, SolveError> {
        let Some(degrees) = &solution.uncertainty else { return Ok(None) };
        let Solution { normals, albedo, .. } = solution;
        for found in [normals.len(), albedo.len(), degrees.len()] {
            if found != mask.len() {
                return Err(SolveError::Places { found, expected: mask.len() });
            }
        }
        Ok(Some(Self { normals, albedo, degrees }))
    }
}

/// The cues of every pixel.
///
/// # Panics
/// Where there is not one normal, albedo and error for each pixel of the mask.
#[must_use]
pub fn cues(mask: &Mask, found: &Found) -> Vec<[f32; CUES]> {
    let pixels = mask.len();
    let (_, _, width, height) = mask.bounds();
    let half = 0.5 * width.max(height) as f32;
    let log = |v: f32| libm::logf(v.max(1e-20));
    let errors: Vec<f32> = found.degrees.iter().map(|&d| libm::logf(d.clamp(0.02, 90.0))).collect();
    let whole = mean(&errors);
    let bright = mean(found.albedo).max(1e-20);
    let albedo: Vec<f32> = found.albedo.iter().map(|&a| log((a / bright).max(DARKEST))).collect();
    let part = |axis: usize| -> Vec<f32> { found.normals.iter().map(|n| n[axis]).collect() };
    let parts = [part(0), part(1), part(2)];

    let mut rows = vec![[0.0; CUES]; pixels];
    let mut column = 0;
    let mut add = |values: &mut dyn Iterator<Item = f32>| {
        rows.iter_mut().zip(values).for_each(|(row, v)| row[column] = v);
        column += 1;
    };
    add(&mut errors.iter().copied());
    add(&mut std::iter::repeat_n(whole, pixels));
    add(&mut parts[2].iter().copied());
    for (scale, share) in SCALES.into_iter().enumerate() {
        let smoother = Smoother::new(mask, (share * half).max(NARROWEST));
        let around = parts.each_ref().map(|part| smoother.mean(part));
        let normal = |p: usize| Vec3::new(around[0][p], around[1][p], around[2][p]);
        add(&mut smoother.mean(&errors).into_iter());
        // Positive where the surface bulges, negative where it folds inwards.
        let (across, up) = (smoother.slopes(&around[0]), smoother.slopes(&around[1]));
        add(&mut across.iter().zip(&up).map(|(x, y)| libm::asinhf(half * (x[0] + y[1]))));
        if scale < 3 {
            add(&mut (0..pixels).map(|p| log((found.normals[p] - normal(p)).length() + 1e-3)));
            add(&mut smoother.cover().iter().copied());
        }
        if scale < 2 {
            let unlike: Vec<f32> =
                (0..pixels).map(|p| (found.normals[p] - normal(p)).length_squared()).collect();
            add(&mut smoother.mean(&unlike).into_iter().map(|v| log(v + 1e-6)));
        }
        if scale == 0 {
            add(&mut around[2].iter().copied());
        }
        if scale == 1 || scale == 3 {
            let around = smoother.mean(&albedo);
            add(&mut albedo.iter().zip(&around).map(|(a, m)| a - m));
        }
    }
    rows
}

/// Expected errors of all pixels, in degrees, shared out anew; their mean stays.
///
/// # Panics
/// As [`cues`].
#[must_use]
pub fn shared_out(network: &Perceptron<CUES>, mask: &Mask, found: &Found) -> Vec<f32> {
    let outputs: Vec<f32> = cues(mask, found).iter().map(|c| network.output(c)).collect();
    let middle = mean(&outputs);
    let shares: Vec<f32> = outputs.iter().map(|o| libm::expf((o - middle).clamp(-MOST, MOST))).collect();
    let unit = mean(found.degrees) / mean(&shares).max(1e-6);
    shares.into_iter().map(|share| (unit * share).min(90.0)).collect()
}

/// Mean, 0 of nothing.
pub(super) fn mean(values: &[f32]) -> f32 {
    (values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len().max(1) as f64) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    /// A bulge beside a hollow on a disc of this many pixels, seen without errors.
    fn bulge_and_hollow(side: u32) -> (Mask, Vec<Vec3>) {
        let at = |i: u32| (i as f32 + 0.5) / side as f32 * 2.0 - 1.0;
        let inside: Vec<bool> = (0..side * side).map(|i| at(i % side).hypot(at(i / side)) < 0.98).collect();
        let mask = Mask::new(side, side, &inside).unwrap();
        let normal = |p| {
            let (x, y) = mask.position(p);
            let (x, y) = (at(x), -at(y));
            // Height is sin(3x) e^(−y²).
            let fall = libm::expf(-y * y);
            Vec3::new(-3.0 * libm::cosf(3.0 * x) * fall, 2.0 * y * libm::sinf(3.0 * x) * fall, 1.0)
                .normalize()
        };
        let normals = (0..mask.len()).map(normal).collect();
        (mask, normals)
    }

    fn of(mask: &Mask, normals: &[Vec3]) -> Vec<[f32; CUES]> {
        let flat = vec![1.0; mask.len()];
        cues(mask, &Found { normals, albedo: &flat, degrees: &flat })
    }

    #[test]
    fn bulges_and_hollows_differ() {
        let (mask, normals) = bulge_and_hollow(80);
        let cues = of(&mask, &normals);
        let at = |x: u32| (0..mask.len()).find(|&p| mask.position(p) == (x, 40)).unwrap();
        // The bulge is at x = π/6 of a half width, the hollow at −π/6.
        for bend in [4, 10] {
            let [bulge, hollow] = [61, 19].map(|x| cues[at(x)][bend]);
            assert!(bulge > 1.0 && hollow < -1.0, "{bulge} {hollow}");
        }
    }

    #[test]
    fn resolution_matters_little() {
        let [small, large] = [90, 180].map(bulge_and_hollow);
        let [few, many] = [&small, &large].map(|(mask, normals)| of(mask, normals));
        let mean = |cues: &[[f32; CUES]], c: usize| mean(&cues.iter().map(|row| row[c]).collect::<Vec<_>>());
        for c in 0..CUES {
            let [a, b] = [mean(&few, c), mean(&many, c)];
            assert!((a - b).abs() < 0.15, "cue {c}: {a} {b}");
        }
    }

    #[test]
    fn nothing_but_finite_numbers() {
        let mut rng = Rng::new(8);
        for (width, height) in [(1, 1), (1, 30), (2, 2), (31, 17)] {
            let mask = Mask::full(width, height).unwrap();
            let normals: Vec<Vec3> = (0..mask.len()).map(|_| rng.direction(1.5)).collect();
            for albedo in [0.0, 1e-30, 1e30] {
                let albedo: Vec<f32> =
                    (0..mask.len()).map(|_| if rng.uniform() < 0.5 { 0.0 } else { albedo }).collect();
                let degrees: Vec<f32> = (0..mask.len()).map(|_| 90.0 * rng.uniform().round()).collect();
                let found = Found { normals: &normals, albedo: &albedo, degrees: &degrees };
                assert!(cues(&mask, &found).iter().flatten().all(|v| v.is_finite()));
            }
        }
    }

    #[test]
    fn the_mean_stays() {
        let (mask, normals) = bulge_and_hollow(40);
        let mut rng = Rng::new(9);
        let degrees: Vec<f32> = (0..mask.len()).map(|_| rng.range(0.5, 20.0)).collect();
        let found = Found { normals: &normals, albedo: &vec![0.5; mask.len()], degrees: &degrees };
        let weights = (0..Perceptron::<CUES>::WEIGHTS).map(|_| 0.3 * rng.normal()).collect();
        let network =
            Perceptron { mean: vec![0.0; CUES], deviation: vec![1.0; CUES], weights, rectified: false };
        let shared = shared_out(&network, &mask, &found);
        assert!((mean(&shared) - mean(&degrees)).abs() < 1e-3);
        assert_ne!(shared, degrees);
    }
}
