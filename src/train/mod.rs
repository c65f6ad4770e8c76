//! Training and export of the networks, on burn. Native only.

pub mod adamw;
pub mod checkpoint;
pub mod compute;
pub mod export;
pub mod fit;
pub mod formation;
pub mod import;
pub mod loss;
pub mod network;
pub mod objects;
pub mod onnx;
pub mod plot;
pub mod rollout;
pub mod tape;
pub mod validate;
pub mod weights;
