//! Fits the weights that share the expected error of an object out among its pixels ([`crate::solve::neighbourhood`]).

use super::expectation::{LEARNED, object, planned, random, rig, rival};
use super::fit::in_parallel;
use super::perceptron::{Group, Recipe, fit};
use super::{Generator, PixelsError, pictures, seen};
use crate::camera::Camera;
use crate::error::unit_angle;
use crate::planner::Learned;
use crate::render::worlds::{self, Split};
use crate::render::{Scene, SceneCamera};
use crate::rng::Rng;
use crate::solve::expectation::{self, expected_by};
use crate::solve::neighbourhood::{CUES, Found, cues};
use crate::solve::perceptron::Perceptron;
use crate::solve::{self, Measurements, Solution, near};
use crate::stack::Mask;
use std::collections::BTreeMap;
use std::f32::consts::FRAC_PI_2;

/// Pixels that are taken of each object under each light set.
const PIXELS: usize = 128;
/// Smallest and largest image: what a neighbour tells must not depend on the resolution.
const SIZES: [usize; 2] = [64, 192];
/// Errors below this many degrees count alike.
const LEAST: f32 = 0.1;

/// The networks of pixels by themselves, by solver.
pub type Alone = BTreeMap<&'static str, Perceptron<{ expectation::CUES }>>;

/// Some pixels of whole solutions, for each solver of `alone`: cues and errors in degrees, a group for each of `objects` objects under each
/// of five light sets.
///
/// # Errors
/// [`PixelsError`] of the first object that has one.
pub fn samples(
    objects: usize,
    alone: &Alone,
    learned: &dyn Learned,
) -> Result<BTreeMap<&'static str, Vec<Group<CUES>>>, PixelsError> {
    let generator = Generator::new(Split::Train);
    let mut all: BTreeMap<&'static str, Vec<Group<CUES>>> = BTreeMap::new();
    for one in in_parallel(objects, |number| of_object(&generator, number, alone, learned)) {
        for (solver, group) in one? {
            all.entry(solver).or_default().push(group);
        }
    }
    Ok(all)
}

fn of_object(
    generator: &Generator,
    number: usize,
    alone: &Alone,
    learned: &dyn Learned,
) -> Result<Vec<(&'static str, Group<CUES>)>, PixelsError> {
    let mut out = Vec::new();
    each_set(generator, number, object, learned, |scene, mask, given, rng| {
        let places = near::places(mask);
        let some: Vec<usize> = (0..PIXELS).map(|_| rng.below(mask.len())).collect();
        for (&name, network) in alone {
            let ready = solve::prepare(name, given.clone(), &places)?;
            let measurements = ready.measurements();
            let solution = solve::by_name(name)?.solve(&measurements)?;
            let degrees = &expected_by(network, &measurements, &solution)?;
            let Solution { normals, albedo, .. } = &solution;
            let cues = cues(mask, &Found { normals, albedo, degrees });
            let error = |&p: &usize| unit_angle(normals[p], scene.truth()[p]).to_degrees();
            let inputs = some.iter().map(|&p| cues[p]).collect();
            out.push((name, Group { inputs, truth: some.iter().map(error).collect() }));
        }
        Ok(())
    })?;
    Ok(out)
}

/// Gives `take` the pictures of one object, of some size and seen by some rig, under five light sets: random ones, ring and vertical, those of two planners, and
/// one of the generator's.
pub(super) fn each_set(
    generator: &Generator,
    number: usize,
    object: impl FnOnce(&mut Rng, usize) -> worlds::Object,
    learned: &dyn Learned,
    mut take: impl FnMut(&Scene, &Mask, &Measurements, &mut Rng) -> Result<(), PixelsError>,
) -> Result<(), PixelsError> {
    let mut rng = Rng::stream(0x6e6267, number as u64);
    let size = SIZES[0] + rng.below(SIZES[1] - SIZES[0] + 1);
    let scene = seen(&object(&mut rng, number), size as u32)?;
    let camera = SceneCamera::real(&scene, rig(&mut rng), number as u64);
    let mut sets = vec![random(&mut rng, 10)];
    for name in ["dc05v", &rival(&mut rng), LEARNED] {
        sets.push(planned(&camera, name, 10, FRAC_PI_2, rng.next_u64(), learned)?);
    }
    let count = 4 + rng.below(17);
    sets.push(generator.lights(&mut rng, count));
    for lights in sets {
        let images = pictures(&camera, &lights)?;
        let images = images.iter().map(Vec::as_slice).collect();
        let given = Measurements { lights, images, saturated: Vec::new() };
        take(&scene, camera.mask(), &given, &mut rng)?;
    }
    Ok(())
}

/// Fits the network to the logarithms of the errors, as they differ from their mean over the object.
#[must_use]
pub fn network(groups: &[Group<CUES>], seed: u64) -> Perceptron<CUES> {
    let recipe = Recipe { seed, passes: 24, groups: 4, rate: 4e-3, beginning: 0.0, rectified: false };
    fit(groups, &recipe, loss)
}

/// Derivatives of half the squared differences.
fn loss(outputs: &[f32], errors: &[f32]) -> Vec<f32> {
    let logs: Vec<f32> = errors.iter().map(|d| libm::logf(d.max(LEAST))).collect();
    let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len().max(1) as f32;
    let (middle, wanted) = (mean(outputs), mean(&logs));
    outputs.iter().zip(&logs).map(|(o, l)| (o - middle) - (l - wanted)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::expectation::tests::Ring;
    use super::super::perceptron::assert_gradient;
    use super::super::tune::rank_correlation;
    use super::*;

    #[test]
    fn whole_objects_are_seen_and_learned_from() {
        let alone = expectation::judge("ls").unwrap().alone.clone();
        let alone = Alone::from([("ls", alone)]);
        let groups = samples(2, &alone, &Ring).unwrap().remove("ls").unwrap();
        assert_eq!(groups.len(), 2 * 5);
        assert!(groups.iter().all(|g| g.inputs.len() == PIXELS && g.truth.len() == PIXELS));
        let network = network(&groups, 1);
        assert!(network.is_whole());
        // On what it was fitted to it must tell good from bad.
        let rank = |g: &Group<CUES>| {
            let outputs: Vec<f32> = g.inputs.iter().map(|i| network.output(i)).collect();
            rank_correlation(&outputs, &g.truth)
        };
        let mean = groups.iter().map(rank).sum::<f64>() / groups.len() as f64;
        assert!(mean > 0.5, "{mean}");
    }

    #[test]
    fn gradient_is_that_of_the_loss() {
        let mut rng = Rng::new(2);
        let inputs = (0..6).map(|_| std::array::from_fn(|_| rng.normal())).collect();
        let group: Group<CUES> = Group { inputs, truth: vec![0.01, 0.5, 1.0, 3.0, 20.0, 60.0] };
        let value = |outputs: &[f64], errors: &[f32]| {
            let logs: Vec<f64> = errors.iter().map(|&d| f64::from(d.max(LEAST)).ln()).collect();
            let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
            let (middle, wanted) = (mean(outputs), mean(&logs));
            outputs.iter().zip(&logs).map(|(o, l)| 0.5 * (o - middle - l + wanted).powi(2)).sum()
        };
        assert_gradient(&group, value, loss);
    }
}
