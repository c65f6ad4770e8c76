//! Where to put the next light: one interface for every planner, learned or not.
//!
//! Discrete planners return one of the candidates; continuous ones return any unit vector within reach.
//! None repeats a light, all are deterministic for a seed.

pub mod random;

use crate::camera::{Domain, Observation};
use crate::stack::Mask;
use glam::Vec3;

/// What a planner may look at.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The object's pixels.
    pub mask: &'a Mask,
    /// Where a light may be asked for.
    pub domain: &'a Domain,
    /// The pictures so far, in order; empty before the first.
    pub seen: &'a [Observation],
    /// How many pictures there will be, T.
    pub lights: usize,
}

impl View<'_> {
    /// The candidates not asked for yet, as (index, direction); empty on a continuous domain.
    pub fn free_candidates(&self) -> impl Iterator<Item = (usize, Vec3)> {
        let all = self.domain.candidates().unwrap_or_default();
        all.iter().copied().enumerate().filter(|(_, c)| !self.seen.iter().any(|o| o.requested == *c))
    }
}

/// Why a planner can't name a light.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum PlanError {
    /// Less candidates than lights.
    #[error("{candidates} candidate lights for {lights} pictures: ask for at most {candidates}")]
    TooFewCandidates {
        /// Number of candidates.
        candidates: usize,
        /// Number of pictures asked for.
        lights: usize,
    },
    /// The planner has no set of this size.
    #[error("{planner} is not defined for {lights} lights: {hint}")]
    Lights {
        /// Its name.
        planner: &'static str,
        /// Number of pictures asked for.
        lights: usize,
        /// What would be right.
        hint: String,
    },
    /// No such planner.
    #[error("no planner '{name}': choose from {known}")]
    Unknown {
        /// What was asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// An oracle without true normals, or a learned planner without its model.
    #[error("{planner} needs {what}")]
    Needs {
        /// Its name.
        planner: &'static str,
        /// What is missing.
        what: String,
    },
    /// The model could not be run.
    #[error("{0}")]
    Model(String),
}

/// Decides where the next light goes.
pub trait Planner {
    /// The direction of the next light: one of the candidates where the domain has them, else a unit
    /// vector within its reach. Called once for each picture, the first time with nothing seen.
    ///
    /// # Errors
    /// [`PlanError`].
    fn next(&mut self, view: &View) -> Result<Vec3, PlanError>;
}
