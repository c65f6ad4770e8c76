//! From normals to a surface: depth by integration, and the surface as a mesh file.

pub mod export;
pub mod integrate;

pub use export::Surface;
pub use integrate::{Depth, Integration, integrate};
