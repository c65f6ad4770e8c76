//! Model files: two ONNX graphs of one network, and what their metadata must say before they are run.

use super::config::{Config, FORMAT};
use crate::fingerprint::Fingerprint;
use tract_onnx::pb;
use tract_onnx::prelude::*;

/// Metadata: version of the format.
pub const KEY_FORMAT: &str = "coil.format";
/// Metadata: `encoder` or `step`.
pub const KEY_PART: &str = "coil.part";
/// Metadata: the [`Config`], as JSON.
pub const KEY_CONFIG: &str = "coil.config";
/// Metadata: identity of the trained network, the same in both files.
pub const KEY_NETWORK: &str = "coil.network";
/// Metadata: fingerprint of the file's constants.
pub const KEY_FINGERPRINT: &str = "coil.fingerprint";
/// Metadata: how it was trained, one line.
pub const KEY_NOTE: &str = "coil.note";

/// The two ONNX files of a policy.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelFiles {
    /// One frame to gated features.
    pub encoder: Vec<u8>,
    /// Features, light and what was seen before to the next direction.
    pub step: Vec<u8>,
}

/// What a model file says of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// Sizes of the network.
    pub config: Config,
    /// Identity of the trained network (16 hexadecimal digits).
    pub network: String,
    /// How it was trained.
    pub note: String,
    /// Number of constants (weights and the like) in the file.
    pub values: usize,
}

/// Why a model can't be used.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum ModelError {
    /// No ONNX, or cut short.
    #[error("{part}: not a readable ONNX file ({detail}): download it again")]
    Damaged {
        /// `encoder` or `step`.
        part: &'static str,
        /// What the parser said.
        detail: String,
    },
    /// An ONNX file that this project didn't write, or the other part of the pair.
    #[error(
        "{part}: the file's {key} is '{found}' where '{expected}' is needed: use the {part} file of a coil policy"
    )]
    Foreign {
        /// `encoder` or `step`.
        part: &'static str,
        /// Which metadata entry.
        key: &'static str,
        /// What it says.
        found: String,
        /// What it should say.
        expected: String,
    },
    /// Another version of the format.
    #[error(
        "{part}: model format {found}, this build reads format {FORMAT}: use the models of the same release"
    )]
    Version {
        /// `encoder` or `step`.
        part: &'static str,
        /// What the file says.
        found: String,
    },
    /// Weights that are not what the exporter wrote.
    #[error(
        "{part}: the weights' fingerprint is {found}, the file says {expected}: it is damaged, download it again"
    )]
    Fingerprint {
        /// `encoder` or `step`.
        part: &'static str,
        /// Of the weights in the file.
        found: String,
        /// What the exporter wrote.
        expected: String,
    },
    /// Encoder and step of two different networks.
    #[error("the encoder is of network {encoder}, the step of network {step}: use two files of one model")]
    Pair {
        /// Network of the encoder.
        encoder: String,
        /// Network of the step.
        step: String,
    },
    /// The runtime can't run it.
    #[error("the model can't be run: {0}")]
    Run(String),
}

/// Reads a part and checks what it says of itself.
pub(crate) fn read(part: &'static str, bytes: &[u8]) -> Result<(pb::ModelProto, Header), ModelError> {
    let damaged = |detail: String| ModelError::Damaged { part, detail };
    let proto = tract_onnx::onnx().proto_model_for_read(&mut &bytes[..]).map_err(|e| damaged(chain(&e)))?;
    let entry = |key| proto.metadata_props.iter().find(|e| e.key == key).map(|e| e.value.clone());
    let needed = |key, expected: &str| {
        entry(key).ok_or_else(|| ModelError::Foreign {
            part,
            key,
            found: "missing".into(),
            expected: expected.into(),
        })
    };
    let format = needed(KEY_FORMAT, &FORMAT.to_string())?;
    if format != FORMAT.to_string() {
        return Err(ModelError::Version { part, found: format });
    }
    let found = needed(KEY_PART, part)?;
    if found != part {
        return Err(ModelError::Foreign { part, key: KEY_PART, found, expected: part.into() });
    }
    let config: Config = serde_json::from_str(&needed(KEY_CONFIG, "a configuration")?)
        .map_err(|e| damaged(format!("{KEY_CONFIG}: {e}")))?;
    config.check().map_err(|e| damaged(format!("{KEY_CONFIG}: {e}")))?;
    let constants = proto.graph.as_ref().map(|g| g.initializer.as_slice()).unwrap_or_default();
    let found = Fingerprint::of(constants.iter().flat_map(|t| t.raw_data.iter().copied())).to_string();
    let expected = needed(KEY_FINGERPRINT, &found)?;
    if found != expected {
        return Err(ModelError::Fingerprint { part, found, expected });
    }
    let values = constants.iter().map(|t| t.dims.iter().product::<i64>().max(0) as usize).sum();
    let header = Header {
        config,
        network: needed(KEY_NETWORK, "an identity")?,
        note: entry(KEY_NOTE).unwrap_or_default(),
        values,
    };
    Ok((proto, header))
}

/// What both files of a policy say of themselves, checked but not loaded: (encoder, step).
///
/// # Errors
/// [`ModelError`].
pub fn headers(files: &ModelFiles) -> Result<(Header, Header), ModelError> {
    let (_, encoder) = read("encoder", &files.encoder)?;
    let (_, step) = read("step", &files.step)?;
    pair(&encoder, &step)?;
    Ok((encoder, step))
}

pub(crate) fn pair(encoder: &Header, step: &Header) -> Result<(), ModelError> {
    if encoder.network == step.network && encoder.config == step.config {
        Ok(())
    } else {
        Err(ModelError::Pair { encoder: encoder.network.clone(), step: step.network.clone() })
    }
}

/// All messages of a runtime's error, the outermost first.
pub(super) fn chain(error: &TractError) -> String {
    format!("{error:#}")
}
