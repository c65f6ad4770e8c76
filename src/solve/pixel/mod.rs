//! The learned solver: a set network over the observations of one pixel.
//!
//! Each pixel is solved robustly first (Cauchy's loss). Its observations are turned about the optical axis so
//! that this normal has azimuth 0, described by [`INPUTS`] numbers each, and the [`Network`] gives a
//! correction and the error to expect. The correction fades where the robust fit already explains all
//! values, so that what is exact stays exact. No neighbour is looked at: the result for a pixel
//! does not depend on the crop, the resolution or the tile.

pub mod network;
pub mod onnx;

use super::expectation::Own;
use super::{Irls, LeastSquares, Loss, Measurements, Solution, SolveError, Solver};
use glam::Vec3;
use network::{INPUTS, Network, OUTPUTS, Tape, WIDTH, Wide};
use std::f32::consts::FRAC_PI_2;
use std::sync::Arc;
#[cfg(not(target_arch = "wasm32"))]
use std::sync::LazyLock;

/// Name of the solver.
pub const NAME: &str = "pixel";

/// Relative residual at which half of the correction is applied.
const HALF_TRUST: f32 = 0.01;
/// Pixels whose robust solution is held at a time.
const TILE: usize = 4096;

/// The learned solver.
#[derive(Clone, Debug)]
pub struct PixelNetwork {
    network: Arc<Network>,
}

/// What the network is not told: the azimuth that was turned away, and how the correction is applied.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    cos: f32,
    sin: f32,
    base: Vec3,
    trust: f32,
}

impl Frame {
    /// Into the frame in which the robust normal has azimuth 0.
    pub(crate) fn turn(&self, v: Vec3) -> Vec3 {
        Vec3::new(self.cos * v.x + self.sin * v.y, self.cos * v.y - self.sin * v.x, v.z)
    }

    fn turn_back(&self, v: Vec3) -> Vec3 {
        Vec3::new(self.cos * v.x - self.sin * v.y, self.sin * v.x + self.cos * v.y, v.z)
    }

    /// The corrected normal in the turned frame, its length before normalisation, and how much of the
    /// correction is applied.
    pub(crate) fn correct(&self, correction: Vec3) -> (Vec3, f32, f32) {
        let moved = self.turn(self.base) + self.trust * correction;
        let length = moved.length().max(1e-6);
        (moved / length, length, self.trust)
    }
}

/// Expected angular error in radians of the network's last output.
pub(crate) fn expected_error(log: f32) -> f32 {
    libm::expf(log.clamp(-7.0, 0.45))
}

/// Robust and plain least-squares solutions, which the network starts from.
pub(crate) struct Start {
    robust: Solution,
    plain: Solution,
}

impl Start {
    pub(crate) fn new(measurements: &Measurements) -> Result<Self, SolveError> {
        Ok(Self {
            robust: Irls::new(Loss::Cauchy).solve(measurements)?,
            plain: LeastSquares.solve(measurements)?,
        })
    }

    /// Describes pixel `p` to lane `lane` of `inputs` (`[token · INPUTS + input]`).
    pub(crate) fn describe(&self, m: &Measurements, p: usize, lane: usize, inputs: &mut [Wide]) -> Frame {
        let base = self.robust.normals[p];
        let across = base.truncate().length();
        let (cos, sin) = if across > 1e-6 { (base.x / across, base.y / across) } else { (1.0, 0.0) };
        let mut frame = Frame { cos, sin, base, trust: 1.0 };
        let (albedo, plain_albedo) = (self.robust.albedo[p], self.plain.albedo[p]);
        let plain = self.plain.normals[p];
        let turned_plain = frame.turn(plain);
        let clean = |v: f32| if v.is_finite() { v.max(0.0) } else { 0.0 };
        let brightest = m.images.iter().map(|i| clean(i[p])).fold(1e-20, f32::max);
        let (per_brightest, per_albedo) = (1.0 / brightest, 1.0 / albedo.max(1e-3 * brightest));
        let count = m.lights.len();
        let log_count = libm::logf(count as f32 / 10.0);

        let mut squares = 0.0;
        for (image, &l) in m.images.iter().zip(&m.lights) {
            let r = (clean(image[p]) - albedo * base.dot(l).max(0.0)) * per_brightest;
            squares += r * r;
        }
        if count > 3 {
            let residual = (squares / (count - 3) as f32).sqrt();
            frame.trust = residual / (residual + HALF_TRUST);
        }
        let trust = frame.trust;
        let pictures = m.images.iter().zip(&m.lights).enumerate();
        for (token, (k, (image, &l))) in inputs.chunks_exact_mut(INPUTS).zip(pictures) {
            let value = clean(image[p]);
            let v = value * per_brightest;
            let turned = frame.turn(l);
            let cosine = base.dot(l);
            let half = (l + Vec3::Z).normalize_or_zero();
            let numbers: [f32; INPUTS] = [
                turned.x,
                turned.y,
                turned.z,
                v,
                v.sqrt(),
                cosine,
                v - albedo * per_brightest * cosine.max(0.0),
                v - plain_albedo * per_brightest * plain.dot(l),
                base.dot(half),
                0.5 * (value * per_albedo).min(4.0),
                across,
                base.z,
                turned_plain.x,
                turned_plain.y,
                turned_plain.z,
                log_count,
                f32::from(m.saturated_in(k).get(p) == Some(&true)),
                trust,
            ];
            for (wide, number) in token.iter_mut().zip(numbers) {
                wide.0[lane] = number;
            }
        }
        frame
    }
}

/// The model that comes with the crate; `models/pixel.md` is its card. The page fetches it when it is first used.
#[cfg(not(target_arch = "wasm32"))]
pub const SHIPPED: &[u8] = include_bytes!("../../../models/pixel.onnx");

#[cfg(not(target_arch = "wasm32"))]
static NETWORK: LazyLock<Arc<Network>> =
    LazyLock::new(|| Arc::new(onnx::read(SHIPPED).expect("the committed file is valid").network));

impl PixelNetwork {
    /// The solver with the network that comes with the crate.
    #[cfg(not(target_arch = "wasm32"))]
    #[must_use]
    pub fn shipped() -> Self {
        Self { network: Arc::clone(&NETWORK) }
    }

    /// A solver with this network.
    #[must_use]
    pub fn new(network: Arc<Network>) -> Self {
        Self { network }
    }
}

impl Solver for PixelNetwork {
    fn name(&self) -> &'static str {
        NAME
    }

    fn solve(&self, measurements: &Measurements) -> Result<Solution, SolveError> {
        let pixels = measurements.check()?;
        let tokens = measurements.lights.len();
        let mut tape = Tape::default();
        let mut inputs = vec![Wide::ZERO; tokens * INPUTS];
        let mut out = Solution {
            normals: Vec::with_capacity(pixels),
            albedo: Vec::with_capacity(pixels),
            validity: Vec::with_capacity(pixels),
            uncertainty: None,
            own: Vec::with_capacity(pixels),
        };
        for first in (0..pixels).step_by(TILE) {
            let tile = measurements.range(first, pixels.min(first + TILE));
            let count = tile.check()?;
            let start = Start::new(&tile)?;
            for block in (0..count).step_by(WIDTH) {
                let lanes = WIDTH.min(count - block);
                inputs.fill(Wide::ZERO);
                let mut frames = [None; WIDTH];
                for (lane, frame) in frames.iter_mut().enumerate().take(lanes) {
                    *frame = Some(start.describe(&tile, block + lane, lane, &mut inputs));
                }
                let outputs = self.network.forward(&mut tape, &inputs, tokens);
                for (lane, frame) in frames.iter().enumerate() {
                    if let Some(frame) = frame {
                        push(&mut out, &start.robust, block + lane, frame, outputs.map(|o| o.0[lane]));
                    }
                }
            }
        }
        Ok(out)
    }
}

fn push(out: &mut Solution, robust: &Solution, p: usize, frame: &Frame, [x, y, z, log]: [f32; OUTPUTS]) {
    let correction = Vec3::new(x, y, z);
    // A black pixel has nothing to correct; an overflow in the network must not get out.
    let usable = robust.albedo[p] > 0.0 && correction.is_finite() && log.is_finite();
    let normal = if usable { frame.turn_back(frame.correct(correction).0) } else { robust.normals[p] };
    out.normals.push(normal);
    out.albedo.push(robust.albedo[p]);
    out.validity.push(robust.validity[p]);
    let expected = if usable { expected_error(log) } else { FRAC_PI_2 };
    out.own.push(Own { expected, moved: crate::error::unit_angle(normal, robust.normals[p]) });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::fibonacci_cap;
    use crate::rng::Rng;

    #[test]
    fn tiles_of_any_size_give_the_same() {
        let mut rng = Rng::new(1);
        let lights = fibonacci_cap(8, 0.9);
        let images: Vec<Vec<f32>> = (0..8).map(|_| (0..TILE + 37).map(|_| rng.uniform()).collect()).collect();
        let m = Measurements {
            lights,
            images: images.iter().map(Vec::as_slice).collect(),
            saturated: Vec::new(),
        };
        let solver = PixelNetwork::shipped();
        let whole = solver.solve(&m).unwrap();
        let part = solver.solve(&m.range(TILE - 3, TILE + 30)).unwrap();
        assert_eq!(whole.normals[TILE - 3..TILE + 30], part.normals);
        assert_eq!(whole.own[TILE - 3..TILE + 30], part.own);
    }

    #[test]
    fn turning_lights_turns_normals() {
        let mut rng = Rng::new(2);
        let lights = fibonacci_cap(9, 0.9);
        let images: Vec<Vec<f32>> = (0..9).map(|_| (0..200).map(|_| rng.uniform()).collect()).collect();
        let images: Vec<&[f32]> = images.iter().map(Vec::as_slice).collect();
        let turned = lights.iter().map(|&l| crate::light::rotate_about_axis(l, 1.1)).collect();
        let solve = |lights| {
            let m = Measurements { lights, images: images.clone(), saturated: Vec::new() };
            PixelNetwork::shipped().solve(&m).unwrap().normals
        };
        for (a, b) in solve(lights).into_iter().zip(solve(turned)) {
            assert!((crate::light::rotate_about_axis(a, 1.1) - b).length() < 2e-2);
        }
    }
}
