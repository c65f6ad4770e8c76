//! What an evaluation is asked for: planners, solvers, lights, look-ups, draws; and the runs that this means.

use super::{Protocol, Subject};
use crate::planner::{self, PlanError};
use crate::relight::Lookup;
use crate::solve::uncertainty::StopAt;
use crate::solve::{self, UnknownSolver};
use serde::{Deserialize, Serialize};

/// The pseudo-planner that takes every light of the stack (of a rendered object: 100 Fibonacci directions).
pub const ALL_LIGHTS: &str = "all";

/// What to compare.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Names in [`planner::PLANNERS`], `ring:DEGREES`, or [`ALL_LIGHTS`].
    pub planners: Vec<String>,
    /// Names in [`solve::SOLVERS`].
    pub solvers: Vec<String>,
    /// Numbers of lights T.
    pub lights: Vec<usize>,
    /// How code values become linear ones; objects that are rendered have none.
    pub protocol: Protocol,
    /// How a direction becomes a picture.
    pub lookups: Vec<String>,
    /// Repetitions.
    pub draws: usize,
    /// Seed of all of them.
    pub seed: u64,
    /// Ends a run before T lights where the first of `solvers` predicts a mean error of at most so many degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stop_at: Option<f32>,
}

/// Why settings can't be used.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum SettingsError {
    /// A planner is unknown.
    #[error("{0}; or all, for every light of the stack")]
    Planner(PlanError),
    /// A solver is unknown.
    #[error(transparent)]
    Solver(#[from] UnknownSolver),
    /// A look-up can't be read.
    #[error(transparent)]
    Lookup(#[from] crate::relight::LookupError),
    /// A number is out of range or a list is empty.
    #[error("{what}: {why}")]
    Value {
        /// Which setting.
        what: &'static str,
        /// What is wrong and what would be right.
        why: String,
    },
}

/// One run to make on an object.
#[derive(Clone, Debug, PartialEq)]
pub struct RunSpec {
    /// Planner.
    pub planner: String,
    /// Number of lights, T; 0 for all of the stack.
    pub lights: usize,
    /// Look-up.
    pub lookup: Lookup,
    /// Which repetition, from 0.
    pub draw: usize,
    /// Seed.
    pub seed: u64,
    /// When to end before T lights.
    pub stop_at: Option<StopAt>,
}

impl Settings {
    /// Refuses what can't be run before anything is computed.
    ///
    /// # Errors
    /// [`SettingsError`].
    pub fn check(&self) -> Result<(), SettingsError> {
        let empty = |what| SettingsError::Value { what, why: "the list is empty: name at least one".into() };
        for (list, what) in
            [(&self.planners, "planner"), (&self.solvers, "solver"), (&self.lookups, "lookup")]
        {
            if list.is_empty() {
                return Err(empty(what));
            }
        }
        if self.lights.is_empty() {
            return Err(empty("lights"));
        }
        if let Some(t) = self.lights.iter().find(|&&t| !(3..=1000).contains(&t)) {
            let why = format!("{t} is outside 3..=1000 (a normal needs at least three lights)");
            return Err(SettingsError::Value { what: "lights", why });
        }
        if !(1..=100_000).contains(&self.draws) {
            let why = format!("{} is outside 1..=100000", self.draws);
            return Err(SettingsError::Value { what: "draws", why });
        }
        for name in self.planners.iter().filter(|p| *p != ALL_LIGHTS) {
            planner::info(name).map_err(SettingsError::Planner)?;
        }
        for name in &self.solvers {
            solve::check_name(name)?;
        }
        for lookup in &self.lookups {
            lookup.parse::<Lookup>()?;
        }
        // Twice the same would be counted twice.
        let lookups: Vec<String> =
            self.lookups.iter().filter_map(|l| Some(l.parse::<Lookup>().ok()?.to_string())).collect();
        let lights: Vec<String> = self.lights.iter().map(ToString::to_string).collect();
        let lists = [
            ("planner", &self.planners),
            ("solver", &self.solvers),
            ("lookup", &lookups),
            ("lights", &lights),
        ];
        for (what, list) in lists {
            if let Some(name) = list.iter().enumerate().find_map(|(i, n)| list[..i].contains(n).then_some(n))
            {
                return Err(SettingsError::Value {
                    what,
                    why: format!("{name} is there twice: once is enough"),
                });
            }
        }
        if let Some(degrees) = self.stop_at.filter(|d| !(*d > 0.0 && *d < 90.0)) {
            let why = format!("{degrees} degrees is not above 0 and below 90");
            return Err(SettingsError::Value { what: "stop_at", why });
        }
        Ok(())
    }

    /// Every run to make on a stack, in the order of the table.
    ///
    /// # Errors
    /// [`SettingsError`], as [`Settings::check`].
    pub fn runs(&self) -> Result<Vec<RunSpec>, SettingsError> {
        self.check()?;
        let mut runs = Vec::new();
        for lookup in &self.lookups {
            let lookup: Lookup = lookup.parse()?;
            for planner in &self.planners {
                let all = planner == ALL_LIGHTS;
                let counts = if all { &[0][..] } else { &self.lights[..] };
                for &lights in counts {
                    for draw in 0..if all { 1 } else { self.draws } {
                        runs.push(RunSpec {
                            planner: planner.clone(),
                            lights,
                            lookup,
                            draw,
                            seed: self.seed,
                            stop_at: self.stop_at.map(StopAt::new),
                        });
                    }
                }
            }
        }
        Ok(runs)
    }

    /// [`runs`](Self::runs) of this object. A rendered one has no look-up: more than one would be the same again.
    ///
    /// # Errors
    /// [`SettingsError`], as [`Settings::check`].
    pub fn runs_on(&self, subject: &Subject) -> Result<Vec<RunSpec>, SettingsError> {
        let mut runs = self.runs()?;
        if let (Subject::Scene { .. }, Some(first)) = (subject, runs.first().map(|run| run.lookup)) {
            runs.retain(|run| run.lookup == first);
        }
        Ok(runs)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub fn settings() -> Settings {
        Settings {
            planners: ["all", "random", "dc05", "dc05v", "tk22", "lipids", "oracle"].map(Into::into).to_vec(),
            solvers: vec!["ls".into()],
            lights: vec![5, 10],
            protocol: Protocol::Official,
            lookups: vec!["nearest".into(), "soft:0.05".into()],
            draws: 3,
            seed: 1,
            stop_at: None,
        }
    }

    #[test]
    fn bad_settings_are_named() {
        let with = |f: &dyn Fn(&mut Settings)| {
            let mut s = settings();
            f(&mut s);
            s.check().unwrap_err().to_string()
        };
        assert!(with(&|s| s.lights = vec![2]).contains("outside 3..=1000"));
        assert!(with(&|s| s.planners = vec!["best".into()]).contains("random, dc05"));
        assert!(with(&|s| s.solvers = vec!["magic".into()]).contains("ls"));
        assert!(with(&|s| s.lookups = vec!["soft:-1".into()]).contains("soft:TAU"));
        assert!(with(&|s| s.draws = 0).contains("draws"));
        assert!(with(&|s| s.planners.clear()).contains("empty"));
        assert!(with(&|s| s.planners.push("random".into())).contains("planner: random is there twice"));
        assert!(with(&|s| s.lights = vec![10, 5, 10]).contains("lights: 10 is there twice"));
        assert!(with(&|s| s.solvers = vec!["ls".into(); 2]).contains("solver: ls"));
        assert!(with(&|s| s.lookups.push("soft:0.050".into())).contains("lookup: soft:0.05"));
    }
}
