//! The policy network, written once over the few operations it needs. Burn runs and differentiates it
//! ([`super::tape`]), the exporter writes it as ONNX ([`super::export`]).

use crate::policy::config::Config;

/// What is outside a feature map when a 3×3 kernel looks there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Border {
    /// The map mirrored at its border pixels.
    Reflect,
    /// Zero.
    Zero,
}

/// The operations of the network. `Map` is `[batch, channels, height, width]`, `Rows` is `[rows, features]`;
/// layers take their parameters by name.
pub trait Ops {
    /// Feature maps.
    type Map: Clone;
    /// Rows of features.
    type Rows: Clone;

    /// 3×3 convolution, stride 1, same size.
    fn conv(&mut self, layer: &str, x: Self::Map, border: Border) -> Self::Map;
    /// 3×3 transposed convolution, stride 2, padding 1, output padding 1: twice the size.
    fn up(&mut self, layer: &str, x: Self::Map) -> Self::Map;
    /// max(x, 0).
    fn relu(&mut self, x: Self::Map) -> Self::Map;
    /// 2×2 max-pool.
    fn pool(&mut self, x: Self::Map) -> Self::Map;
    /// Element-wise product.
    fn mul(&mut self, a: Self::Map, b: Self::Map) -> Self::Map;
    /// Element-wise sum.
    fn add(&mut self, a: Self::Map, b: Self::Map) -> Self::Map;
    /// Channels of both.
    fn join(&mut self, a: Self::Map, b: Self::Map) -> Self::Map;
    /// The first `count` channels.
    fn first_channels(&mut self, x: Self::Map, count: usize) -> Self::Map;
    /// Less its mean over height and width.
    fn centred(&mut self, x: Self::Map) -> Self::Map;
    /// Reliability mask of RGB frames: σ((x−θ_low)/t)·σ((θ_high−x)/t) of their mean over channels, `[batch, 1, h, w]`.
    fn gate(&mut self, frames: Self::Map) -> Self::Map;
    /// A one-channel map three times.
    fn three_channels(&mut self, x: Self::Map) -> Self::Map;

    /// Each location a row: `[batch·h·w, channels]`.
    fn rows(&mut self, x: Self::Map) -> Self::Rows;
    /// Rows back to maps with `grid × grid` locations.
    fn map(&mut self, x: Self::Rows, grid: usize) -> Self::Map;
    /// A one-channel map as one row: `[batch, h·w]`.
    fn flat(&mut self, x: Self::Map) -> Self::Rows;
    /// Each row at every location of a map: `[batch, features, grid, grid]`.
    fn spread(&mut self, x: Self::Rows, grid: usize) -> Self::Map;
    /// x·W + b.
    fn linear(&mut self, layer: &str, x: Self::Rows) -> Self::Rows;
    /// max(x, 0).
    fn relu_rows(&mut self, x: Self::Rows) -> Self::Rows;
    /// Sum of rows.
    fn add_rows(&mut self, a: Self::Rows, b: Self::Rows) -> Self::Rows;
    /// Layer norm over features.
    fn norm(&mut self, layer: &str, x: Self::Rows) -> Self::Rows;
    /// Adds the encoding of the current frame's position.
    fn add_position(&mut self, x: Self::Rows) -> Self::Rows;
    /// Causal attention of the current frame (`qkv`: queries, keys and values side by side) over itself and the frames
    /// before it, whose keys and values the implementation keeps.
    fn attend(&mut self, layer: usize, qkv: Self::Rows) -> Self::Rows;
    /// Light direction and reach (as a fraction of 90°) side by side: `[batch, 4]`.
    fn light(&mut self) -> Self::Rows;
    /// Adds the learned direction of the current step.
    fn add_base(&mut self, x: Self::Rows) -> Self::Rows;
    /// `|z| + 1e-8` in the third component, unit length, then mapped into the reach: slant s becomes
    /// `s·(1 + (r⁻⁴ − 1)(s/90°)⁴)^(−1/4)` with r the reach as a fraction of 90°. That is s where s is well within the reach, the
    /// reach at 90°, and s everywhere where the reach is 90°.
    fn direction(&mut self, x: Self::Rows) -> Self::Rows;
}

/// (a) Multi-scale encoder: `[batch, 3, input, input]` → `[batch, channels[3], grid, grid]`.
fn encode<O: Ops>(o: &mut O, config: &Config, mut x: O::Map) -> O::Map {
    // A pool follows these convolutions (3-32 P, 32-64, 64-64 P, 64-128, 128-128 P, 128-256, 256-256 P, 256-256).
    let mut pools = [0, 2, 4, 6].into_iter().take(config.pools).peekable();
    for i in 0..8 {
        x = o.conv(&format!("encoder.{i}"), x, Border::Reflect);
        x = o.relu(x);
        if pools.next_if_eq(&i).is_some() {
            x = o.pool(x);
        }
    }
    x
}

/// (a) The gated features F̃ of new frames, and the gate (absent in the ablation without it).
pub fn encode_frame<O: Ops>(o: &mut O, config: &Config, frame: O::Map) -> (O::Map, Option<O::Map>) {
    let image = encode(o, config, frame.clone());
    if !config.gating {
        return (image, None);
    }
    let gate = o.gate(frame);
    let mask = o.three_channels(gate.clone());
    let mask = encode(o, config, mask);
    (o.mul(mask, image), Some(gate))
}

/// (b) to (d): from the gated features of the newest frame and the light it was taken under to the next direction.
pub fn next_direction<O: Ops>(o: &mut O, config: &Config, gated: O::Map) -> O::Rows {
    let features = temporal(o, config, gated);
    let view = view(o, features.clone());
    let light = fuse(o, config, features);
    let light = o.centred(light);
    let sum = o.add(view, light);
    let x = o.flat(sum);
    let x = o.linear("head.0", x);
    let x = o.relu_rows(x);
    let mut x = o.linear("head.1", x);
    if config.base {
        x = o.add_base(x);
    }
    o.direction(x)
}

/// (b) Per location, a causal transformer over the frames, residual onto F̃.
fn temporal<O: Ops>(o: &mut O, config: &Config, gated: O::Map) -> O::Map {
    if !config.transformer {
        return gated;
    }
    let tokens = o.rows(gated.clone());
    let x = o.linear("tokens.in", tokens);
    let mut x = o.add_position(x);
    for l in 0..config.layers {
        let y = o.norm(&format!("block.{l}.norm1"), x.clone());
        let y = o.linear(&format!("block.{l}.qkv"), y);
        let y = o.attend(l, y);
        let y = o.linear(&format!("block.{l}.out"), y);
        x = o.add_rows(x, y);
        let y = o.norm(&format!("block.{l}.norm2"), x.clone());
        let y = o.linear(&format!("block.{l}.up"), y);
        let y = o.relu_rows(y);
        let y = o.linear(&format!("block.{l}.down"), y);
        x = o.add_rows(x, y);
    }
    let x = o.norm("tokens.norm", x);
    let x = o.linear("tokens.out", x);
    let x = o.map(x, config.grid());
    o.add(gated, x)
}

/// (b) F_v: what the frames show, one channel.
fn view<O: Ops>(o: &mut O, mut x: O::Map) -> O::Map {
    for i in 0..2 {
        x = o.conv(&format!("view.{i}"), x, Border::Zero);
        x = o.relu(x);
    }
    o.conv("view.2", x, Border::Zero)
}

/// (c) F_a: appearance and light fused by a U-Net, one channel.
fn fuse<O: Ops>(o: &mut O, config: &Config, features: O::Map) -> O::Map {
    let light = o.light();
    let light = o.linear("light.0", light);
    let light = o.relu_rows(light);
    let light = o.linear("light.1", light);
    let light = o.relu_rows(light);
    let light = o.spread(light, config.grid());
    let look = o.first_channels(features, config.embedding());
    let x = o.join(look, light);

    let level0 = step(o, "fuser.down0", x);
    let x = o.pool(level0.clone());
    let level1 = step(o, "fuser.down1", x);
    let x = o.pool(level1.clone());
    let x = step(o, "fuser.down2", x);
    let x = o.up("fuser.up1", x);
    let x = o.relu(x);
    let x = o.join(x, level1);
    let x = step(o, "fuser.merge1", x);
    let x = o.up("fuser.up0", x);
    let x = o.relu(x);
    let x = o.join(x, level0);
    let x = step(o, "fuser.merge0", x);
    let x = step(o, "fuser.last0", x);
    o.conv("fuser.last1", x, Border::Zero)
}

fn step<O: Ops>(o: &mut O, layer: &str, x: O::Map) -> O::Map {
    let x = o.conv(layer, x, Border::Zero);
    o.relu(x)
}
