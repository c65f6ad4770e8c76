//! The trained planners of a `models` folder, by planner name. A build without the feature `policy` has none.

#[cfg(feature = "policy")]
pub use coil_ps::planner::coil::Policies as Models;
#[cfg(feature = "policy")]
use {crate::model, anyhow::Context, coil_ps::policy::Policy, std::path::PathBuf};
#[cfg(not(feature = "policy"))]
use {
    coil_ps::planner::{Learned, Planner},
    glam::Vec3,
};

/// Planner name, and the folder of its two files under `models`. Beside it, where there is one, is the folder of the network for
/// limited reach, its name with [`LIMITED`].
#[cfg(feature = "policy")]
const FOLDERS: [(&str, &str); 4] = [
    ("coil", "compact"),
    ("coil-no-gate", "compact-no-gate"),
    ("coil-no-transformer", "compact-no-transformer"),
    ("coil-blank", "compact-blank"),
];

/// What the folder's name of a network for limited reach ends with.
#[cfg(feature = "policy")]
const LIMITED: &str = "-limited";

/// The option that says where the models are.
#[derive(clap::Args)]
pub struct Folder {
    /// Folder with the trained planners' models.
    #[cfg(feature = "policy")]
    #[arg(long, value_name = "DIR", default_value = "models")]
    models: PathBuf,
}

/// Loaded policies.
#[cfg(not(feature = "policy"))]
pub struct Models;

impl Folder {
    /// Loads the policies that `planners` name.
    ///
    /// # Errors
    /// A file that is missing or can't be used.
    #[cfg(feature = "policy")]
    pub fn load(&self, planners: &[String]) -> anyhow::Result<Models> {
        let mut models = Models::default();
        for (name, folder) in FOLDERS.iter().filter(|(name, _)| planners.iter().any(|p| p == name)) {
            let load = |folder: &str| {
                let folder = self.models.join(folder);
                let files = model::read(&folder)?;
                Policy::load(&files).with_context(|| folder.display().to_string())
            };
            let limited = format!("{folder}{LIMITED}");
            let policy = load(folder)?;
            let policy = match self.models.join(&limited).is_dir() {
                true => policy.with_limited(load(&limited)?),
                false => policy,
            };
            models.insert(*name, policy);
        }
        Ok(models)
    }

    /// No policies.
    #[cfg(not(feature = "policy"))]
    pub fn load(&self, _planners: &[String]) -> anyhow::Result<Models> {
        Ok(Models)
    }
}

#[cfg(not(feature = "policy"))]
impl Learned for Models {
    fn planner(&self, _name: &str, _start: Vec3) -> Option<Box<dyn Planner>> {
        None
    }
}
