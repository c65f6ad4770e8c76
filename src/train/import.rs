//! The weights of a policy's two files, back from ONNX: what training can go on from where only the shipped files are left.

use super::weights::Weights;
use crate::policy::file::{self, ModelError, ModelFiles};
use tract_onnx::pb;
use tract_onnx::prelude::f16;

/// The network that [`super::export::export`] wrote, in half precision as it was written.
///
/// # Errors
/// [`ModelError`] for files that are damaged, of another version or don't belong together.
pub fn import(files: &ModelFiles) -> Result<Weights, ModelError> {
    let (encoder, header) = file::read("encoder", &files.encoder)?;
    let (step, step_header) = file::read("step", &files.step)?;
    file::pair(&header, &step_header)?;
    let constants: Vec<&pb::TensorProto> =
        [&encoder, &step].into_iter().filter_map(|m| m.graph.as_ref()).flat_map(|g| &g.initializer).collect();
    let mut weights = Weights::new(&header.config, 0);
    for p in weights.params.iter_mut().filter(|p| !p.name.ends_with(".g")) {
        let name = format!("{}.half", p.name);
        let values: Vec<f32> = constants
            .iter()
            .find(|t| t.name == name)
            .map(|t| t.raw_data.as_chunks::<2>().0.iter().map(|b| f16::from_le_bytes(*b).to_f32()).collect())
            .unwrap_or_default();
        if values.len() != p.values.len() {
            let detail = format!("{name} has {} values, its network needs {}", values.len(), p.values.len());
            return Err(ModelError::Damaged { part: "encoder and step", detail });
        }
        p.values = values;
    }
    Ok(weights.with_gains_of_kernels())
}
