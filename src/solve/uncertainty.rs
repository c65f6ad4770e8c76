//! How far off a normal probably is: per pixel in degrees, and for the whole object.
//!
//! Leaving light k out of a weighted least-squares fit moves g by exactly
//! `(LᵀWL)⁻¹ l_k w_k r_k / (1 − h_k)` with the leverage `h_k = w_k l_kᵀ(LᵀWL)⁻¹l_k`: a rank-one downdate, no
//! second solve. The root of the summed squares of these moves across the normal, over |g|, is the
//! jackknife's standard error (HC3 of MacKinnon & White 1985). It sees that values contradict each other, not
//! that all of them mislead the same way, so what it says is mapped to degrees by a power law
//! fitted to synthetic pixels, one for each solver (`coil tune` prints it); its factor is then scaled so that the mean
//! prediction for 60 rendered validation objects (`coil solve worlds-validate:0..59`) is their mean error.

use super::lanes::{LANES, Lanes};
use super::robust::{Fit, dot, fit, length};
use super::tiles::Piece;
use super::{Measurements, Solution, SolveError, Solver, Validity};
use glam::Vec3;

/// Residual, in units of the albedo, that is taken for possible where a fit shows none (three lights
/// always fit exactly).
const DOUBT: f32 = 0.02;
/// Smallest 1 − h: a value that nothing else confirms must not make the error infinite.
const UNCONFIRMED: f32 = 0.25;

/// Standard error of the normal of each pixel of a block, radians (not calibrated).
#[inline(always)]
pub(crate) fn jackknife(lights: &[Vec3], values: &[Lanes], weights: &[Lanes], fitted: &Fit) -> Lanes {
    let albedo = length(fitted.g).max(Lanes::splat(1e-20));
    let per_albedo = Lanes::ONE / albedo;
    let n = fitted.g.map(|g| g * per_albedo);
    let mut sum = Lanes::ZERO;
    for ((&l, &v), &w) in lights.iter().zip(values).zip(weights) {
        let pull = fitted.inverse.times_light(l).map(|p| p * w);
        let along = pull[0] * n[0] + pull[1] * n[1] + pull[2] * n[2];
        let across = pull[0] * pull[0] + pull[1] * pull[1] + pull[2] * pull[2] - along * along;
        let r = (v - dot(fitted.g, l)) * per_albedo;
        let confirmed = (Lanes::ONE - dot(pull, l)).max(Lanes::splat(UNCONFIRMED));
        sum += across.max(Lanes::ZERO) * (r * r + DOUBT * DOUBT) / (confirmed * confirmed);
    }
    sum.sqrt()
}

/// The power law `degrees = factor · error^exponent` from the jackknife's radians to the mean angular error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Degrees at a standard error of one radian.
    pub factor: f32,
    /// How the degrees grow with it.
    pub exponent: f32,
}

impl Calibration {
    /// Of least squares.
    pub const LEAST_SQUARES: Self = Self { factor: 39.4, exponent: 0.572 };
    /// Of trimmed least squares.
    pub const TRIMMED: Self = Self { factor: 36.2, exponent: 0.649 };
    /// Of L1.
    pub const L1: Self = Self { factor: 37.6, exponent: 0.582 };
    /// Of Huber's loss.
    pub const HUBER: Self = Self { factor: 37.9, exponent: 0.592 };
    /// Of Cauchy's loss.
    pub const CAUCHY: Self = Self { factor: 37.8, exponent: 0.597 };
    /// Of sparse Bayesian regression.
    pub const SPARSE_BAYES: Self = Self { factor: 35.0, exponent: 0.574 };

    /// Of the pixel network, which gives an error of its own in radians.
    pub const PIXEL: Self = Self { factor: 43.0, exponent: 1.0 };

    /// The calibration of a solver of this name, where it has one.
    #[must_use]
    pub fn of(solver: &str) -> Option<Self> {
        Some(match solver {
            "ls" => Self::LEAST_SQUARES,
            "trimmed" => Self::TRIMMED,
            "l1" => Self::L1,
            "huber" => Self::HUBER,
            "cauchy" => Self::CAUCHY,
            "sbr" => Self::SPARSE_BAYES,
            "pixel" => Self::PIXEL,
            _ => return None,
        })
    }

    /// Expected angular error in degrees, at most 90.
    #[must_use]
    pub fn degrees(&self, error: f32) -> f32 {
        let d = self.factor * libm::powf(error.max(0.0), self.exponent);
        if d.is_finite() { d.min(90.0) } else { 90.0 }
    }
}

/// Expected angular error of least squares, degrees, one a pixel.
///
/// # Errors
/// [`SolveError`] where the measurements don't fit together.
pub fn of_least_squares(measurements: &Measurements) -> Result<Vec<f32>, SolveError> {
    let lights = measurements.lights.as_slice();
    let weights = vec![Lanes::ONE; lights.len()];
    let mut degrees = Vec::new();
    raw(measurements, &weights, |error, dark| {
        degrees.push(if dark { 90.0 } else { Calibration::LEAST_SQUARES.degrees(error) });
    })?;
    Ok(degrees)
}

/// Hands the uncalibrated standard error (radians) of each pixel to `each(error, black)`.
fn raw(m: &Measurements, weights: &[Lanes], mut each: impl FnMut(f32, bool)) -> Result<(), SolveError> {
    let pixels = m.check()?;
    let mut values = vec![Lanes::ZERO; m.lights.len()];
    for start in (0..pixels).step_by(LANES) {
        let end = pixels.min(start + LANES);
        for (v, image) in values.iter_mut().zip(&m.images) {
            *v = Lanes::load(&image[start..end]);
        }
        let fitted = fit(&m.lights, &values, weights);
        let error = jackknife(&m.lights, &values, weights, &fitted);
        let albedo = length(fitted.g);
        for i in 0..end - start {
            each(error.0[i], albedo.0[i] <= 1e-20);
        }
    }
    Ok(())
}

/// Adds the per-pixel uncertainty where the solver gave none (least squares, which is kept fast).
///
/// # Errors
/// [`SolveError`] where the measurements don't fit together.
pub fn complete(measurements: &Measurements, solution: &mut Solution) -> Result<(), SolveError> {
    if solution.uncertainty.is_none() {
        solution.uncertainty = Some(of_least_squares(measurements)?);
    }
    Ok(())
}

/// Predicted mean angular error of the whole object, degrees: the mean of the pixels' expected errors.
/// `None` where the solution has no uncertainty (see [`complete`]) or no pixel.
#[must_use]
pub fn predicted_mae(solution: &Solution) -> Option<f32> {
    let degrees = solution.uncertainty.as_ref()?;
    let sum: f64 = degrees.iter().map(|&d| f64::from(d)).sum();
    (!degrees.is_empty()).then(|| (sum / degrees.len() as f64) as f32)
}

/// So many pixels are enough to predict a mean over the object after every picture.
pub const JUDGED: usize = 4096;

/// Ends a capture when the object is good enough (the idea of LAC-PS, on a continuous scale).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopAt {
    /// Predicted mean angular error at which to stop, degrees.
    pub degrees: f32,
    /// Never stop with fewer lights: the prediction needs values that can contradict each other.
    pub least_lights: usize,
}

impl StopAt {
    /// Stop at `degrees`, with at least five lights.
    #[must_use]
    pub fn new(degrees: f32) -> Self {
        Self { degrees, least_lights: 5 }
    }

    /// Whether these pictures are good enough, judged by `solver` on evenly spread pixels (at most [`JUDGED`] of them).
    /// Lights in one plane are not.
    #[must_use]
    pub fn enough(&self, solver: &dyn Solver, pictures: &Measurements) -> bool {
        let count = pictures.lights.len();
        if count < self.least_lights {
            return false;
        }
        let pixels = pictures.images.first().map_or(0, |image| image.len());
        let some: Vec<u32> = (0..pixels as u32).step_by(pixels.div_ceil(JUDGED).max(1)).collect();
        let piece = Piece::of(pictures, &some);
        let part = piece.measurements(pictures);
        let solved = solver.solve(&part).and_then(|mut solution| {
            complete(&part, &mut solution)?;
            Ok(solution)
        });
        solved.is_ok_and(|solution| self.met(&solution, count))
    }

    /// Whether `solution`, from `lights` pictures, is good enough.
    #[must_use]
    pub fn met(&self, solution: &Solution, lights: usize) -> bool {
        lights >= self.least_lights && predicted_mae(solution).is_some_and(|mae| mae <= self.degrees)
    }
}

/// Why a stop criterion can't be read.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("stop criterion '{0}': write degrees above 0 and below 90, for example 8deg")]
pub struct StopAtError(String);

impl std::str::FromStr for StopAt {
    type Err = StopAtError;

    /// Reads `8deg` or `8`.
    fn from_str(s: &str) -> Result<Self, StopAtError> {
        let number = s.strip_suffix("deg").unwrap_or(s).trim();
        match number.parse::<f32>() {
            Ok(degrees) if degrees > 0.0 && degrees < 90.0 => Ok(Self::new(degrees)),
            _ => Err(StopAtError(s.into())),
        }
    }
}

/// Fraction of the pixels whose normal can be trusted.
#[must_use]
pub fn coverage(solution: &Solution) -> f32 {
    let valid = solution.validity.iter().filter(|&&v| v == Validity::Valid).count();
    valid as f32 / solution.validity.len().max(1) as f32
}
