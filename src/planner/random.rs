//! Random lights: uniform by area within reach; of a finite set the nearest one not used yet.

use super::{PlanError, Planner, View};
use crate::camera::Domain;
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
            Domain::Candidates(_) => view.nearest_free(wish),
            Domain::Hemisphere { .. } => Ok(wish),
        }
    }
}
