//! How far off a normal probably is: per pixel in degrees ([`super::expectation`]), and for the whole object.

use super::tiles::Piece;
use super::{
    Measurements, Solution, SolveError, Solver, Validity, expectation, finish, near, neighbourhood, of_whole,
    prepare,
};
use crate::stack::Mask;
use glam::Vec2;

/// Adds the expected error of every pixel to what the solver of this name found.
///
/// # Errors
/// [`SolveError`] where the measurements don't fit together, and for an unknown solver.
pub fn complete(
    solver: &str,
    measurements: &Measurements,
    solution: &mut Solution,
) -> Result<(), SolveError> {
    if solution.uncertainty.is_none() {
        solution.uncertainty = Some(expectation::expected(solver, measurements, solution)?);
    }
    Ok(())
}

/// Shares the expected errors of a whole object, of which [`complete`] has looked at each pixel by itself, out anew: with what their neighbours
/// tell ([`neighbourhood`]). The predicted MAE stays.
///
/// # Errors
/// [`SolveError::Places`] where the solution isn't one of all pixels of `mask`, and [`SolveError::Model`] for an unknown solver.
pub fn compare(solver: &str, mask: &Mask, solution: &mut Solution) -> Result<(), SolveError> {
    let network = &expectation::judge(solver)?.among;
    let Some(found) = neighbourhood::Found::of(mask, solution)? else { return Ok(()) };
    solution.uncertainty = Some(neighbourhood::shared_out(network, mask, &found));
    Ok(())
}

/// Predicted mean angular error of the whole object, degrees: the mean of the pixels' expected errors.
/// `None` where the solution has no uncertainty (see [`complete`]) or no pixel.
#[must_use]
pub fn predicted_mae(solution: &Solution) -> Option<f32> {
    let degrees = solution.uncertainty.as_ref()?;
    (!degrees.is_empty()).then(|| neighbourhood::mean(degrees))
}

/// So many pixels are enough to predict a mean over the object after every picture.
pub const JUDGED: usize = 4096;

/// Ends a capture when the object is good enough (the idea of LAC-PS, on a continuous scale).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopAt {
    /// Predicted mean angular error at which to stop, degrees.
    pub degrees: f32,
    /// Never stop with fewer lights: the prediction needs values that can contradict each other.
    pub least_lights: usize,
}

impl StopAt {
    /// Stop at `degrees`, with at least five lights.
    #[must_use]
    pub fn new(degrees: f32) -> Self {
        Self { degrees, least_lights: 5 }
    }

    /// Whether these pictures of `mask`'s pixels are good enough, judged by `solver` on evenly spread pixels (at most [`JUDGED`] of
    /// them). Lights in one plane are not.
    #[must_use]
    pub fn enough(&self, solver: &dyn Solver, pictures: &Measurements, mask: &Mask) -> bool {
        let count = pictures.lights.len();
        if count < self.least_lights {
            return false;
        }
        let pixels = pictures.images.first().map_or(0, |image| image.len());
        let (some, small) = if of_whole(solver.name()) {
            if pixels != mask.len() {
                return false;
            }
            let (some, small) = thinned(mask);
            (some, Some(small))
        } else {
            ((0..pixels as u32).step_by(pixels.div_ceil(JUDGED).max(1)).collect(), None)
        };
        let piece = Piece::of(pictures, &some);
        let places = near::places(mask);
        let places: Vec<Vec2> = some.iter().filter_map(|&p| places.get(p as usize).copied()).collect();
        let solved = prepare(solver.name(), piece.measurements(pictures), &places).and_then(|ready| {
            let part = ready.measurements();
            let mut solution = solver.solve(&part)?;
            complete(solver.name(), &part, &mut solution)?;
            if let Some(small) = &small {
                finish(solver.name(), small, &mut solution)?;
            }
            Ok(solution)
        });
        solved.is_ok_and(|solution| self.met(&solution, count))
    }

    /// Whether `solution`, from `lights` pictures, is good enough.
    #[must_use]
    pub fn met(&self, solution: &Solution, lights: usize) -> bool {
        lights >= self.least_lights && predicted_mae(solution).is_some_and(|mae| mae <= self.degrees)
    }
}

/// At most [`JUDGED`] pixels of a coarser grid, and the mask of the picture that they make: each still has its neighbours.
fn thinned(mask: &Mask) -> (Vec<u32>, Mask) {
    let on = |p: &u32, step: u32| {
        let (x, y) = mask.position(*p as usize);
        x % step == 0 && y % step == 0
    };
    let mut step = 1;
    loop {
        let some: Vec<u32> = (0..mask.len() as u32).filter(|p| on(p, step)).collect();
        let (width, height) = (mask.width().div_ceil(step), mask.height().div_ceil(step));
        let mut inside = vec![false; (width * height) as usize];
        for &p in &some {
            let (x, y) = mask.position(p as usize);
            inside[(y / step * width + x / step) as usize] = true;
        }
        match Mask::new(width, height, &inside) {
            Ok(small) if some.len() <= JUDGED => return (some, small),
            Ok(_) => step += 1,
            // Nothing of a thin object is on the grid: take all of it.
            Err(_) => return ((0..mask.len() as u32).collect(), mask.clone()),
        }
    }
}

/// Why a stop criterion can't be read.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("stop criterion '{0}': write degrees above 0 and below 90, for example 8deg")]
pub struct StopAtError(String);

impl std::str::FromStr for StopAt {
    type Err = StopAtError;

    /// Reads `8deg` or `8`.
    fn from_str(s: &str) -> Result<Self, StopAtError> {
        let number = s.strip_suffix("deg").unwrap_or(s).trim();
        match number.parse::<f32>() {
            Ok(degrees) if degrees > 0.0 && degrees < 90.0 => Ok(Self::new(degrees)),
            _ => Err(StopAtError(s.into())),
        }
    }
}

/// Fraction of the pixels whose normal can be trusted.
#[must_use]
pub fn coverage(solution: &Solution) -> f32 {
    let valid = solution.validity.iter().filter(|&&v| v == Validity::Valid).count();
    valid as f32 / solution.validity.len().max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn only_whole_objects_are_compared() {
        let solution = Solution {
            normals: vec![Vec3::Z; 12],
            albedo: vec![1.0; 12],
            validity: vec![Validity::Valid; 12],
            uncertainty: Some(vec![2.0; 12]),
            own: Vec::new(),
        };
        let [fits, other] = [(4, 3), (4, 4)].map(|(w, h)| Mask::full(w, h).unwrap());
        let mut whole = solution.clone();
        compare("ls", &fits, &mut whole).unwrap();
        assert!((predicted_mae(&whole).unwrap() - 2.0).abs() < 1e-4);
        let wrong = compare("ls", &other, &mut solution.clone());
        assert_eq!(wrong, Err(SolveError::Places { found: 12, expected: 16 }));
        assert!(matches!(compare("lz", &fits, &mut solution.clone()), Err(SolveError::Model(_))));
        // Without expected errors there is nothing to share out.
        let mut bare = Solution { uncertainty: None, ..solution };
        compare("ls", &fits, &mut bare).unwrap();
        assert_eq!(bare.uncertainty, None);
    }
}
