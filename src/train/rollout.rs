//! One pass of training: capture a few objects under the policy, and the gradient of the reconstruction loss.
//!
//! Pictures enter burn's graph as `I(l₀) + J·(l − l₀)` with l₀ the direction's own value: exact in value and
//! gradient. The solver's gradient is computed by hand ([`super::loss`]), so the graph holds the network alone.

use super::formation::{Lookup, Scene, Shot};
use super::loss::{Captured, Measure, TrainingSolver, step_weights};
use super::tape::{Network, tensor, values};
use super::weights::Weights;
use crate::policy::config::Config;
use crate::policy::frame::{CEILING, Frames};
use burn::tensor::{Device, Tensor};
use glam::Vec3;
use std::f32::consts::FRAC_PI_2;

/// One object to be captured, and how.
pub struct Episode<'a> {
    /// The object.
    pub scene: &'a dyn Scene,
    /// What answers a direction.
    pub lookup: Lookup,
    /// Largest slant, radians; the policy is told.
    pub reach: f32,
}

/// How an episode is run.
#[derive(Clone, Copy, Debug)]
pub struct Conditions {
    /// Pictures an object, T.
    pub lights: usize,
    /// Share of the gradient through what the policy sees; see [`super::fit::Recipe::feedback`].
    pub feedback: f32,
    /// Largest length of dLoss/d(direction) of one picture; see [`super::fit::Recipe::steepest`].
    pub steepest: f32,
    /// What the loss measures.
    pub measure: Measure,
    /// The picture after which the loss is measured first.
    pub first_loss: usize,
    /// Whether the policy sees black frames only: what it can then learn is one fixed set of lights.
    pub blank: bool,
}

/// What a pass gives.
pub struct Pass {
    /// Mean weighted loss.
    pub total: f64,
    /// Mean of the measure after the last picture.
    pub last: f64,
    /// Gradient of the mean loss by each parameter.
    pub gradients: Vec<Vec<f32>>,
    /// Directions asked for, object by object.
    pub directions: Vec<Vec<Vec3>>,
}

/// Captures `episodes` as one batch and differentiates their mean loss; the network runs on `device`.
#[must_use]
pub fn differentiate(
    weights: &Weights,
    episodes: &[Episode],
    how: Conditions,
    solver: &dyn TrainingSolver,
    device: &Device,
) -> Pass {
    let device = device.clone().autodiff();
    let net = Network::new(weights, &device);
    let mut run = Run::new(&weights.config, episodes, how);
    let mut sequence = net.start(how.lights);
    let mut asked: Vec<Tensor<2>> = Vec::new();
    let mut direction = run.first(&device);
    for i in 0..how.lights {
        let newest = run.capture(&values(direction.clone()), true);
        asked.push(direction.clone());
        if i + 1 < how.lights {
            let (frames, lights) = run.inputs(newest, &direction, &device);
            direction = sequence.step(frames, lights, run.reach(&device));
        }
    }
    let step = step_weights(how.lights, how.first_loss);
    let (mut total, mut last) = (0.0, 0.0);
    let mut surrogate: Option<Tensor<1>> = None;
    let share = 1.0 / episodes.len() as f64;
    let mut slopes = vec![vec![0.0f32; 3 * episodes.len()]; how.lights];
    for (b, track) in run.tracks.iter().enumerate() {
        let lights: Vec<Vec3> = track.shots.iter().map(|s| s.light).collect();
        let captured = Captured { lights: &lights, grey: &track.grey, truth: episodes[b].scene.truth() };
        let loss = solver.loss(&captured, &step, how.measure);
        total += share * loss.total;
        last += share * loss.last;
        for (t, shot) in track.shots.iter().enumerate() {
            let mut slope = shot.light_gradient.transpose() * loss.lights[t];
            for (gradient, &by_grey) in shot.gradient.iter().zip(&loss.grey[t]) {
                slope += (gradient[0] + gradient[1] + gradient[2]) * (by_grey / 3.0);
            }
            let slope = slope.clamp_length_max(how.steepest) * share as f32;
            slopes[t][3 * b..3 * b + 3].copy_from_slice(&slope.to_array());
        }
    }
    // The first light is given, not decided.
    for (slope, direction) in slopes.into_iter().zip(asked).skip(1) {
        let term = (direction * tensor(slope, [episodes.len(), 3], &device)).sum();
        surrogate = Some(match surrogate {
            Some(s) => s + term,
            None => term,
        });
    }
    let gradients = match surrogate {
        Some(s) => net.gradients(s.backward()),
        None => weights.params.iter().map(|p| vec![0.0; p.values.len()]).collect(),
    };
    Pass { total, last, gradients, directions: run.tracks.into_iter().map(|t| t.asked).collect() }
}

/// What the policy does on `episodes`, without gradients: the pictures' lights (as the solver must use them) and grey
/// values, object by object.
#[must_use]
pub fn capture(net: &Network, episodes: &[Episode], how: Conditions, device: &Device) -> Vec<Captures> {
    let mut run = Run::new(net.config(), episodes, how);
    let mut sequence = net.start(how.lights);
    let mut direction = run.first(device);
    for i in 0..how.lights {
        let newest = run.capture(&values(direction.clone()), false);
        if i + 1 < how.lights {
            let (frames, lights) = run.inputs(newest, &direction, device);
            direction = sequence.step(frames, lights, run.reach(device));
        }
    }
    run.tracks
        .into_iter()
        .map(|t| Captures { lights: t.shots.iter().map(|s| s.light).collect(), grey: t.grey, asked: t.asked })
        .collect()
}

/// The pictures of one object.
#[derive(Clone, Debug)]
pub struct Captures {
    /// Light direction of each picture.
    pub lights: Vec<Vec3>,
    /// Grey values of each picture.
    pub grey: Vec<Vec<f32>>,
    /// Directions asked for.
    pub asked: Vec<Vec3>,
}

struct Track {
    frames: Frames,
    used: Vec<usize>,
    shots: Vec<Shot>,
    grey: Vec<Vec<f32>>,
    asked: Vec<Vec3>,
}

struct Run<'a> {
    side: usize,
    episodes: &'a [Episode<'a>],
    how: Conditions,
    tracks: Vec<Track>,
}

impl<'a> Run<'a> {
    fn new(config: &Config, episodes: &'a [Episode<'a>], how: Conditions) -> Self {
        let tracks = episodes
            .iter()
            .map(|e| Track {
                frames: Frames::new(e.scene.mask(), config.input),
                used: Vec::new(),
                shots: Vec::new(),
                grey: Vec::new(),
                asked: Vec::new(),
            })
            .collect();
        Self { side: config.input, episodes, how, tracks }
    }

    fn first(&self, device: &Device) -> Tensor<2> {
        tensor([0.0, 0.0, 1.0].repeat(self.tracks.len()), [self.tracks.len(), 3], device)
    }

    fn reach(&self, device: &Device) -> Tensor<2> {
        tensor(self.episodes.iter().map(|e| e.reach / FRAC_PI_2).collect(), [self.tracks.len(), 1], device)
    }

    /// Photographs every object under its direction (three numbers each); gives the picture's number.
    fn capture(&mut self, directions: &[f32], keep_gradient: bool) -> usize {
        for ((track, e), d) in self.tracks.iter_mut().zip(self.episodes).zip(directions.as_chunks::<3>().0) {
            let direction = Vec3::from_array(*d).normalize_or(Vec3::Z);
            let mut shot = if keep_gradient || e.lookup != Lookup::Exact {
                e.lookup.take(e.scene, direction, &track.used)
            } else {
                Shot {
                    light: direction,
                    light_gradient: glam::Mat3::IDENTITY,
                    index: None,
                    rgb: e.scene.image(direction),
                    gradient: Vec::new(),
                }
            };
            if !keep_gradient {
                shot.gradient = Vec::new();
            }
            track.used.extend(shot.index);
            track.asked.push(direction);
            track.grey.push(shot.rgb.iter().map(|c| (c[0] + c[1] + c[2]) / 3.0).collect());
            track.shots.push(shot);
        }
        self.tracks.first().map_or(0, |t| t.shots.len() - 1)
    }

    /// The newest pictures and their directions as the network takes them, depending on `direction`.
    fn inputs(&mut self, newest: usize, direction: &Tensor<2>, device: &Device) -> (Tensor<4>, Tensor<2>) {
        let (batch, s) = (self.tracks.len(), self.side);
        let cells = 3 * s * s;
        let mut frames = Vec::with_capacity(batch * cells);
        let mut slopes = [Vec::new(), Vec::new(), Vec::new()];
        let (mut lights, mut by_light) = (Vec::new(), [Vec::new(), Vec::new(), Vec::new()]);
        for track in &mut self.tracks {
            let shot = &track.shots[newest];
            lights.extend(shot.light.normalize_or(Vec3::Z).to_array());
            for (axis, column) in by_light.iter_mut().enumerate() {
                column.extend(shot.light_gradient.col(axis).to_array());
            }
            if self.how.blank {
                continue;
            }
            let frame = track.frames.next(&shot.rgb);
            let share = self.how.feedback / track.frames.white().unwrap_or(1.0);
            if !shot.gradient.is_empty() {
                for (axis, slope) in slopes.iter_mut().enumerate() {
                    for channel in 0..3 {
                        slope.extend(track.frames.crop.average(|p| shot.gradient[p][channel][axis] * share));
                    }
                    // Nothing changes where a value is cut off at the ceiling.
                    let start = slope.len() - cells;
                    for (s, &v) in slope[start..].iter_mut().zip(&frame) {
                        *s = if v < CEILING { s.clamp(-STEEP_PIXEL, STEEP_PIXEL) } else { 0.0 };
                    }
                }
            }
            frames.extend(frame);
        }
        // Black frames are all the same: one is enough.
        let mut frames = match self.how.blank {
            true => Tensor::zeros([1, 3, s, s], device),
            false => tensor(frames, [batch, 3, s, s], device),
        };
        let mut lights = tensor(lights, [batch, 3], device);
        let tracked =
            self.how.feedback > 0.0 && self.tracks.iter().any(|t| !t.shots[newest].gradient.is_empty());
        if tracked {
            let step = direction.clone() - direction.clone().detach();
            for (axis, (slope, by)) in slopes.into_iter().zip(by_light).enumerate() {
                let step = step.clone().narrow(1, axis, 1);
                lights = lights + tensor(by, [batch, 3], device) * step.clone().mul_scalar(self.how.feedback);
                if !self.how.blank {
                    frames =
                        frames + tensor(slope, [batch, 3, s, s], device) * step.reshape([batch, 1, 1, 1]);
                }
            }
        }
        (frames, lights)
    }
}

/// Largest slope of one value of an input frame by the direction.
const STEEP_PIXEL: f32 = 10.0;
