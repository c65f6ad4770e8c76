//! The network's operations on burn tensors, recorded for the backward pass where the device records.

use super::network::{self, Border, Ops};
use super::weights::Weights;
use crate::policy::config::Config;
use burn::tensor::activation::{relu, sigmoid, softmax};
use burn::tensor::module::{conv_transpose2d, conv2d, linear, max_pool2d};
use burn::tensor::ops::{ConvOptions, ConvTransposeOptions, MaxPoolOptions, PadMode};
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use std::collections::HashMap;
use std::f32::consts::FRAC_2_PI;

/// Layer norm's guard against division by zero.
pub const NORM_EPSILON: f32 = 1e-5;
/// Guard of lengths under a square root, where the gradient would be infinite.
pub const LENGTH_EPSILON: f32 = 1e-12;

/// A network on a device: parameters as tensors, weight norm applied.
pub struct Network {
    config: Config,
    leaves: Vec<Tensor<1>>,
    kernels: HashMap<String, Tensor<4>>,
    matrices: HashMap<String, Tensor<2>>,
    vectors: HashMap<String, Tensor<1>>,
    positions: Vec<Tensor<2>>,
}

impl Network {
    /// The network of `weights` on `device`; gradients are recorded if the device is an autodiff one.
    #[must_use]
    pub fn new(weights: &Weights, device: &Device) -> Self {
        let config = weights.config.clone();
        let record = device.is_autodiff();
        let mut leaves = Vec::new();
        let (mut kernels, mut matrices, mut vectors) = (HashMap::new(), HashMap::new(), HashMap::new());
        let mut gains = HashMap::new();
        for p in &weights.params {
            let leaf = Tensor::<1>::from_data(TensorData::new(p.values.clone(), [p.values.len()]), device);
            let leaf = if record { leaf.require_grad() } else { leaf };
            leaves.push(leaf.clone());
            match p.shape[..] {
                [a, b, c, d] => drop(kernels.insert(p.name.clone(), leaf.reshape([a, b, c, d]))),
                [a, b] => drop(matrices.insert(p.name.clone(), leaf.reshape([a, b]))),
                _ if p.name.ends_with(".g") => drop(gains.insert(p.name.clone(), leaf)),
                _ => drop(vectors.insert(p.name.clone(), leaf)),
            }
        }
        let kernels = kernels
            .into_iter()
            .map(|(name, v)| {
                let layer = name.trim_end_matches(".v");
                let g = gains[&format!("{layer}.g")].clone();
                (layer.to_owned(), weight_norm(v, g, layer.starts_with("fuser.up")))
            })
            .collect();
        let positions = (0..config.max_frames)
            .map(|i| Tensor::from_data(TensorData::new(config.position(i), [1, config.width]), device))
            .collect();
        Self { leaves, kernels, matrices, vectors, positions, config }
    }

    /// Its sizes.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The gradient of every parameter, in the order of [`Weights::params`]; zero where the loss doesn't depend on it.
    #[must_use]
    pub fn gradients(&self, mut gradients: Gradients) -> Vec<Vec<f32>> {
        self.leaves
            .iter()
            .map(|leaf| match leaf.grad_remove(&mut gradients) {
                Some(g) => values(g),
                None => vec![0.0; leaf.dims()[0]],
            })
            .collect()
    }

    /// A new batch of sequences of `lights` pictures, nothing seen yet.
    #[must_use]
    pub fn start(&self, lights: usize) -> Sequence<'_> {
        self.sequence(None, lights)
    }

    /// All frames of `batch` sequences of `count` frames at once, attention masked so that none sees a later one: the same
    /// directions as frame by frame. Rows of every input are `sequence × count + frame`; shapes as for [`Sequence::step`].
    #[must_use]
    pub fn whole(&self, count: usize, frames: Tensor<4>, lights: Tensor<2>, reach: Tensor<2>) -> Tensor<2> {
        self.sequence(Some(count), count).step(frames, lights, reach)
    }

    fn sequence(&self, whole: Option<usize>, lights: usize) -> Sequence<'_> {
        let caches = vec![(Vec::new(), Vec::new()); self.config.layers];
        let told = self.config.told(lights);
        Sequence { net: self, whole, told, position: 0, light: None, reach: None, caches, gate: None }
    }
}

/// The numbers of a tensor.
///
/// # Panics
/// If the device fails: there is nothing to go on with then.
#[must_use]
pub fn values<const D: usize>(t: Tensor<D>) -> Vec<f32> {
    t.try_into_vec_as::<f32>().expect("a float tensor can be read back")
}

fn weight_norm(v: Tensor<4>, g: Tensor<1>, input_first: bool) -> Tensor<4> {
    let [a, b, _, _] = v.dims();
    let (axes, shape) = if input_first { ([0usize, 2, 3], [1, b, 1, 1]) } else { ([1, 2, 3], [a, 1, 1, 1]) };
    let norm = v.clone().square().sum_dims(&axes).clamp_min(1e-24).sqrt();
    v * (g.reshape(shape) / norm)
}

/// A batch of sequences in progress: what attention remembers of the frames so far.
pub struct Sequence<'a> {
    net: &'a Network,
    /// Number of frames where all are given at once.
    whole: Option<usize>,
    /// Number of pictures that the policy is told.
    told: usize,
    position: usize,
    light: Option<Tensor<2>>,
    reach: Option<Tensor<2>>,
    caches: Vec<(Vec<Tensor<3>>, Vec<Tensor<3>>)>,
    gate: Option<Tensor<4>>,
}

impl Sequence<'_> {
    /// Takes in the newest frames `[batch, 3, input, input]` (or one frame for all of the batch), the unit directions `[batch, 3]` they were taken under
    /// and the reach `[batch, 1]` as a fraction of 90°; gives the next directions `[batch, 3]`.
    pub fn step(&mut self, frames: Tensor<4>, lights: Tensor<2>, reach: Tensor<2>) -> Tensor<2> {
        let config = self.net.config.clone();
        let mut known = vec![lights, reach.clone()];
        if config.horizon > 0 {
            known.push(reach.zeros_like() + self.told as f32 / config.horizon as f32);
        }
        self.light = Some(Tensor::cat(known, 1));
        self.reach = Some(reach);
        let (mut features, gate) = network::encode_frame(self, &config, frames);
        self.gate = gate;
        let batch = self.light.as_ref().map_or(1, |l| l.dims()[0]);
        if features.dims()[0] < batch {
            let [_, c, h, w] = features.dims();
            features = features.expand([batch, c, h, w]);
        }
        let direction = network::next_direction(self, &config, features);
        self.position += 1;
        direction
    }

    /// The reliability mask of the newest frames, `[batch, 1, input, input]`.
    #[must_use]
    pub fn gate_map(&self) -> Option<&Tensor<4>> {
        self.gate.as_ref()
    }

    fn vector(&self, name: &str) -> Tensor<1> {
        self.net.vectors[name].clone()
    }
}

impl Ops for Sequence<'_> {
    type Map = Tensor<4>;
    type Rows = Tensor<2>;

    fn conv(&mut self, layer: &str, x: Tensor<4>, border: Border) -> Tensor<4> {
        let (x, pad) = match border {
            Border::Reflect => (x.pad((1, 1, 1, 1), PadMode::Reflect), 0),
            Border::Zero => (x, 1),
        };
        let kernel = self.net.kernels[layer].clone();
        let bias = self.vector(&format!("{layer}.b"));
        conv2d(x, kernel, Some(bias), ConvOptions::new([1, 1], [pad, pad], [1, 1], 1))
    }

    fn up(&mut self, layer: &str, x: Tensor<4>) -> Tensor<4> {
        let kernel = self.net.kernels[layer].clone();
        let bias = self.vector(&format!("{layer}.b"));
        conv_transpose2d(x, kernel, Some(bias), ConvTransposeOptions::new([2, 2], [1, 1], [1, 1], [1, 1], 1))
    }

    fn relu(&mut self, x: Tensor<4>) -> Tensor<4> {
        relu(x)
    }

    fn pool(&mut self, x: Tensor<4>) -> Tensor<4> {
        max_pool2d(x, MaxPoolOptions::new([2, 2]))
    }

    fn mul(&mut self, a: Tensor<4>, b: Tensor<4>) -> Tensor<4> {
        a * b
    }

    fn add(&mut self, a: Tensor<4>, b: Tensor<4>) -> Tensor<4> {
        a + b
    }

    fn join(&mut self, a: Tensor<4>, b: Tensor<4>) -> Tensor<4> {
        Tensor::cat(vec![a, b], 1)
    }

    fn first_channels(&mut self, x: Tensor<4>, count: usize) -> Tensor<4> {
        x.narrow(1, 0, count)
    }

    fn centred(&mut self, x: Tensor<4>) -> Tensor<4> {
        x.clone() - x.mean_dims(&[2, 3])
    }

    fn gate(&mut self, frames: Tensor<4>) -> Tensor<4> {
        let scalar = |name| self.vector(name).reshape([1, 1, 1, 1]);
        let x = frames.mean_dim(1);
        let softness = scalar("gate.softness");
        let low = sigmoid((x.clone() - scalar("gate.low")) / softness.clone());
        let high = sigmoid((scalar("gate.high") - x) / softness);
        low * high
    }

    fn three_channels(&mut self, x: Tensor<4>) -> Tensor<4> {
        Tensor::cat(vec![x.clone(), x.clone(), x], 1)
    }

    fn rows(&mut self, x: Tensor<4>) -> Tensor<2> {
        let [b, c, h, w] = x.dims();
        x.permute([0, 2, 3, 1]).reshape([b * h * w, c])
    }

    fn map(&mut self, x: Tensor<2>, grid: usize) -> Tensor<4> {
        let [rows, c] = x.dims();
        x.reshape([rows / (grid * grid), grid, grid, c]).permute([0, 3, 1, 2])
    }

    fn flat(&mut self, x: Tensor<4>) -> Tensor<2> {
        let [b, c, h, w] = x.dims();
        x.reshape([b, c * h * w])
    }

    fn spread(&mut self, x: Tensor<2>, grid: usize) -> Tensor<4> {
        let [b, c] = x.dims();
        x.reshape([b, c, 1, 1]).expand([b, c, grid, grid])
    }

    fn linear(&mut self, layer: &str, x: Tensor<2>) -> Tensor<2> {
        let w = self.net.matrices[&format!("{layer}.w")].clone();
        linear(x, w, Some(self.vector(&format!("{layer}.b"))))
    }

    fn relu_rows(&mut self, x: Tensor<2>) -> Tensor<2> {
        relu(x)
    }

    fn add_rows(&mut self, a: Tensor<2>, b: Tensor<2>) -> Tensor<2> {
        a + b
    }

    fn norm(&mut self, layer: &str, x: Tensor<2>) -> Tensor<2> {
        let x = x.clone() - x.mean_dim(1);
        let deviation = (x.clone().square().mean_dim(1) + NORM_EPSILON).sqrt();
        let gain = self.vector(&format!("{layer}.w")).unsqueeze::<2>();
        x / deviation * gain + self.vector(&format!("{layer}.b")).unsqueeze::<2>()
    }

    fn add_position(&mut self, x: Tensor<2>) -> Tensor<2> {
        let Some(frames) = self.whole else {
            return x + self.net.positions[self.position].clone();
        };
        let [rows, d] = x.dims();
        let locations = self.net.config.locations();
        let positions = Tensor::cat(self.net.positions[..frames].to_vec(), 0).reshape([1, frames, 1, d]);
        (x.reshape([rows / frames / locations, frames, locations, d]) + positions).reshape([rows, d])
    }

    fn attend(&mut self, layer: usize, qkv: Tensor<2>) -> Tensor<2> {
        let config = &self.net.config;
        let (d, heads) = (config.width, config.heads);
        let rows = qkv.dims()[0];
        if let Some(frames) = self.whole {
            return attend_whole(config, frames, qkv);
        }
        let part = |i: usize| qkv.clone().narrow(1, i * d, d);
        let query =
            part(0).mul_scalar(1.0 / ((d / heads) as f32).sqrt()).reshape([rows, 1, heads, d / heads]);
        let (keys, values) = &mut self.caches[layer];
        keys.push(part(1).reshape([rows, 1, d]));
        values.push(part(2).reshape([rows, 1, d]));
        let frames = keys.len();
        let shape = [rows, frames, heads, d / heads];
        let keys = Tensor::cat(keys.clone(), 1).reshape(shape);
        let values = Tensor::cat(values.clone(), 1).reshape(shape);
        // One query a row: products and sums are faster than many tiny matrix products.
        let weights = softmax((keys * query).sum_dim(3), 1);
        (values * weights).sum_dim(1).reshape([rows, d])
    }

    fn light(&mut self) -> Tensor<2> {
        self.light.clone().expect("set by step")
    }

    fn add_base(&mut self, x: Tensor<2>) -> Tensor<2> {
        let mut base = self.net.matrices["head.base"].clone();
        let config = &self.net.config;
        if config.horizon > 0 {
            let [first, frames] = [self.told * config.max_frames, config.max_frames];
            base = base + self.net.matrices["head.horizon"].clone().narrow(0, first, frames);
        }
        let Some(frames) = self.whole else {
            return x + base.narrow(0, self.position, 1);
        };
        let [rows, d] = x.dims();
        let base = base.narrow(0, 0, frames).reshape([1, frames, d]);
        (x.reshape([rows / frames, frames, d]) + base).reshape([rows, d])
    }

    fn direction(&mut self, x: Tensor<2>) -> Tensor<2> {
        let reach = self.reach.clone().expect("set by step");
        let xy = x.clone().narrow(1, 0, 2);
        let z = x.narrow(1, 2, 1).abs() + 1e-8;
        let length = (xy.clone().square().sum_dim(1) + z.clone().square() + LENGTH_EPSILON).sqrt();
        let (xy, z) = (xy / length.clone(), z / length);
        let radius = (xy.clone().square().sum_dim(1) + LENGTH_EPSILON).sqrt();
        // tan(slant/2) = r/(1+z): exact also where slant is small.
        let slant = (radius.clone() / (z + 1.0)).atan() * 2.0;
        let tightness = reach.recip().square().square() - 1.0;
        let fourth = (slant.clone() * FRAC_2_PI).square().square();
        let slant = slant / (tightness * fourth + 1.0).sqrt().sqrt();
        Tensor::cat(vec![xy * (slant.clone().sin() / radius), slant.cos()], 1)
    }
}

/// Attention over all frames at once, later ones masked.
fn attend_whole(config: &Config, frames: usize, qkv: Tensor<2>) -> Tensor<2> {
    let (d, heads, locations) = (config.width, config.heads, config.locations());
    let rows = qkv.dims()[0];
    let batch = rows / frames / locations;
    let part = |i: usize| {
        let x = qkv.clone().narrow(1, i * d, d).reshape([batch, frames, locations, heads, d / heads]);
        x.permute([0, 2, 3, 1, 4]).reshape([batch * locations * heads, frames, d / heads])
    };
    let later = (0..frames * frames).map(|i| if i % frames > i / frames { -1e9 } else { 0.0 }).collect();
    let later = tensor(later, [1, frames, frames], &qkv.device());
    let scores = part(0).matmul(part(1).swap_dims(1, 2)) * (1.0 / ((d / heads) as f32).sqrt());
    let mixed = softmax(scores + later, 2).matmul(part(2));
    let mixed = mixed.reshape([batch, locations, heads, frames, d / heads]).permute([0, 3, 1, 2, 4]);
    mixed.reshape([rows, d])
}

/// Numbers as a tensor on `device`.
#[must_use]
pub fn tensor<const D: usize>(numbers: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(numbers, shape), device)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    /// Small enough for finite differences.
    pub(crate) fn tiny() -> Config {
        Config {
            size: "tiny".into(),
            input: 8,
            channels: [2, 4, 4, 8],
            pools: 1,
            width: 8,
            layers: 1,
            heads: 2,
            feed_forward: 8,
            light_hidden: 4,
            head_hidden: 6,
            max_frames: 12,
            gating: true,
            base: true,
            horizon: 0,
            transformer: true,
        }
    }

    struct Input {
        frames: Vec<f32>,
        lights: Vec<f32>,
        reach: Vec<f32>,
    }

    impl Input {
        /// What `run` makes of frame `i`.
        fn step(&self, run: &mut Sequence, i: usize, device: &Device) -> Tensor<2> {
            let s = run.net.config.input;
            let frame = self.frames[i * 3 * s * s..(i + 1) * 3 * s * s].to_vec();
            run.step(
                tensor(frame, [1, 3, s, s], device),
                tensor(self.lights[3 * i..3 * i + 3].to_vec(), [1, 3], device),
                tensor(vec![self.reach[i]], [1, 1], device),
            )
        }
    }

    /// `count` random frames and lights, frame by frame.
    fn random(config: &Config, count: usize, seed: u64) -> Input {
        let mut rng = Rng::new(seed);
        let frames = (0..count * 3 * config.input * config.input).map(|_| rng.uniform()).collect();
        let lights = (0..count).flat_map(|_| rng.direction(1.5).to_array()).collect();
        Input { frames, lights, reach: vec![0.7; count] }
    }

    fn one(net: &Network, input: &Input, count: usize) -> Vec<Vec<f32>> {
        let device = Device::flex();
        let mut run = net.start(count);
        (0..count).map(|i| values(input.step(&mut run, i, &device))).collect()
    }

    fn all(net: &Network, input: &Input, count: usize) -> Vec<f32> {
        let (s, device) = (net.config.input, &Device::flex());
        values(net.whole(
            count,
            tensor(input.frames.clone(), [count, 3, s, s], device),
            tensor(input.lights.clone(), [count, 3], device),
            tensor(input.reach.clone(), [count, 1], device),
        ))
    }

    fn ablations(config: Config) -> [Config; 4] {
        [
            Config { gating: false, ..config.clone() },
            Config { transformer: false, ..config.clone() },
            Config { horizon: 10, ..config.clone() },
            config,
        ]
    }

    #[test]
    fn a_network_that_is_told_the_number_of_pictures_begins_as_it_was_and_can_use_it() {
        let config = Config::compact();
        let weights = Weights::new(&config, 1);
        let input = random(&config, 4, 2);
        let device = Device::flex();
        let before = one(&Network::new(&weights, &device), &input, 4);
        let mut told = weights.told(10);
        let after = one(&Network::new(&told, &device), &input, 4);
        for (a, b) in before.iter().flatten().zip(after.iter().flatten()) {
            assert!((a - b).abs() < 1e-6);
        }
        let row = 7 * config.max_frames + 1;
        let table = told.index()["head.horizon"];
        told.params[table].values[3 * row] = 0.5;
        let net = Network::new(&told, &device);
        let second = |lights: usize| {
            let mut run = net.start(lights);
            (0..2).map(|i| values(input.step(&mut run, i, &device))).collect::<Vec<_>>()
        };
        let (seven, eight) = (second(7), second(8));
        assert_eq!(seven[0], eight[0]);
        assert!((seven[1][0] - eight[1][0]).abs() > 0.05);
    }

    #[test]
    fn directions_are_unit_vectors_within_reach() {
        for config in ablations(Config::compact()) {
            let net = Network::new(&Weights::new(&config, 1), &Device::flex());
            let input = random(&config, 4, 2);
            for d in one(&net, &input, 4) {
                assert!((d.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5);
                let limit = 0.7 * std::f32::consts::FRAC_PI_2;
                assert!(d[2] >= limit.cos() - 1e-6, "{d:?}");
            }
        }
    }

    #[test]
    fn frame_by_frame_equals_all_at_once() {
        for config in ablations(Config::compact()) {
            let net = Network::new(&Weights::new(&config, 3), &Device::flex());
            let input = random(&config, 10, 4);
            let step: Vec<f32> = one(&net, &input, 10).concat();
            for (a, b) in step.iter().zip(all(&net, &input, 10)) {
                assert!((a - b).abs() < 1e-5, "{a} {b}");
            }
        }
    }

    #[test]
    fn a_later_frame_changes_no_earlier_direction() {
        let config = Config::compact();
        let net = Network::new(&Weights::new(&config, 5), &Device::flex());
        let input = random(&config, 5, 6);
        let before = all(&net, &input, 5);
        let mut changed = random(&config, 5, 6);
        let frame = 3 * config.input * config.input;
        changed.frames[3 * frame..4 * frame].iter_mut().for_each(|v| *v = 1.0 - *v);
        changed.lights[9..12].copy_from_slice(&[0.0, 0.6, 0.8]);
        let after = all(&net, &changed, 5);
        assert_eq!(before[..9], after[..9]);
        assert!(before[9..12] != after[9..12], "the frame itself must matter");
        assert!(before[12..15] != after[12..15], "and be remembered");
    }

    #[test]
    fn gradients_agree_with_finite_differences() {
        for config in ablations(tiny()) {
            let mut weights = Weights::new(&config, 7);
            // Away from kinks and from zero biases, so that every parameter has a say.
            let mut rng = Rng::new(8);
            weights
                .params
                .iter_mut()
                .for_each(|p| p.values.iter_mut().for_each(|v| *v += 0.05 * rng.normal()));
            let input = random(&config, 3, 9);
            let loss = |weights: &Weights, device: &Device| {
                let net = Network::new(weights, device);
                let mut run = net.start(3);
                let mut sum: Option<Tensor<1>> = None;
                for i in 0..3 {
                    let d = input.step(&mut run, i, device);
                    let weight = tensor(vec![1.0, -2.0, 0.5], [1, 3], device);
                    let term = (d * weight).sum();
                    sum = Some(match sum {
                        Some(s) => s + term,
                        None => term,
                    });
                }
                let sum = sum.unwrap();
                let value = values(sum.clone())[0];
                let gradient = device.is_autodiff().then(|| net.gradients(sum.backward()));
                (value, gradient)
            };
            let (_, gradient) = loss(&weights, &Device::flex().autodiff());
            let gradient = gradient.unwrap();
            let (mut checked, mut total) = (0, 0.0);
            for p in 0..weights.params.len() {
                let k = rng.below(weights.params[p].values.len());
                let at = |weights: &mut Weights, step: f32| {
                    let old = weights.params[p].values[k];
                    weights.params[p].values[k] = old + step;
                    let l = f64::from(loss(weights, &Device::flex()).0);
                    weights.params[p].values[k] = old;
                    l
                };
                let exact = f64::from(gradient[p][k]);
                // A kink of a ReLU or pool within ±h spoils a difference: one of three steps must agree.
                let agrees = [4e-3f32, 1e-3, 4e-4].into_iter().any(|h| {
                    let numeric = (at(&mut weights, h) - at(&mut weights, -h)) / f64::from(2.0 * h);
                    (numeric - exact).abs() < 1e-3 + 0.02 * exact.abs()
                });
                total += 1.0;
                checked += i32::from(agrees);
            }
            assert!(f64::from(checked) > 0.9 * total, "{checked} of {total} agree");
            let moved = gradient.iter().filter(|g| g.iter().any(|&v| v != 0.0)).count();
            assert!(moved as f64 > 0.9 * total, "{moved} of {total} parameters have a gradient");
        }
    }

    /// On a card, or Mesa's software Vulkan where there is none: `cargo test --release --features train-wgpu card`.
    #[cfg(feature = "train-wgpu")]
    #[test]
    fn a_card_gives_the_directions_and_gradients_of_the_cpu() {
        use crate::train::compute::{Compute, Processor};
        let card = Compute::new(Processor::Wgpu, 1).unwrap().device.autodiff();
        for config in ablations(Config::compact()) {
            let weights = Weights::new(&config, 11);
            let input = random(&config, 10, 12);
            let run = |device: &Device| {
                let net = Network::new(&weights, device);
                let mut sequence = net.start(10);
                let mut directions = Vec::new();
                let mut sum = tensor(vec![0.0], [1], device);
                for i in 0..10 {
                    let d = input.step(&mut sequence, i, device);
                    directions.extend(values(d.clone()));
                    sum = sum + (d * tensor(vec![1.0, -2.0, 0.5], [1, 3], device)).sum();
                }
                (directions, net.gradients(sum.backward()).concat())
            };
            let (expected, expected_gradient) = run(&Device::flex().autodiff());
            let (directions, gradient) = run(&card);
            for (a, b) in directions.iter().zip(&expected) {
                assert!((a - b).abs() < 1e-4, "{a} {b}");
            }
            let length = |g: &[f32]| g.iter().map(|v| v * v).sum::<f32>().sqrt();
            let off: Vec<f32> = gradient.iter().zip(&expected_gradient).map(|(a, b)| a - b).collect();
            let share = length(&off) / length(&expected_gradient);
            assert!(share < 1e-3, "gradients are {share} of their length apart");
            println!("gradients {share:.1e} of their length apart");
        }
    }
}
