//! The set network of the pixel solver: forward, and backward for training.
//!
//! Tokens are the observations of one pixel. Two pre-norm transformer layers without positions (the order of
//! the lights means nothing), mean and maximum over the tokens, two fully connected layers.
//!
//! [`WIDTH`] pixels are computed at once, one a SIMD lane, and each lane adds in the order a single pixel
//! would, without fused multiply-adds: the result is the same to the bit on every machine and in WASM. The
//! network is this small and this fixed, so its gradient is written out here (checked against finite
//! differences) instead of carrying a tensor library into the page.

/// Pixels computed at once.
pub const WIDTH: usize = 16;
/// Values that describe one observation.
pub const INPUTS: usize = 18;
/// Width of the token stream.
pub const MODEL: usize = 64;
/// Attention heads.
pub const HEADS: usize = 4;
/// Width of the feed-forward layers.
pub const HIDDEN: usize = 96;
/// Transformer layers.
pub const LAYERS: usize = 2;
/// Width of the head.
pub const HEAD: usize = 64;
/// Correction of the normal (3) and logarithm of the expected error in radians.
pub const OUTPUTS: usize = 4;

/// Width of an attention head.
pub const HEAD_WIDTH: usize = MODEL / HEADS;
/// Added to the variance by the layer norms.
pub const NORM_EPSILON: f32 = 1e-5;
/// Rows of a weight matrix that are multiplied together; measured on AVX2 (4) and WASM SIMD (2).
const TILE: usize = if cfg!(target_arch = "wasm32") { 2 } else { 4 };
/// Lanes of a gradient accumulator.
const HALF: usize = WIDTH / 2;

/// One value of each of [`WIDTH`] pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
pub struct Wide(pub [f32; WIDTH]);

impl Wide {
    /// 0 everywhere.
    pub const ZERO: Self = Self([0.0; WIDTH]);

    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        let mut out = self;
        for l in 0..WIDTH {
            out.0[l] = f(self.0[l], other.0[l]);
        }
        out
    }

    #[inline(always)]
    fn map(self, f: impl Fn(f32) -> f32) -> Self {
        let mut out = self;
        for v in &mut out.0 {
            *v = f(*v);
        }
        out
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }

    #[inline(always)]
    fn scale(self, factor: f32) -> Self {
        self.map(|v| v * factor)
    }
}

/// Part of a gradient: one accumulator a weight, summed over its lanes at the end.
pub type Gradient = Vec<[f32; HALF]>;

/// One named weight array in the flat list of all weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameter {
    /// Which layer.
    pub name: &'static str,
    /// Rows (outputs), columns (inputs); one row for biases and norms.
    pub shape: [usize; 2],
    /// Where it begins.
    pub offset: usize,
}

const fn parameter(name: &'static str, rows: usize, columns: usize) -> Parameter {
    Parameter { name, shape: [rows, columns], offset: 0 }
}

/// All weight arrays in the order of the flat list.
pub const PARAMETERS: [Parameter; 4 * 3 * LAYERS + 8] = {
    let mut all = [
        parameter("embed.weight", MODEL, INPUTS),
        parameter("embed.bias", 1, MODEL),
        parameter("layer0.norm1.scale", 1, MODEL),
        parameter("layer0.norm1.shift", 1, MODEL),
        parameter("layer0.qkv.weight", 3 * MODEL, MODEL),
        parameter("layer0.qkv.bias", 1, 3 * MODEL),
        parameter("layer0.merge.weight", MODEL, MODEL),
        parameter("layer0.merge.bias", 1, MODEL),
        parameter("layer0.norm2.scale", 1, MODEL),
        parameter("layer0.norm2.shift", 1, MODEL),
        parameter("layer0.up.weight", HIDDEN, MODEL),
        parameter("layer0.up.bias", 1, HIDDEN),
        parameter("layer0.down.weight", MODEL, HIDDEN),
        parameter("layer0.down.bias", 1, MODEL),
        parameter("layer1.norm1.scale", 1, MODEL),
        parameter("layer1.norm1.shift", 1, MODEL),
        parameter("layer1.qkv.weight", 3 * MODEL, MODEL),
        parameter("layer1.qkv.bias", 1, 3 * MODEL),
        parameter("layer1.merge.weight", MODEL, MODEL),
        parameter("layer1.merge.bias", 1, MODEL),
        parameter("layer1.norm2.scale", 1, MODEL),
        parameter("layer1.norm2.shift", 1, MODEL),
        parameter("layer1.up.weight", HIDDEN, MODEL),
        parameter("layer1.up.bias", 1, HIDDEN),
        parameter("layer1.down.weight", MODEL, HIDDEN),
        parameter("layer1.down.bias", 1, MODEL),
        parameter("norm.scale", 1, MODEL),
        parameter("norm.shift", 1, MODEL),
        parameter("head1.weight", HEAD, 2 * MODEL),
        parameter("head1.bias", 1, HEAD),
        parameter("head2.weight", OUTPUTS, HEAD),
        parameter("head2.bias", 1, OUTPUTS),
    ];
    let mut offset = 0;
    let mut i = 0;
    while i < all.len() {
        all[i].offset = offset;
        offset += all[i].shape[0] * all[i].shape[1];
        i += 1;
    }
    all
};

/// Number of weights.
pub const WEIGHTS: usize = {
    let last = PARAMETERS[PARAMETERS.len() - 1];
    last.offset + last.shape[0] * last.shape[1]
};

// Positions in PARAMETERS.
const EMBED: usize = 0;
const FIRST_LAYER: usize = 2;
const A_LAYER: usize = 12;
const NORM: usize = FIRST_LAYER + LAYERS * A_LAYER;
const HEAD1: usize = NORM + 2;
const HEAD2: usize = HEAD1 + 2;
// Within a layer.
const NORM1: usize = 0;
const QKV: usize = 2;
const MERGE: usize = 4;
const NORM2: usize = 6;
const UP: usize = 8;
const DOWN: usize = 10;

/// The network with weights laid out for multiplication.
#[derive(Clone, Debug)]
pub struct Network {
    weights: Vec<f32>,
    /// Each matrix in tiles of TILE rows, column by column; beside its own the transposed one.
    forward: Vec<Vec<f32>>,
    transposed: Vec<Vec<f32>>,
}

fn tiles(rows: usize, columns: usize, at: impl Fn(usize, usize) -> f32) -> Vec<f32> {
    let mut out = Vec::with_capacity(rows * columns);
    for tile in 0..rows / TILE {
        for column in 0..columns {
            out.extend((0..TILE).map(|r| at(tile * TILE + r, column)));
        }
    }
    out
}

impl Network {
    /// The network of these weights, in the order of [`PARAMETERS`]; `None` where the count is wrong.
    #[must_use]
    pub fn new(weights: Vec<f32>) -> Option<Self> {
        if weights.len() != WEIGHTS {
            return None;
        }
        let mut network = Self {
            weights,
            forward: vec![Vec::new(); PARAMETERS.len()],
            transposed: vec![Vec::new(); PARAMETERS.len()],
        };
        network.pack();
        Some(network)
    }

    /// All weights in the order of [`PARAMETERS`].
    #[must_use]
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// Changes the weights.
    pub fn update(&mut self, change: impl FnOnce(&mut [f32])) {
        change(&mut self.weights);
        self.pack();
    }

    fn pack(&mut self) {
        for (i, p) in PARAMETERS.iter().enumerate() {
            let [rows, columns] = p.shape;
            if rows > 1 {
                let w = &self.weights[p.offset..p.offset + rows * columns];
                self.forward[i] = tiles(rows, columns, |r, c| w[r * columns + c]);
                if columns % TILE == 0 {
                    self.transposed[i] = tiles(columns, rows, |r, c| w[c * columns + r]);
                }
            }
        }
    }

    fn vector(&self, i: usize) -> &[f32] {
        let p = &PARAMETERS[i];
        &self.weights[p.offset..p.offset + p.shape[0] * p.shape[1]]
    }

    /// Output of [`WIDTH`] pixels for `tokens` observations each: `inputs[token · INPUTS + input]`.
    /// The tape keeps what [`Network::backward`] needs.
    pub fn forward(&self, tape: &mut Tape, inputs: &[Wide], tokens: usize) -> [Wide; OUTPUTS] {
        pulp::Arch::new().dispatch(Forward { network: self, tape, inputs, tokens })
    }

    #[inline(always)]
    fn forward_here(&self, tape: &mut Tape, inputs: &[Wide], tokens: usize) -> [Wide; OUTPUTS] {
        tape.resize(tokens);
        tape.inputs.copy_from_slice(&inputs[..tokens * INPUTS]);
        self.linear(EMBED, &tape.inputs, &mut tape.layers[0].input);
        for layer in 0..LAYERS {
            let at = FIRST_LAYER + layer * A_LAYER;
            let (before, after) = tape.layers.split_at_mut(layer + 1);
            let step = &mut before[layer];
            self.norm(at + NORM1, &step.input, &mut step.norm1, &mut step.normed);
            self.linear(at + QKV, &step.normed, &mut step.qkv);
            attend(&step.qkv, &mut step.shares, &mut step.attended, tokens);
            self.linear(at + MERGE, &step.attended, &mut step.middle);
            accumulate(&mut step.middle, &step.input);
            self.norm(at + NORM2, &step.middle, &mut step.norm2, &mut step.normed);
            self.linear(at + UP, &step.normed, &mut step.hidden);
            step.hidden.iter_mut().for_each(|h| *h = h.map(|v| if v > 0.0 { v } else { 0.0 }));
            let output = after.first_mut().map_or(&mut tape.last, |next| &mut next.input);
            self.linear(at + DOWN, &step.hidden, output);
            accumulate(output, &step.middle);
        }
        self.norm(NORM, &tape.last, &mut tape.norm, &mut tape.normed);
        let share = 1.0 / tokens as f32;
        for i in 0..MODEL {
            let (mut sum, mut top) = (Wide::ZERO, tape.normed[i]);
            for t in 0..tokens {
                let v = tape.normed[t * MODEL + i];
                sum = sum.add(v);
                top = top.zip(v, |a, b| if b > a { b } else { a });
            }
            tape.pooled[i] = sum.scale(share);
            tape.pooled[MODEL + i] = top;
        }
        self.linear(HEAD1, &tape.pooled, &mut tape.head);
        tape.head.iter_mut().for_each(|h| *h = h.map(|v| if v > 0.0 { v } else { 0.0 }));
        let mut out = [Wide::ZERO; OUTPUTS];
        self.linear(HEAD2, &tape.head, &mut out);
        out
    }

    /// Adds the gradient of `Σ outputs·d_outputs` with respect to all weights, for the pixels last given to
    /// [`Network::forward`] with this tape, to `gradient` (WEIGHTS accumulators).
    pub fn backward(&self, tape: &mut Tape, d_outputs: &[Wide; OUTPUTS], gradient: &mut Gradient) {
        pulp::Arch::new().dispatch(Backward { network: self, tape, d_outputs, gradient });
    }

    #[inline(always)]
    fn backward_here(&self, tape: &mut Tape, d_outputs: &[Wide; OUTPUTS], gradient: &mut Gradient) {
        let tokens = tape.tokens;
        let Tape { layers, inputs, last: _, norm, normed, pooled, head, scratch: s, .. } = tape;
        self.linear_gradient(HEAD2, head, d_outputs, gradient);
        self.linear_back(HEAD2, d_outputs, &mut s.head);
        through_relu(&mut s.head, head);
        self.linear_gradient(HEAD1, pooled, &s.head, gradient);
        self.linear_back(HEAD1, &s.head, &mut s.pooled);
        let share = 1.0 / tokens as f32;
        for t in 0..tokens {
            for i in 0..MODEL {
                let peak =
                    normed[t * MODEL + i].zip(pooled[MODEL + i], |v, top| if v == top { 1.0 } else { 0.0 });
                s.normed[t * MODEL + i] = s.pooled[i].scale(share).add(peak.mul(s.pooled[MODEL + i]));
            }
        }
        s.stream.fill(Wide::ZERO);
        self.norm_back(NORM, norm, &s.normed, &mut s.stream, gradient);
        for (layer, step) in layers.iter_mut().enumerate().rev() {
            let at = FIRST_LAYER + layer * A_LAYER;
            // Feed-forward; step.normed still holds the second norm's output.
            self.linear_gradient(at + DOWN, &step.hidden, &s.stream, gradient);
            self.linear_back(at + DOWN, &s.stream, &mut s.hidden);
            through_relu(&mut s.hidden, &step.hidden);
            self.linear_gradient(at + UP, &step.normed, &s.hidden, gradient);
            self.linear_back(at + UP, &s.hidden, &mut s.normed);
            self.norm_back(at + NORM2, &step.norm2, &s.normed, &mut s.stream, gradient);
            // Attention.
            self.linear_gradient(at + MERGE, &step.attended, &s.stream, gradient);
            self.linear_back(at + MERGE, &s.stream, &mut s.normed);
            attend_back(&step.qkv, &step.shares, &s.normed, &mut s.qkv, &mut s.shares, tokens);
            self.scale_shift(at + NORM1, &step.norm1, &mut step.normed);
            self.linear_gradient(at + QKV, &step.normed, &s.qkv, gradient);
            self.linear_back(at + QKV, &s.qkv, &mut s.normed);
            self.norm_back(at + NORM1, &step.norm1, &s.normed, &mut s.stream, gradient);
        }
        self.linear_gradient(EMBED, inputs, &s.stream, gradient);
    }

    /// `y = W x + b` for each token.
    #[inline(always)]
    fn linear(&self, i: usize, x: &[Wide], y: &mut [Wide]) {
        let [rows, columns] = PARAMETERS[i].shape;
        let bias = self.vector(i + 1);
        for (x, y) in x.chunks_exact(columns).zip(y.chunks_exact_mut(rows)) {
            multiply(&self.forward[i], x, Some(bias), y);
        }
    }

    /// `dx = Wᵀ dy` for each token.
    #[inline(always)]
    fn linear_back(&self, i: usize, dy: &[Wide], dx: &mut [Wide]) {
        let [rows, columns] = PARAMETERS[i].shape;
        for (dy, dx) in dy.chunks_exact(rows).zip(dx.chunks_exact_mut(columns)) {
            multiply(&self.transposed[i], dy, None, dx);
        }
    }

    /// `dW += dy xᵀ`, `db += dy`, summed over tokens.
    #[inline(always)]
    fn linear_gradient(&self, i: usize, x: &[Wide], dy: &[Wide], gradient: &mut Gradient) {
        let [rows, columns] = PARAMETERS[i].shape;
        let (offset, bias) = (PARAMETERS[i].offset, PARAMETERS[i + 1].offset);
        for row in (0..rows).step_by(2) {
            for column in (0..columns).step_by(2) {
                let mut sums = [Wide::ZERO; 4];
                for (x, dy) in x.chunks_exact(columns).zip(dy.chunks_exact(rows)) {
                    let (x0, x1) = (x[column], x[column + 1]);
                    let (d0, d1) = (dy[row], dy[row + 1]);
                    for l in 0..WIDTH {
                        sums[0].0[l] += d0.0[l] * x0.0[l];
                        sums[1].0[l] += d0.0[l] * x1.0[l];
                        sums[2].0[l] += d1.0[l] * x0.0[l];
                        sums[3].0[l] += d1.0[l] * x1.0[l];
                    }
                }
                let first = offset + row * columns + column;
                for (sum, at) in sums.iter().zip([first, first + 1, first + columns, first + columns + 1]) {
                    let total = &mut gradient[at];
                    for l in 0..HALF {
                        total[l] += sum.0[l] + sum.0[HALF + l];
                    }
                }
            }
        }
        for dy in dy.chunks_exact(rows) {
            for (total, d) in gradient[bias..bias + rows].iter_mut().zip(dy) {
                for l in 0..HALF {
                    total[l] += d.0[l] + d.0[HALF + l];
                }
            }
        }
    }

    /// Layer norm of each token: keeps the normalised values and 1/σ, writes scaled and shifted ones.
    #[inline(always)]
    fn norm(&self, i: usize, x: &[Wide], kept: &mut Normalised, y: &mut [Wide]) {
        for (t, x) in x.chunks_exact(MODEL).enumerate() {
            let mut mean = Wide::ZERO;
            for &v in x {
                mean = mean.add(v);
            }
            mean = mean.scale(1.0 / MODEL as f32);
            let mut variance = Wide::ZERO;
            for &v in x {
                let d = v.zip(mean, |a, b| a - b);
                variance = variance.add(d.mul(d));
            }
            let per_sigma = variance.map(|v| 1.0 / (v * (1.0 / MODEL as f32) + NORM_EPSILON).sqrt());
            kept.per_sigma[t] = per_sigma;
            for (k, &v) in kept.values[t * MODEL..][..MODEL].iter_mut().zip(x) {
                *k = v.zip(mean, |a, b| a - b).mul(per_sigma);
            }
        }
        self.scale_shift(i, kept, y);
    }

    #[inline(always)]
    fn scale_shift(&self, i: usize, kept: &Normalised, y: &mut [Wide]) {
        let (scale, shift) = (self.vector(i), self.vector(i + 1));
        for (k, y) in kept.values.chunks_exact(MODEL).zip(y.chunks_exact_mut(MODEL)) {
            for (((k, y), &a), &b) in k.iter().zip(y).zip(scale).zip(shift) {
                *y = k.map(|v| v * a + b);
            }
        }
    }

    /// Adds the gradient through a layer norm to `dx`.
    #[inline(always)]
    fn norm_back(&self, i: usize, kept: &Normalised, dy: &[Wide], dx: &mut [Wide], gradient: &mut Gradient) {
        let scale = self.vector(i);
        let (at_scale, at_shift) = (PARAMETERS[i].offset, PARAMETERS[i + 1].offset);
        for (t, (dy, dx)) in dy.chunks_exact(MODEL).zip(dx.chunks_exact_mut(MODEL)).enumerate() {
            let k = &kept.values[t * MODEL..][..MODEL];
            let (mut sum, mut along) = (Wide::ZERO, Wide::ZERO);
            for j in 0..MODEL {
                let d = dy[j].scale(scale[j]);
                sum = sum.add(d);
                along = along.add(d.mul(k[j]));
                let scaled = dy[j].mul(k[j]);
                for l in 0..HALF {
                    gradient[at_scale + j][l] += scaled.0[l] + scaled.0[HALF + l];
                    gradient[at_shift + j][l] += dy[j].0[l] + dy[j].0[HALF + l];
                }
            }
            let share = 1.0 / MODEL as f32;
            for j in 0..MODEL {
                let mut d = dy[j].scale(scale[j]);
                for l in 0..WIDTH {
                    d.0[l] -= share * (sum.0[l] + k[j].0[l] * along.0[l]);
                }
                dx[j] = dx[j].add(d.mul(kept.per_sigma[t]));
            }
        }
    }
}

/// The forward pass as `pulp` takes it, to compile it once for each instruction set and choose at run time.
struct Forward<'a> {
    network: &'a Network,
    tape: &'a mut Tape,
    inputs: &'a [Wide],
    tokens: usize,
}

impl pulp::WithSimd for Forward<'_> {
    type Output = [Wide; OUTPUTS];

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Self::Output {
        self.network.forward_here(self.tape, self.inputs, self.tokens)
    }
}

/// The backward pass, as [`Forward`].
struct Backward<'a> {
    network: &'a Network,
    tape: &'a mut Tape,
    d_outputs: &'a [Wide; OUTPUTS],
    gradient: &'a mut Gradient,
}

impl pulp::WithSimd for Backward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        self.network.backward_here(self.tape, self.d_outputs, self.gradient);
    }
}

/// `y = W x (+ b)` with W in tiles.
#[inline(always)]
fn multiply(w: &[f32], x: &[Wide], bias: Option<&[f32]>, y: &mut [Wide]) {
    for (tile, (y, w)) in y.chunks_exact_mut(TILE).zip(w.chunks_exact(TILE * x.len())).enumerate() {
        let mut sums = [Wide::ZERO; TILE];
        for (x, w) in x.iter().zip(w.chunks_exact(TILE)) {
            for r in 0..TILE {
                for l in 0..WIDTH {
                    sums[r].0[l] += w[r] * x.0[l];
                }
            }
        }
        if let Some(bias) = bias {
            for r in 0..TILE {
                sums[r] = sums[r].map(|v| v + bias[tile * TILE + r]);
            }
        }
        y.copy_from_slice(&sums);
    }
}

#[inline(always)]
fn accumulate(to: &mut [Wide], from: &[Wide]) {
    for (a, b) in to.iter_mut().zip(from) {
        *a = a.add(*b);
    }
}

#[inline(always)]
fn through_relu(d: &mut [Wide], activation: &[Wide]) {
    for (d, a) in d.iter_mut().zip(activation) {
        *d = d.zip(*a, |d, a| if a > 0.0 { d } else { 0.0 });
    }
}

/// Attention of all heads: `shares[head][t][u]` is how much token t takes of token u.
#[inline(always)]
fn attend(qkv: &[Wide], shares: &mut [Wide], out: &mut [Wide], tokens: usize) {
    let scale = 1.0 / (HEAD_WIDTH as f32).sqrt();
    for head in 0..HEADS {
        for t in 0..tokens {
            let q = &qkv[t * 3 * MODEL + head * HEAD_WIDTH..][..HEAD_WIDTH];
            let row = &mut shares[(head * tokens + t) * tokens..][..tokens];
            let mut top = Wide([f32::NEG_INFINITY; WIDTH]);
            for (u, share) in row.iter_mut().enumerate() {
                let k = &qkv[u * 3 * MODEL + MODEL + head * HEAD_WIDTH..][..HEAD_WIDTH];
                let mut score = Wide::ZERO;
                for d in 0..HEAD_WIDTH {
                    score = score.add(q[d].mul(k[d]));
                }
                *share = score.scale(scale);
                top = top.zip(*share, |a, b| if b > a { b } else { a });
            }
            let mut sum = Wide::ZERO;
            for share in row.iter_mut() {
                *share = share.zip(top, |s, t| exp(s - t));
                sum = sum.add(*share);
            }
            let per_sum = sum.map(|s| 1.0 / s);
            let out = &mut out[t * MODEL + head * HEAD_WIDTH..][..HEAD_WIDTH];
            out.fill(Wide::ZERO);
            for (u, share) in row.iter_mut().enumerate() {
                *share = share.mul(per_sum);
                let v = &qkv[u * 3 * MODEL + 2 * MODEL + head * HEAD_WIDTH..][..HEAD_WIDTH];
                for d in 0..HEAD_WIDTH {
                    out[d] = out[d].add(share.mul(v[d]));
                }
            }
        }
    }
}

/// Gradient of [`attend`] with respect to its queries, keys and values.
#[inline(always)]
fn attend_back(
    qkv: &[Wide],
    shares: &[Wide],
    dy: &[Wide],
    d_qkv: &mut [Wide],
    row: &mut [Wide],
    tokens: usize,
) {
    let scale = 1.0 / (HEAD_WIDTH as f32).sqrt();
    d_qkv.fill(Wide::ZERO);
    for head in 0..HEADS {
        let at = |token: usize, part: usize| token * 3 * MODEL + part * MODEL + head * HEAD_WIDTH;
        for t in 0..tokens {
            let p = &shares[(head * tokens + t) * tokens..][..tokens];
            let dy = &dy[t * MODEL + head * HEAD_WIDTH..][..HEAD_WIDTH];
            let mut mean = Wide::ZERO;
            for u in 0..tokens {
                let mut d = Wide::ZERO;
                for i in 0..HEAD_WIDTH {
                    d = d.add(dy[i].mul(qkv[at(u, 2) + i]));
                    d_qkv[at(u, 2) + i] = d_qkv[at(u, 2) + i].add(p[u].mul(dy[i]));
                }
                row[u] = d;
                mean = mean.add(d.mul(p[u]));
            }
            for u in 0..tokens {
                let d = row[u].zip(mean, |a, b| a - b).mul(p[u]).scale(scale);
                for i in 0..HEAD_WIDTH {
                    d_qkv[at(t, 0) + i] = d_qkv[at(t, 0) + i].add(d.mul(qkv[at(u, 1) + i]));
                    d_qkv[at(u, 1) + i] = d_qkv[at(u, 1) + i].add(d.mul(qkv[at(t, 0) + i]));
                }
            }
        }
    }
}

/// exp(x) for x ≤ 0, relative error below 1e-6; the same arithmetic everywhere, and it vectorises.
#[inline(always)]
fn exp(x: f32) -> f32 {
    let x = if x > -87.0 { x } else { -87.0 };
    // Adding 1.5·2²³ rounds to an integer that then stands in the low bits.
    let shifted = x * std::f32::consts::LOG2_E + 12_582_912.0;
    let n = shifted - 12_582_912.0;
    let r = x - n * 0.693_359_4 + n * 2.121_944_4e-4;
    let p = 1.0
        + r * (1.0
            + r * (0.5 + r * (0.166_666_55 + r * (0.041_665_795 + r * (0.008_333_452 + r * 0.001_398_2)))));
    let power = shifted.to_bits().wrapping_add(127).wrapping_shl(23);
    p * f32::from_bits(power)
}

/// Output of a layer norm before scale and shift.
#[derive(Clone, Debug, Default)]
struct Normalised {
    values: Vec<Wide>,
    per_sigma: Vec<Wide>,
}

#[derive(Clone, Debug, Default)]
struct Step {
    input: Vec<Wide>,
    norm1: Normalised,
    normed: Vec<Wide>,
    qkv: Vec<Wide>,
    shares: Vec<Wide>,
    attended: Vec<Wide>,
    middle: Vec<Wide>,
    norm2: Normalised,
    hidden: Vec<Wide>,
}

/// What the backward pass writes into.
#[derive(Clone, Debug, Default)]
struct Scratch {
    stream: Vec<Wide>,
    normed: Vec<Wide>,
    hidden: Vec<Wide>,
    qkv: Vec<Wide>,
    shares: Vec<Wide>,
    pooled: Vec<Wide>,
    head: Vec<Wide>,
}

/// Activations of one forward pass; used again by the next.
#[derive(Clone, Debug, Default)]
pub struct Tape {
    tokens: usize,
    inputs: Vec<Wide>,
    layers: Vec<Step>,
    last: Vec<Wide>,
    norm: Normalised,
    normed: Vec<Wide>,
    pooled: Vec<Wide>,
    head: Vec<Wide>,
    scratch: Scratch,
}

impl Tape {
    fn resize(&mut self, tokens: usize) {
        if self.tokens == tokens {
            return;
        }
        self.tokens = tokens;
        let zeros = |count: usize| vec![Wide::ZERO; count];
        let norm = || Normalised { values: zeros(tokens * MODEL), per_sigma: zeros(tokens) };
        self.inputs = zeros(tokens * INPUTS);
        self.layers = (0..LAYERS)
            .map(|_| Step {
                input: zeros(tokens * MODEL),
                norm1: norm(),
                normed: zeros(tokens * MODEL),
                qkv: zeros(tokens * 3 * MODEL),
                shares: zeros(HEADS * tokens * tokens),
                attended: zeros(tokens * MODEL),
                middle: zeros(tokens * MODEL),
                norm2: norm(),
                hidden: zeros(tokens * HIDDEN),
            })
            .collect();
        self.last = zeros(tokens * MODEL);
        self.norm = norm();
        self.normed = zeros(tokens * MODEL);
        self.pooled = zeros(2 * MODEL);
        self.head = zeros(HEAD);
        self.scratch = Scratch {
            stream: zeros(tokens * MODEL),
            normed: zeros(tokens * MODEL),
            hidden: zeros(tokens * HIDDEN),
            qkv: zeros(tokens * 3 * MODEL),
            shares: zeros(tokens),
            pooled: zeros(2 * MODEL),
            head: zeros(HEAD),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    fn random_network(rng: &mut Rng) -> Network {
        let mut weights = vec![0.0; WEIGHTS];
        for p in &PARAMETERS {
            let spread = if p.shape[0] > 1 { 1.0 / (p.shape[1] as f32).sqrt() } else { 0.1 };
            for w in &mut weights[p.offset..p.offset + p.shape[0] * p.shape[1]] {
                *w = spread * rng.normal() + if p.name.ends_with("scale") { 1.0 } else { 0.0 };
            }
        }
        Network::new(weights).unwrap()
    }

    fn random_inputs(rng: &mut Rng, tokens: usize) -> Vec<Wide> {
        (0..tokens * INPUTS).map(|_| Wide(std::array::from_fn(|_| rng.normal()))).collect()
    }

    #[test]
    fn exp_is_exp() {
        for i in 0..9000 {
            let x = -(i as f32) * 0.01;
            let truth = f64::from(x.max(-87.0)).exp();
            assert!((f64::from(exp(x)) / truth - 1.0).abs() < 2e-6, "{x}");
        }
    }

    #[test]
    fn gradient_agrees_with_finite_differences() {
        let mut rng = Rng::new(11);
        let mut network = random_network(&mut rng);
        let inputs = random_inputs(&mut rng, 5);
        let d: [Wide; OUTPUTS] = std::array::from_fn(|_| Wide(std::array::from_fn(|_| rng.normal())));
        let mut tape = Tape::default();
        let mut gradient = vec![[0.0; HALF]; WEIGHTS];
        network.forward(&mut tape, &inputs, 5);
        network.backward(&mut tape, &d, &mut gradient);
        let value = |network: &Network, tape: &mut Tape| {
            let out = network.forward(tape, &inputs, 5);
            let products = out.iter().zip(&d).flat_map(|(o, d)| o.0.iter().zip(&d.0));
            products.map(|(&o, &d)| f64::from(o) * f64::from(d)).sum::<f64>()
        };
        // Along a random direction in each array: corners of ReLU and the maximum average out.
        for p in &PARAMETERS {
            let range = p.offset..p.offset + p.shape[0] * p.shape[1];
            let direction: Vec<f32> = range.clone().map(|_| rng.normal()).collect();
            let size = direction.iter().map(|d| d * d).sum::<f32>().sqrt();
            let exact: f64 = gradient[range.clone()]
                .iter()
                .zip(&direction)
                .map(|(g, &d)| f64::from(g.iter().sum::<f32>()) * f64::from(d / size))
                .sum();
            let scale: f64 =
                gradient[range.clone()].iter().map(|g| f64::from(g.iter().sum::<f32>()).powi(2)).sum();
            let step = 3e-3f32;
            let original = network.weights().to_vec();
            let mut at = |change: f32| {
                network.update(|all| {
                    all.copy_from_slice(&original);
                    for (w, d) in all[range.clone()].iter_mut().zip(&direction) {
                        *w += change * d / size;
                    }
                });
                value(&network, &mut tape)
            };
            let numeric = (at(step) - at(-step)) / (2.0 * f64::from(step));
            at(0.0);
            let error = (numeric - exact).abs();
            assert!(error < 0.02 * exact.abs() + 0.01 * scale.sqrt(), "{}: {exact} {numeric}", p.name);
        }
    }

    #[test]
    fn order_of_lights_and_neighbouring_lanes_do_not_matter() {
        let mut rng = Rng::new(3);
        let network = random_network(&mut rng);
        let mut inputs = random_inputs(&mut rng, 7);
        let mut tape = Tape::default();
        let a = network.forward(&mut tape, &inputs, 7);
        let mut swapped: Vec<Wide> = inputs.chunks(INPUTS).rev().flatten().copied().collect();
        let b = network.forward(&mut tape, &swapped, 7);
        for (a, b) in a.iter().zip(&b) {
            assert!(a.0.iter().zip(&b.0).all(|(a, b)| (a - b).abs() < 1e-4));
        }
        // Another pixel in lane 0 leaves lane 1 as it was, to the bit.
        inputs.iter_mut().for_each(|v| v.0[0] = 0.3);
        let c = network.forward(&mut tape, &inputs, 7);
        assert!(a.iter().zip(&c).all(|(a, c)| a.0[1] == c.0[1] && a.0[0] != c.0[0]));
        swapped.clear();
    }

    #[test]
    fn another_number_of_weights_is_refused() {
        assert!(Network::new(vec![0.0; WEIGHTS - 1]).is_none());
    }
}
