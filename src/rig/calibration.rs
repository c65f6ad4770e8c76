//! The arm's zero and tilt from a few measured light directions.

use crate::arm::Joints;
use crate::arm::kinematics::Mount;
use crate::light;
use glam::Vec3;

/// A pose and the direction that was measured there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Joint angles, degrees.
    pub joints: Joints,
    /// Measured unit direction of the light.
    pub measured: Vec3,
    /// Its standard uncertainty, degrees; smaller counts more.
    pub uncertainty: f64,
}

/// A fitted mount.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Zero and tilt.
    pub mount: Mount,
    /// Angle between measured and fitted direction of every sighting, degrees.
    pub residuals: Vec<f64>,
    /// The same before the fit (commanded against measured).
    pub before: Vec<f64>,
}

impl Fit {
    /// Root mean square of the residuals, degrees.
    #[must_use]
    pub fn rms(&self) -> f64 {
        libm::sqrt(self.residuals.iter().map(|r| r * r).sum::<f64>() / self.residuals.len().max(1) as f64)
    }
}

/// Why no mount can be fitted.
#[derive(Clone, Debug, thiserror::Error, PartialEq)]
pub enum FitError {
    /// Too few sightings.
    #[error(
        "{0} measured direction(s): zero and tilt have four unknowns, so take at least 3, well apart in azimuth"
    )]
    TooFew(usize),
    /// They lie too close together.
    #[error("the measured directions lie too close together: spread them over azimuth, at slants above 20°")]
    Degenerate,
    /// A sighting is not usable.
    #[error("sighting {0} has a direction that is not of unit length, or no positive uncertainty")]
    Sighting(usize),
}

fn angle(a: Vec3, b: Vec3) -> f64 {
    f64::from(light::angle(a, b)).to_degrees()
}

fn parameters(m: &Mount) -> [f64; 4] {
    [m.azimuth, m.slant, m.tilt[0], m.tilt[1]]
}

fn mount([azimuth, slant, x, y]: [f64; 4]) -> Mount {
    Mount { azimuth, slant, tilt: [x, y] }
}

/// The mount that explains the sightings best (weighted least squares on directions, Levenberg-Marquardt from
/// `start`).
///
/// # Errors
/// [`FitError`].
pub fn fit_mount(sightings: &[Sighting], start: Mount) -> Result<Fit, FitError> {
    if sightings.len() < 3 {
        return Err(FitError::TooFew(sightings.len()));
    }
    if let Some(k) = sightings.iter().position(|s| {
        !((s.measured.length() - 1.0).abs() < 1e-3 && s.uncertainty > 0.0 && s.uncertainty.is_finite())
    }) {
        return Err(FitError::Sighting(k));
    }
    let residuals = |p: [f64; 4]| -> Vec<f64> {
        let m = mount(p);
        sightings
            .iter()
            .flat_map(|s| {
                let d = (m.direction(s.joints) - s.measured).as_dvec3() / s.uncertainty.to_radians();
                d.to_array()
            })
            .collect()
    };
    let cost = |r: &[f64]| r.iter().map(|v| v * v).sum::<f64>();
    let mut p = parameters(&start);
    let mut r = residuals(p);
    let mut damping = 1e-3;
    for _ in 0..100 {
        const STEP: f64 = 1e-2; // degrees; f32 directions resolve 1e-5
        let columns: [Vec<f64>; 4] = std::array::from_fn(|k| {
            let (mut low, mut high) = (p, p);
            low[k] -= STEP;
            high[k] += STEP;
            residuals(high).iter().zip(residuals(low)).map(|(a, b)| (a - b) / (2.0 * STEP)).collect()
        });
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let mut normal = [[0.0; 5]; 4];
        let scale = (0..4).map(|i| dot(&columns[i], &columns[i])).fold(0.0, f64::max);
        for i in 0..4 {
            for j in 0..4 {
                normal[i][j] = dot(&columns[i], &columns[j]);
            }
            normal[i][4] = -dot(&columns[i], &r);
        }
        if solve(normal, 1e-6 * scale).is_none() {
            return Err(FitError::Degenerate);
        }
        for (i, row) in normal.iter_mut().enumerate() {
            row[i] *= 1.0 + damping;
        }
        let Some(step) = solve(normal, 0.0) else { return Err(FitError::Degenerate) };
        let next: [f64; 4] = std::array::from_fn(|i| p[i] + step[i]);
        let better = residuals(next);
        if cost(&better) < cost(&r) {
            (p, r) = (next, better);
            damping = (damping * 0.3).max(1e-9);
        } else {
            damping *= 5.0;
        }
        if step.iter().all(|s| s.abs() < 1e-6) || damping > 1e9 {
            break;
        }
    }
    let fitted = mount(p);
    let with =
        |m: &Mount| sightings.iter().map(|s| angle(m.direction(s.joints), s.measured)).collect::<Vec<_>>();
    Ok(Fit { mount: fitted, residuals: with(&fitted), before: with(&start) })
}

/// Gaussian elimination of a 4×4 system with its right side; `None` where a pivot is not above `tiny`.
fn solve(mut m: [[f64; 5]; 4], tiny: f64) -> Option<[f64; 4]> {
    for k in 0..4 {
        let pivot = (k..4).max_by(|&a, &b| m[a][k].abs().total_cmp(&m[b][k].abs()))?;
        m.swap(k, pivot);
        if m[k][k].abs() <= tiny {
            return None;
        }
        for i in (0..4).filter(|&i| i != k) {
            let f = m[i][k] / m[k][k];
            let row = m[k];
            for (a, b) in m[i].iter_mut().zip(row) {
                *a -= f * b;
            }
        }
    }
    Some(std::array::from_fn(|i| m[i][4] / m[i][i]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    fn poses(n: usize) -> Vec<Joints> {
        (0..n)
            .map(|k| Joints {
                azimuth: -150.0 + 300.0 * k as f64 / n as f64,
                slant: 30.0 + 25.0 * (k % 2) as f64,
            })
            .collect()
    }

    #[test]
    fn finds_zero_and_tilt_again() {
        let truth = Mount { azimuth: 4.0, slant: -2.5, tilt: [1.2, -0.7] };
        let mut rng = Rng::new(3);
        let noisy: Vec<Sighting> = poses(8)
            .into_iter()
            .map(|joints| {
                let d = truth.direction(joints) + Vec3::new(rng.normal(), rng.normal(), rng.normal()) * 0.003;
                Sighting { joints, measured: d.normalize(), uncertainty: 0.2 }
            })
            .collect();
        let fit = fit_mount(&noisy, Mount::default()).unwrap();
        for (a, b) in parameters(&fit.mount).iter().zip(parameters(&truth)) {
            assert!((a - b).abs() < 0.35, "{:?}", fit.mount);
        }
        assert!(fit.rms() < 0.35 && fit.before.iter().all(|b| *b > 1.0), "{fit:?}");
        // A new direction is hit far better than before.
        let j = Joints { azimuth: 77.0, slant: 60.0 };
        assert!(angle(fit.mount.direction(j), truth.direction(j)) < 0.4);
    }

    #[test]
    fn too_little_is_an_error() {
        let one =
            Sighting { joints: Joints { azimuth: 0.0, slant: 0.0 }, measured: Vec3::Z, uncertainty: 0.2 };
        assert_eq!(fit_mount(&[one; 2], Mount::default()), Err(FitError::TooFew(2)));
        assert_eq!(fit_mount(&[one; 5], Mount::default()), Err(FitError::Degenerate));
        let bad = Sighting { measured: Vec3::ZERO, ..one };
        assert_eq!(fit_mount(&[one, bad, one], Mount::default()), Err(FitError::Sighting(1)));
    }
}
