//! The reconstruction loss of a run of lights and its exact gradient, by hand: the graph of burn then holds the
//! network alone, and the photometric-stereo part costs a few passes over the pixels.

use glam::{DMat3, DVec3, Vec3};
use serde::{Deserialize, Serialize};

/// The pictures of one object in the order of capture, as a solver sees them.
#[derive(Clone, Copy, Debug)]
pub struct Captured<'a> {
    /// Light direction of each picture.
    pub lights: &'a [Vec3],
    /// Grey value of every mask pixel, for each picture.
    pub grey: &'a [Vec<f32>],
    /// True unit normals of the mask pixels.
    pub truth: &'a [Vec3],
}

/// How far a normal n is from the true one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Measure {
    /// 1 − n·n_gt, the paper's. About half the square of the angle: glossy objects with their large errors count most.
    Cosine,
    /// The angle, radians: what objects are judged by.
    Angle,
}

/// Widens the arc cosine so that its slope is finite where normals agree: `arccos(c/s) − arccos(1/s)`, s² = 1 + this (about 1°).
const ROUNDING: f64 = 4e-4;

impl Measure {
    /// The measure of a cosine, and minus its slope.
    fn of(self, cosine: f64) -> (f64, f64) {
        match self {
            Self::Cosine => (1.0 - cosine, 1.0),
            Self::Angle => {
                let s = (1.0 + ROUNDING).sqrt();
                let slope = 1.0 / (s * s - cosine * cosine).max(ROUNDING).sqrt();
                (libm::acos(cosine / s) - libm::acos(1.0 / s), slope)
            }
        }
    }
}

/// Loss of a run and its gradient.
#[derive(Clone, Debug)]
pub struct Loss {
    /// Weighted sum over the steps.
    pub total: f64,
    /// Mean of the measure after the last picture.
    pub last: f64,
    /// dLoss/d(light), for each picture, at fixed images.
    pub lights: Vec<Vec3>,
    /// dLoss/d(grey value), for each picture and mask pixel.
    pub grey: Vec<Vec<f32>>,
}

/// A solver that a policy can be trained through.
pub trait TrainingSolver: Sync {
    /// Its name on the command line.
    fn name(&self) -> &'static str;

    /// Σ_t weights[t−1]·mean(measure of n), with the normals `n` solved from the first t pictures; steps of weight zero
    /// are skipped. `weights` has one entry a picture.
    fn loss(&self, captured: &Captured, weights: &[f64], measure: Measure) -> Loss;
}

/// Weight of the loss after picture t = i+1: 1 − 0.9^i from picture `first` on, 0 before (COIL-PS: Σ_{i=3}^{T−1} w_i L_{i+1},
/// so `first` is 4).
#[must_use]
pub fn step_weights(lights: usize, first: usize) -> Vec<f64> {
    (0..lights).map(|i| if i + 1 >= first { 1.0 - libm::pow(0.9, i as f64) } else { 0.0 }).collect()
}

/// Least squares, with a small ridge on LᵀL so that lights which (still) lie in one plane give a finite gradient.
#[derive(Clone, Copy, Debug)]
pub struct LeastSquares {
    /// Added to the diagonal of LᵀL.
    pub ridge: f64,
}

impl Default for LeastSquares {
    fn default() -> Self {
        Self { ridge: 1e-3 }
    }
}

impl TrainingSolver for LeastSquares {
    fn name(&self) -> &'static str {
        "ls"
    }

    fn loss(&self, captured: &Captured, weights: &[f64], measure: Measure) -> Loss {
        let Captured { lights, grey, truth } = *captured;
        let (count, pixels) = (lights.len(), truth.len());
        let directions: Vec<DVec3> = lights.iter().map(|l| l.as_dvec3()).collect();
        let mut gram = DMat3::from_diagonal(DVec3::splat(self.ridge));
        let mut inverses = Vec::with_capacity(count);
        for l in &directions {
            gram += DMat3::from_cols(*l * l.x, *l * l.y, *l * l.z);
            inverses.push(gram.inverse());
        }
        // Adjoint of LᵀL after each picture, summed over pixels.
        let mut gram_adjoint = vec![DMat3::ZERO; count];
        let mut light_gradient = vec![DVec3::ZERO; count];
        let mut grey_gradient = vec![vec![0.0f32; pixels]; count];
        let (mut total, mut last) = (0.0, 0.0);
        let mut stage_rhs = vec![DVec3::ZERO; count];
        for p in 0..pixels {
            let mut rhs = DVec3::ZERO;
            for t in 0..count {
                rhs += directions[t] * f64::from(grey[t][p]);
                stage_rhs[t] = rhs;
            }
            let n_gt = truth[p].as_dvec3();
            // dLoss/d(rhs), summed over this and all later steps.
            let mut adjoint = DVec3::ZERO;
            for t in (0..count).rev() {
                if weights[t] != 0.0 {
                    let g = inverses[t] * stage_rhs[t];
                    let length = g.length().max(1e-9);
                    let n = g / length;
                    let cosine = n.dot(n_gt);
                    let weight = weights[t] / pixels as f64;
                    let (value, slope) = measure.of(cosine);
                    total += weight * value;
                    if t + 1 == count {
                        last += value / pixels as f64;
                    }
                    let u = (n * cosine - n_gt) * (slope * weight / length);
                    let v = inverses[t] * u;
                    adjoint += v;
                    gram_adjoint[t] -= DMat3::from_cols(v * g.x, v * g.y, v * g.z);
                }
                grey_gradient[t][p] = directions[t].dot(adjoint) as f32;
                light_gradient[t] += adjoint * f64::from(grey[t][p]);
            }
        }
        let mut sum = DMat3::ZERO;
        for t in (0..count).rev() {
            sum += gram_adjoint[t];
            light_gradient[t] += (sum + sum.transpose()) * directions[t];
        }
        Loss {
            total,
            last,
            lights: light_gradient.iter().map(|g| g.as_vec3()).collect(),
            grey: grey_gradient,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::fibonacci_cap;
    use crate::rng::Rng;
    use crate::solve::{LeastSquares as Exact, Measurements, Solver};

    fn scene(count: usize) -> (Vec<Vec3>, Vec<Vec<f32>>, Vec<Vec3>) {
        let mut rng = Rng::new(3);
        let truth = fibonacci_cap(40, 1.2);
        let lights: Vec<Vec3> = (0..count).map(|_| rng.direction(1.2)).collect();
        let grey = lights
            .iter()
            .map(|l| truth.iter().map(|n| n.dot(*l).max(0.0).powf(1.5) + 0.05 * rng.uniform()).collect())
            .collect();
        (lights, grey, truth)
    }

    #[test]
    fn weights_are_the_papers() {
        let w = step_weights(10, 4);
        assert_eq!(w[..3], [0.0; 3]);
        assert!(
            (w[3] - (1.0 - 0.9f64.powi(3))).abs() < 1e-12 && (w[9] - (1.0 - 0.9f64.powi(9))).abs() < 1e-12
        );
    }

    #[test]
    fn the_normals_are_those_of_the_core_solver() {
        let (lights, grey, truth) = scene(6);
        let captured = Captured { lights: &lights, grey: &grey, truth: &truth };
        let loss =
            LeastSquares { ridge: 0.0 }.loss(&captured, &[0.0, 0.0, 0.0, 0.0, 0.0, 1.0], Measure::Cosine);
        let images = grey.iter().map(Vec::as_slice).collect();
        let m = Measurements { lights: lights.clone(), images, saturated: Vec::new() };
        let normals = Exact.solve(&m).unwrap().normals;
        let mean = normals.iter().zip(&truth).map(|(a, b)| 1.0 - f64::from(a.dot(*b))).sum::<f64>() / 40.0;
        assert!((loss.last - mean).abs() < 1e-6 && (loss.total - mean).abs() < 1e-6);
    }

    #[test]
    fn gradients_agree_with_finite_differences() {
        let (lights, grey, truth) = scene(5);
        let solver = LeastSquares::default();
        let weights = step_weights(5, 3);
        for measure in [Measure::Cosine, Measure::Angle] {
            let value = |lights: &[Vec3], grey: &[Vec<f32>]| {
                solver.loss(&Captured { lights, grey, truth: &truth }, &weights, measure).total
            };
            let loss =
                solver.loss(&Captured { lights: &lights, grey: &grey, truth: &truth }, &weights, measure);
            let h = 1e-3f32;
            for t in 0..5 {
                for axis in 0..3 {
                    let moved = |step: f32| {
                        let mut l = lights.clone();
                        l[t][axis] += step;
                        value(&l, &grey)
                    };
                    let numeric = (moved(h) - moved(-h)) / f64::from(2.0 * h);
                    assert!((numeric - f64::from(loss.lights[t][axis])).abs() < 1e-3, "light {t}.{axis}");
                }
                for p in [0, 7, 39] {
                    let moved = |step: f32| {
                        let mut g = grey.clone();
                        g[t][p] += step;
                        value(&lights, &g)
                    };
                    let numeric = (moved(h) - moved(-h)) / f64::from(2.0 * h);
                    assert!((numeric - f64::from(loss.grey[t][p])).abs() < 1e-4, "grey {t}.{p}");
                }
            }
        }
    }
}
