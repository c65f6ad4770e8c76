//! TK22 (Tanikawa, Kawahara, Okabe, "Online Illumination Planning for Shadow-Robust Photometric Stereo", 2022).
//!
//! Online: finds the pixel whose lit measurements determine its normal worst and puts the next light where that
//! pixel is probably lit and the measurement is most informative.

use super::{PlanError, Planner, View, ascend};
use crate::camera::{Domain, Observation};
use crate::light;
use crate::rng::Rng;
use glam::{DMat3, DVec3, Vec3};

/// Candidates of the dense scan on a continuous domain.
const SCAN: usize = 2000;
/// Share of the captured intensities that counts as shadow.
const SHADOW_QUANTILE: f32 = 0.1;
/// Largest tr A⁻¹: beyond it a pixel is simply undetermined.
const WORST: f64 = 100.0;

/// Shadow-robust online planning.
#[derive(Clone, Debug)]
pub struct Tk22 {
    start: Vec3,
    rng: Rng,
}

impl Tk22 {
    /// Begins at `start`; `rng` breaks ties between equally undetermined pixels.
    #[must_use]
    pub fn new(start: Vec3, rng: Rng) -> Self {
        Self { start, rng }
    }

    /// The pixel with the largest min(tr A⁻¹, 100) and its A.
    fn worst_pixel(&mut self, seen: &[Observation], threshold: f32) -> (usize, DMat3) {
        let ridge = DMat3::from_diagonal(DVec3::splat(1e-6));
        let outer: Vec<DMat3> = seen
            .iter()
            .map(|o| o.light.as_dvec3())
            .map(|l| DMat3::from_cols(l * l.x, l * l.y, l * l.z))
            .collect();
        let mut worst = (0, ridge, f64::NEG_INFINITY);
        for p in 0..seen[0].grey.len() {
            let lit = seen.iter().zip(&outer).filter(|(o, _)| o.grey[p] > threshold);
            let a = lit.fold(ridge, |a, (_, l)| a + *l);
            let inverse = a.inverse();
            let trace = inverse.x_axis.x + inverse.y_axis.y + inverse.z_axis.z;
            let score = trace.min(WORST) + 1e-6 * f64::from(self.rng.uniform());
            if score > worst.2 {
                worst = (p, a, score);
            }
        }
        (worst.0, worst.1)
    }
}

impl Planner for Tk22 {
    fn next(&mut self, view: &View) -> Result<Vec3, PlanError> {
        if view.seen.is_empty() {
            return super::first(view, self.start);
        }
        let threshold = quantile(view.seen, SHADOW_QUANTILE);
        let (pixel, a) = self.worst_pixel(view.seen, threshold);
        let weakest = smallest_eigenvector(a).as_vec3();
        let sharpness = view.seen.len() as f32 / 2.0;
        let bump = |c: Vec3, at: Vec3| libm::expf(-(c - at).length_squared() * sharpness);
        let value = |c: Vec3| {
            let visible: f32 = view
                .seen
                .iter()
                .map(|o| if o.grey[pixel] > threshold { bump(c, o.light) } else { -bump(c, o.light) })
                .sum();
            (bump(c, Vec3::Z) + visible).clamp(-1.0, 1.0) * c.dot(weakest).abs()
        };
        match view.domain {
            Domain::Candidates(all) => view
                .free_candidates()
                .map(|(_, c)| (c, value(c)))
                .reduce(|best, next| if next.1 > best.1 { next } else { best })
                .map(|(c, _)| c)
                .ok_or(PlanError::TooFewCandidates { candidates: all.len(), lights: view.lights }),
            Domain::Hemisphere { reach } => {
                let scan = light::fibonacci_cap(SCAN, *reach);
                Ok(ascend(&scan, *reach, view.seen, value))
            }
        }
    }
}

/// The value below which `share` of all captured intensities lie.
fn quantile(seen: &[Observation], share: f32) -> f32 {
    let mut all: Vec<f32> = seen.iter().flat_map(|o| o.grey.iter().copied()).collect();
    let rank = ((all.len() - 1) as f32 * share) as usize;
    *all.select_nth_unstable_by(rank, f32::total_cmp).1
}

/// Unit eigenvector of the smallest eigenvalue of a symmetric matrix (cyclic Jacobi rotations).
fn smallest_eigenvector(a: DMat3) -> DVec3 {
    let mut m = a.to_cols_array_2d();
    let mut v = DMat3::IDENTITY.to_cols_array_2d(); // v[k]: k-th eigenvector
    for _ in 0..12 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if m[p][q].abs() < 1e-15 {
                continue;
            }
            let theta = (m[q][q] - m[p][p]) / (2.0 * m[p][q]);
            let t = theta.signum() / (theta.abs() + libm::sqrt(theta * theta + 1.0));
            let c = 1.0 / libm::sqrt(t * t + 1.0);
            let s = t * c;
            for k in 0..3 {
                let (mp, mq) = (m[k][p], m[k][q]);
                (m[k][p], m[k][q]) = (c * mp - s * mq, s * mp + c * mq);
            }
            for k in 0..3 {
                let (mp, mq) = (m[p][k], m[q][k]);
                (m[p][k], m[q][k]) = (c * mp - s * mq, s * mp + c * mq);
                let (vp, vq) = (v[p][k], v[q][k]);
                (v[p][k], v[q][k]) = (c * vp - s * vq, s * vp + c * vq);
            }
        }
    }
    let k = (0..3).min_by(|&i, &j| m[i][i].total_cmp(&m[j][j])).unwrap_or(0);
    DVec3::from(v[k]).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvector_of_the_smallest_eigenvalue() {
        let lights = [Vec3::Z, Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.3, 0.05, 0.95).normalize()];
        let a = lights
            .iter()
            .map(|l| l.as_dvec3())
            .fold(DMat3::ZERO, |m, l| m + DMat3::from_cols(l * l.x, l * l.y, l * l.z));
        let e = smallest_eigenvector(a);
        let value = e.dot(a * e);
        assert!((a * e - value * e).length() < 1e-12);
        assert!(e.y.abs() > 0.99, "{e}"); // the lights hardly leave the x-z plane
    }
}
