//! What error to expect of a pixel's normal: a small network looks at how the values disagree with it.
//!
//! For every solver the same [`CUES`] are taken from the pixel's values and the solver's answer, and a small network
//! makes the expected angular error of them; each solver has weights of its own. They are fitted to rendered
//! training objects and synthetic pixels (`coil tune --uncertainty`) with the loss error/e + ln e, which is smallest where e is the mean error
//! of pixels that look alike: so the mean over an object predicts the object's mean error. `models/expected-error.md`
//! is the card of the weights. What a pixel's neighbours add to that is [`neighbourhood`]'s.

use super::perceptron::Perceptron;
use super::{Measurements, Solution, SolveError, context, least_squares, neighbourhood, pixel};
use glam::{Mat3, Vec3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// Number of values that describe a pixel and its normal.
pub const CUES: usize = 22;

/// Values at most this fraction of the brightest are dark, as for the robust solvers.
const DARK: f32 = 0.05;
/// Residual, in units of the albedo, at which a value counts half for the weighted cues (Cauchy's loss).
const SCALE: f32 = 0.05;
/// Smallest 1 − leverage: a value that nothing else confirms must not make the error infinite.
const UNCONFIRMED: f32 = 0.25;

/// What a solver can add from its own knowledge: the error it expects (radians) and the angle between its answer
/// and what it began with (radians). Zero where there is none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Own {
    /// Expected error, radians.
    pub expected: f32,
    /// How far it moved the normal, radians.
    pub moved: f32,
}

/// What all pixels share: the lights.
pub struct Cues<'a> {
    lights: &'a [Vec3],
    /// Columns of the pseudo-inverse (LᵀL)⁻¹Lᵀ.
    columns: Vec<Vec3>,
    log_count: f32,
    height: f32,
    spread: f32,
    values: Vec<f32>,
}

impl<'a> Cues<'a> {
    /// For pixels under these lights.
    ///
    /// # Errors
    /// [`SolveError::Coplanar`] and [`SolveError::TooFew`] for lights that no normal can be solved from.
    pub fn new(lights: &'a [Vec3]) -> Result<Self, SolveError> {
        let columns = least_squares::pseudo_inverse(lights)?;
        let count = lights.len() as f32;
        let gram = lights.iter().fold(Mat3::ZERO, |m, &l| m + outer(l)) * (1.0 / count);
        Ok(Self {
            lights,
            columns,
            log_count: libm::logf(count),
            height: lights.iter().map(|l| l.z).sum::<f32>() / count,
            spread: log(gram.determinant(), 1e-6),
            values: vec![0.0; lights.len()],
        })
    }

    /// The cues of pixel `p` of `images`, where a solver found `normal` and `albedo`; `None` for a black pixel.
    pub fn of(
        &mut self,
        images: &[&[f32]],
        p: usize,
        normal: Vec3,
        albedo: f32,
        own: Own,
    ) -> Option<[f32; CUES]> {
        let mut brightest = 0.0f32;
        let mut first = 0;
        for (k, (v, image)) in self.values.iter_mut().zip(images).enumerate() {
            let value = image[p];
            *v = if value > 0.0 && value <= f32::MAX { value } else { 0.0 };
            if *v > brightest {
                (brightest, first) = (*v, k);
            }
        }
        if !(brightest > 1e-20 && albedo > 0.0 && albedo.is_finite() && normal.is_finite()) {
            return None;
        }
        let per_brightest = 1.0 / brightest;
        let mut plain = Vec3::ZERO;
        for (v, &column) in self.values.iter_mut().zip(&self.columns) {
            *v *= per_brightest;
            plain += column * *v;
        }
        let count = self.values.len() as f32;
        let albedo = albedo * per_brightest;
        let plain_albedo = plain.length().max(1e-6);
        let plain_normal = plain * (1.0 / plain_albedo);
        let per_scale = 1.0 / (SCALE * albedo.max(0.05));

        let (mut squares, mut plain_squares, mut plain_jackknife) = (0.0, 0.0, 0.0);
        let (mut sum, mut sum_squares, mut lit, mut bright, mut second) = (0.0, 0.0, 0.0, 0.0, 0.0f32);
        let (mut above, mut below) = (0.0f32, 0.0f32);
        let mut gram = Mat3::ZERO;
        let mut total = 0.0;
        for (k, ((&v, &l), &column)) in self.values.iter().zip(self.lights).zip(&self.columns).enumerate() {
            let r = v - albedo * normal.dot(l).max(0.0);
            squares += r * r;
            above = above.max(r);
            below = below.min(r);
            let r0 = v - plain.dot(l);
            plain_squares += r0 * r0;
            let confirmed = (1.0 - column.dot(l)).max(UNCONFIRMED);
            let step = r0 / confirmed;
            plain_jackknife += across(column, plain_normal) * step * step;
            sum += v;
            sum_squares += v * v;
            lit += f32::from(v > DARK);
            bright += f32::from(v > 0.25);
            if k != first {
                second = second.max(v);
            }
            let w = weight(v, r * per_scale);
            gram += outer(l) * w;
            total += w;
        }
        gram *= 1.0 / total.max(1e-6);
        let determinant = gram.determinant();
        let inverse = adjugate(gram) * (1.0 / (determinant.max(1e-5) * total.max(1e-6)));
        let mut jackknife = 0.0;
        // How far an error of one per cent in every value would turn the normal.
        let mut sensitivity = 0.0;
        for (&v, &l) in self.values.iter().zip(self.lights) {
            let r = v - albedo * normal.dot(l).max(0.0);
            let pull = inverse * l * weight(v, r * per_scale);
            let step = r / (1.0 - pull.dot(l)).max(UNCONFIRMED);
            let turned = across(pull, normal);
            jackknife += turned * step * step;
            sensitivity += turned * v * v;
        }
        let per_albedo = 1.0 / albedo.max(1e-3);
        let half = (self.lights[first] + Vec3::Z).normalize_or_zero();
        Some([
            log((squares / count).sqrt(), 1e-3),
            log((plain_squares / count).sqrt(), 1e-3),
            log(jackknife.sqrt() * per_albedo, 1e-3),
            log(plain_jackknife.sqrt() / plain_albedo, 1e-3),
            log(sensitivity.sqrt() * per_albedo, 1e-2),
            log((normal - plain_normal).length(), 2e-3),
            normal.z,
            above,
            below,
            sum / count,
            (sum_squares / count).sqrt(),
            second,
            lit / count,
            bright / count,
            log(albedo, 1e-2),
            normal.dot(half),
            self.log_count,
            self.height,
            self.spread,
            log(determinant, 1e-5),
            log(own.expected, 1e-3),
            log(own.moved, 1e-3),
        ])
    }
}

/// Natural logarithm of `value`, of `least` where it is below.
fn log(value: f32, least: f32) -> f32 {
    libm::logf(value.max(least))
}

fn outer(l: Vec3) -> Mat3 {
    Mat3::from_cols(l * l.x, l * l.y, l * l.z)
}

/// Inverse times determinant of a symmetric matrix.
fn adjugate(m: Mat3) -> Mat3 {
    Mat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis))
}

/// Square of what of `pull` is across `normal`.
fn across(pull: Vec3, normal: Vec3) -> f32 {
    let along = pull.dot(normal);
    (pull.length_squared() - along * along).max(0.0)
}

/// Cauchy's weight of a value with residual `r` (in units of [`SCALE`]); 0 for dark values.
fn weight(value: f32, r: f32) -> f32 {
    if value > DARK { 1.0 / (1.0 + r * r) } else { 1e-3 }
}

/// What to expect of one solver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Judge {
    /// Of a pixel by itself: [`CUES`] to the logarithm of the expected error in degrees.
    pub alone: Perceptron<CUES>,
    /// Of a pixel among others, see [`neighbourhood`].
    pub among: Perceptron<{ neighbourhood::CUES }>,
}

/// The expected angular error, degrees, at most 90, that a network's output stands for.
#[must_use]
pub fn degrees(output: f32) -> f32 {
    libm::expf(output.clamp(-4.0, 4.5)).min(90.0)
}

/// The judges that come with the crate, by solver.
static SHIPPED: LazyLock<BTreeMap<String, Judge>> = LazyLock::new(|| {
    let judges: BTreeMap<String, Judge> =
        serde_json::from_str(include_str!("../../models/expected-error.json"))
            .expect("the committed file is valid");
    assert!(judges.values().all(|j| j.alone.is_whole() && j.among.is_whole()), "the committed file is whole");
    judges
});

/// Expected angular error of every pixel of `solution`, degrees; 90 for black pixels.
///
/// # Errors
/// [`SolveError`] where the measurements don't fit together, and for a solver without weights.
pub fn expected(
    solver: &str,
    measurements: &Measurements,
    solution: &Solution,
) -> Result<Vec<f32>, SolveError> {
    expected_by(&judge(solver)?.alone, measurements, solution)
}

/// The same by a network of the caller's.
///
/// # Errors
/// [`SolveError`] where the measurements don't fit together.
pub fn expected_by(
    network: &Perceptron<CUES>,
    measurements: &Measurements,
    solution: &Solution,
) -> Result<Vec<f32>, SolveError> {
    let degrees = |cues: Option<[f32; CUES]>| cues.map_or(90.0, |cues| degrees(network.output(&cues)));
    Ok(cues(measurements, solution)?.map(degrees).collect())
}

/// The judge that comes with the crate for the solver of this name.
///
/// # Errors
/// [`SolveError::Model`] where there is none.
pub fn judge(solver: &str) -> Result<&'static Judge, SolveError> {
    let none = || SolveError::Model(format!("no expected errors for solver '{solver}'"));
    // What it finds of single pixels is the pixel network's.
    let of = if solver == context::NAME { pixel::NAME } else { solver };
    SHIPPED.get(of).ok_or_else(none)
}

/// The cues of every pixel of `solution`, `None` for black ones.
///
/// # Errors
/// [`SolveError`] where the measurements don't fit together.
pub fn cues<'a>(
    measurements: &'a Measurements,
    solution: &'a Solution,
) -> Result<impl Iterator<Item = Option<[f32; CUES]>> + 'a, SolveError> {
    let pixels = measurements.check()?;
    let mut cues = Cues::new(&measurements.lights)?;
    Ok((0..pixels).map(move |p| {
        let own = solution.own.get(p).copied().unwrap_or_default();
        cues.of(&measurements.images, p, solution.normals[p], solution.albedo[p], own)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::fibonacci_cap;
    use crate::rng::Rng;
    use crate::solve::{SOLVERS, by_name};

    #[test]
    fn every_solver_has_a_judge() {
        for name in SOLVERS.iter().map(|s| s.name) {
            assert!(judge(name).is_ok(), "{name}");
        }
    }

    #[test]
    fn the_unit_of_the_images_does_not_matter() {
        let mut rng = Rng::new(6);
        let lights = fibonacci_cap(9, 0.9);
        let images: Vec<Vec<f32>> = (0..9).map(|_| (0..40).map(|_| rng.uniform()).collect()).collect();
        let expect = |unit: f32| {
            let scaled: Vec<Vec<f32>> = images.iter().map(|i| i.iter().map(|v| v * unit).collect()).collect();
            let m = Measurements {
                lights: lights.clone(),
                images: scaled.iter().map(Vec::as_slice).collect(),
                saturated: Vec::new(),
            };
            let solver = by_name("trimmed").unwrap();
            let solution = solver.solve(&m).unwrap();
            expected(solver.name(), &m, &solution).unwrap()
        };
        // A power of two changes no digit.
        for (a, b) in expect(1.0).into_iter().zip(expect(1024.0)) {
            assert!((a - b).abs() <= 1e-3 * a, "{a} {b}");
        }
    }

    #[test]
    fn contradictions_are_worse_than_agreement() {
        let lights = fibonacci_cap(10, 0.9);
        let normals = fibonacci_cap(50, 0.5);
        let mut images: Vec<Vec<f32>> =
            lights.iter().map(|l| normals.iter().map(|n| 0.7 * n.dot(*l).max(0.0)).collect()).collect();
        let mean = |images: &[Vec<f32>], name: &str| {
            let m = Measurements {
                lights: lights.clone(),
                images: images.iter().map(Vec::as_slice).collect(),
                saturated: Vec::new(),
            };
            let solver = by_name(name).unwrap();
            let solution = solver.solve(&m).unwrap();
            expected(name, &m, &solution).unwrap().iter().sum::<f32>() / normals.len() as f32
        };
        let clean = SOLVERS.iter().map(|s| mean(&images, s.name)).collect::<Vec<_>>();
        let mut rng = Rng::new(7);
        for image in &mut images {
            image.iter_mut().for_each(|v| *v *= rng.range(0.4, 1.6));
        }
        for (name, clean) in SOLVERS.iter().map(|s| s.name).zip(clean) {
            let spoilt = mean(&images, name);
            assert!(spoilt > 2.0 * clean, "{name}: {clean} {spoilt}");
        }
    }
}
