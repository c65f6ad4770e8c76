//! The trained planners of a `models` folder, by planner name.

use crate::model;
use anyhow::Context;
use coil_ps::planner::coil::Coil;
use coil_ps::planner::{Learned, Planner};
use coil_ps::policy::Policy;
use glam::Vec3;
use std::collections::BTreeMap;
use std::path::Path;

/// Planner name, and the folder of its two files under `models`.
const FOLDERS: [(&str, &str); 4] = [
    ("coil", "compact"),
    ("coil-no-gate", "compact-no-gate"),
    ("coil-no-transformer", "compact-no-transformer"),
    ("coil-blank", "compact-blank"),
];

/// Loaded policies.
#[derive(Default)]
pub struct Models(BTreeMap<&'static str, Policy>);

impl Models {
    /// Loads the policies that `planners` name from the folders under `models`.
    ///
    /// # Errors
    /// A file that is missing or can't be used.
    pub fn load(models: &Path, planners: &[String]) -> anyhow::Result<Self> {
        let mut loaded = BTreeMap::new();
        for (name, folder) in FOLDERS.iter().filter(|(name, _)| planners.iter().any(|p| p == name)) {
            let folder = models.join(folder);
            let policy =
                Policy::load(&model::read(&folder)?).with_context(|| folder.display().to_string())?;
            loaded.insert(*name, policy);
        }
        Ok(Self(loaded))
    }
}

impl Learned for Models {
    fn planner(&self, name: &str, start: Vec3) -> Option<Box<dyn Planner>> {
        let policy = self.0.get(name)?.clone();
        Some(if name == "coil-blank" {
            Box::new(Coil::blank(policy, start))
        } else {
            Box::new(Coil::new(policy, start))
        })
    }

    fn network(&self, name: &str) -> Option<String> {
        Some(self.0.get(name)?.header().network.clone())
    }
}
