//! Random lights: uniform by area within reach; of a finite set the nearest one not used yet.

use super::{PlanError, Planner, View};
use crate::camera::Domain;
use crate::light;
use crate::rng::Rng;
use glam::Vec3;

/// Random directions. A finite set answers them as it answers any other planner's, so that the name means one thing on a rig, on
/// rendered objects and on datasets, whose lights are seldom spread evenly.
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
        let wish = self.rng.direction(view.domain.reach());
        match view.domain {
            Domain::Candidates(all) => {
                let free: Vec<Vec3> = view.free_candidates().map(|(_, c)| c).collect();
                light::nearest(wish, &free, |_| true)
                    .map(|i| free[i])
                    .ok_or(PlanError::TooFewCandidates { candidates: all.len(), lights: view.lights })
            }
            Domain::Hemisphere { .. } => Ok(wish),
        }
    }
}
