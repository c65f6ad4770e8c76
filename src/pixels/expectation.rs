//! Fits the weights that say what error to expect of a solver's normals ([`crate::solve::expectation`]).

use super::fit::{in_parallel, light_count};
use super::perceptron::{self, Group, Recipe};
use super::tune::rank_correlation;
use super::{Generator, Pixels, PixelsError, pictures, seen};
use crate::camera::{Camera, Domain};
use crate::error::unit_angle;
use crate::eval::statistics::median;
use crate::planner::{self, Learned, Setup};
use crate::render::worlds::{self, Split};
use crate::render::{SceneCamera, Tolerances};
use crate::rng::Rng;
use crate::session::{Session, SessionError, Step};
use crate::solve::expectation::{CUES, Judge, cues, expected_by};
use crate::solve::perceptron::Perceptron;
use crate::solve::tiles::Piece;
use crate::solve::{self, Measurements, Solution, SolveError, Solver, near, neighbourhood, pixel};
use crate::stack::Mask;
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_PI_2;

/// Pixels taken of each object under each light set.
const PIXELS: usize = 48;
/// Share of the rendered objects that are of validation materials: solvers that were trained or tuned on the training
/// materials do better there than on others.
const VALIDATION_SHARE: f32 = 0.4;
/// The first validation objects are left to be looked at.
const FIRST_VALIDATION: usize = 1000;
/// Share of the rigs whose light is collimated, and half width of the object in units of the nearest light's distance.
const COLLIMATED: f32 = 0.8;
const NEAREST: f32 = 0.08;
/// Smallest error, degrees: rounding is nothing to learn from.
const LEAST: f32 = 0.02;

/// Sets of random lights under which each object is seen.
const RANDOM: usize = 3;
/// Planners whose lights the pictures of an object are taken under beside random ones: an adaptive planner leaves errors that no fixed set
/// leaves. [`LEARNED`] twice, over the whole hemisphere and within a limited reach.
const PLANNED: [&str; 4] = ["dc05", "tk22", "lipids", "ring"];
/// The learned planner.
pub(super) const LEARNED: &str = "coil";
/// Smallest reach of the lights of an object, radians (25°).
const SHORTEST_REACH: f32 = 25.0 / 180.0 * std::f32::consts::PI;

/// The same pixels as the lamps give them, and as [`near`] makes them: solvers take the one or the other.
#[derive(Clone, Debug, Default)]
pub struct Groups {
    given: Vec<Pixels>,
    distant: Vec<Pixels>,
}

impl Groups {
    /// As the solver of this name takes them.
    #[must_use]
    pub fn of(&self, solver: &str) -> &[Pixels] {
        if solve::wants_distant_lamps(solver) { &self.distant } else { &self.given }
    }

    fn append(&mut self, mut other: Self) {
        self.given.append(&mut other.given);
        self.distant.append(&mut other.distant);
    }

    /// Adds the pixels `some` of an object's pictures.
    fn add(
        &mut self,
        lights: Vec<Vec3>,
        images: &[Vec<f32>],
        object: &Seen,
        some: &[u32],
    ) -> Result<(), SolveError> {
        let images = images.iter().map(Vec::as_slice).collect();
        let whole = Measurements { lights, images, saturated: Vec::new() };
        let ready = solve::prepare(pixel::NAME, whole.clone(), object.places)?;
        for (list, m) in [(&mut self.given, whole), (&mut self.distant, ready.measurements())] {
            list.push(Pixels {
                images: Piece::of(&m, some).images,
                lights: m.lights,
                normals: some.iter().map(|&p| object.truth[p as usize]).collect(),
                saturated: Vec::new(),
            });
        }
        Ok(())
    }
}

/// What is known of a rendered object's pixels.
struct Seen<'a> {
    truth: &'a [Vec3],
    places: &'a [Vec2],
}

/// Rendered pixels of `objects` worlds of training and validation under random lights, those of planners, and the generator's sets, seen
/// by rigs good and bad; and a third as many light sets of synthetic pixels.
///
/// # Errors
/// [`PixelsError`] of the first object that has one.
pub fn pixels(objects: usize, size: u32, learned: &dyn Learned) -> Result<Groups, PixelsError> {
    let generator = Generator::new(Split::Train);
    let mut all = Groups::default();
    for group in in_parallel(objects, |number| rendered(&generator, number, size, learned)) {
        all.append(group?);
    }
    let corrected = generator.clone().with_distant_lamps();
    for set in 0..3 * objects {
        for (list, generator) in [(&mut all.given, &generator), (&mut all.distant, &corrected)] {
            let mut rng = Rng::stream(0x657870, set as u64);
            let count = light_count(&mut rng);
            let lights = generator.lights(&mut rng, count);
            list.push(generator.pixels(&mut rng, lights, PIXELS));
        }
    }
    Ok(all)
}

fn rendered(
    generator: &Generator,
    number: usize,
    size: u32,
    learned: &dyn Learned,
) -> Result<Groups, PixelsError> {
    let mut rng = Rng::stream(0x6a7564, number as u64);
    let scene = seen(&object(&mut rng, number), size)?;
    let camera = SceneCamera::real(&scene, rig(&mut rng), number as u64);
    let truth = scene.truth();
    let mut sets: Vec<_> = (0..RANDOM).map(|_| random(&mut rng, 10)).collect();
    let reach = rng.range(SHORTEST_REACH, FRAC_PI_2);
    let name = rival(&mut rng);
    for (name, count, reach) in [
        ("dc05v", 10, FRAC_PI_2),
        (&name, 10, FRAC_PI_2),
        (LEARNED, 10, FRAC_PI_2),
        (LEARNED, 3 + rng.below(8), reach),
    ] {
        sets.push(planned(&camera, name, count, reach, rng.next_u64(), learned)?);
    }
    for count in [10, light_count(&mut rng), light_count(&mut rng)] {
        sets.push(generator.lights(&mut rng, count));
    }
    let places = near::places(camera.mask());
    let mut out = Groups::default();
    for lights in sets {
        let some: Vec<u32> = (0..PIXELS).map(|_| rng.below(truth.len()) as u32).collect();
        let images = pictures(&camera, &lights)?;
        out.add(lights, &images, &Seen { truth, places: &places }, &some)?;
    }
    Ok(out)
}

/// An object of the training or the validation split.
pub(super) fn object(rng: &mut Rng, number: usize) -> worlds::Object {
    if rng.uniform() < VALIDATION_SHARE {
        worlds::validation(1, FIRST_VALIDATION + number)
    } else {
        worlds::training(1, number)
    }
}

/// Some rig, good or bad.
pub(super) fn rig(rng: &mut Rng) -> Tolerances {
    Tolerances::any(rng, COLLIMATED, NEAREST)
}

/// One of [`PLANNED`].
pub(super) fn rival(rng: &mut Rng) -> String {
    match PLANNED[rng.below(PLANNED.len())] {
        "ring" => format!("ring:{}", 10 + rng.below(50)),
        name => name.to_owned(),
    }
}

/// The lights that a planner asks for, of slants up to `reach` (radians).
pub(super) fn planned(
    camera: &dyn Camera,
    name: &str,
    lights: usize,
    reach: f32,
    seed: u64,
    learned: &dyn Learned,
) -> Result<Vec<Vec3>, PixelsError> {
    let setup = Setup { lights, seed, draw: 1, camera: Some(camera), truth: None, learned: Some(learned) };
    let failed = |error: SessionError| PixelsError::Plan { planner: name.into(), error };
    let planner = planner::build(name, &setup).map_err(|e| failed(e.into()))?;
    let mut session = Session::new(camera.mask().clone(), Domain::Hemisphere { reach }, planner, lights);
    while let Step::Capture(direction) = session.step().map_err(failed)? {
        let picture = camera.capture(direction, session.seen())?;
        session.observe(picture).map_err(failed)?;
    }
    Ok(session.seen().iter().map(|o| o.light).collect())
}

/// Lights anywhere on the hemisphere.
pub(super) fn random(rng: &mut Rng, count: usize) -> Vec<Vec3> {
    loop {
        let set: Vec<Vec3> = (0..count).map(|_| rng.direction(FRAC_PI_2)).collect();
        if crate::solve::least_squares::pseudo_inverse(&set).is_ok() {
            return set;
        }
    }
}

/// What `solver` makes of them, one group for each light set: cues and errors in degrees; black pixels are left out.
///
/// # Errors
/// [`SolveError`] of the solver.
pub fn samples(solver: &dyn Solver, pixels: &[Pixels]) -> Result<Vec<Group<CUES>>, SolveError> {
    let one = |group: &Pixels| {
        let measurements = group.measurements();
        let solution = solver.solve(&measurements)?;
        let mut out = Group { inputs: Vec::new(), truth: Vec::new() };
        for ((cues, &n), &t) in cues(&measurements, &solution)?.zip(&solution.normals).zip(&group.normals) {
            if let Some(cues) = cues {
                out.inputs.push(cues);
                out.truth.push(unit_angle(n, t).to_degrees());
            }
        }
        Ok(out)
    };
    pixels.iter().map(one).collect()
}

/// Fits the network of pixels by themselves to error/e + ln e, of each pixel and of the mean over each group's pixels alike.
#[must_use]
pub fn fit(groups: &[Group<CUES>], seed: u64) -> Perceptron<CUES> {
    let (mut sum, mut count) = (0.0, 0usize);
    for group in groups {
        sum += group.truth.iter().map(|&d| f64::from(d)).sum::<f64>();
        count += group.truth.len();
    }
    let beginning = libm::log((sum / count.max(1) as f64).max(f64::from(LEAST))) as f32;
    let recipe = Recipe { seed, passes: 32, groups: 6, rate: 4e-3, beginning, rectified: false };
    perceptron::fit(groups, &recipe, loss)
}

/// Derivatives of the losses of a group's pixels and of their mean, by the logarithms of the expected errors.
pub(super) fn loss(logs: &[f32], errors: &[f32]) -> Vec<f32> {
    let expected: Vec<f32> = logs.iter().map(|&l| libm::expf(l.clamp(-6.0, 6.0))).collect();
    let all_expected = expected.iter().sum::<f32>().max(LEAST);
    let of_mean = (1.0 - errors.iter().sum::<f32>().max(LEAST) / all_expected).max(-10.0);
    let one = |(&e, &error): (&f32, &f32)| {
        let of_pixel = (1.0 - error.max(LEAST) / e).max(-10.0);
        of_pixel + of_mean * e / all_expected * errors.len() as f32
    };
    expected.iter().zip(errors).map(one).collect()
}

/// Whole objects under the light sets that are looked at.
pub struct Checks {
    masks: Vec<Mask>,
    sets: Vec<(&'static str, Groups)>,
}

/// Validation objects that nothing is fitted to, seen by [`Tolerances::RIG`] with ten lights: random, ring and vertical,
/// those of the learned planner.
///
/// # Errors
/// [`PixelsError`] of the first object that has one.
pub fn checks(objects: usize, size: u32, learned: &dyn Learned) -> Result<Checks, PixelsError> {
    let all = in_parallel(objects, |number| -> Result<_, PixelsError> {
        let object = worlds::validation(1, number);
        let scene = seen(&object, size)?;
        let camera = SceneCamera::real(&scene, Tolerances::RIG, 1);
        let (truth, places) = (scene.truth(), near::places(camera.mask()));
        let every: Vec<u32> = (0..truth.len() as u32).collect();
        let sets = CHECKED.iter().map(|&(_, name)| {
            let lights = planned(&camera, name, 10, FRAC_PI_2, number as u64, learned)?;
            let images = pictures(&camera, &lights)?;
            let mut one = Groups::default();
            one.add(lights, &images, &Seen { truth, places: &places }, &every)?;
            Ok(one)
        });
        Ok((camera.mask().clone(), sets.collect::<Result<Vec<_>, PixelsError>>()?))
    });
    let mut checks =
        Checks { masks: Vec::new(), sets: CHECKED.map(|(title, _)| (title, Groups::default())).into() };
    for object in all {
        let (mask, pixels) = object?;
        checks.masks.push(mask);
        for ((_, set), pixels) in checks.sets.iter_mut().zip(pixels) {
            set.append(pixels);
        }
    }
    Ok(checks)
}

/// Titles and planners of the light sets that are looked at.
const CHECKED: [(&str, &str); 3] = [("random", "random"), ("ring + vertical", "dc05v"), ("COIL-PS", LEARNED)];

/// How well errors are expected on some objects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Check {
    /// Mean error, degrees.
    pub mean: f64,
    /// Mean expected error, degrees.
    pub expected: f64,
    /// Share of the objects whose mean error is within 2° of the expected one.
    pub within: f64,
    /// Median over the objects of the rank correlation over the pixels.
    pub rank: f64,
}

/// Compares what `judge` expects of `solver` with what it does, for each of the light sets.
///
/// # Errors
/// [`SolveError`] of the solver.
pub fn check(
    solver: &dyn Solver,
    judge: &Judge,
    checks: &Checks,
) -> Result<Vec<(&'static str, Check)>, SolveError> {
    let of_set = |(title, groups): &(&'static str, Groups)| {
        let objects = groups.of(solver.name());
        let mut check = Check { mean: 0.0, expected: 0.0, within: 0.0, rank: 0.0 };
        let mut ranks = Vec::new();
        for (object, mask) in objects.iter().zip(&checks.masks) {
            let measurements = object.measurements();
            let solution = solver.solve(&measurements)?;
            let alone = expected_by(&judge.alone, &measurements, &solution)?;
            let Solution { normals, albedo, .. } = &solution;
            let found = neighbourhood::Found { normals, albedo, degrees: &alone };
            let expected = neighbourhood::shared_out(&judge.among, mask, &found);
            let errors: Vec<f32> =
                normals.iter().zip(&object.normals).map(|(&n, &t)| unit_angle(n, t).to_degrees()).collect();
            let mean = |values: &[f32]| {
                values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len().max(1) as f64
            };
            let (error, guess) = (mean(&errors), mean(&expected));
            check.mean += error / objects.len() as f64;
            check.expected += guess / objects.len() as f64;
            check.within += f64::from(u8::from((error - guess).abs() <= 2.0)) / objects.len() as f64;
            ranks.push(rank_correlation(&expected, &errors));
        }
        check.rank = median(&ranks);
        Ok((*title, check))
    };
    checks.sets.iter().map(of_set).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::solve::expectation::degrees;

    /// Samples whose mean error is a function of two cues.
    fn made_up(groups: usize) -> Vec<Group<CUES>> {
        let mut rng = Rng::new(3);
        let mut one = || {
            let cues: [f32; CUES] = std::array::from_fn(|_| rng.normal());
            (cues, mean_of(&cues) * rng.range(0.2, 1.8))
        };
        let group = |_| {
            let (inputs, truth) = (0..PIXELS).map(|_| one()).unzip();
            Group { inputs, truth }
        };
        (0..groups).map(group).collect()
    }

    fn mean_of(cues: &[f32; CUES]) -> f32 {
        libm::expf(1.0 + 0.6 * cues[2] + 0.4 * cues[7].abs())
    }

    /// Stands for the learned planner.
    pub struct Ring;

    impl Learned for Ring {
        fn planner(&self, name: &str, _: Vec3) -> Option<Box<dyn planner::Planner>> {
            (name == LEARNED)
                .then(|| Box::new(planner::fixed::FixedSet::new(crate::light::ring(10, 0.3, 0.0))) as _)
        }
    }

    #[test]
    fn objects_are_seen_under_the_lights_of_planners_too() {
        let groups = rendered(&Generator::new(Split::Train), 0, 24, &Ring).unwrap();
        for solver in ["ls", "pixel"] {
            let sets = groups.of(solver);
            assert_eq!(sets.len(), RANDOM + 4 + 3);
            let learned = sets.iter().filter(|s| s.lights.iter().all(|l| (l.z - 0.3f32.cos()).abs() < 1e-3));
            assert_eq!(learned.count(), 2);
            assert!(sets.iter().all(|s| s.images.len() == s.lights.len() && s.normals.len() == PIXELS));
        }
        struct Nothing;
        impl Learned for Nothing {
            fn planner(&self, _: &str, _: Vec3) -> Option<Box<dyn planner::Planner>> {
                None
            }
        }
        assert!(pixels(1, 24, &Nothing).unwrap_err().to_string().starts_with("coil: "));
    }

    #[test]
    fn what_depends_on_the_cues_is_found() {
        let network = fit(&made_up(120), 1);
        let unseen: Vec<_> = made_up(140).split_off(120).into_iter().flat_map(|g| g.inputs).collect();
        let off: f32 =
            unseen.iter().map(|cues| libm::logf(degrees(network.output(cues)) / mean_of(cues)).abs()).sum();
        // Few and noisy samples; the mean error of all, expected everywhere, would be off by 0.5.
        assert!(off / (unseen.len() as f32) < 0.25, "{}", off / unseen.len() as f32);
    }

    #[test]
    fn gradient_is_that_of_the_loss() {
        let mut group = made_up(1).remove(0);
        group.inputs.truncate(5);
        group.truth.truncate(5);
        let value = |logs: &[f64], errors: &[f32]| {
            let of = |error: f64, e: f64| error / e + e.ln();
            let pixels: f64 = logs.iter().zip(errors).map(|(l, &d)| of(f64::from(d), l.exp())).sum();
            let all: f64 = errors.iter().map(|&d| f64::from(d)).sum();
            pixels + errors.len() as f64 * of(all, logs.iter().map(|l| l.exp()).sum())
        };
        perceptron::assert_gradient(&group, value, loss);
    }
}
