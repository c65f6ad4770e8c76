//! Writes ONNX graphs: fixed shapes, 32-bit arithmetic, weights in half precision behind a `Cast`.

use prost::Message;
use std::collections::BTreeMap;
use tract_onnx::pb;
use tract_onnx::pb::attribute_proto::AttributeType;
use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::prelude::f16;

/// Operator set of the files: the first with LayerNormalization, known to every runtime of the last years.
pub const OPSET: i64 = 17;
const IR_VERSION: i64 = 8;

/// A tensor of the graph being built.
#[derive(Clone, Debug, PartialEq)]
pub struct Value {
    /// Its name.
    pub name: String,
    /// Its dimensions.
    pub dims: Vec<usize>,
}

/// An attribute of a node.
#[derive(Clone, Debug)]
pub enum Attribute {
    /// One integer.
    Int(i64),
    /// Integers.
    Ints(Vec<i64>),
    /// A number.
    Float(f32),
    /// A word.
    Word(&'static str),
}

/// A graph under construction. Nodes must be added in the order in which they are computed.
#[derive(Default)]
pub struct Graph {
    proto: pb::GraphProto,
    constants: BTreeMap<String, Vec<usize>>,
    metadata: Vec<(String, String)>,
}

impl Graph {
    /// An empty graph.
    #[must_use]
    pub fn new(name: &str) -> Self {
        let proto = pb::GraphProto { name: name.into(), ..Default::default() };
        Self { proto, ..Self::default() }
    }

    /// A float input.
    pub fn input(&mut self, name: &str, dims: &[usize]) -> Value {
        self.proto.input.push(info(name, dims, DataType::Float));
        Value { name: name.into(), dims: dims.to_vec() }
    }

    /// An integer (i64) input.
    pub fn input_int(&mut self, name: &str, dims: &[usize]) -> Value {
        self.proto.input.push(info(name, dims, DataType::Int64));
        Value { name: name.into(), dims: dims.to_vec() }
    }

    /// Gives `value` a public name and makes it an output.
    pub fn output(&mut self, name: &str, value: &Value) {
        self.named(name, "Identity", &[value], &[], &value.dims);
        self.proto.output.push(info(name, &value.dims, DataType::Float));
    }

    /// An entry of the file's metadata.
    pub fn metadata(&mut self, key: &str, value: &str) {
        self.metadata.push((key.into(), value.into()));
    }

    /// Trained weights, kept in half precision; asked for again, the same tensor.
    pub fn weights(&mut self, name: &str, dims: &[usize], values: &[f32]) -> Value {
        let value = Value { name: name.into(), dims: dims.to_vec() };
        if self.constants.contains_key(name) {
            return value;
        }
        let raw = values.iter().flat_map(|&v| f16::from_f32(v).to_le_bytes()).collect();
        let half = self.initializer(&format!("{name}.half"), dims, DataType::Float16, raw);
        self.named(name, "Cast", &[&half], &[("to", Attribute::Int(DataType::Float as i64))], dims);
        self.constants.insert(name.into(), dims.to_vec());
        value
    }

    /// A constant in full precision; asked for again by the same name, the same tensor.
    pub fn constant(&mut self, name: &str, dims: &[usize], values: &[f32]) -> Value {
        let raw = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.initializer(name, dims, DataType::Float, raw)
    }

    /// An integer constant (shapes, axes).
    pub fn integers(&mut self, name: &str, values: &[i64]) -> Value {
        let raw = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.initializer(name, &[values.len()], DataType::Int64, raw)
    }

    fn initializer(&mut self, name: &str, dims: &[usize], kind: DataType, raw_data: Vec<u8>) -> Value {
        if self.constants.insert(name.into(), dims.to_vec()).is_none() {
            self.proto.initializer.push(pb::TensorProto {
                name: name.into(),
                dims: dims.iter().map(|&d| d as i64).collect(),
                data_type: kind as i32,
                raw_data,
                ..Default::default()
            });
        }
        Value { name: name.into(), dims: dims.to_vec() }
    }

    /// A node with one output of the given dimensions.
    pub fn node(
        &mut self,
        op: &str,
        inputs: &[&Value],
        attributes: &[(&str, Attribute)],
        dims: &[usize],
    ) -> Value {
        let name = format!("{}_{}", op.to_lowercase(), self.proto.node.len());
        self.named(&name, op, inputs, attributes, dims)
    }

    fn named(
        &mut self,
        name: &str,
        op: &str,
        inputs: &[&Value],
        attributes: &[(&str, Attribute)],
        dims: &[usize],
    ) -> Value {
        self.proto.node.push(pb::NodeProto {
            name: name.into(),
            op_type: op.into(),
            input: inputs.iter().map(|v| v.name.clone()).collect(),
            output: vec![name.into()],
            attribute: attributes.iter().map(|(name, a)| attribute(name, a)).collect(),
            ..Default::default()
        });
        Value { name: name.into(), dims: dims.to_vec() }
    }

    /// Reshape to `dims`.
    pub fn reshape(&mut self, x: &Value, dims: &[usize]) -> Value {
        assert_eq!(
            x.dims.iter().product::<usize>(),
            dims.iter().product::<usize>(),
            "reshape keeps the count"
        );
        let target: Vec<i64> = dims.iter().map(|&d| d as i64).collect();
        let shape = self.integers(&format!("shape{target:?}"), &target);
        self.node("Reshape", &[x, &shape], &[], dims)
    }

    /// Axes in another order.
    pub fn transpose(&mut self, x: &Value, order: &[usize]) -> Value {
        let dims: Vec<usize> = order.iter().map(|&i| x.dims[i]).collect();
        let perm = order.iter().map(|&i| i as i64).collect();
        self.node("Transpose", &[x], &[("perm", Attribute::Ints(perm))], &dims)
    }

    /// `count` entries of an axis from `start`.
    pub fn slice(&mut self, x: &Value, axis: usize, start: usize, count: usize) -> Value {
        let mut dims = x.dims.clone();
        dims[axis] = count;
        let starts = self.integers(&format!("int[{start}]"), &[start as i64]);
        let ends = self.integers(&format!("int[{}]", start + count), &[(start + count) as i64]);
        let axes = self.integers(&format!("int[{axis}]"), &[axis as i64]);
        self.node("Slice", &[x, &starts, &ends, &axes], &[], &dims)
    }

    /// Joined along an axis.
    pub fn concat(&mut self, parts: &[&Value], axis: usize) -> Value {
        let mut dims = parts[0].dims.clone();
        dims[axis] = parts.iter().map(|p| p.dims[axis]).sum();
        self.node("Concat", parts, &[("axis", Attribute::Int(axis as i64))], &dims)
    }

    /// Bytes of all constants, in order: what a fingerprint is taken of.
    pub fn constant_bytes(&self) -> impl Iterator<Item = u8> {
        self.proto.initializer.iter().flat_map(|t| t.raw_data.iter().copied())
    }

    /// The file.
    #[must_use]
    pub fn encode(self) -> Vec<u8> {
        pb::ModelProto {
            ir_version: IR_VERSION,
            opset_import: vec![pb::OperatorSetIdProto { domain: String::new(), version: OPSET }],
            producer_name: env!("CARGO_PKG_NAME").into(),
            producer_version: env!("CARGO_PKG_VERSION").into(),
            graph: Some(self.proto),
            metadata_props: self
                .metadata
                .into_iter()
                .map(|(key, value)| pb::StringStringEntryProto { key, value })
                .collect(),
            ..Default::default()
        }
        .encode_to_vec()
    }
}

fn info(name: &str, dims: &[usize], kind: DataType) -> pb::ValueInfoProto {
    use pb::tensor_shape_proto::{Dimension, dimension};
    let dim =
        |&d: &usize| Dimension { value: Some(dimension::Value::DimValue(d as i64)), ..Default::default() };
    let shape = pb::TensorShapeProto { dim: dims.iter().map(dim).collect() };
    let tensor = pb::type_proto::Tensor { elem_type: kind as i32, shape: Some(shape) };
    let kind = pb::TypeProto { value: Some(pb::type_proto::Value::TensorType(tensor)), ..Default::default() };
    pb::ValueInfoProto { name: name.into(), r#type: Some(kind), ..Default::default() }
}

fn attribute(name: &str, value: &Attribute) -> pb::AttributeProto {
    let mut proto = pb::AttributeProto { name: name.into(), ..Default::default() };
    match value {
        Attribute::Int(i) => (proto.i, proto.r#type) = (*i, AttributeType::Int as i32),
        Attribute::Ints(i) => (proto.ints, proto.r#type) = (i.clone(), AttributeType::Ints as i32),
        Attribute::Float(f) => (proto.f, proto.r#type) = (*f, AttributeType::Float as i32),
        Attribute::Word(s) => (proto.s, proto.r#type) = (s.as_bytes().to_vec(), AttributeType::String as i32),
    }
    proto
}
