//! Photometric stereo that decides for itself where to put the next light.
//!
//! A camera looks at an object; a light can stand anywhere on the hemisphere. A [`planner`] looks at
//! the pictures so far and names the next light direction, a [`camera`] (a stack of real photos, a
//! renderer, a rig) takes the picture, a [`solve`]r turns pictures and directions into normals.
//! The modules stand in the order in which data flows.
//!
//! Frame: x right, y up (image row 0 is +y), z towards the camera. Angles are radians inside the
//! crate and degrees where people read them.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod rng;

pub mod camera;
pub mod dataset;
pub mod error;
pub mod image;
pub mod light;
pub mod planner;
pub mod relight;
#[cfg(feature = "render")]
pub mod render;
pub mod session;
pub mod solve;
pub mod stack;

pub mod view;

pub mod eval;

#[cfg(target_arch = "wasm32")]
pub mod web;
