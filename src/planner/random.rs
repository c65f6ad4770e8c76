//! Random lights: without replacement from the candidates, or uniform by area within reach.

use super::{PlanError, Planner, View};
use crate::camera::Domain;
use crate::rng::Rng;
use glam::Vec3;

/// Random directions.
#[derive(Clone, Debug)]
pub struct Random {
    rng: Rng,
}

impl Random {
    /// Draws from `rng`.
    #[must_use]
    pub fn new(rng: Rng) -> Self {
        Self { rng }
    }
}

impl Planner for Random {
    fn next(&mut self, view: &View) -> Result<Vec3, PlanError> {
        match view.domain {
            Domain::Candidates(all) => {
                let free: Vec<Vec3> = view.free_candidates().map(|(_, c)| c).collect();
                if free.is_empty() {
                    return Err(PlanError::TooFewCandidates { candidates: all.len(), lights: view.lights });
                }
                Ok(free[self.rng.below(free.len())])
            }
            Domain::Hemisphere { reach } => Ok(self.rng.direction(*reach)),
        }
    }
}
