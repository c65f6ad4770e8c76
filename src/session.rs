//! The loop without I/O: ask for a picture, take it in, ask for the next, until T are there.
//!
//! The evaluator, the page and the rig all drive this one.

use crate::camera::{CameraError, Domain, Observation, check_direction};
use crate::planner::{PlanError, Planner, View};
use crate::solve::{self, Measurements, Solution, SolveError, Solver};
use crate::stack::Mask;
use glam::Vec3;

/// What the session wants next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// A picture under this direction, then [`Session::observe`].
    Capture(Vec3),
    /// Nothing: all pictures are there.
    Done,
}

/// Why a session can't go on.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum SessionError {
    /// The planner failed.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The camera failed.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The solver failed.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// A picture has another number of pixels than the mask.
    #[error("the picture has {found} pixels, the mask {expected}")]
    Pixels {
        /// Pixels of the picture.
        found: usize,
        /// Pixels of the mask.
        expected: usize,
    },
    /// A picture holds NaN or infinity.
    #[error("the picture has a value that is not finite at mask pixel {0}")]
    NotFinite(usize),
}

/// A capture of T lights in progress.
pub struct Session<'a> {
    mask: Mask,
    domain: Domain,
    planner: Box<dyn Planner + 'a>,
    lights: usize,
    pending: Option<Vec3>,
    seen: Vec<Observation>,
}

impl<'a> Session<'a> {
    /// A session that will take `lights` pictures of the pixels of `mask`.
    #[must_use]
    pub fn new(mask: Mask, domain: Domain, planner: Box<dyn Planner + 'a>, lights: usize) -> Self {
        Self { mask, domain, planner, lights, pending: None, seen: Vec::new() }
    }

    /// What to do next. Asking again before the picture is there gives the same answer.
    ///
    /// # Errors
    /// [`SessionError::Plan`], or [`SessionError::Camera`] for a planner that names no direction of the hemisphere.
    pub fn step(&mut self) -> Result<Step, SessionError> {
        if self.seen.len() >= self.lights {
            return Ok(Step::Done);
        }
        if let Some(direction) = self.pending {
            return Ok(Step::Capture(direction));
        }
        let view = View { mask: &self.mask, domain: &self.domain, seen: &self.seen, lights: self.lights };
        let direction = self.planner.next(&view)?;
        check_direction(direction)?;
        self.pending = Some(direction);
        Ok(Step::Capture(direction))
    }

    /// Takes in the picture that was asked for.
    ///
    /// # Errors
    /// [`SessionError`] for a picture that does not fit; the session is then as it was.
    pub fn observe(&mut self, picture: Observation) -> Result<(), SessionError> {
        if picture.grey.len() != self.mask.len() {
            return Err(SessionError::Pixels { found: picture.grey.len(), expected: self.mask.len() });
        }
        if let Some(p) = picture.grey.iter().position(|v| !v.is_finite()) {
            return Err(SessionError::NotFinite(p));
        }
        self.pending = None;
        self.seen.push(picture);
        Ok(())
    }

    /// Ends the session with the pictures so far: they are good enough (see [`crate::solve::uncertainty::StopAt`]).
    pub fn finish(&mut self) {
        self.lights = self.seen.len();
        self.pending = None;
    }

    /// The pictures so far.
    #[must_use]
    pub fn seen(&self) -> &[Observation] {
        &self.seen
    }

    /// The pictures, when the session is no longer needed.
    #[must_use]
    pub fn into_seen(self) -> Vec<Observation> {
        self.seen
    }

    /// The object's pixels.
    #[must_use]
    pub fn mask(&self) -> &Mask {
        &self.mask
    }

    /// Number of pictures the session will take, T.
    #[must_use]
    pub fn lights(&self) -> usize {
        self.lights
    }

    /// Normals from the first `count` pictures (all of them when there are less).
    ///
    /// # Errors
    /// [`SessionError::Solve`].
    pub fn solve(&self, solver: &dyn Solver, count: usize) -> Result<Solution, SessionError> {
        let seen = &self.seen[..count.min(self.seen.len())];
        Ok(solve::whole(solver, Measurements::of(seen), &self.mask, false)?.solution)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planner::{self, Setup};

    #[test]
    fn a_session_ends_early_where_its_pictures_are_good_enough() {
        let setup = Setup { lights: 10, seed: 1, draw: 0, camera: None, truth: None, learned: None };
        let planner = planner::build("dc05", &setup).unwrap();
        let domain = Domain::Hemisphere { reach: 1.0 };
        let mut session = Session::new(Mask::full(1, 1).unwrap(), domain, planner, 10);
        let Step::Capture(light) = session.step().unwrap() else { panic!("a light is wanted") };
        let (grey, rgb) = (vec![0.5], vec![[0.5; 3]]);
        let picture = Observation::new(light, light, grey, rgb);
        session.observe(picture).unwrap();
        assert!(matches!(session.step(), Ok(Step::Capture(_))));
        session.finish();
        assert_eq!((session.step().unwrap(), session.lights()), (Step::Done, 1));
    }
}
