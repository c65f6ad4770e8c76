//! Something that takes a picture of an object under a light direction: a stack of photos with a
//! look-up, a renderer, a rig.

use crate::light;
use crate::stack::Mask;
use glam::Vec3;

/// Where a light may be asked for.
#[derive(Clone, Debug, PartialEq)]
pub enum Domain {
    /// One of these unit directions.
    Candidates(Vec<Vec3>),
    /// Any direction whose slant is at most `reach` radians (π/2: the whole hemisphere).
    Hemisphere {
        /// Largest slant, radians.
        reach: f32,
    },
}

impl Domain {
    /// Largest slant that can be asked for, radians.
    #[must_use]
    pub fn reach(&self) -> f32 {
        match self {
            Self::Candidates(lights) => light::reach(lights),
            Self::Hemisphere { reach } => *reach,
        }
    }

    /// The candidates, where the domain is a finite list.
    #[must_use]
    pub fn candidates(&self) -> Option<&[Vec3]> {
        match self {
            Self::Candidates(lights) => Some(lights),
            Self::Hemisphere { .. } => None,
        }
    }
}

/// One picture of the object under one light.
#[derive(Clone, Debug)]
pub struct Observation {
    /// The direction that was asked for, unit length.
    pub requested: Vec3,
    /// The direction of the light in the picture, as the solver must use it. Unit length, but for soft
    /// interpolation, where it is the unnormalised blend `l̃ = Σ w_p l_p`.
    pub light: Vec3,
    /// Linear grey value of every mask pixel.
    pub grey: Vec<f32>,
    /// Linear RGB of every mask pixel; empty where the camera has no colour.
    pub rgb: Vec<[f32; 3]>,
    /// Which mask pixels are saturated in the picture; empty where none is.
    pub saturated: Vec<bool>,
    /// How many stored photos the picture is made of, exp(entropy of the weights); 1 for a real one.
    pub effective_images: f32,
    /// Number of the stored photo, where it is a single one.
    pub index: Option<usize>,
}

impl Observation {
    /// A real picture: one that no stored photo is, with nothing saturated.
    #[must_use]
    pub fn new(requested: Vec3, light: Vec3, grey: Vec<f32>, rgb: Vec<[f32; 3]>) -> Self {
        Self { requested, light, grey, rgb, saturated: Vec::new(), effective_images: 1.0, index: None }
    }

    /// Angle between the requested and the used light, radians.
    #[must_use]
    pub fn deviation(&self) -> f32 {
        light::angle(self.requested, self.light)
    }
}

/// Why a picture could not be taken.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum CameraError {
    /// The direction is not a unit vector of the hemisphere.
    #[error("light direction ({0}, {1}, {2}) is not a unit vector with z ≥ 0")]
    Direction(f32, f32, f32),
    /// Every stored photo has been used.
    #[error("all {0} stored images have been used: ask for at most {0} lights")]
    Exhausted(usize),
    /// A device or renderer failed.
    #[error("{0}")]
    Device(String),
}

/// Takes pictures of one object.
pub trait Camera {
    /// The object's pixels.
    fn mask(&self) -> &Mask;

    /// The picture under `direction`. `seen` are the pictures of this run so far: a camera that has
    /// only stored photos gives none of them twice.
    ///
    /// # Errors
    /// [`CameraError`] for a direction outside the hemisphere, or where no picture can be given.
    fn capture(&self, direction: Vec3, seen: &[Observation]) -> Result<Observation, CameraError>;
}

/// Refuses what is not a unit direction of the hemisphere (tolerance 1e-3 on length and z).
///
/// # Errors
/// [`CameraError::Direction`].
pub fn check_direction(d: Vec3) -> Result<(), CameraError> {
    // NaN fails every comparison, so it is refused too.
    if (d.length() - 1.0).abs() <= 1e-3 && d.z >= -1e-3 {
        Ok(())
    } else {
        Err(CameraError::Direction(d.x, d.y, d.z))
    }
}
