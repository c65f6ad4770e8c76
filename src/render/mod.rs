//! Synthetic objects: shapes, materials and light made into pictures under any direction.
//!
//! Orthographic camera along −z, distant light, linear response:
//! `I(p) = π f(n, l, v) max(n·l, 0) · visible + light from other parts of the object`.
//! A [`Shape`] at a [`Pose`] is seen once ([`View`]); with its [`Finish`] it makes a [`Scene`], which answers every
//! light direction. How, and how exactly: docs/rendering.md.

pub mod capture;
pub mod finish;
pub mod horizon;
pub mod material;
pub mod mesh;
pub mod real;
pub mod scene;
pub mod sculpture;
pub mod sensor;
pub mod tolerance;
pub mod trace;
pub mod view;
pub mod worlds;

pub use capture::Capture;
pub use finish::Finish;
pub use horizon::Horizon;
pub use material::{Abc, Ggx, Material};
pub use mesh::Mesh;
pub use scene::{Buffers, Options, Scene, SceneCamera};
pub use sculpture::Sculpture;
pub use sensor::{Sensor, stack};
pub use tolerance::{Errors, Tolerances};
pub use trace::Tracer;
pub use view::{Pose, Shape, View};

/// Largest image side.
pub const MAX_SIZE: u32 = 8192;

/// Why an object can't be rendered.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum RenderError {
    /// The mesh can't be read.
    #[error(transparent)]
    Mesh(#[from] mesh::MeshError),
    /// No such sculpture.
    #[error(transparent)]
    Sculpture(#[from] sculpture::UnknownSculpture),
    /// No such material.
    #[error(transparent)]
    Material(#[from] material::MaterialError),
    /// A set of objects without the numbers, or with wrong ones.
    #[error("'{name}': write a number or a range of 0..={last}, as {name}:3 or {name}:0..9", name = name.split(':').next().unwrap_or_default())]
    Numbers {
        /// What was asked for.
        name: String,
        /// The last number there is.
        last: usize,
    },
    /// An image side of 0 or too many pixels.
    #[error("image size {0}: it must lie in 1..={MAX_SIZE} pixels")]
    Size(u32),
    /// Nothing in the frame.
    #[error("the camera does not see the object: no pixel is covered")]
    Invisible,
    /// Not a rotation, or no finite place.
    #[error(
        "the pose needs a rotation matrix (orthonormal rows, determinant +1), a scale > 0 and a finite translation"
    )]
    Pose,
    /// The pose file can't be read.
    #[error(
        "pose file: {0}; it holds {{\"rotation\": [[…],[…],[…]], \"scale\": …, \"translation\": […]}}, the last two optional"
    )]
    PoseFile(String),
    /// A material that the flat arrays can't hold.
    #[error("material {0} has no place in the trainer's arrays: use Lambert or a measured material")]
    Export(String),
}

/// The sculpture of a name as a shape.
///
/// # Errors
/// [`RenderError::Sculpture`].
pub fn named(name: &str) -> Result<Shape, RenderError> {
    Ok(Shape::Sculpture(Sculpture::named(name)?))
}
