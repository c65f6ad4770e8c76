//! The network as an ONNX file: written for everyone, read back for ourselves.
//!
//! The file is the model: the page and the command line read the weights from it, any ONNX runtime can run it
//! (`observations [pixels, lights, INPUTS]` → `corrections [pixels, OUTPUTS]`, see `Start` for what an observation
//! is). Weights are stored in half precision behind a `Cast`; both sides compute in 32 bits. Only the few message kinds
//! of protocol buffers that such a file has are written and read here.

use super::network::{
    HEAD_WIDTH, HEADS, INPUTS, LAYERS, MODEL, NORM_EPSILON, Network, OUTPUTS, PARAMETERS, Parameter, WEIGHTS,
};

/// Version of what the inputs mean and how the outputs are applied; a file of another one is refused.
pub const VERSION: &str = "1";
const KIND: &str = "coil-ps pixel network";
const OPSET: u64 = 17;

/// A network and what is known about it.
#[derive(Clone, Debug)]
pub struct Model {
    /// The network.
    pub network: Network,
    /// Pairs of name and text, as training wrote them.
    pub metadata: Vec<(String, String)>,
}

/// Why a model file can't be used.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum ModelError {
    /// Not a whole ONNX file.
    #[error("not a whole ONNX file: it is damaged at byte {0}")]
    Damaged(usize),
    /// ONNX, but not a pixel network.
    #[error("an ONNX file, but not a pixel network of coil-ps (its metadata has no kind '{KIND}')")]
    Foreign,
    /// Of another version.
    #[error(
        "a pixel network of version {0}, where this program reads version {VERSION}: take the model file that came with it"
    )]
    Version(String),
    /// A weight array is missing or has another shape.
    #[error("weights '{0}' are missing, or have another shape or type than version {VERSION} has")]
    Weights(String),
    /// A weight is NaN or infinite.
    #[error("weights '{0}' hold a value that is not finite")]
    NotFinite(String),
}

// ---- Protocol buffers -------------------------------------------------------------------------

/// A message being written.
#[derive(Default)]
struct Message(Vec<u8>);

impl Message {
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    fn int(mut self, field: u64, value: u64) -> Self {
        self.varint(field << 3);
        self.varint(value);
        self
    }

    fn float(mut self, field: u64, value: f32) -> Self {
        self.varint(field << 3 | 5);
        self.0.extend(value.to_le_bytes());
        self
    }

    fn bytes(mut self, field: u64, bytes: &[u8]) -> Self {
        self.varint(field << 3 | 2);
        self.varint(bytes.len() as u64);
        self.0.extend(bytes);
        self
    }

    fn message(self, field: u64, message: Self) -> Self {
        self.bytes(field, &message.0)
    }
}

/// A field that was read.
enum Field<'a> {
    Int(u64),
    Bytes(&'a [u8]),
    Other,
}

/// Reads the fields of a message one by one.
struct Fields<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Where the message begins in the file.
    offset: usize,
}

impl<'a> Fields<'a> {
    fn varint(&mut self) -> Result<u64, ModelError> {
        let mut value = 0u64;
        for shift in (0..64).step_by(7) {
            let byte = *self.bytes.get(self.at).ok_or(ModelError::Damaged(self.offset + self.at))?;
            self.at += 1;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(ModelError::Damaged(self.offset + self.at))
    }

    fn take(&mut self, count: u64) -> Result<&'a [u8], ModelError> {
        let rest = &self.bytes[self.at..];
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        let taken = rest.get(..count).ok_or(ModelError::Damaged(self.offset + self.at))?;
        self.at += count;
        Ok(taken)
    }

    fn next(&mut self) -> Result<Option<(u64, Field<'a>)>, ModelError> {
        if self.at == self.bytes.len() {
            return Ok(None);
        }
        let key = self.varint()?;
        let field = match key & 7 {
            0 => Field::Int(self.varint()?),
            1 => {
                self.take(8)?;
                Field::Other
            }
            2 => {
                let count = self.varint()?;
                Field::Bytes(self.take(count)?)
            }
            5 => {
                self.take(4)?;
                Field::Other
            }
            _ => return Err(ModelError::Damaged(self.offset + self.at)),
        };
        Ok(Some((key >> 3, field)))
    }

    fn within(&self, inner: &'a [u8]) -> Fields<'a> {
        Fields { bytes: inner, at: 0, offset: self.offset + self.at - inner.len() }
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

// ---- Writing ----------------------------------------------------------------------------------

const FLOAT: u64 = 1;
const INT64: u64 = 7;
const HALF: u64 = 10;

#[derive(Default)]
struct Graph {
    nodes: Vec<Message>,
    initializers: Vec<Message>,
}

fn attribute_ints(name: &str, values: &[i64]) -> Message {
    let start = Message::default().bytes(1, name.as_bytes()).int(20, 7);
    values.iter().fold(start, |m, &v| m.int(8, v as u64))
}

fn attribute_int(name: &str, value: i64) -> Message {
    Message::default().bytes(1, name.as_bytes()).int(20, 2).int(3, value as u64)
}

fn attribute_float(name: &str, value: f32) -> Message {
    Message::default().bytes(1, name.as_bytes()).int(20, 1).float(2, value)
}

impl Graph {
    /// Adds a node whose (first) output has the name that is returned.
    fn node(&mut self, kind: &str, inputs: &[&str], outputs: &[&str], attributes: Vec<Message>) -> String {
        let mut node = Message::default();
        for input in inputs {
            node = node.bytes(1, input.as_bytes());
        }
        for output in outputs {
            node = node.bytes(2, output.as_bytes());
        }
        node = node.bytes(3, outputs[0].as_bytes()).bytes(4, kind.as_bytes());
        for attribute in attributes {
            node = node.message(5, attribute);
        }
        self.nodes.push(node);
        outputs[0].into()
    }

    fn tensor(&mut self, name: &str, dims: &[usize], kind: u64, raw: &[u8]) {
        let mut tensor = Message::default();
        for &d in dims {
            tensor = tensor.int(1, d as u64);
        }
        self.initializers.push(tensor.int(2, kind).bytes(8, name.as_bytes()).bytes(9, raw));
    }

    fn integers(&mut self, name: &str, values: &[i64]) -> String {
        let raw: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.tensor(name, &[values.len()], INT64, &raw);
        name.into()
    }

    /// `x Wᵀ + b`.
    fn linear(&mut self, layer: &str, x: &str, output: &str) -> String {
        let product = self.node(
            "MatMul",
            &[x, &format!("{layer}.weight.f32")],
            &[&format!("{output}.product")],
            vec![],
        );
        self.node("Add", &[&product, &format!("{layer}.bias.f32")], &[output], vec![])
    }

    fn norm(&mut self, layer: &str, x: &str, output: &str) -> String {
        let inputs = [x, &format!("{layer}.scale.f32"), &format!("{layer}.shift.f32")];
        let attributes = vec![attribute_int("axis", -1), attribute_float("epsilon", NORM_EPSILON)];
        self.node("LayerNormalization", &inputs, &[output], attributes)
    }
}

/// The stored order of a matrix is that of `MatMul`: inputs first.
fn stored_shape(p: &Parameter) -> Vec<usize> {
    if p.shape[0] == 1 { vec![p.shape[1]] } else { vec![p.shape[1], p.shape[0]] }
}

/// Places in the flat list of the values of `p` in stored order.
fn stored_order(p: &Parameter) -> impl Iterator<Item = usize> + use<> {
    let Parameter { shape: [rows, columns], offset, .. } = *p;
    (0..rows * columns).map(move |i| offset + (i % rows) * columns + i / rows)
}

/// The ONNX file of a network.
#[must_use]
pub fn write(network: &Network, metadata: &[(String, String)]) -> Vec<u8> {
    let mut g = Graph::default();
    for p in &PARAMETERS {
        let raw: Vec<u8> =
            stored_order(p).flat_map(|i| to_half(network.weights()[i]).to_le_bytes()).collect();
        g.tensor(p.name, &stored_shape(p), HALF, &raw);
        let cast = vec![attribute_int("to", FLOAT as i64)];
        g.node("Cast", &[p.name], &[&format!("{}.f32", p.name)], cast);
    }
    let heads = g.integers("heads", &[0, 0, HEADS as i64, HEAD_WIDTH as i64]);
    let merged = g.integers("merged", &[0, 0, MODEL as i64]);
    let thirds = g.integers("thirds", &[MODEL as i64; 3]);
    g.tensor("scale", &[], FLOAT, &(1.0 / (HEAD_WIDTH as f32).sqrt()).to_le_bytes());

    let mut x = g.linear("embed", "observations", "embedded");
    for layer in 0..LAYERS {
        let l = |name: &str| format!("layer{layer}.{name}");
        let normed = g.norm(&l("norm1"), &x, &l("normed1"));
        let all = g.linear(&l("qkv"), &normed, &l("all"));
        let parts = [l("q"), l("k"), l("v")];
        let outputs: Vec<&str> = parts.iter().map(String::as_str).collect();
        g.node("Split", &[&all, &thirds], &outputs, vec![attribute_int("axis", 2)]);
        let mut turned = Vec::new();
        for (part, order) in parts.iter().zip([[0, 2, 1, 3], [0, 2, 3, 1], [0, 2, 1, 3]]) {
            let split = g.node("Reshape", &[part, &heads], &[&format!("{part}.heads")], vec![]);
            let order = vec![attribute_ints("perm", &order)];
            turned.push(g.node("Transpose", &[&split], &[&format!("{part}.turned")], order));
        }
        let scores = g.node("MatMul", &[&turned[0], &turned[1]], &[&l("scores")], vec![]);
        let scaled = g.node("Mul", &[&scores, "scale"], &[&l("scaled")], vec![]);
        let shares = g.node("Softmax", &[&scaled], &[&l("shares")], vec![attribute_int("axis", -1)]);
        let mixed = g.node("MatMul", &[&shares, &turned[2]], &[&l("mixed")], vec![]);
        let back = g.node("Transpose", &[&mixed], &[&l("back")], vec![attribute_ints("perm", &[0, 2, 1, 3])]);
        let attended = g.node("Reshape", &[&back, &merged], &[&l("attended")], vec![]);
        let merge = g.linear(&l("merge"), &attended, &l("merge.out"));
        let middle = g.node("Add", &[&merge, &x], &[&l("middle")], vec![]);
        let normed = g.norm(&l("norm2"), &middle, &l("normed2"));
        let up = g.linear(&l("up"), &normed, &l("up.out"));
        let hidden = g.node("Relu", &[&up], &[&l("hidden")], vec![]);
        let down = g.linear(&l("down"), &hidden, &l("down.out"));
        x = g.node("Add", &[&down, &middle], &[&l("out")], vec![]);
    }
    let normed = g.norm("norm", &x, "normed");
    let over_lights = || vec![attribute_ints("axes", &[1]), attribute_int("keepdims", 0)];
    let mean = g.node("ReduceMean", &[&normed], &["mean"], over_lights());
    let top = g.node("ReduceMax", &[&normed], &["maximum"], over_lights());
    let pooled = g.node("Concat", &[&mean, &top], &["pooled"], vec![attribute_int("axis", 1)]);
    let head = g.linear("head1", &pooled, "head");
    let head = g.node("Relu", &[&head], &["head.active"], vec![]);
    g.linear("head2", &head, "corrections");

    let dimension = |d: Result<usize, &str>| match d {
        Ok(value) => Message::default().int(1, value as u64),
        Err(name) => Message::default().bytes(2, name.as_bytes()),
    };
    let value = |name: &str, dims: &[Result<usize, &str>]| {
        let shape = dims.iter().fold(Message::default(), |m, &d| m.message(1, dimension(d)));
        let tensor = Message::default().int(1, FLOAT).message(2, shape);
        Message::default().bytes(1, name.as_bytes()).message(2, Message::default().message(1, tensor))
    };
    let mut graph = Message::default();
    for node in g.nodes {
        graph = graph.message(1, node);
    }
    graph = graph.bytes(2, b"pixel network");
    for tensor in g.initializers {
        graph = graph.message(5, tensor);
    }
    graph = graph
        .message(11, value("observations", &[Err("pixels"), Err("lights"), Ok(INPUTS)]))
        .message(12, value("corrections", &[Err("pixels"), Ok(OUTPUTS)]));
    let mut model = Message::default()
        .int(1, 8)
        .bytes(2, b"coil-ps")
        .message(7, graph)
        .message(8, Message::default().bytes(1, b"").int(2, OPSET));
    let own = [("kind".to_string(), KIND.to_string()), ("version".into(), VERSION.into())];
    for (key, text) in own.iter().chain(metadata) {
        let entry = Message::default().bytes(1, key.as_bytes()).bytes(2, text.as_bytes());
        model = model.message(14, entry);
    }
    model.0
}

// ---- Reading ----------------------------------------------------------------------------------

struct Tensor {
    name: String,
    dims: Vec<usize>,
    kind: u64,
    raw: Vec<u8>,
}

/// Reads a file that [`write()`] made.
///
/// # Errors
/// [`ModelError`] for a damaged or foreign file, or one of another version.
pub fn read(bytes: &[u8]) -> Result<Model, ModelError> {
    let mut metadata = Vec::new();
    let mut tensors = Vec::new();
    let mut file = Fields { bytes, at: 0, offset: 0 };
    while let Some((number, field)) = file.next()? {
        match (number, field) {
            (7, Field::Bytes(graph)) => {
                let mut graph = file.within(graph);
                while let Some((number, field)) = graph.next()? {
                    if let (5, Field::Bytes(inner)) = (number, field) {
                        tensors.push(tensor(graph.within(inner))?);
                    }
                }
            }
            (14, Field::Bytes(entry)) => {
                let mut entry = file.within(entry);
                let (mut key, mut value) = (String::new(), String::new());
                while let Some((number, field)) = entry.next()? {
                    match (number, field) {
                        (1, Field::Bytes(b)) => key = text(b),
                        (2, Field::Bytes(b)) => value = text(b),
                        _ => {}
                    }
                }
                metadata.push((key, value));
            }
            _ => {}
        }
    }
    let entry = |key: &str| metadata.iter().find(|(k, _)| k == key).map(|(_, v)| v.clone());
    if entry("kind").as_deref() != Some(KIND) {
        return Err(ModelError::Foreign);
    }
    let version = entry("version").unwrap_or_default();
    if version != VERSION {
        return Err(ModelError::Version(version));
    }
    let mut weights = vec![0.0; WEIGHTS];
    for p in &PARAMETERS {
        let count = p.shape[0] * p.shape[1];
        let tensor = tensors
            .iter()
            .find(|t| t.name == p.name)
            .filter(|t| t.kind == HALF && t.dims == stored_shape(p) && t.raw.len() == 2 * count)
            .ok_or_else(|| ModelError::Weights(p.name.into()))?;
        for (i, raw) in stored_order(p).zip(tensor.raw.chunks_exact(2)) {
            weights[i] = from_half(u16::from_le_bytes([raw[0], raw[1]]));
            if !weights[i].is_finite() {
                return Err(ModelError::NotFinite(p.name.into()));
            }
        }
    }
    let network = Network::new(weights).ok_or(ModelError::Foreign)?;
    metadata.retain(|(key, _)| key != "kind" && key != "version");
    Ok(Model { network, metadata })
}

fn tensor(mut fields: Fields) -> Result<Tensor, ModelError> {
    let mut tensor = Tensor { name: String::new(), dims: Vec::new(), kind: 0, raw: Vec::new() };
    while let Some((number, field)) = fields.next()? {
        match (number, field) {
            (1, Field::Int(d)) => tensor.dims.push(d as usize),
            (2, Field::Int(kind)) => tensor.kind = kind,
            (8, Field::Bytes(b)) => tensor.name = text(b),
            (9, Field::Bytes(b)) => tensor.raw = b.to_vec(),
            _ => {}
        }
    }
    Ok(tensor)
}

/// IEEE half precision, rounded to nearest even; beyond its range the largest finite value.
fn to_half(value: f32) -> u16 {
    let bits = value.to_bits();
    let sign = (bits >> 16 & 0x8000) as u16;
    let magnitude = f32::from_bits(bits & 0x7fff_ffff).min(65504.0);
    if magnitude < 6.103_515_6e-5 {
        // Subnormal: a multiple of 2⁻²⁴; adding 2²³·2⁻²⁴ rounds to one.
        return sign | ((magnitude + 0.5).to_bits() & 0x07ff) as u16;
    }
    let m = magnitude.to_bits();
    let rounded = m + 0x0fff + (m >> 13 & 1) - (112 << 23);
    sign | (rounded >> 13) as u16
}

fn from_half(half: u16) -> f32 {
    let sign = u32::from(half & 0x8000) << 16;
    let (exponent, fraction) = (u32::from(half >> 10 & 31), u32::from(half & 0x3ff));
    let magnitude = match exponent {
        0 => fraction as f32 * (1.0 / 16_777_216.0),
        31 => f32::from_bits(0x7f80_0000 | fraction << 13),
        _ => f32::from_bits((exponent + 112) << 23 | fraction << 13),
    };
    f32::from_bits(magnitude.to_bits() | sign)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    fn network() -> Network {
        let mut rng = Rng::new(1);
        Network::new((0..WEIGHTS).map(|_| 0.2 * rng.normal()).collect()).unwrap()
    }

    #[test]
    fn halves_are_exact_both_ways() {
        for half in (0..0x7c00).chain(0x8000..0xfc00u16) {
            assert_eq!(to_half(from_half(half)), half);
        }
        assert_eq!(from_half(to_half(1.0)), 1.0);
        assert!((from_half(to_half(0.1)) - 0.1).abs() < 5e-5);
        assert_eq!(from_half(to_half(1e9)), 65504.0);
        // Ties go to even: 1 + 2⁻¹¹ lies between 1 and 1 + 2⁻¹⁰.
        assert_eq!(from_half(to_half(1.0 + 1.0 / 2048.0)), 1.0);
    }

    #[test]
    fn what_is_written_is_read() {
        let network = network();
        let file = write(&network, &[("seed".into(), "7".into())]);
        let model = read(&file).unwrap();
        for (a, b) in network.weights().iter().zip(model.network.weights()) {
            assert!((a - b).abs() <= 5e-4 * a.abs().max(1e-3));
        }
        assert_eq!(model.metadata, [("seed".to_string(), "7".to_string())]);
        assert_eq!(write(&model.network, &model.metadata), file);
    }

    #[test]
    fn bad_files_are_named() {
        let file = write(&network(), &[]);
        assert!(matches!(read(&file[..file.len() / 2]), Err(ModelError::Damaged(_))));
        assert!(matches!(read(b"\x89PNG\r\n"), Err(ModelError::Damaged(_) | ModelError::Foreign)));
        assert_eq!(read(b"").unwrap_err(), ModelError::Foreign);
        let place = file.windows(7).position(|w| w == b"version").unwrap();
        let mut other = file.clone();
        other[place + 9] = b'9';
        assert_eq!(read(&other).unwrap_err(), ModelError::Version("9".into()));
        let mut renamed = file.clone();
        let place = renamed.windows(11).position(|w| w == b"head1.bias\x4a").unwrap();
        renamed[place] = b'x';
        assert_eq!(read(&renamed).unwrap_err(), ModelError::Weights("head1.bias".into()));
    }

    #[test]
    fn any_bytes_are_refused_without_panic() {
        let file = write(&network(), &[]);
        let mut rng = Rng::new(5);
        for _ in 0..300 {
            let mut bytes = file[..rng.below(3000)].to_vec();
            for _ in 0..4 {
                if !bytes.is_empty() {
                    let at = rng.below(bytes.len());
                    bytes[at] = rng.next_u64() as u8;
                }
            }
            assert!(read(&bytes).is_err());
        }
    }
}
