//! The network's parameters as plain numbers: what the optimiser changes, checkpoints keep and the exporter folds.

use crate::policy::config::Config;
use crate::rng::Rng;
use std::collections::BTreeMap;

/// One trained tensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Param {
    /// Layer and part, as `encoder.3.v`.
    pub name: String,
    /// Its dimensions, row-major.
    pub shape: Vec<usize>,
    /// Its values.
    pub values: Vec<f32>,
}

/// All parameters of a network, in a fixed order.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    /// The network they belong to.
    pub config: Config,
    /// The tensors.
    pub params: Vec<Param>,
}

/// Gain of a layer that a ReLU follows: keeps the scale of activations from layer to layer.
const RELU_GAIN: f32 = std::f32::consts::SQRT_2;

/// Gain of the encoder's layers. With [`RELU_GAIN`] features of frames, which are dark and smooth, come out at about 0.06, the
/// gated product of two such at 0.004, and the policy did not notice its pictures within 300 updates (directions differed
/// by 0.2° between objects); this makes the product about twenty times larger.
const ENCODER_GAIN: f32 = 1.2 * RELU_GAIN;

/// Gain of the layers before a sum or the direction: the direction starts near the last bias, and light to move.
const LAST_GAIN: f32 = 0.4;

/// Start of the gate's thresholds and softness, in units of the first frame's 99 % quantile.
const GATE: [(&str, f32); 3] = [("gate.low", 0.05), ("gate.high", 0.95), ("gate.softness", 0.05)];

impl Weights {
    /// Fresh parameters: convolutions orthogonal with zero bias and a gain for weight norm, linear layers
    /// uniform (Glorot), the decoder's last bias such that directions start away from the optical axis.
    #[must_use]
    pub fn new(config: &Config, seed: u64) -> Self {
        let mut b = Builder { rng: Rng::new(seed), params: Vec::new() };
        let [c0, c1, c2, c3] = config.channels;
        for (i, pair) in [3, c0, c1, c1, c2, c2, c3, c3, c3].windows(2).enumerate() {
            b.conv(&format!("encoder.{i}"), pair[0], pair[1], ENCODER_GAIN);
        }
        if config.gating {
            for (name, start) in GATE {
                b.push(name, vec![1], vec![start]);
            }
        }
        if config.transformer {
            let d = config.width;
            b.linear("tokens.in", c3, d, 1.0);
            for l in 0..config.layers {
                b.norm(&format!("block.{l}.norm1"), d);
                b.linear(&format!("block.{l}.qkv"), d, 3 * d, 1.0);
                b.linear(&format!("block.{l}.out"), d, d, 1.0);
                b.norm(&format!("block.{l}.norm2"), d);
                b.linear(&format!("block.{l}.up"), d, config.feed_forward, 1.0);
                b.linear(&format!("block.{l}.down"), config.feed_forward, d, 1.0);
            }
            b.norm("tokens.norm", d);
            b.linear("tokens.out", d, c3, 1.0);
        }
        b.conv("view.0", c3, c3 / 2, RELU_GAIN);
        b.conv("view.1", c3 / 2, c3 / 4, RELU_GAIN);
        b.conv("view.2", c3 / 4, 1, LAST_GAIN);
        let e = config.embedding();
        // Direction and reach, perhaps the number of pictures; the paper's embedding has the direction alone.
        b.linear("light.0", 4 + usize::from(config.horizon > 0), config.light_hidden, RELU_GAIN);
        b.linear("light.1", config.light_hidden, e, RELU_GAIN);
        b.conv("fuser.down0", 2 * e, 2 * e, RELU_GAIN);
        b.conv("fuser.down1", 2 * e, 4 * e, RELU_GAIN);
        b.conv("fuser.down2", 4 * e, 8 * e, RELU_GAIN);
        b.up("fuser.up1", 8 * e, 4 * e);
        b.conv("fuser.merge1", 8 * e, 4 * e, RELU_GAIN);
        b.up("fuser.up0", 4 * e, 2 * e);
        b.conv("fuser.merge0", 4 * e, 2 * e, RELU_GAIN);
        b.conv("fuser.last0", 2 * e, e, RELU_GAIN);
        b.conv("fuser.last1", e, 1, LAST_GAIN);
        b.linear("head.0", config.locations(), config.head_hidden, RELU_GAIN);
        b.linear("head.1", config.head_hidden, 3, LAST_GAIN);
        if config.base {
            let base = (0..config.max_frames).flat_map(|t| base(t).to_array()).collect();
            b.push("head.base", vec![config.max_frames, 3], base);
        } else {
            let bias = b.params.last_mut().expect("head.1 has a bias");
            bias.values = vec![0.5, 0.5, 1.0];
        }
        if config.horizon > 0 {
            // A row for each number of pictures and each step.
            let rows = (config.horizon + 1) * config.max_frames;
            b.push("head.horizon", vec![rows, 3], vec![0.0; 3 * rows]);
        }
        Self { config: config.clone(), params: b.params }
    }

    /// The same network, to be told how many pictures there will be: it does at first what it did before.
    #[must_use]
    pub fn told(self, horizon: usize) -> Self {
        let config = Config { horizon, ..self.config.clone() };
        let mut told = Self::new(&config, 0);
        for p in &mut told.params {
            p.values.fill(0.0);
            // A new input of a layer is a row at the end of its matrix.
            if let Some(old) = self.params.iter().find(|old| old.name == p.name) {
                p.values[..old.values.len()].copy_from_slice(&old.values);
            }
        }
        told
    }

    /// Goes this share of the way to `other`, parameters of the same network.
    pub fn approach(&mut self, other: &Self, share: f32) {
        for (mine, theirs) in self.params.iter_mut().zip(&other.params) {
            for (a, b) in mine.values.iter_mut().zip(&theirs.values) {
                *a += share * (b - *a);
            }
        }
    }

    /// Number of trained values.
    #[must_use]
    pub fn count(&self) -> usize {
        self.params.iter().map(|p| p.values.len()).sum()
    }

    /// Position of each parameter by name.
    #[must_use]
    pub fn index(&self) -> BTreeMap<&str, usize> {
        self.params.iter().enumerate().map(|(i, p)| (p.name.as_str(), i)).collect()
    }

    /// The values of one parameter.
    ///
    /// # Panics
    /// If the network has no such parameter: a mistake in this crate.
    #[must_use]
    pub fn get(&self, name: &str) -> &Param {
        self.params.iter().find(|p| p.name == name).unwrap_or_else(|| panic!("no parameter {name}"))
    }

    /// Replaces weight norm by its result and rounds everything to half precision, as a model file holds it: the
    /// network that is shipped. Doing it twice changes nothing beyond rounding.
    #[must_use]
    pub fn folded(&self) -> Self {
        let mut out = self.clone();
        for p in &mut out.params {
            if let Some(layer) = p.name.strip_suffix(".v") {
                p.values = self.fold(layer).values;
            }
            p.values.iter_mut().for_each(|v| *v = half(*v));
        }
        out.with_gains_of_kernels()
    }

    /// With each gain equal to the norm of its kernel, so that weight norm changes nothing: the kernels are those to be used.
    #[must_use]
    pub fn with_gains_of_kernels(mut self) -> Self {
        for i in 0..self.params.len() {
            if let Some(layer) = self.params[i].name.strip_suffix(".g") {
                let v = self.get(&format!("{layer}.v"));
                self.params[i].values = norms(v);
            }
        }
        self
    }

    /// The convolution kernel `g·v/‖v‖` of a weight-normed layer.
    #[must_use]
    pub fn fold(&self, layer: &str) -> Param {
        let v = self.get(&format!("{layer}.v"));
        let g = self.get(&format!("{layer}.g"));
        let scale: Vec<f32> = norms(v).iter().zip(&g.values).map(|(n, g)| g / n).collect();
        let mut folded = v.clone();
        folded.name = format!("{layer}.w");
        for (i, value) in folded.values.iter_mut().enumerate() {
            *value *= scale[output_channel(v, i)];
        }
        folded
    }
}

/// `value` rounded to half precision.
#[must_use]
pub fn half(value: f32) -> f32 {
    tract_onnx::prelude::f16::from_f32(value).to_f32()
}

/// Whether a kernel is stored input channel first (transposed convolutions are).
fn input_first(name: &str) -> bool {
    name.starts_with("fuser.up")
}

fn output_channel(v: &Param, i: usize) -> usize {
    let area = v.shape[2] * v.shape[3];
    if input_first(&v.name) { i / area % v.shape[1] } else { i / area / v.shape[1] }
}

/// Length of the kernel of each output channel.
fn norms(v: &Param) -> Vec<f32> {
    let outputs = if input_first(&v.name) { v.shape[1] } else { v.shape[0] };
    let mut squares = vec![0.0f32; outputs];
    for (i, value) in v.values.iter().enumerate() {
        squares[output_channel(v, i)] += value * value;
    }
    squares.iter().map(|s| s.max(1e-24).sqrt()).collect()
}

/// The direction that step `t` (0 the first decided one) starts from: on a ring of 20° that is good on most objects. Neighbours in
/// time are 160° apart, so that every beginning of the sequence is spread over the azimuths.
fn base(t: usize) -> glam::Vec3 {
    crate::light::from_azimuth_slant((160.0 * t as f32).to_radians(), 20f32.to_radians())
}

struct Builder {
    rng: Rng,
    params: Vec<Param>,
}

impl Builder {
    fn push(&mut self, name: &str, shape: Vec<usize>, values: Vec<f32>) {
        assert_eq!(shape.iter().product::<usize>(), values.len());
        self.params.push(Param { name: name.into(), shape, values });
    }

    /// 3×3 convolution with weight norm.
    fn conv(&mut self, name: &str, from: usize, to: usize, gain: f32) {
        let v = orthogonal(&mut self.rng, to, from * 9);
        self.normed(name, vec![to, from, 3, 3], v, to, gain);
    }

    /// 3×3 transposed convolution, stride 2, with weight norm.
    fn up(&mut self, name: &str, from: usize, to: usize) {
        let rows = orthogonal(&mut self.rng, to, from * 9);
        let mut v = vec![0.0; rows.len()];
        for o in 0..to {
            for i in 0..from {
                let (src, dst) = ((o * from + i) * 9, (i * to + o) * 9);
                v[dst..dst + 9].copy_from_slice(&rows[src..src + 9]);
            }
        }
        // A quarter of the taps reaches each output pixel: twice the gain keeps the scale.
        self.normed(name, vec![from, to, 3, 3], v, to, 2.0 * RELU_GAIN);
    }

    fn normed(&mut self, name: &str, shape: Vec<usize>, mut v: Vec<f32>, outputs: usize, gain: f32) {
        v.iter_mut().for_each(|x| *x *= gain);
        self.push(&format!("{name}.v"), shape, v);
        let v = self.params.last().expect("just pushed");
        let g = norms(v);
        self.push(&format!("{name}.g"), vec![outputs], g);
        self.push(&format!("{name}.b"), vec![outputs], vec![0.0; outputs]);
    }

    fn linear(&mut self, name: &str, from: usize, to: usize, gain: f32) {
        let limit = gain * libm::sqrtf(6.0 / (from + to) as f32);
        let w = (0..from * to).map(|_| self.rng.range(-limit, limit)).collect();
        self.push(&format!("{name}.w"), vec![from, to], w);
        self.push(&format!("{name}.b"), vec![to], vec![0.0; to]);
    }

    fn norm(&mut self, name: &str, width: usize) {
        self.push(&format!("{name}.w"), vec![width], vec![1.0; width]);
        self.push(&format!("{name}.b"), vec![width], vec![0.0; width]);
    }
}

/// `rows × columns` with orthonormal rows (or columns, where there are fewer of them), from normal numbers.
fn orthogonal(rng: &mut Rng, rows: usize, columns: usize) -> Vec<f32> {
    let (count, length) = (rows.min(columns), rows.max(columns));
    let mut basis: Vec<Vec<f64>> = Vec::with_capacity(count);
    while basis.len() < count {
        let mut v: Vec<f64> = (0..length).map(|_| f64::from(rng.normal())).collect();
        // Twice: one pass of Gram-Schmidt leaves rounding behind.
        for _ in 0..2 {
            for b in &basis {
                let dot: f64 = b.iter().zip(&v).map(|(x, y)| x * y).sum();
                v.iter_mut().zip(b).for_each(|(y, x)| *y -= dot * x);
            }
        }
        let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        if norm > 1e-6 {
            v.iter_mut().for_each(|x| *x /= norm);
            basis.push(v);
        }
    }
    let mut out = vec![0.0; rows * columns];
    for r in 0..rows {
        for c in 0..columns {
            out[r * columns + c] = if rows <= columns { basis[r][c] } else { basis[c][r] } as f32;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orthogonal_rows_are_orthonormal() {
        let (rows, columns) = (8, 27);
        let m = orthogonal(&mut Rng::new(1), rows, columns);
        for a in 0..rows {
            for b in 0..rows {
                let dot: f32 = (0..columns).map(|c| m[a * columns + c] * m[b * columns + c]).sum();
                assert!((dot - f32::from(u8::from(a == b))).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn folding_is_g_v_over_norm_and_idempotent() {
        let mut w = Weights::new(&Config::compact(), 5);
        for p in &mut w.params {
            if p.name.ends_with(".g") {
                p.values.iter_mut().enumerate().for_each(|(i, g)| *g *= 0.5 + i as f32 * 0.1);
            }
        }
        for layer in ["encoder.2", "fuser.up0"] {
            let k = w.fold(layer);
            let v = w.get(&format!("{layer}.v")).clone();
            let g = w.get(&format!("{layer}.g")).clone();
            for (n, g) in norms(&Param { name: v.name, ..k }).iter().zip(&g.values) {
                assert!((n - g).abs() < 1e-5);
            }
        }
        let once = w.folded();
        for (a, b) in once.params.iter().zip(&once.folded().params) {
            assert!(a.values.iter().zip(&b.values).all(|(x, y)| (x - y).abs() <= 1e-6 * x.abs().max(1e-3)));
        }
    }

    #[test]
    fn ablations_lack_their_part_only() {
        let c = Config::compact();
        let names = |c: &Config| Weights::new(c, 1).params.into_iter().map(|p| p.name).collect::<Vec<_>>();
        let all = names(&c);
        let ungated = names(&Config { gating: false, ..c.clone() });
        let alone = names(&Config { transformer: false, ..c });
        assert!(all.iter().filter(|n| !ungated.contains(n)).all(|n| n.starts_with("gate.")));
        assert!(
            all.iter()
                .filter(|n| !alone.contains(n))
                .all(|n| n.starts_with("block.") || n.starts_with("tokens."))
        );
        assert!(ungated.len() < all.len() && alone.len() < all.len());
    }
}
