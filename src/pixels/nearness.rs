//! Fits what makes the lamps' nearness of its signs ([`near`]), and sees how well it does: on rendered objects under lamps that are as near as is known.

use super::fit::in_parallel;
use super::perceptron::{Group, Recipe, fit};
use super::{PixelsError, pictures, seen};
use crate::camera::Camera;
use crate::light;
use crate::render::worlds::{self, Split};
use crate::render::{SceneCamera, Tolerances};
use crate::rng::Rng;
use crate::solve::Measurements;
use crate::solve::near::{self, SIGNS, UNIT};
use crate::solve::perceptron::Perceptron;
use glam::Vec3;

/// What is seen of lamps of a known nearness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Number of lights.
    pub lights: usize,
    /// The lamps' nearness.
    pub truth: f32,
    /// What the pictures show of it.
    pub signs: [f32; SIGNS],
}

/// Share of the objects under distant lamps, and the nearest of the others.
const DISTANT: f32 = 0.25;
const NEAREST: f32 = 0.1;
/// Every so many objects are also seen under many lights.
const MANY_OF: usize = 4;

/// The first `objects` of a split of `worlds`, seen by rigs good and bad, each under three light sets: ten random ones, a ring with
/// its vertical, and an even spread of 5 to 24; some under one of 25 to 100 too.
///
/// # Errors
/// [`PixelsError`] of the first object that has one.
pub fn samples(split: Split, objects: usize, size: u32) -> Result<Vec<Sample>, PixelsError> {
    let of_objects = in_parallel(objects, |number| of_object(split, number, size));
    Ok(of_objects.into_iter().collect::<Result<Vec<_>, PixelsError>>()?.concat())
}

fn of_object(split: Split, number: usize, size: u32) -> Result<Vec<Sample>, PixelsError> {
    let rng = &mut Rng::stream(0x6e656172, number as u64);
    let object = match split {
        Split::Validation => worlds::validation(1, number),
        _ => worlds::training(1, number),
    };
    let scene = seen(&object, size)?;
    let truth = if rng.uniform() < DISTANT { 0.0 } else { rng.range(1e-3, NEAREST) };
    let rig = Tolerances { distance: 1.0 / truth, ..Tolerances::any(rng, 1.0, NEAREST) };
    let camera = SceneCamera::real(&scene, rig, number as u64);
    let places = near::places(camera.mask());
    let reach = rng.range(0.5, 1.4);
    let mut ring = light::ring(9, reach.min(1.04), 0.3);
    ring.push(Vec3::Z);
    let mut sets = vec![
        (0..10).map(|_| rng.direction(reach)).collect(),
        ring,
        light::fibonacci_cap(5 + rng.below(20), reach),
    ];
    if number.is_multiple_of(MANY_OF) {
        sets.push(light::fibonacci_cap(25 + rng.below(76), reach));
    }
    let mut out = Vec::with_capacity(sets.len());
    for lights in sets {
        let pictures = pictures(&camera, &lights)?;
        let images = pictures.iter().map(Vec::as_slice).collect();
        let m = Measurements { lights, images, saturated: Vec::new() };
        let signs = near::signs(&m, &places)?;
        out.extend(signs.map(|signs| Sample { lights: m.lights.len(), truth, signs }));
    }
    Ok(out)
}

/// Fits the network to squared errors: what comes out is the mean nearness of objects that look alike.
#[must_use]
pub fn network(samples: &[Sample], seed: u64) -> Perceptron<SIGNS> {
    let group = |some: &[Sample]| Group {
        inputs: some.iter().map(|s| s.signs).collect(),
        truth: some.iter().map(|s| s.truth / UNIT).collect(),
    };
    let groups: Vec<_> = samples.chunks(16).map(group).collect();
    let recipe = Recipe { seed, passes: 60, groups: 4, rate: 3e-3, beginning: 0.5, rectified: false };
    fit(&groups, &recipe, |outputs, truth| outputs.iter().zip(truth).map(|(o, t)| o - t).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearness_is_learned_from_rendered_objects() {
        let seen = samples(Split::Train, 16, 24).unwrap();
        assert_eq!(seen, samples(Split::Train, 16, 24).unwrap(), "the same seed, the same objects");
        assert!(seen.iter().any(|s| s.truth == 0.0) && seen.iter().any(|s| s.truth > 0.05));
        // Few objects, seen often: enough for some hundred steps.
        let network = network(&seen.repeat(20), 1);
        let off = |found: &dyn Fn(&Sample) -> f32| -> f32 {
            seen.iter().map(|s| (found(s) - s.truth).powi(2)).sum::<f32>() / seen.len() as f32
        };
        let mean = seen.iter().map(|s| s.truth).sum::<f32>() / seen.len() as f32;
        assert!(off(&|s| near::judged(&network, &s.signs)) < 0.7 * off(&|_| mean));
    }
}
