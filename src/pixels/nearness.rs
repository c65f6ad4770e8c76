//! How well the lamps' nearness is seen ([`near`]): on rendered objects under lamps that are as near as is known.

use super::fit::in_parallel;
use super::{PixelsError, pictures, seen};
use crate::camera::Camera;
use crate::light;
use crate::render::worlds;
use crate::render::{SceneCamera, Tolerances};
use crate::rng::Rng;
use crate::solve::{Measurements, near};
use glam::Vec3;

/// One estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Number of lights.
    pub lights: usize,
    /// The lamps' nearness.
    pub truth: f32,
    /// What the pictures show of it.
    pub found: f32,
}

/// Share of the objects under distant lamps, and the nearest of the others.
const DISTANT: f32 = 0.25;
const NEAREST: f32 = 0.1;

/// Estimates on the first `objects` training objects of `worlds`, seen by rigs good and bad, each under three light sets: ten random ones, a ring with
/// its vertical, and an even spread of 5 to 24.
///
/// # Errors
/// [`PixelsError`] of the first object that has one.
pub fn estimates(objects: usize, size: u32) -> Result<Vec<Estimate>, PixelsError> {
    let of_objects = in_parallel(objects, |number| of_object(number, size));
    Ok(of_objects.into_iter().collect::<Result<Vec<_>, PixelsError>>()?.concat())
}

fn of_object(number: usize, size: u32) -> Result<Vec<Estimate>, PixelsError> {
    let rng = &mut Rng::stream(0x6e656172, number as u64);
    let object = worlds::training(1, number);
    let scene = seen(&object, size)?;
    let truth = if rng.uniform() < DISTANT { 0.0 } else { rng.range(1e-3, NEAREST) };
    let rig = Tolerances { distance: 1.0 / truth, ..Tolerances::any(rng, 1.0, NEAREST) };
    let camera = SceneCamera::real(&scene, rig, number as u64);
    let places = near::places(camera.mask());
    let reach = rng.range(0.5, 1.4);
    let mut ring = light::ring(9, reach.min(1.04), 0.3);
    ring.push(Vec3::Z);
    let random = (0..10).map(|_| rng.direction(reach)).collect();
    let even = light::fibonacci_cap(5 + rng.below(20), reach);
    let one = |lights: Vec<Vec3>| {
        let pictures = pictures(&camera, &lights)?;
        let images = pictures.iter().map(Vec::as_slice).collect();
        let m = Measurements { lights, images, saturated: Vec::new() };
        let found = near::nearness(&m, &places)?;
        Ok(Estimate { lights: m.lights.len(), truth, found })
    };
    [random, ring, even].into_iter().map(one).collect()
}
