//! Fits the weights that say what error to expect of a solver's normals ([`crate::solve::expectation`]).

use super::fit::{in_parallel, light_count};
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
use crate::solve::expectation::{CUES, Judge, Layers, PARTS, Row, WEIGHTS, WIDTH, cues};
use crate::solve::tiles::Piece;
use crate::solve::{self, Measurements, SolveError, Solver, near, pixel};
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_PI_2;

/// A solved pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// What is seen of it.
    pub cues: [f32; CUES],
    /// Its angular error, degrees.
    pub degrees: f32,
}

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
const LEARNED: &str = "coil";
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
    let validation = rng.uniform() < VALIDATION_SHARE;
    let object = if validation {
        worlds::validation(1, FIRST_VALIDATION + number)
    } else {
        worlds::training(1, number)
    };
    let scene = seen(&object, size)?;
    let camera = SceneCamera::real(&scene, Tolerances::any(&mut rng, COLLIMATED, NEAREST), number as u64);
    let truth = scene.truth();
    let mut sets: Vec<_> = (0..RANDOM).map(|_| random(&mut rng, 10)).collect();
    let reach = rng.range(SHORTEST_REACH, FRAC_PI_2);
    let name = match PLANNED[rng.below(PLANNED.len())] {
        "ring" => format!("ring:{}", 10 + rng.below(50)),
        name => name.to_owned(),
    };
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

/// The lights that a planner asks for, of slants up to `reach` (radians).
fn planned(
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
fn random(rng: &mut Rng, count: usize) -> Vec<Vec3> {
    loop {
        let set: Vec<Vec3> = (0..count).map(|_| rng.direction(FRAC_PI_2)).collect();
        if crate::solve::least_squares::pseudo_inverse(&set).is_ok() {
            return set;
        }
    }
}

/// What `solver` makes of them, one list for each light set; black pixels are left out.
///
/// # Errors
/// [`SolveError`] of the solver.
pub fn samples(solver: &dyn Solver, pixels: &[Pixels]) -> Result<Vec<Vec<Sample>>, SolveError> {
    let one = |group: &Pixels| {
        let measurements = group.measurements();
        let solution = solver.solve(&measurements)?;
        let mut out = Vec::with_capacity(group.normals.len());
        for ((cues, &n), &t) in cues(&measurements, &solution)?.zip(&solution.normals).zip(&group.normals) {
            out.extend(cues.map(|cues| Sample { cues, degrees: unit_angle(n, t).to_degrees() }));
        }
        Ok(out)
    };
    pixels.iter().map(one).collect()
}

/// Passes over all samples.
const PASSES: usize = 32;
/// Light sets a step.
const GROUPS: usize = 6;
/// Largest learning rate of Adam; it falls to 0 along a cosine.
const RATE: f32 = 4e-3;

/// Fits the weights by Adam to error/e + ln e, of each pixel and of the mean over each group's pixels alike.
#[must_use]
pub fn fit(groups: &[Vec<Sample>], seed: u64) -> Judge {
    let mut rng = Rng::new(seed);
    let mut judge = beginning(&groups.concat(), &mut rng);
    let steps = (PASSES * groups.len() / GROUPS).max(1);
    let (mut mean, mut square) = (vec![0.0f32; WEIGHTS], vec![0.0f32; WEIGHTS]);
    for step in 0..steps {
        let mut gradient = vec![0.0f32; WEIGHTS];
        let mut pixels = 0.0f32;
        for _ in 0..GROUPS {
            let group = &groups[rng.below(groups.len())];
            add_gradient(&judge, group, &mut gradient);
            pixels += group.len() as f32;
        }
        let progress = step as f32 / steps as f32;
        let rate = RATE
            * 0.5
            * (1.0 + libm::cosf(std::f32::consts::PI * progress))
            * ((step + 1) as f32 / 100.0).min(1.0);
        let t = (step + 1).min(10_000) as i32;
        let (c1, c2) = (1.0 - 0.9f32.powi(t), 1.0 - 0.99f32.powi(t));
        for (((w, g), m), s) in judge.weights.iter_mut().zip(gradient).zip(&mut mean).zip(&mut square) {
            let g = g / pixels.max(1.0);
            *m = 0.9 * *m + 0.1 * g;
            *s = 0.99 * *s + 0.01 * g * g;
            *w -= rate * (*m / c1) / ((*s / c2).sqrt() + 1e-8);
        }
    }
    // Three decimals are enough, and keep the file small.
    judge.weights.iter_mut().for_each(|w| *w = (*w * 1e3).round() / 1e3);
    judge
}

/// Cues in units of their spread; matrices uniform with the variance 1/inputs; the mean error expected of every pixel.
fn beginning(samples: &[Sample], rng: &mut Rng) -> Judge {
    let count = samples.len().max(1) as f64;
    let mean_of = |f: &dyn Fn(&Sample) -> f64| samples.iter().map(f).sum::<f64>() / count;
    let mean: Vec<f64> = (0..CUES).map(|c| mean_of(&|s| f64::from(s.cues[c]))).collect();
    let deviation = |c: usize| mean_of(&|s| (f64::from(s.cues[c]) - mean[c]).powi(2)).sqrt();
    let deviation =
        (0..CUES).map(deviation).map(|d| if d > 1e-3 { (d * 1e4).round() as f32 / 1e4 } else { 1.0 });
    let deviation = deviation.collect();
    let [bias, second, second_bias, last] = PARTS;
    let mut weights = vec![0.0; WEIGHTS];
    for (part, inputs) in [(0..bias, CUES), (second..second_bias, WIDTH)] {
        let bound = (3.0 / inputs as f32).sqrt();
        weights[part].iter_mut().for_each(|w| *w = rng.range(-bound, bound));
    }
    weights[last + WIDTH] = libm::log(mean_of(&|s| f64::from(s.degrees)).max(f64::from(LEAST))) as f32;
    let round = |v: f64| ((v * 1e4).round() / 1e4) as f32;
    Judge { mean: mean.into_iter().map(round).collect(), deviation, weights }
}

/// Adds the gradient of the losses of a group's pixels and of their mean.
fn add_gradient(judge: &Judge, group: &[Sample], gradient: &mut [f32]) {
    let layers: Vec<Layers> = group.iter().map(|s| judge.layers(&s.cues)).collect();
    let expected: Vec<f32> = layers.iter().map(|l| libm::expf(l.log.clamp(-6.0, 6.0))).collect();
    let sum = |values: &mut dyn Iterator<Item = f32>| values.sum::<f32>().max(LEAST);
    let all_expected = sum(&mut expected.iter().copied());
    let of_mean = 1.0 - sum(&mut group.iter().map(|s| s.degrees)) / all_expected;
    for ((sample, layers), e) in group.iter().zip(&layers).zip(&expected) {
        let of_pixel = (1.0 - sample.degrees.max(LEAST) / e).max(-10.0);
        let share = e / all_expected * group.len() as f32;
        add_pixel(judge, layers, of_pixel + of_mean.max(-10.0) * share, gradient);
    }
}

/// Goes back from the gradient of the expected error's logarithm to the weights.
fn add_pixel(judge: &Judge, layers: &Layers, d_log: f32, gradient: &mut [f32]) {
    let [bias, second, second_bias, last] = PARTS;
    let w = judge.weights.as_slice();
    let mut d_second: Row = [0.0; WIDTH];
    for i in 0..WIDTH {
        gradient[last + i] += d_log * layers.second[i];
        d_second[i] = d_log * w[last + i] * slope(layers.second[i]);
        gradient[second_bias + i] += d_second[i];
    }
    gradient[last + WIDTH] += d_log;
    for j in 0..WIDTH {
        let mut d = 0.0;
        for i in 0..WIDTH {
            let at = second + j * WIDTH + i;
            gradient[at] += d_second[i] * layers.first[j];
            d += d_second[i] * w[at];
        }
        let d = d * slope(layers.first[j]);
        gradient[bias + j] += d;
        for (c, &cue) in layers.cues.iter().enumerate() {
            gradient[c * WIDTH + j] += d * cue;
        }
    }
}

/// Derivative of y = x/(1 + |x|) by its value: (1 − |y|)².
fn slope(y: f32) -> f32 {
    (1.0 - y.abs()) * (1.0 - y.abs())
}

/// Validation objects that nothing is fitted to, seen by [`Tolerances::RIG`] with ten lights: random, ring and vertical,
/// those of the learned planner.
///
/// # Errors
/// [`PixelsError`] of the first object that has one.
pub fn checks(
    objects: usize,
    size: u32,
    learned: &dyn Learned,
) -> Result<Vec<(&'static str, Groups)>, PixelsError> {
    let all = in_parallel(objects, |number| {
        let object = worlds::validation(1, number);
        let scene = seen(&object, size)?;
        let camera = SceneCamera::real(&scene, Tolerances::RIG, 1);
        let (truth, places) = (scene.truth(), near::places(camera.mask()));
        let every: Vec<u32> = (0..truth.len() as u32).collect();
        CHECKED
            .iter()
            .map(|&(_, name)| {
                let lights = planned(&camera, name, 10, FRAC_PI_2, number as u64, learned)?;
                let images = pictures(&camera, &lights)?;
                let mut one = Groups::default();
                one.add(lights, &images, &Seen { truth, places: &places }, &every)?;
                Ok(one)
            })
            .collect::<Result<Vec<_>, PixelsError>>()
    });
    let mut sets = CHECKED.map(|(title, _)| (title, Groups::default()));
    for object in all {
        for ((_, set), pixels) in sets.iter_mut().zip(object?) {
            set.append(pixels);
        }
    }
    Ok(sets.into())
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

/// Compares what `judge` expects of `solver` with what it does.
///
/// # Errors
/// [`SolveError`] of the solver.
pub fn check(solver: &dyn Solver, judge: &Judge, objects: &[Pixels]) -> Result<Check, SolveError> {
    let mut check = Check { mean: 0.0, expected: 0.0, within: 0.0, rank: 0.0 };
    let mut ranks = Vec::new();
    for object in objects {
        let samples = samples(solver, std::slice::from_ref(object))?.concat();
        let errors: Vec<f32> = samples.iter().map(|s| s.degrees).collect();
        let expected: Vec<f32> = samples.iter().map(|s| judge.degrees(&s.cues)).collect();
        let mean =
            |values: &[f32]| values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len().max(1) as f64;
        let (error, guess) = (mean(&errors), mean(&expected));
        check.mean += error / objects.len() as f64;
        check.expected += guess / objects.len() as f64;
        check.within += f64::from(u8::from((error - guess).abs() <= 2.0)) / objects.len() as f64;
        ranks.push(rank_correlation(&expected, &errors));
    }
    check.rank = median(&ranks);
    Ok(check)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples whose mean error is a function of two cues.
    fn made_up(groups: usize) -> Vec<Vec<Sample>> {
        let mut rng = Rng::new(3);
        let mut one = || {
            let mut cues = [0.0; CUES];
            cues.iter_mut().for_each(|c| *c = rng.normal());
            let mean = libm::expf(1.0 + 0.6 * cues[2] + 0.4 * cues[7].abs());
            Sample { cues, degrees: mean * rng.range(0.2, 1.8) }
        };
        (0..groups).map(|_| (0..PIXELS).map(|_| one()).collect()).collect()
    }

    /// Stands for the learned planner.
    struct Ring;

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
        let judge = fit(&made_up(120), 1);
        let unseen = made_up(140).split_off(120).concat();
        let off: f32 = unseen
            .iter()
            .map(|s| {
                let mean = libm::expf(1.0 + 0.6 * s.cues[2] + 0.4 * s.cues[7].abs());
                libm::logf(judge.degrees(&s.cues) / mean).abs()
            })
            .sum();
        // Few and noisy samples; the mean error of all, expected everywhere, would be off by 0.5.
        assert!(off / (unseen.len() as f32) < 0.25, "{}", off / unseen.len() as f32);
    }

    #[test]
    fn gradient_is_that_of_the_loss() {
        let group = &made_up(1)[0][..5];
        let mut rng = Rng::new(4);
        let mut judge = beginning(group, &mut rng);
        judge.weights.iter_mut().for_each(|w| *w += 0.3 * rng.normal());
        let loss = |judge: &Judge| {
            let expected: Vec<f64> =
                group.iter().map(|s| f64::from(judge.layers(&s.cues).log).exp()).collect();
            let of = |error: f64, e: f64| error / e + e.ln();
            let pixels: f64 = group.iter().zip(&expected).map(|(s, &e)| of(f64::from(s.degrees), e)).sum();
            let errors: f64 = group.iter().map(|s| f64::from(s.degrees)).sum();
            pixels + group.len() as f64 * of(errors, expected.iter().sum())
        };
        let mut gradient = vec![0.0; WEIGHTS];
        add_gradient(&judge, group, &mut gradient);
        for at in (0..WEIGHTS).step_by(37).chain([WEIGHTS - 1]) {
            let step = 1e-2f32;
            let [more, less] = [step, -step].map(|d| {
                let mut moved = judge.clone();
                moved.weights[at] += d;
                loss(&moved)
            });
            let slope = ((more - less) / f64::from(2.0 * step)) as f32;
            assert!(
                (gradient[at] - slope).abs() < 2e-2 * (1.0 + slope.abs()),
                "{at}: {} {slope}",
                gradient[at]
            );
        }
    }
}
