//! Synthetic objects: shapes, materials and light made into pictures under any direction.
//!
//! Orthographic camera along −z, distant light, linear response.

pub mod material;
pub mod real;
