//! Fits the weights that correct normals by what is around them ([`crate::solve::context`]), on rendered objects.

use super::expectation::{self, object};
use super::fit::in_parallel;
use super::neighbourhood::each_set;
use super::perceptron::{Group, Recipe, fit_outputs};
use super::tune::rank_correlation;
use super::{Generator, PixelsError};
use crate::error::unit_angle;
use crate::eval::statistics::{mean, median};
use crate::planner::Learned;
use crate::render::worlds::{self, Split};
use crate::render::{Mesh, Shape};
use crate::rng::Rng;
use crate::solve::context::{CUES, Frame, Network, OUTPUTS, corrected, cues, reach};
use crate::solve::neighbourhood::Found;
use crate::solve::{self, Measurements, Solution, near, pixel, uncertainty};
use crate::stack::Mask;
use glam::Vec3;

/// Pixels that are taken of each object under each light set.
const PIXELS: usize = 384;
/// One in so many objects is a mesh, if there are any.
const MESH_EVERY: usize = 3;
/// Weight of what the error is expected to be beside the error (radians).
const EXPECTED: f32 = 0.05;
/// Smallest error that is expected, degrees.
const LEAST: f32 = 0.1;
/// Chords below this many radians have no direction worth following.
const SHORT: f32 = 1e-3;

/// What is true of a pixel, in the frame in which the normal that was found has azimuth 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    found: Vec3,
    reach: f32,
    normal: Vec3,
}

/// A whole object as the pixel network solves it.
fn solved(given: &Measurements, mask: &Mask) -> Result<Solution, PixelsError> {
    let ready = solve::prepare(pixel::NAME, given.clone(), &near::places(mask))?;
    let pictures = ready.measurements();
    let mut solution = solve::by_name(pixel::NAME)?.solve(&pictures)?;
    uncertainty::complete(pixel::NAME, &pictures, &mut solution)?;
    Ok(solution)
}

/// Object `number`: a sculpture, and where there are meshes every [`MESH_EVERY`]th time one of these, in another pose and of another material each time.
fn sculpture_or_mesh(rng: &mut Rng, number: usize, meshes: &[(String, Mesh)]) -> worlds::Object {
    if meshes.is_empty() || !number.is_multiple_of(MESH_EVERY) {
        return object(rng, number);
    }
    let (name, mesh) = &meshes[number / MESH_EVERY % meshes.len()];
    worlds::Object::dressed(name, Shape::Mesh(mesh.clone()), Split::Train, rng)
}

/// Some pixels of `objects` solved objects, a group for each object under each of five light sets.
///
/// # Errors
/// [`PixelsError`] of the first object that has one.
pub fn samples(
    objects: usize,
    meshes: &[(String, Mesh)],
    learned: &dyn Learned,
) -> Result<Vec<Group<CUES, Truth>>, PixelsError> {
    let generator = Generator::new(Split::Train);
    let of_object = |number| {
        let mut out = Vec::new();
        let object = |rng: &mut Rng, number| sculpture_or_mesh(rng, number, meshes);
        each_set(&generator, number, object, learned, |scene, mask, given, rng| {
            let solution = solved(given, mask)?;
            let Some(found) = Found::of(mask, &solution)? else { return Ok(()) };
            let cues = cues(mask, &found);
            let mut group = Group { inputs: Vec::new(), truth: Vec::new() };
            for p in (0..PIXELS).map(|_| rng.below(mask.len())) {
                let frame = Frame::of(found.normals[p]);
                group.inputs.push(cues[p]);
                group.truth.push(Truth {
                    found: frame.turn(found.normals[p]),
                    reach: reach(found.degrees[p]),
                    normal: frame.turn(scene.truth()[p]),
                });
            }
            out.push(group);
            Ok(())
        })?;
        Ok(out)
    };
    let of_objects = in_parallel(objects, of_object);
    Ok(of_objects.into_iter().collect::<Result<Vec<_>, PixelsError>>()?.concat())
}

/// Fits the network to the chord |n̂ − n|, and its last output to the error that stays, as [`expectation::fit`].
#[must_use]
pub fn network(groups: &[Group<CUES, Truth>], seed: u64) -> Network {
    let recipe = Recipe { seed, passes: 24, groups: 3, rate: 2e-3, beginning: 1.2, rectified: true };
    fit_outputs(groups, &recipe, loss)
}

/// The normal that outputs make, and its length before it was made one.
fn moved([x, y, z, _]: [f32; OUTPUTS], truth: &Truth) -> (Vec3, f32) {
    let moved = truth.found + truth.reach * Vec3::new(x, y, z);
    let length = moved.length().max(1e-6);
    (moved / length, length)
}

fn loss(outputs: &[[f32; OUTPUTS]], truth: &[Truth]) -> Vec<[f32; OUTPUTS]> {
    let moved: Vec<(Vec3, f32)> = outputs.iter().zip(truth).map(|(&o, t)| moved(o, t)).collect();
    let error = |((n, _), t): (&(Vec3, f32), &Truth)| unit_angle(*n, t.normal).to_degrees().max(LEAST);
    let errors: Vec<f32> = moved.iter().zip(truth).map(error).collect();
    let logs: Vec<f32> = outputs.iter().map(|o| o[OUTPUTS - 1]).collect();
    let of_logs = expectation::loss(&logs, &errors);
    let one = |(((n, length), t), d_log): ((&(Vec3, f32), &Truth), f32)| {
        let off = *n - t.normal;
        let along = off / off.length().max(SHORT);
        let d = (along - *n * n.dot(along)) * (t.reach / length);
        [d.x, d.y, d.z, EXPECTED * d_log]
    };
    moved.iter().zip(truth).zip(of_logs).map(one).collect()
}

/// What a correction does to an object under one light set; degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Check {
    before: f64,
    after: f64,
    expected: f64,
    rank: f64,
}

/// Looks at objects that nothing was fitted to, `objects` sculptures of validation and every one of `meshes`; a line of text for each of the light sets.
///
/// # Errors
/// [`PixelsError`] of the first object that has one.
pub fn check(
    network: &Network,
    objects: usize,
    meshes: &[(String, Mesh)],
    learned: &dyn Learned,
) -> Result<Vec<String>, PixelsError> {
    let generator = Generator::new(Split::Validation);
    let of_object = |number: usize| {
        let mut out = Vec::new();
        let object = |rng: &mut Rng, _| match meshes.get(number.wrapping_sub(objects)) {
            Some((name, mesh)) => {
                worlds::Object::dressed(name, Shape::Mesh(mesh.clone()), Split::Validation, rng)
            }
            None => worlds::validation(1, number),
        };
        each_set(&generator, number, object, learned, |scene, mask, given, _| {
            let solution = solved(given, mask)?;
            let Some(found) = Found::of(mask, &solution)? else { return Ok(()) };
            let (normals, expected) = corrected(network, mask, &found);
            let errors = |normals: &[Vec3]| -> Vec<f32> {
                normals.iter().zip(scene.truth()).map(|(&n, &t)| unit_angle(n, t).to_degrees()).collect()
            };
            let mean = |v: &[f32]| mean(&v.iter().map(|&d| f64::from(d)).collect::<Vec<_>>());
            let after = errors(&normals);
            out.push(Check {
                before: mean(&errors(found.normals)),
                after: mean(&after),
                expected: mean(&expected),
                rank: rank_correlation(&expected, &after),
            });
            Ok(())
        })?;
        Ok(out)
    };
    let of_objects = in_parallel(objects + meshes.len(), of_object);
    let of_objects = of_objects.into_iter().collect::<Result<Vec<_>, PixelsError>>()?;
    let (sculptures, meshes) = of_objects.split_at(objects);
    let mut lines = Vec::new();
    for (what, objects) in [("sculptures", sculptures), ("meshes", meshes)] {
        for (set, lights) in
            ["random", "ring + vertical", "a planner's", "COIL-PS", "some"].iter().enumerate()
        {
            let checks: Vec<&Check> = objects.iter().filter_map(|o| o.get(set)).collect();
            if checks.is_empty() {
                continue;
            }
            let all = |f: fn(&Check) -> f64| checks.iter().map(|c| f(c)).collect::<Vec<f64>>();
            let near = |c: &Check| f64::from(u8::from((c.expected - c.after).abs() <= 2.0));
            lines.push(format!(
                "{:3} {what:10} {lights:15} {:5.2} {:5.2} {:5.2} {:3.0} % {:.2}",
                checks.len(),
                mean(&all(|c| c.before)),
                mean(&all(|c| c.after)),
                mean(&all(|c| c.expected)),
                100.0 * mean(&checks.iter().map(|c| near(c)).collect::<Vec<_>>()),
                median(&all(|c| c.rank)),
            ));
        }
    }
    Ok(lines)
}

#[cfg(test)]
mod tests {
    use super::super::expectation::tests::Ring;
    use super::super::perceptron::assert_gradient_of;
    use super::*;

    fn error(network: &Network, groups: &[Group<CUES, Truth>]) -> f32 {
        let rows = groups.iter().flat_map(|g| g.inputs.iter().zip(&g.truth));
        let errors: Vec<f32> =
            rows.map(|(cues, t)| unit_angle(moved(network.outputs(cues), t).0, t.normal)).collect();
        errors.iter().sum::<f32>() / errors.len() as f32
    }

    #[test]
    fn normals_are_corrected_on_what_it_was_fitted_to() {
        let groups = samples(2, &[], &Ring).unwrap();
        assert_eq!(groups.len(), 2 * 5);
        assert!(groups.iter().all(|g| g.inputs.len() == PIXELS && g.truth.len() == PIXELS));
        let groups: Vec<_> = std::iter::repeat_n(groups, 8).flatten().collect();
        let network = network(&groups, 1);
        assert!(network.is_whole());
        let nothing = Network { weights: vec![0.0; Network::WEIGHTS], ..network.clone() };
        let (before, after) = (error(&nothing, &groups), error(&network, &groups));
        assert!(after < 0.8 * before, "{before} {after}");
    }

    #[test]
    fn gradient_is_that_of_the_loss() {
        let mut rng = Rng::new(2);
        let mut unit = || Vec3::new(rng.normal(), rng.normal(), 2.0 + rng.normal()).normalize();
        let truth: Vec<Truth> =
            (0..5).map(|i| Truth { found: unit(), reach: 0.1 * i as f32, normal: unit() }).collect();
        let inputs = (0..5).map(|_| std::array::from_fn(|_| rng.normal())).collect();
        let group = Group { inputs, truth };
        // Errors are given to the expectation, not led back through it.
        let value = |outputs: &[[f64; OUTPUTS]], truth: &[Truth]| -> f64 {
            outputs
                .iter()
                .zip(truth)
                .map(|(o, t)| f64::from((moved(o.map(|v| v as f32), t).0 - t.normal).length()))
                .sum()
        };
        let chord = |outputs: &[[f32; OUTPUTS]], truth: &[Truth]| -> Vec<[f32; OUTPUTS]> {
            loss(outputs, truth).into_iter().map(|[x, y, z, _]| [x, y, z, 0.0]).collect()
        };
        assert_gradient_of::<CUES, OUTPUTS, 64, Truth>(&group, value, chord);
    }
}
