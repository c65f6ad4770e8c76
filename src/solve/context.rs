//! The learned solver in context: what [`super::pixel`] finds of each pixel, corrected by what is around it.
//!
//! Single pixels make errors that a surface shows: where surfaces meet, light goes from one to the other and flattens the fold; at the outline pixels
//! see the background too; noise turns neighbours different ways. For every pixel the means of normals, expected errors and albedo around
//! it at six widths, how the mean normal bends, and where the outline is ([`CUES`]), all turned so that its own normal has azimuth 0, go through a small
//! network; out come a correction, in units of the error that was expected of the pixel by itself, and the error to expect now. So where little is expected to be wrong, little changes.
//! `models/context.md` is the card of the weights.

use super::neighbourhood::{Found, mean};
use super::perceptron::Perceptron;
use super::smooth::Smoother;
use super::{Measurements, PixelNetwork, Solution, SolveError, Solver, expectation};
use crate::stack::Mask;
use glam::Vec3;
use std::sync::LazyLock;

/// Name of the solver.
pub const NAME: &str = "context";

/// Number of values that describe a pixel among others.
pub const CUES: usize = 4 + SCALES * A_SCALE;
const A_SCALE: usize = 14;
const SCALES: usize = NARROW.len() + WIDE.len();
/// Standard deviations of the means over neighbours: in pixels, for noise; in half widths of the object, for shape, and at least so many pixels.
const NARROW: [f32; 2] = [0.7, 1.5];
const WIDE: [f32; 4] = [0.02, 0.05, 0.12, 0.25];
const NARROWEST: f32 = 0.6;
/// Albedo counts as at least this fraction of its mean.
const DARKEST: f32 = 1e-3;
/// Expected errors between these count, degrees.
const LEAST: f32 = 0.02;
const MOST: f32 = 90.0;
/// The largest expected error that scales a correction, degrees.
const LARGEST: f32 = 40.0;

/// A correction (3) and the logarithm of the expected error in degrees.
pub const OUTPUTS: usize = 4;
/// What makes them of the cues.
pub type Network = Perceptron<CUES, OUTPUTS, 64>;

/// The weights that come with the crate.
static SHIPPED: LazyLock<Network> = LazyLock::new(|| {
    let network: Network =
        serde_json::from_str(include_str!("../../models/context.json")).expect("the committed file is valid");
    assert!(network.is_whole(), "the committed file is whole");
    network
});

/// [`PixelNetwork`] as the first half of this solver; [`correct`] is the second.
#[derive(Clone, Debug)]
pub struct InContext(pub PixelNetwork);

impl Solver for InContext {
    fn name(&self) -> &'static str {
        NAME
    }

    fn solve(&self, measurements: &Measurements) -> Result<Solution, SolveError> {
        self.0.solve(measurements)
    }
}

/// Turns vectors so that a normal has azimuth 0.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    cos: f32,
    sin: f32,
}

impl Frame {
    /// That of this normal.
    #[must_use]
    pub fn of(normal: Vec3) -> Self {
        let across = normal.truncate().length();
        let (cos, sin) = if across > 1e-6 { (normal.x / across, normal.y / across) } else { (1.0, 0.0) };
        Self { cos, sin }
    }

    fn turn_flat(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        [self.cos * x + self.sin * y, self.cos * y - self.sin * x]
    }

    /// Into the frame.
    #[must_use]
    pub fn turn(&self, v: Vec3) -> Vec3 {
        let [x, y] = self.turn_flat([v.x, v.y]);
        Vec3::new(x, y, v.z)
    }

    /// Out of the frame.
    #[must_use]
    pub fn turn_back(&self, v: Vec3) -> Vec3 {
        Self { sin: -self.sin, ..*self }.turn(v)
    }
}

/// The cues of every pixel.
///
/// # Panics
/// Where there is not one normal, albedo and error for each pixel of the mask.
#[must_use]
pub fn cues(mask: &Mask, found: &Found) -> Vec<[f32; CUES]> {
    let (_, _, width, height) = mask.bounds();
    let half = 0.5 * width.max(height) as f32;
    let errors: Vec<f32> = found.degrees.iter().map(|&d| libm::logf(d.clamp(LEAST, MOST))).collect();
    let whole = mean(&errors);
    let bright = mean(found.albedo).max(1e-20);
    let albedo: Vec<f32> = found.albedo.iter().map(|&a| libm::logf((a / bright).max(DARKEST))).collect();
    let part = |axis: usize| -> Vec<f32> { found.normals.iter().map(|n| n[axis]).collect() };
    let parts = [part(0), part(1), part(2)];
    let frames: Vec<Frame> = found.normals.iter().map(|&n| Frame::of(n)).collect();

    let mut rows = vec![[0.0; CUES]; mask.len()];
    for ((row, &n), &error) in rows.iter_mut().zip(found.normals).zip(&errors) {
        row[..4].copy_from_slice(&[error, whole, n.z, n.truncate().length()]);
    }
    let widths = NARROW.into_iter().chain(WIDE.map(|share| (share * half).max(NARROWEST)));
    for (scale, sigma) in widths.enumerate() {
        let smoother = Smoother::new(mask, sigma);
        let around = parts.each_ref().map(|part| smoother.mean(part));
        let bends = [smoother.slopes(&around[0]), smoother.slopes(&around[1])];
        let (error, bright) = (smoother.mean(&errors), smoother.mean(&albedo));
        let growing = smoother.slopes(&error);
        let outwards = smoother.slopes(smoother.cover());
        for (p, row) in rows.iter_mut().enumerate() {
            let frame = frames[p];
            let off = frame.turn(Vec3::new(around[0][p], around[1][p], around[2][p]) - found.normals[p]);
            let [edge_x, edge_y] = frame.turn_flat(outwards[p].map(|v| v * sigma));
            let [more_x, more_y] = frame.turn_flat(growing[p].map(|v| v * sigma));
            // Slopes of the normal's parts, one after the other: both the parts and the directions are turned.
            let [a, b] = [frame.turn_flat(bends[0][p]), frame.turn_flat(bends[1][p])];
            let [[xx, yx], [xy, yy]] = [frame.turn_flat([a[0], b[0]]), frame.turn_flat([a[1], b[1]])];
            let bend = |v: f32| libm::asinhf(half * v);
            row[4 + scale * A_SCALE..][..A_SCALE].copy_from_slice(&[
                off.x,
                off.y,
                off.z,
                error[p] - errors[p],
                bright[p] - albedo[p],
                smoother.cover()[p],
                edge_x,
                edge_y,
                bend(xx),
                bend(xy),
                bend(yx),
                bend(yy),
                more_x,
                more_y,
            ]);
        }
    }
    rows
}

/// How far a correction of 1 goes, radians, for a pixel of which this error was expected by itself.
#[must_use]
pub fn reach(degrees: f32) -> f32 {
    degrees.clamp(0.0, LARGEST).to_radians()
}

/// Normals and expected errors (degrees) of all pixels, corrected by what is around them.
///
/// # Panics
/// As [`cues`].
#[must_use]
pub fn corrected(network: &Network, mask: &Mask, found: &Found) -> (Vec<Vec3>, Vec<f32>) {
    let one = |((cues, &normal), &degrees): ((&[f32; CUES], &Vec3), &f32)| {
        let [x, y, z, log] = network.outputs(cues);
        let frame = Frame::of(normal);
        let moved = (frame.turn(normal) + reach(degrees) * Vec3::new(x, y, z)).normalize_or_zero();
        if moved == Vec3::ZERO || !moved.is_finite() {
            return (normal, degrees);
        }
        (frame.turn_back(moved), expectation::degrees(log))
    };
    cues(mask, found).iter().zip(found.normals).zip(found.degrees).map(one).unzip()
}

/// Corrects a whole object's solution, of which [`super::uncertainty::complete`] has said what to expect of each pixel by itself.
///
/// # Errors
/// [`SolveError::Places`] where the solution isn't one of all pixels of `mask`, [`SolveError::Model`] where it has no expected errors.
pub fn correct(mask: &Mask, solution: &mut Solution) -> Result<(), SolveError> {
    let found = Found::of(mask, solution)?
        .ok_or_else(|| SolveError::Model("without expected errors no normal can be corrected".into()))?;
    let (normals, degrees) = corrected(&SHIPPED, mask, &found);
    (solution.normals, solution.uncertainty) = (normals, Some(degrees));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::fibonacci_cap;
    use crate::rng::Rng;
    use crate::solve::{Validity, uncertainty, whole};

    /// A ball of `side` pixels, and what a solver with errors might have found of it.
    fn noisy_ball(side: u32, noise: f32) -> (Mask, Vec<Vec3>, Vec<Vec3>) {
        let at = |i: u32| (i as f32 + 0.5) / side as f32 * 2.0 - 1.0;
        let inside: Vec<bool> = (0..side * side).map(|i| at(i % side).hypot(at(i / side)) < 0.9).collect();
        let mask = Mask::new(side, side, &inside).unwrap();
        let normal = |p| {
            let (x, y) = mask.position(p);
            let (x, y) = (at(x), -at(y));
            Vec3::new(x, y, (1.0 - x * x - y * y).max(0.0).sqrt()).normalize()
        };
        let truth: Vec<Vec3> = (0..mask.len()).map(normal).collect();
        let mut rng = Rng::new(7);
        let mut off = || noise * Vec3::new(rng.normal(), rng.normal(), rng.normal());
        let found = truth.iter().map(|&n| (n + off()).normalize()).collect();
        (mask, truth, found)
    }

    fn network() -> Network {
        let mut rng = Rng::new(3);
        let mut random = |count: usize, spread: f32| (0..count).map(|_| spread * rng.normal()).collect();
        Network {
            mean: random(CUES, 0.1),
            deviation: vec![1.0; CUES],
            weights: random(Network::WEIGHTS, 0.1),
            rectified: true,
        }
    }

    #[test]
    fn noise_is_taken_out() {
        let (mask, truth, found) = noisy_ball(60, 0.08);
        let (albedo, degrees) = (vec![0.7; mask.len()], vec![6.0; mask.len()]);
        let found = Found { normals: &found, albedo: &albedo, degrees: &degrees };
        let (normals, expected) = corrected(&SHIPPED, &mask, &found);
        let [before, after] = [found.normals, &normals].map(|n| crate::error::mae(n, &truth));
        assert!(after < 0.75 * before, "{before} {after}");
        assert!(expected.iter().all(|&d| d > 0.0 && d <= 90.0));
    }

    #[test]
    fn what_is_exact_hardly_moves() {
        let (mask, truth, _) = noisy_ball(50, 0.0);
        let lights = fibonacci_cap(9, 0.7);
        let shade = |l: &Vec3| truth.iter().map(|n| 0.6 * n.dot(*l)).collect::<Vec<f32>>();
        let images: Vec<Vec<f32>> = lights.iter().map(shade).collect();
        let lit: Vec<bool> = (0..mask.len()).map(|p| images.iter().all(|i| i[p] > 0.0)).collect();
        let inside: Vec<bool> = mask.scatter(&lit, false);
        let bright = Mask::new(mask.width(), mask.height(), &inside).unwrap();
        let pick = |v: &[f32]| -> Vec<f32> {
            v.iter().zip(&lit).filter(|(_, lit)| **lit).map(|(&v, _)| v).collect()
        };
        let images: Vec<Vec<f32>> = images.iter().map(|i| pick(i)).collect();
        let truth: Vec<Vec3> = truth.into_iter().zip(&lit).filter(|(_, lit)| **lit).map(|(n, _)| n).collect();
        let given = Measurements {
            lights,
            images: images.iter().map(Vec::as_slice).collect(),
            saturated: Vec::new(),
        };
        let solved = whole(&InContext(PixelNetwork::shipped()), given, &bright, false).unwrap();
        let error = crate::error::mae(&solved.solution.normals, &truth);
        // Some error is always expected: no real rig is exact.
        assert!(error < 0.8, "{error}");
    }

    #[test]
    fn an_object_that_is_turned_has_its_corrections_turned() {
        let side = 24;
        let (mask, _, found) = noisy_ball(side, 0.1);
        let mut rng = Rng::new(5);
        let degrees: Vec<f32> = (0..mask.len()).map(|_| rng.range(1.0, 20.0)).collect();
        let albedo: Vec<f32> = (0..mask.len()).map(|_| rng.range(0.2, 1.0)).collect();
        // By a quarter: the pixel at (x, y) goes to (y, side − 1 − x), a normal (x, y) to (−y, x).
        let to = |p: usize| {
            let (x, y) = mask.position(p);
            (0..mask.len()).find(|&q| mask.position(q) == (y, side - 1 - x)).unwrap()
        };
        let places: Vec<usize> = (0..mask.len()).map(to).collect();
        let quarter = |n: Vec3| Vec3::new(-n.y, n.x, n.z);
        let turned = |values: &[f32]| {
            let mut out = values.to_vec();
            places.iter().zip(values).for_each(|(&q, &v)| out[q] = v);
            out
        };
        let mut normals = found.clone();
        places.iter().zip(&found).for_each(|(&q, &n)| normals[q] = quarter(n));
        let network = network();
        let one = corrected(&network, &mask, &Found { normals: &found, albedo: &albedo, degrees: &degrees });
        let (albedo, degrees) = (turned(&albedo), turned(&degrees));
        let other =
            corrected(&network, &mask, &Found { normals: &normals, albedo: &albedo, degrees: &degrees });
        for (p, &q) in places.iter().enumerate() {
            assert!((quarter(one.0[p]) - other.0[q]).length() < 1e-4, "{p}");
            assert!((one.1[p] / other.1[q] - 1.0).abs() < 1e-3, "{p}");
        }
    }

    #[test]
    fn nothing_that_is_not_finite_gets_out() {
        let mask = Mask::full(3, 2).unwrap();
        for network in [network(), Network { weights: vec![f32::MAX; Network::WEIGHTS], ..network() }] {
            let mut solution = Solution {
                normals: vec![Vec3::Z; 6],
                albedo: vec![0.0, 1.0, 1e30, 1e-30, 0.5, 0.5],
                validity: vec![Validity::Valid; 6],
                uncertainty: Some(vec![90.0, 0.0, 1e-9, 5.0, 90.0, 20.0]),
                own: Vec::new(),
            };
            let found = Found::of(&mask, &solution).unwrap().unwrap();
            let (normals, degrees) = corrected(&network, &mask, &found);
            assert!(normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-4), "{normals:?}");
            assert!(degrees.iter().all(|d| (0.0..=90.0).contains(d)), "{degrees:?}");
            correct(&mask, &mut solution).unwrap();
            assert!(solution.normals.iter().all(|n| n.is_finite()));
            let other = Mask::full(3, 3).unwrap();
            assert_eq!(correct(&other, &mut solution), Err(SolveError::Places { found: 6, expected: 9 }));
            solution.uncertainty = None;
            assert!(matches!(correct(&mask, &mut solution), Err(SolveError::Model(_))));
        }
    }

    #[test]
    fn a_capture_ends_by_what_the_whole_will_be() {
        let (mask, truth, _) = noisy_ball(90, 0.0);
        let lights = fibonacci_cap(7, 0.8);
        let mut rng = Rng::new(8);
        let mut noisy = |v: f32| (v + 0.03 * rng.normal()).max(0.0);
        let images: Vec<Vec<f32>> =
            lights.iter().map(|l| truth.iter().map(|n| noisy(0.6 * n.dot(*l).max(0.0))).collect()).collect();
        let given = Measurements {
            lights,
            images: images.iter().map(Vec::as_slice).collect(),
            saturated: Vec::new(),
        };
        let solver = InContext(PixelNetwork::shipped());
        let solved = whole(&solver, given.clone(), &mask, true).unwrap().solution;
        let predicted = uncertainty::predicted_mae(&solved).unwrap();
        let enough = |degrees| uncertainty::StopAt::new(degrees).enough(&solver, &given, &mask);
        assert!(enough(predicted * 1.6) && !enough(predicted * 0.6), "{predicted}");
    }
}
