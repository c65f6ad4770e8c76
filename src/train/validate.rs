//! How well a policy in training does on objects it was not trained on, and what fixed light sets and a greedy oracle
//! do on the same objects.

use super::compute::Compute;
use super::fit::in_parallel;
use super::formation::{Lookup, Scene};
use super::loss::Measure;
use super::rollout::{Conditions, Episode, capture};
use super::tape::Network;
use super::weights::Weights;
use crate::error::mae;
use crate::light;
use crate::rng::Rng;
use crate::solve::least_squares::NormalEquations;
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Numbers of pictures at which errors are reported.
pub const STAGES: [usize; 3] = [3, 5, 10];
/// Objects captured together.
const TOGETHER: usize = 8;

/// Mean angular error over objects, degrees, after 3, 5 and 10 pictures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Errors(pub [f64; 3]);

impl Errors {
    fn mean(each: &[[f64; 3]]) -> Self {
        Self(std::array::from_fn(|s| each.iter().map(|e| e[s]).sum::<f64>() / each.len().max(1) as f64))
    }

    /// After the last stage.
    #[must_use]
    pub fn last(&self) -> f64 {
        self.0[2]
    }
}

/// What a policy does on objects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Validation {
    /// Mean errors.
    pub degrees: Errors,
    /// How much directions differ from object to object, degrees (mean over steps): 0 for a fixed light set.
    pub spread: f64,
    /// Mean slant of each step's directions, degrees.
    pub slants: Vec<f32>,
}

/// How a policy does on `scenes` with lights within `reach` (radians), pictures at exactly the direction asked for. One that is
/// told how many pictures there will be makes a run of its own for each number.
#[must_use]
pub fn policy(
    weights: &Weights,
    scenes: &[Box<dyn Scene>],
    reach: f32,
    blank: bool,
    on: &Compute,
) -> Validation {
    let mut found = run(weights, scenes, reach, STAGES[2], blank, on);
    if weights.config.horizon > 0 {
        for (s, &lights) in STAGES[..2].iter().enumerate() {
            found.degrees.0[s] = run(weights, scenes, reach, lights, blank, on).degrees.0[s];
        }
    }
    found
}

fn run(
    weights: &Weights,
    scenes: &[Box<dyn Scene>],
    reach: f32,
    lights: usize,
    blank: bool,
    on: &Compute,
) -> Validation {
    let how = Conditions {
        lights,
        feedback: 0.0,
        steepest: 0.0,
        measure: Measure::Angle,
        first_loss: STAGES[0],
        blank,
    };
    let groups: Vec<&[Box<dyn Scene>]> = scenes.chunks(TOGETHER).collect();
    let runs = in_parallel(groups.len(), on.threads, |g| {
        let net = Network::new(weights, &on.device);
        let episodes: Vec<Episode> =
            groups[g].iter().map(|s| Episode { scene: &**s, lookup: Lookup::Exact, reach }).collect();
        capture(&net, &episodes, how, &on.device)
    });
    let runs: Vec<_> = runs.into_iter().flatten().collect();
    let each: Vec<[f64; 3]> =
        runs.iter().zip(scenes).map(|(r, s)| errors(&r.lights, &r.grey, s.truth())).collect();
    let asked: Vec<&[Vec3]> = runs.iter().map(|r| r.asked.as_slice()).collect();
    let slants = (0..how.lights)
        .map(|t| {
            asked.iter().map(|a| light::slant(a[t]).to_degrees()).sum::<f32>() / asked.len().max(1) as f32
        })
        .map(|v| (10.0 * v).round() / 10.0)
        .collect();
    Validation { degrees: Errors::mean(&each), spread: spread(&asked), slants }
}

/// Mean errors of one light set on `scenes`.
#[must_use]
pub fn fixed(lights: &[Vec3], scenes: &[Box<dyn Scene>], threads: usize) -> Errors {
    Errors::mean(&in_parallel(scenes.len(), threads, |i| {
        let grey: Vec<Vec<f32>> = lights.iter().map(|&l| grey(&*scenes[i], l)).collect();
        errors(lights, &grey, scenes[i].truth())
    }))
}

/// Mean errors of random directions within `reach` (radians), `draws` sets an object.
#[must_use]
pub fn random(scenes: &[Box<dyn Scene>], reach: f32, draws: usize, seed: u64, threads: usize) -> Errors {
    Errors::mean(&in_parallel(scenes.len() * draws, threads, |i| {
        let mut rng = Rng::stream(seed, i as u64);
        let scene = &*scenes[i / draws];
        let lights: Vec<Vec3> = (0..STAGES[2]).map(|_| rng.direction(reach)).collect();
        let grey: Vec<Vec<f32>> = lights.iter().map(|&l| grey(scene, l)).collect();
        errors(&lights, &grey, scene.truth())
    }))
}

/// Mean errors of the greedy oracle, which sees the true normals and each time takes the best of `candidates`.
#[must_use]
pub fn oracle(scenes: &[Box<dyn Scene>], candidates: &[Vec3], threads: usize) -> Errors {
    Errors::mean(&in_parallel(scenes.len(), threads, |i| {
        let scene = &*scenes[i];
        let images: Vec<Vec<f32>> = candidates.iter().map(|&l| grey(scene, l)).collect();
        let mut equations = NormalEquations::new(scene.mask().len());
        let (mut lights, mut taken) = (vec![Vec3::Z], vec![grey(scene, Vec3::Z)]);
        equations.add(Vec3::Z, &taken[0]);
        while lights.len() < STAGES[2] {
            let cost = |k: usize| {
                let mut sum = 0.0;
                equations.preview(candidates[k], &images[k], |p, n| {
                    sum += crate::error::unit_angle(n, scene.truth()[p]);
                });
                sum
            };
            let best = (0..candidates.len())
                .filter(|&k| !lights.contains(&candidates[k]))
                .map(|k| (k, cost(k)))
                .min_by(|a, b| a.1.total_cmp(&b.1));
            let Some((best, _)) = best else { break };
            equations.add(candidates[best], &images[best]);
            lights.push(candidates[best]);
            taken.push(images[best].clone());
        }
        errors(&lights, &taken, scene.truth())
    }))
}

/// Ring plus vertical (DC05) for `count` lights.
#[must_use]
pub fn ring_and_vertical(count: usize) -> Vec<Vec3> {
    let n = count as f32;
    let z = ((n - 3.0) / (3.0 * (n - 1.0))).max(0.0).sqrt();
    let mut lights = vec![Vec3::Z];
    lights.extend(light::ring(count - 1, libm::acosf(z), 0.0));
    lights
}

fn grey(scene: &dyn Scene, l: Vec3) -> Vec<f32> {
    scene.image(l).iter().map(|c| (c[0] + c[1] + c[2]) / 3.0).collect()
}

/// Errors of the first 3, 5, 10 pictures; 90° where they can't be solved.
fn errors(lights: &[Vec3], grey: &[Vec<f32>], truth: &[Vec3]) -> [f64; 3] {
    let mut equations = NormalEquations::new(truth.len());
    let mut out = [90.0; 3];
    for (t, (&l, image)) in lights.iter().zip(grey).enumerate() {
        equations.add(l, image);
        if let Some(s) = STAGES.iter().position(|&s| s == t + 1) {
            out[s] = equations.solve().map_or(90.0, |solution| mae(&solution.normals, truth));
        }
    }
    out
}

/// Mean over steps of the angle between an object's direction and the mean direction of that step, degrees.
fn spread(asked: &[&[Vec3]]) -> f64 {
    let steps = asked.first().map_or(0, |a| a.len());
    let mut sum = 0.0;
    for t in 1..steps {
        let mean = asked.iter().map(|a| a[t]).sum::<Vec3>().normalize_or(Vec3::Z);
        let squares: f64 =
            asked.iter().map(|a| f64::from(light::angle(a[t], mean).to_degrees()).powi(2)).sum();
        sum += (squares / asked.len() as f64).sqrt();
    }
    sum / (steps.max(2) - 1) as f64
}

#[cfg(test)]
mod tests {
    use super::super::formation::tests::Bump;
    use super::*;
    use std::f32::consts::FRAC_PI_2;

    #[test]
    fn the_oracle_is_never_behind_and_lambert_is_exact() {
        let matte: Vec<Box<dyn Scene>> = vec![Box::new(Bump::new(16, 0.0))];
        let near = light::ring(10, 0.2, 0.0);
        // Attached shadows at the rim are all that is left.
        assert!(fixed(&near, &matte, 1).last() < 2.0);
        let glossy: Vec<Box<dyn Scene>> = (14..18).map(|s| Box::new(Bump::new(s, 4.0)) as _).collect();
        let oracle = oracle(&glossy, &light::fibonacci_hemisphere(60), 2).last();
        assert!(oracle < random(&glossy, FRAC_PI_2, 4, 1, 2).last());
        assert!(oracle < fixed(&ring_and_vertical(10), &glossy, 2).last());
    }

    #[test]
    fn a_blind_policy_has_no_spread() {
        let scenes: Vec<Box<dyn Scene>> = (14..18).map(|s| Box::new(Bump::new(s, 4.0)) as _).collect();
        let weights = Weights::new(&crate::policy::Config::compact(), 1);
        assert!(policy(&weights, &scenes, FRAC_PI_2, true, &Compute::cpu(1)).spread < 0.05);
        assert!(policy(&weights, &scenes, FRAC_PI_2, false, &Compute::cpu(1)).spread > 0.05);
    }
}
