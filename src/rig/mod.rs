//! From an arm and a camera to a session on disk: exposures, calibration, storage and the capture itself.
//!
//! Like [`crate::arm`], all of it takes values and gives values; files, ports and cameras belong to the callers.

pub mod calibration;
pub mod camera;
pub mod capture;
pub mod drawing;
pub mod hdr;
pub mod setup;
pub mod sphere;
pub mod store;
pub mod thrifty;
pub mod tiff;
