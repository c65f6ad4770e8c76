//! The policy network as two ONNX files: the encoder of one frame, and the step from a frame's features to the next
//! direction, with attention's keys and values of earlier frames as inputs, so that every step costs the same.

use super::network::{Border, Ops, encode_frame, next_direction};
use super::onnx::{Attribute, Graph, Value};
use super::tape::{LENGTH_EPSILON, NORM_EPSILON};
use super::weights::Weights;
use crate::fingerprint::Fingerprint;
use crate::policy::config::FORMAT;
use crate::policy::file::{self, ModelFiles};
use std::f32::consts::FRAC_2_PI;

/// The two files of a network, weight norm folded.
///
/// # Panics
/// If the configuration can't be written as JSON: it always can.
#[must_use]
pub fn export(weights: &Weights, note: &str) -> ModelFiles {
    let folded = weights.folded();
    let config = &folded.config;
    let (s, g, c) = (config.input, config.grid(), config.channels[3]);
    let identity = folded.params.iter().flat_map(|p| p.values.iter().flat_map(|v| v.to_le_bytes()));
    let identity = Fingerprint::of(identity).to_string();

    let mut o = Exporter::new("coil_encoder", &folded);
    let frame = o.graph.input("frame", &[1, 3, s, s]);
    let (features, gate) = encode_frame(&mut o, config, frame);
    o.graph.output("features", &features);
    if let Some(gate) = gate {
        o.graph.output("gate", &gate);
    }
    let encoder = o.finish("encoder", &identity, note);

    let mut o = Exporter::new("coil_step", &folded);
    let features = o.graph.input("features", &[1, c, g, g]);
    o.light = Some(o.graph.input("light", &[1, 3]));
    o.reach = Some(o.graph.input("reach", &[1, 1]));
    if config.horizon > 0 {
        o.lights = Some(o.graph.input_int("lights", &[1]));
    }
    if config.counts_steps() {
        o.position = Some(o.graph.input_int("position", &[1]));
    }
    if config.transformer {
        let cache = config.cache_shape();
        o.keys = Some(o.graph.input("keys", &cache));
        o.values = Some(o.graph.input("values", &cache));
    }
    let direction = next_direction(&mut o, config, features);
    o.graph.output("direction", &direction);
    for (name, parts) in [("new_keys", o.new_keys.clone()), ("new_values", o.new_values.clone())] {
        if !parts.is_empty() {
            let stacked = o.graph.concat(&parts.iter().collect::<Vec<_>>(), 0);
            o.graph.output(name, &stacked);
        }
    }
    let step = o.finish("step", &identity, note);
    ModelFiles { encoder, step }
}

struct Exporter<'a> {
    graph: Graph,
    weights: &'a Weights,
    light: Option<Value>,
    reach: Option<Value>,
    lights: Option<Value>,
    position: Option<Value>,
    keys: Option<Value>,
    values: Option<Value>,
    new_keys: Vec<Value>,
    new_values: Vec<Value>,
}

impl<'a> Exporter<'a> {
    fn new(name: &str, weights: &'a Weights) -> Self {
        Self {
            graph: Graph::new(name),
            weights,
            light: None,
            reach: None,
            lights: None,
            position: None,
            keys: None,
            values: None,
            new_keys: Vec::new(),
            new_values: Vec::new(),
        }
    }

    fn finish(mut self, part: &str, identity: &str, note: &str) -> Vec<u8> {
        let config = serde_json::to_string(&self.weights.config).expect("a configuration is plain data");
        let fingerprint = Fingerprint::of(self.graph.constant_bytes()).to_string();
        for (key, value) in [
            (file::KEY_FORMAT, FORMAT.to_string().as_str()),
            (file::KEY_PART, part),
            (file::KEY_CONFIG, &config),
            (file::KEY_NETWORK, identity),
            (file::KEY_FINGERPRINT, &fingerprint),
            (file::KEY_NOTE, note),
        ] {
            self.graph.metadata(key, value);
        }
        self.graph.encode()
    }

    fn param(&mut self, name: &str) -> Value {
        let p = self.weights.get(name);
        self.graph.weights(name, &p.shape, &p.values)
    }

    fn scalar(&mut self, value: f32) -> Value {
        self.graph.constant(&format!("float[{value:e}]"), &[], &[value])
    }

    fn binary(&mut self, op: &str, a: &Value, b: &Value) -> Value {
        let dims = if a.dims.len() >= b.dims.len() { &a.dims } else { &b.dims };
        let dims: Vec<usize> = dims
            .iter()
            .enumerate()
            .map(|(i, &d)| {
                let other = |v: &Value| (v.dims.len() + i).checked_sub(dims.len()).map_or(1, |k| v.dims[k]);
                d.max(other(a)).max(other(b))
            })
            .collect();
        self.graph.node(op, &[a, b], &[], &dims)
    }

    /// The row of a table that an integer input names.
    fn gather(&mut self, table: &Value, row: &Value, dims: &[usize]) -> Value {
        self.graph.node("Gather", &[table, row], &[("axis", Attribute::Int(0))], dims)
    }

    fn unary(&mut self, op: &str, x: &Value) -> Value {
        self.graph.node(op, &[x], &[], &x.dims.clone())
    }

    fn mean(&mut self, x: &Value, axes: &[usize]) -> Value {
        let mut dims = x.dims.clone();
        axes.iter().for_each(|&a| dims[a] = 1);
        let axes = axes.iter().map(|&a| a as i64).collect();
        self.graph.node(
            "ReduceMean",
            &[x],
            &[("axes", Attribute::Ints(axes)), ("keepdims", Attribute::Int(1))],
            &dims,
        )
    }

    /// Sum over the features of rows.
    fn row_sum(&mut self, x: &Value) -> Value {
        let axes = self.graph.integers("int[1]", &[1]);
        self.graph.node("ReduceSum", &[x, &axes], &[("keepdims", Attribute::Int(1))], &[x.dims[0], 1])
    }

    /// x⁴.
    fn fourth(&mut self, x: &Value) -> Value {
        let squared = self.binary("Mul", x, x);
        self.binary("Mul", &squared, &squared)
    }

    /// √(Σ x² + ε) of each row.
    fn row_length(&mut self, x: &Value) -> Value {
        let squared = self.binary("Mul", x, x);
        let sum = self.row_sum(&squared);
        let guard = self.scalar(LENGTH_EPSILON);
        let sum = self.binary("Add", &sum, &guard);
        self.unary("Sqrt", &sum)
    }
}

const KERNEL: (&str, Attribute) = ("group", Attribute::Int(1));

impl Ops for Exporter<'_> {
    type Map = Value;
    type Rows = Value;

    fn conv(&mut self, layer: &str, x: Value, border: Border) -> Value {
        let kernel = self.param(&format!("{layer}.v"));
        let bias = self.param(&format!("{layer}.b"));
        let dims = [1, kernel.dims[0], x.dims[2], x.dims[3]];
        let (x, pad) = match border {
            Border::Zero => (x, 1),
            Border::Reflect => {
                let pads = self.graph.integers("pads", &[0, 0, 1, 1, 0, 0, 1, 1]);
                let padded = [x.dims[0], x.dims[1], x.dims[2] + 2, x.dims[3] + 2];
                let mode = [("mode", Attribute::Word("reflect"))];
                (self.graph.node("Pad", &[&x, &pads], &mode, &padded), 0)
            }
        };
        let attributes = [
            KERNEL,
            ("kernel_shape", Attribute::Ints(vec![3, 3])),
            ("pads", Attribute::Ints(vec![pad; 4])),
            ("strides", Attribute::Ints(vec![1, 1])),
        ];
        self.graph.node("Conv", &[&x, &kernel, &bias], &attributes, &dims)
    }

    fn up(&mut self, layer: &str, x: Value) -> Value {
        let kernel = self.param(&format!("{layer}.v"));
        let bias = self.param(&format!("{layer}.b"));
        let dims = [1, kernel.dims[1], 2 * x.dims[2], 2 * x.dims[3]];
        let attributes = [
            KERNEL,
            ("kernel_shape", Attribute::Ints(vec![3, 3])),
            ("pads", Attribute::Ints(vec![1; 4])),
            ("output_padding", Attribute::Ints(vec![1, 1])),
            ("strides", Attribute::Ints(vec![2, 2])),
        ];
        self.graph.node("ConvTranspose", &[&x, &kernel, &bias], &attributes, &dims)
    }

    fn relu(&mut self, x: Value) -> Value {
        self.unary("Relu", &x)
    }

    fn pool(&mut self, x: Value) -> Value {
        let dims = [1, x.dims[1], x.dims[2] / 2, x.dims[3] / 2];
        let two = || Attribute::Ints(vec![2, 2]);
        self.graph.node("MaxPool", &[&x], &[("kernel_shape", two()), ("strides", two())], &dims)
    }

    fn mul(&mut self, a: Value, b: Value) -> Value {
        self.binary("Mul", &a, &b)
    }

    fn add(&mut self, a: Value, b: Value) -> Value {
        self.binary("Add", &a, &b)
    }

    fn join(&mut self, a: Value, b: Value) -> Value {
        self.graph.concat(&[&a, &b], 1)
    }

    fn first_channels(&mut self, x: Value, count: usize) -> Value {
        self.graph.slice(&x, 1, 0, count)
    }

    fn centred(&mut self, x: Value) -> Value {
        let mean = self.mean(&x, &[2, 3]);
        self.binary("Sub", &x, &mean)
    }

    fn gate(&mut self, frames: Value) -> Value {
        let [low, high, softness] = ["gate.low", "gate.high", "gate.softness"].map(|n| self.param(n));
        let x = self.mean(&frames, &[1]);
        let above = self.binary("Sub", &x, &low);
        let below = self.binary("Sub", &high, &x);
        let [above, below] = [above, below].map(|v| {
            let v = self.binary("Div", &v, &softness);
            self.unary("Sigmoid", &v)
        });
        self.binary("Mul", &above, &below)
    }

    fn three_channels(&mut self, x: Value) -> Value {
        self.graph.concat(&[&x, &x, &x], 1)
    }

    fn rows(&mut self, x: Value) -> Value {
        let (c, locations) = (x.dims[1], x.dims[2] * x.dims[3]);
        let x = self.graph.transpose(&x, &[0, 2, 3, 1]);
        self.graph.reshape(&x, &[locations, c])
    }

    fn map(&mut self, x: Value, grid: usize) -> Value {
        let c = x.dims[1];
        let x = self.graph.reshape(&x, &[1, grid, grid, c]);
        self.graph.transpose(&x, &[0, 3, 1, 2])
    }

    fn flat(&mut self, x: Value) -> Value {
        let count = x.dims.iter().product();
        self.graph.reshape(&x, &[1, count])
    }

    fn spread(&mut self, x: Value, grid: usize) -> Value {
        let c = x.dims[1];
        let x = self.graph.reshape(&x, &[1, c, 1, 1]);
        let shape = self.graph.integers("spread", &[1, c as i64, grid as i64, grid as i64]);
        self.graph.node("Expand", &[&x, &shape], &[], &[1, c, grid, grid])
    }

    fn linear(&mut self, layer: &str, x: Value) -> Value {
        let w = self.param(&format!("{layer}.w"));
        let b = self.param(&format!("{layer}.b"));
        let dims = [x.dims[0], w.dims[1]];
        let x = self.graph.node("MatMul", &[&x, &w], &[], &dims);
        self.binary("Add", &x, &b)
    }

    fn relu_rows(&mut self, x: Value) -> Value {
        self.unary("Relu", &x)
    }

    fn add_rows(&mut self, a: Value, b: Value) -> Value {
        self.binary("Add", &a, &b)
    }

    fn norm(&mut self, layer: &str, x: Value) -> Value {
        let w = self.param(&format!("{layer}.w"));
        let b = self.param(&format!("{layer}.b"));
        let attributes = [("axis", Attribute::Int(-1)), ("epsilon", Attribute::Float(NORM_EPSILON))];
        self.graph.node("LayerNormalization", &[&x, &w, &b], &attributes, &x.dims.clone())
    }

    fn add_position(&mut self, x: Value) -> Value {
        let config = &self.weights.config;
        let table: Vec<f32> = (0..config.max_frames).flat_map(|i| config.position(i)).collect();
        let table = self.graph.constant("positions", &[config.max_frames, config.width], &table);
        let position = self.position.clone().expect("set by export");
        let row = self.gather(&table, &position, &[1, x.dims[1]]);
        self.binary("Add", &x, &row)
    }

    fn attend(&mut self, layer: usize, qkv: Value) -> Value {
        let config = &self.weights.config;
        let (d, heads, frames) = (config.width, config.heads, config.max_frames);
        let (rows, size) = (qkv.dims[0], d / heads);
        let cached = rows * heads;
        let [q, k, v] = [0, 1, 2].map(|i| {
            let part = self.graph.slice(&qkv, 1, i * d, d);
            self.graph.reshape(&part, &[cached, 1, size])
        });
        let with_past = |o: &mut Self, past: Option<Value>, new: &Value| {
            let past = past.expect("set by export");
            let past = o.graph.slice(&past, 0, layer, 1);
            let past = o.graph.reshape(&past, &[cached, frames, size]);
            o.graph.concat(&[&past, new], 1)
        };
        let keys = with_past(self, self.keys.clone(), &k);
        let values = with_past(self, self.values.clone(), &v);
        self.new_keys.push(self.graph.reshape(&k, &[1, cached, size]));
        self.new_values.push(self.graph.reshape(&v, &[1, cached, size]));

        // Entries of the cache from `position` on are not filled yet.
        let entries: Vec<i64> = (0..frames as i64).collect();
        let entries = self.graph.integers("entries", &entries);
        let position = self.position.clone().expect("set by export");
        let filled = self.graph.node("Less", &[&entries, &position], &[], &[frames]);
        let (open, shut) = (self.scalar(0.0), self.scalar(-1e9));
        let past = self.graph.node("Where", &[&filled, &open, &shut], &[], &[frames]);
        let own = self.graph.constant("own", &[1], &[0.0]);
        let mask = self.graph.concat(&[&past, &own], 0);

        let scale = self.scalar(1.0 / (size as f32).sqrt());
        let q = self.binary("Mul", &q, &scale);
        let keys = self.graph.transpose(&keys, &[0, 2, 1]);
        let scores = self.graph.node("MatMul", &[&q, &keys], &[], &[cached, 1, frames + 1]);
        let mask = self.graph.reshape(&mask, &[1, 1, frames + 1]);
        let scores = self.binary("Add", &scores, &mask);
        let weights =
            self.graph.node("Softmax", &[&scores], &[("axis", Attribute::Int(-1))], &scores.dims.clone());
        let mixed = self.graph.node("MatMul", &[&weights, &values], &[], &[cached, 1, size]);
        self.graph.reshape(&mixed, &[rows, d])
    }

    fn light(&mut self) -> Value {
        let [light, reach] = [&self.light, &self.reach].map(|v| v.clone().expect("set by export"));
        let Some(lights) = self.lights.clone() else { return self.graph.concat(&[&light, &reach], 1) };
        let horizon = self.weights.config.horizon;
        let shares: Vec<f32> = (0..=horizon).map(|t| t as f32 / horizon as f32).collect();
        let shares = self.graph.constant("lights.shares", &[horizon + 1, 1], &shares);
        let told = self.gather(&shares, &lights, &[1, 1]);
        self.graph.concat(&[&light, &reach, &told], 1)
    }

    fn add_base(&mut self, x: Value) -> Value {
        let table = self.param("head.base");
        let position = self.position.clone().expect("set by export");
        let row = self.gather(&table, &position, &[1, 3]);
        let x = self.binary("Add", &x, &row);
        let Some(lights) = self.lights.clone() else { return x };
        let table = self.param("head.horizon");
        let (frames, horizon) = (self.weights.config.max_frames, self.weights.config.horizon);
        let table = self.graph.reshape(&table, &[horizon + 1, frames, 3]);
        let table = self.gather(&table, &lights, &[1, frames, 3]);
        let table = self.graph.reshape(&table, &[frames, 3]);
        let row = self.gather(&table, &position, &[1, 3]);
        self.binary("Add", &x, &row)
    }

    fn direction(&mut self, x: Value) -> Value {
        let reach = self.reach.clone().expect("set by export");
        let xy = self.graph.slice(&x, 1, 0, 2);
        let z = self.graph.slice(&x, 1, 2, 1);
        let z = self.unary("Abs", &z);
        let guard = self.scalar(1e-8);
        let z = self.binary("Add", &z, &guard);
        let both = self.graph.concat(&[&xy, &z], 1);
        let length = self.row_length(&both);
        let xy = self.binary("Div", &xy, &length);
        let z = self.binary("Div", &z, &length);
        let radius = self.row_length(&xy);
        let one = self.scalar(1.0);
        let z = self.binary("Add", &z, &one);
        let tangent = self.binary("Div", &radius, &z);
        let half = self.unary("Atan", &tangent);
        let two = self.scalar(2.0);
        let slant = self.binary("Mul", &half, &two);
        let tightness = self.unary("Reciprocal", &reach);
        let tightness = self.fourth(&tightness);
        let tightness = self.binary("Sub", &tightness, &one);
        let share = self.scalar(FRAC_2_PI);
        let fourth = self.binary("Mul", &slant, &share);
        let fourth = self.fourth(&fourth);
        let bend = self.binary("Mul", &tightness, &fourth);
        let bend = self.binary("Add", &bend, &one);
        let bend = self.unary("Sqrt", &bend);
        let bend = self.unary("Sqrt", &bend);
        let slant = self.binary("Div", &slant, &bend);
        let sine = self.unary("Sin", &slant);
        let cosine = self.unary("Cos", &slant);
        let share = self.binary("Div", &sine, &radius);
        let xy = self.binary("Mul", &xy, &share);
        self.graph.concat(&[&xy, &cosine], 1)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tape::{Network, tensor, values};
    use super::*;
    use crate::policy::frame::Frames;
    use crate::policy::{Config, ModelError, Policy};
    use crate::rng::Rng;
    use crate::stack::Mask;
    use crate::train::import::import;
    use burn::tensor::Device;
    use glam::Vec3;

    fn networks() -> [Weights; 4] {
        let c = Config::compact();
        let mut all = [
            c.clone(),
            Config { horizon: 10, ..c.clone() },
            Config { gating: false, ..c.clone() },
            Config { transformer: false, ..c },
        ]
        .map(|c| Weights::new(&c, 5));
        // As after some training: biases and gains are not what they were at the start.
        let mut rng = Rng::new(6);
        for p in all.iter_mut().flat_map(|w| &mut w.params) {
            p.values.iter_mut().for_each(|v| *v += 0.03 * rng.normal());
        }
        all
    }

    #[test]
    fn tract_gives_the_directions_of_burn_at_every_step() {
        for weights in networks() {
            let policy = Policy::load(&export(&weights, "test")).unwrap();
            let folded = weights.folded();
            let device = Device::flex();
            let net = Network::new(&folded, &device);
            let mask = Mask::full(40, 30).unwrap();
            let reach = 1.1f32;
            let mut run = policy.start(&mask, reach, 7);
            let mut sequence = net.start(7);
            let mut frames = Frames::new(&mask, weights.config.input);
            let mut rng = Rng::new(7);
            let mut light = Vec3::Z;
            for t in 1..=10 {
                let rgb: Vec<[f32; 3]> =
                    (0..mask.len()).map(|_| [rng.uniform(), rng.uniform(), rng.uniform()]).collect();
                let frame = frames.next(&rgb);
                let s = weights.config.input;
                let expected = values(sequence.step(
                    tensor(frame, [1, 3, s, s], &device),
                    tensor(light.to_array().to_vec(), [1, 3], &device),
                    tensor(vec![reach / std::f32::consts::FRAC_PI_2], [1, 1], &device),
                ));
                light = run.observe(&rgb, light).unwrap();
                for (a, b) in light.to_array().iter().zip(expected) {
                    assert!((a - b).abs() < 1e-4, "T = {t}: {light} {b}");
                }
                assert_eq!(run.gate().is_some(), weights.config.gating);
                if let (Some(gate), Some(expected)) = (run.gate(), sequence.gate_map()) {
                    let expected = values(expected.clone());
                    assert!(gate.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4));
                }
            }
        }
    }

    #[test]
    fn a_run_is_deterministic_and_refuses_what_does_not_fit() {
        let [.., weights] = networks();
        let policy = Policy::load(&export(&weights, "")).unwrap();
        let mask = Mask::full(9, 9).unwrap();
        let rgb = vec![[0.5; 3]; 81];
        let first = policy.start(&mask, 1.5, 10).observe(&rgb, Vec3::Z).unwrap();
        assert_eq!(policy.start(&mask, 1.5, 10).observe(&rgb, Vec3::Z).unwrap(), first);
        let mut run = policy.start(&mask, 1.5, 10);
        assert!(run.observe(&rgb[1..], Vec3::Z).is_err());
        assert!(run.observe(&[[f32::NAN; 3]; 81], Vec3::Z).is_err());
        assert!(run.observe(&rgb, Vec3::NAN).is_err());
        for _ in 0..policy.config().max_frames {
            run.observe(&rgb, Vec3::Z).unwrap();
        }
        assert!(run.observe(&rgb, Vec3::Z).unwrap_err().to_string().contains("at most"));
    }

    #[test]
    fn another_network_plans_within_a_limited_reach() {
        let [one, other, ..] = networks().map(|w| Policy::load(&export(&w, "")).unwrap());
        let both = one.clone().with_limited(other.clone());
        let mask = Mask::full(9, 9).unwrap();
        let next = |policy: &Policy, degrees: f32| {
            policy.start(&mask, degrees.to_radians(), 10).observe(&[[0.5; 3]; 81], Vec3::Z).unwrap()
        };
        for (reach, same, not) in [(90.0, &one, &other), (87.0, &one, &other), (85.0, &other, &one)] {
            assert_eq!(next(&both, reach), next(same, reach), "{reach}");
            assert_ne!(next(&both, reach), next(not, reach), "{reach}");
            assert_eq!(both.within(f32::to_radians(reach)).config(), same.config());
        }
        assert_eq!(next(&one, 40.0), next(one.within(0.7), 40.0));
    }

    #[test]
    fn weights_come_back_from_the_files() {
        for weights in networks() {
            let files = export(&weights, "");
            let back = import(&files).unwrap();
            for (a, b) in back.params.iter().zip(&weights.folded().params) {
                assert_eq!((&a.name, &a.values), (&b.name, &b.values));
            }
            assert_eq!(export(&back, ""), files);
        }
        assert!(matches!(
            import(&ModelFiles { encoder: Vec::new(), step: Vec::new() }),
            Err(ModelError::Foreign { .. } | ModelError::Damaged { .. })
        ));
    }

    #[test]
    fn unusable_files_are_named() {
        let [other, .., weights] = networks();
        let files = export(&weights, "");
        let load = |encoder: &[u8], step: &[u8]| {
            Policy::load(&ModelFiles { encoder: encoder.to_vec(), step: step.to_vec() }).unwrap_err()
        };
        assert!(matches!(
            load(b"not an onnx file", &files.step),
            ModelError::Damaged { part: "encoder", .. }
        ));
        let cut = &files.step[..files.step.len() / 2];
        assert!(matches!(load(&files.encoder, cut), ModelError::Damaged { part: "step", .. }));
        assert!(matches!(load(&files.step, &files.encoder), ModelError::Foreign { .. }));
        assert!(matches!(load(&files.encoder, &export(&other, "").step), ModelError::Pair { .. }));
        // One bit of a weight.
        let mut flipped = files.encoder.clone();
        let name = b"encoder.6.v.half";
        // The last mention of the name is beside its values.
        let at = flipped.windows(name.len()).rposition(|w| w == name).unwrap();
        flipped[at + 200] ^= 1;
        assert!(matches!(load(&flipped, &files.step), ModelError::Fingerprint { .. }));
        let entry = |version: u32| format!("\x0bcoil.format\x12\x01{version}").into_bytes();
        let newer = swap(&files.encoder, &entry(FORMAT), &entry(9));
        assert!(matches!(load(&newer, &files.step), ModelError::Version { part: "encoder", .. }));
    }

    fn swap(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
        let at = bytes.windows(from.len()).position(|w| w == from).expect("it is there");
        let mut out = bytes.to_vec();
        out[at..at + to.len()].copy_from_slice(to);
        out
    }
}
