//! Trains the pixel network on synthetic pixels.
//!
//! Every step makes its own pixels from the seed and its number, so a run that is killed and resumed from a
//! checkpoint gives the same weights to the bit. The loss of a pixel is the chord |n̂ − n| plus a term
//! that makes the last output the expected chord: with e = exp(output), chord/e + ln e is smallest at e = mean chord.

use super::Generator;
use crate::rng::Rng;
use crate::solve::pixel::network::{
    Gradient, INPUTS, Network, OUTPUTS, PARAMETERS, Tape, WEIGHTS, WIDTH, Wide,
};
use crate::solve::pixel::{Frame, Start, expected_error};
use crate::solve::{Measurements, SolveError};
use glam::Vec3;

/// How the network is trained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recipe {
    /// Seed of weights and pixels.
    pub seed: u64,
    /// Number of steps; the learning rate falls to 0 at the last.
    pub steps: u64,
    /// Light sets of a step.
    pub groups: usize,
    /// Blocks of [`WIDTH`] pixels under each light set.
    pub blocks: usize,
    /// Largest learning rate (AdamW), reached after [`Recipe::warm_up`] steps.
    pub rate: f32,
    /// Steps of linear warm-up.
    pub warm_up: u64,
    /// Decoupled weight decay of matrices.
    pub decay: f32,
    /// Weight of the uncertainty's term.
    pub uncertainty: f32,
}

impl Default for Recipe {
    fn default() -> Self {
        Self {
            seed: 1,
            steps: 14_000,
            groups: 48,
            blocks: 1,
            rate: 1.5e-3,
            warm_up: 200,
            decay: 1e-3,
            uncertainty: 0.1,
        }
    }
}

/// A training run at some step.
#[derive(Clone, Debug)]
pub struct Training {
    recipe: Recipe,
    step: u64,
    network: Network,
    mean: Vec<f32>,
    square: Vec<f32>,
}

/// What a step was like.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Report {
    /// Mean angular error of the step's pixels, degrees.
    pub error: f64,
    /// The same of the robust solution that the network starts from.
    pub start_error: f64,
    /// Pixels.
    pub pixels: usize,
}

/// Why a checkpoint can't be read.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum CheckpointError {
    /// Not of this program.
    #[error("not a checkpoint of the pixel network of this version")]
    Foreign,
    /// Cut off or damaged.
    #[error("the checkpoint has {found} bytes where {expected} are needed: it is cut off")]
    Length {
        /// Its bytes.
        found: usize,
        /// The bytes it must have.
        expected: usize,
    },
}

/// Parts that a step is summed from, always the same ones: the number of threads does not change the result.
const SHARDS: usize = 4;

const MAGIC: &[u8; 8] = b"coilpix1";

impl Training {
    /// A new run: matrices uniform with the variance 1/inputs, the last layer near 0 (it begins with the robust normal).
    #[must_use]
    pub fn new(recipe: Recipe) -> Self {
        let mut rng = Rng::stream(recipe.seed, u64::MAX);
        let mut weights = vec![0.0f32; WEIGHTS];
        for p in &PARAMETERS {
            let [rows, columns] = p.shape;
            let values = &mut weights[p.offset..p.offset + rows * columns];
            if p.name.ends_with("scale") {
                values.fill(1.0);
            } else if rows > 1 {
                let small: f32 = if p.name == "head2.weight" { 0.1 } else { 1.0 };
                let bound = small * (3.0 / columns as f32).sqrt();
                values.iter_mut().for_each(|w| *w = rng.range(-bound, bound));
            } else if p.name == "head2.bias" {
                values[OUTPUTS - 1] = -1.5; // e^−1.5 rad = 13°, about the robust solver's error
            }
        }
        Self::from(Network::new(weights).expect("one weight for each parameter"), recipe)
    }

    /// A new run that begins with the weights of another.
    #[must_use]
    pub fn from(network: Network, recipe: Recipe) -> Self {
        Self { recipe, step: 0, network, mean: vec![0.0; WEIGHTS], square: vec![0.0; WEIGHTS] }
    }

    /// Steps done.
    #[must_use]
    pub fn step(&self) -> u64 {
        self.step
    }

    /// The network as it is.
    #[must_use]
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// One step of AdamW.
    ///
    /// # Errors
    /// [`SolveError`] of the robust solver.
    pub fn advance(&mut self, generator: &Generator) -> Result<Report, SolveError> {
        let mut gradient: Gradient = vec![[0.0; WIDTH / 2]; WEIGHTS];
        let mut report = Report::default();
        for shard in in_parallel(SHARDS, |s| self.shard(generator, s)) {
            let (part, of_part) = shard?;
            for (sum, value) in gradient.iter_mut().flatten().zip(part.iter().flatten()) {
                *sum += value;
            }
            report.error += of_part.error;
            report.start_error += of_part.start_error;
        }
        let pixels = self.recipe.groups * self.recipe.blocks * WIDTH;
        report.pixels = pixels;
        report.error /= pixels as f64;
        report.start_error /= pixels as f64;
        self.update(&gradient, pixels);
        Ok(report)
    }

    /// Gradient and summed errors of every [`SHARDS`]th group of the step.
    fn shard(&self, generator: &Generator, shard: usize) -> Result<(Gradient, Report), SolveError> {
        let mut gradient: Gradient = vec![[0.0; WIDTH / 2]; WEIGHTS];
        let mut report = Report::default();
        let mut tape = Tape::default();
        for group in (shard..self.recipe.groups).step_by(SHARDS) {
            let stream = self.step * self.recipe.groups as u64 + group as u64;
            let mut rng = Rng::stream(self.recipe.seed, stream);
            let count = light_count(&mut rng);
            let lights = generator.lights(&mut rng, count);
            let batch = generator.pixels(&mut rng, lights, self.recipe.blocks * WIDTH);
            let measurements = batch.measurements();
            let start = Start::new(&measurements)?;
            for block in 0..self.recipe.blocks {
                let truth = &batch.normals[block * WIDTH..][..WIDTH];
                self.block(
                    &measurements,
                    &start,
                    block * WIDTH,
                    truth,
                    &mut tape,
                    &mut gradient,
                    &mut report,
                );
            }
        }
        Ok((gradient, report))
    }

    #[allow(clippy::too_many_arguments)]
    fn block(
        &self,
        measurements: &Measurements,
        start: &Start,
        first: usize,
        truth: &[Vec3],
        tape: &mut Tape,
        gradient: &mut Gradient,
        report: &mut Report,
    ) {
        let tokens = measurements.lights.len();
        let mut inputs = vec![Wide::ZERO; tokens * INPUTS];
        let frames: Vec<Frame> =
            (0..WIDTH).map(|lane| start.describe(measurements, first + lane, lane, &mut inputs)).collect();
        let outputs = self.network.forward(tape, &inputs, tokens);
        let mut d_outputs = [Wide::ZERO; OUTPUTS];
        for (lane, (frame, &truth)) in frames.iter().zip(truth).enumerate() {
            let [x, y, z, log] = outputs.map(|o| o.0[lane]);
            let truth = frame.turn(truth);
            let loss = pixel_loss(frame, Vec3::new(x, y, z), log, truth, self.recipe.uncertainty);
            report.error += f64::from(loss.error.to_degrees());
            report.start_error +=
                f64::from(crate::error::unit_angle(frame.correct(Vec3::ZERO).0, truth).to_degrees());
            for (d, value) in d_outputs.iter_mut().zip(loss.gradient) {
                d.0[lane] = value;
            }
        }
        self.network.backward(tape, &d_outputs, gradient);
    }

    fn update(&mut self, gradient: &Gradient, pixels: usize) {
        let Recipe { rate, warm_up, steps, decay, .. } = self.recipe;
        let mut g: Vec<f32> =
            gradient.iter().map(|lanes| lanes.iter().sum::<f32>() / pixels as f32).collect();
        let norm = g.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>().sqrt() as f32;
        if norm > 1.0 {
            g.iter_mut().for_each(|v| *v /= norm);
        }
        self.step += 1;
        let t = self.step;
        let progress = t.saturating_sub(warm_up) as f32 / steps.saturating_sub(warm_up).max(1) as f32;
        let falling = 0.5 * (1.0 + libm::cosf(std::f32::consts::PI * progress.min(1.0)));
        let rate = rate * falling * (t as f32 / warm_up.max(1) as f32).min(1.0);
        let (b1, b2) = (0.9f32, 0.99f32);
        let (c1, c2) = (1.0 - b1.powi(t.min(10_000) as i32), 1.0 - b2.powi(t.min(10_000) as i32));
        let (mean, square) = (&mut self.mean, &mut self.square);
        self.network.update(|weights| {
            for p in &PARAMETERS {
                let shrink = if p.shape[0] > 1 { 1.0 - rate * decay } else { 1.0 };
                for i in p.offset..p.offset + p.shape[0] * p.shape[1] {
                    mean[i] = b1 * mean[i] + (1.0 - b1) * g[i];
                    square[i] = b2 * square[i] + (1.0 - b2) * g[i] * g[i];
                    weights[i] =
                        weights[i] * shrink - rate * (mean[i] / c1) / ((square[i] / c2).sqrt() + 1e-8);
                }
            }
        });
    }

    /// Everything that a resumed run needs.
    #[must_use]
    pub fn checkpoint(&self) -> Vec<u8> {
        let mut out = MAGIC.to_vec();
        out.extend(self.step.to_le_bytes());
        for v in self.network.weights().iter().chain(&self.mean).chain(&self.square) {
            out.extend(v.to_le_bytes());
        }
        out
    }

    /// The run of a checkpoint; `recipe` must be the one it was begun with.
    ///
    /// # Errors
    /// [`CheckpointError`].
    pub fn resume(recipe: Recipe, bytes: &[u8]) -> Result<Self, CheckpointError> {
        let expected = 16 + 3 * 4 * WEIGHTS;
        if !bytes.starts_with(MAGIC) {
            return Err(CheckpointError::Foreign);
        }
        if bytes.len() != expected {
            return Err(CheckpointError::Length { found: bytes.len(), expected });
        }
        let step = u64::from_le_bytes(bytes[8..16].try_into().map_err(|_| CheckpointError::Foreign)?);
        let values: Vec<f32> =
            bytes[16..].chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        let network = Network::new(values[..WEIGHTS].to_vec()).ok_or(CheckpointError::Foreign)?;
        let mean = values[WEIGHTS..2 * WEIGHTS].to_vec();
        let square = values[2 * WEIGHTS..].to_vec();
        Ok(Self { recipe, step, network, mean, square })
    }
}

/// `work` of 0..count, on all threads where there are any.
#[cfg(all(feature = "cli", not(target_arch = "wasm32")))]
pub(super) fn in_parallel<T: Send>(count: usize, work: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    use rayon::prelude::*;
    (0..count).into_par_iter().map(work).collect()
}

/// `work` of 0..count.
#[cfg(not(all(feature = "cli", not(target_arch = "wasm32"))))]
pub(super) fn in_parallel<T>(count: usize, work: impl Fn(usize) -> T) -> Vec<T> {
    (0..count).map(work).collect()
}

/// Lights of a group: 3 to 100, mostly about ten.
pub(super) fn light_count(rng: &mut Rng) -> usize {
    match rng.uniform() {
        u if u < 0.22 => 3 + rng.below(4),
        u if u < 0.77 => 7 + rng.below(8),
        u if u < 0.95 => 15 + rng.below(16),
        _ => 31 + rng.below(70),
    }
}

struct PixelLoss {
    /// Angular error, radians.
    error: f32,
    /// Of the loss with respect to the outputs.
    gradient: [f32; OUTPUTS],
}

/// The loss of one pixel in its turned frame.
fn pixel_loss(frame: &Frame, correction: Vec3, log: f32, truth: Vec3, weight: f32) -> PixelLoss {
    let (normal, length, trust) = frame.correct(correction);
    let off = normal - truth;
    let chord = off.length();
    // Near zero the chord's direction is undefined: let it fade.
    let along = off / chord.max(1e-3);
    let d = (along - normal * normal.dot(along)) * (trust / length);
    let inside = f32::from(log > -7.0 && log < 0.45);
    let error = crate::error::unit_angle(normal, truth);
    PixelLoss { error, gradient: [d.x, d.y, d.z, weight * inside * (1.0 - error / expected_error(log))] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::worlds::Split;

    fn recipe() -> Recipe {
        Recipe { steps: 40, groups: 6, warm_up: 5, ..Recipe::default() }
    }

    #[test]
    fn a_resumed_run_is_the_same_run() {
        let generator = Generator::new(Split::Train);
        let mut whole = Training::new(recipe());
        for _ in 0..4 {
            whole.advance(&generator).unwrap();
        }
        let mut parts = Training::new(recipe());
        for _ in 0..2 {
            parts.advance(&generator).unwrap();
        }
        let mut parts = Training::resume(recipe(), &parts.checkpoint()).unwrap();
        for _ in 0..2 {
            parts.advance(&generator).unwrap();
        }
        assert_eq!(whole.checkpoint(), parts.checkpoint());
    }

    #[test]
    fn training_improves_on_the_robust_start() {
        let generator = Generator::new(Split::Train);
        let mut training = Training::new(recipe());
        let reports: Vec<Report> = (0..40).map(|_| training.advance(&generator).unwrap()).collect();
        let gain = |r: &[Report]| r.iter().map(|r| r.start_error - r.error).sum::<f64>() / r.len() as f64;
        assert!(
            gain(&reports[30..]) > gain(&reports[..5]) + 0.5,
            "{} {}",
            gain(&reports[30..]),
            gain(&reports[..5])
        );
    }

    #[test]
    fn damaged_checkpoints_are_named() {
        let bytes = Training::new(recipe()).checkpoint();
        assert!(matches!(Training::resume(recipe(), &bytes[..100]), Err(CheckpointError::Length { .. })));
        assert!(matches!(Training::resume(recipe(), b"PNG"), Err(CheckpointError::Foreign)));
    }
}
