//! The learned planner: its network's sizes, its input frames, its model files and its runtime.
//!
//! Training and export live in `train` (native, feature `train`); this module runs what came out of it, native and in WASM.

pub mod config;
pub mod file;
pub mod frame;
mod runtime;

pub use config::Config;
pub use file::{Header, ModelError, ModelFiles};
pub use runtime::{Policy, Sequence, WHOLE};
