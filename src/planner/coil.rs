//! COIL-PS: the learned planner. It looks at all pictures so far and names any direction within reach.

use super::{Learned, PlanError, Planner, View};
use crate::camera::Domain;
use crate::light;
use crate::policy::{Policy, Sequence};
use glam::Vec3;
use std::collections::BTreeMap;

/// The learned planner, with a loaded [`Policy`].
#[derive(Clone, Debug)]
pub struct Coil {
    policy: Policy,
    run: Option<Sequence>,
    /// The network's own last direction, before it is moved to a candidate or away from a light already used.
    wish: Vec3,
    blank: bool,
}

impl Coil {
    /// A planner for one object, whose first light is `start` (frontal in training). The policy is shared, not copied.
    #[must_use]
    pub fn new(policy: Policy, start: Vec3) -> Self {
        Self { policy, run: None, wish: start, blank: false }
    }

    /// The planner of a policy that was trained on black pictures: it is shown none.
    #[must_use]
    pub fn blank(policy: Policy, start: Vec3) -> Self {
        Self { blank: true, ..Self::new(policy, start) }
    }
}

/// Loaded policies by the name of their planner; `coil-blank` is the one that was trained on black pictures.
#[derive(Clone, Debug, Default)]
pub struct Policies(BTreeMap<String, Policy>);

impl Policies {
    /// Adds the policy of planner `name`, or replaces it.
    pub fn insert(&mut self, name: impl Into<String>, policy: Policy) {
        self.0.insert(name.into(), policy);
    }

    /// The policy of planner `name`.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&Policy> {
        self.0.get(name)
    }
}

impl Learned for Policies {
    fn planner(&self, name: &str, start: Vec3) -> Option<Box<dyn Planner>> {
        let policy = self.get(name)?.clone();
        Some(Box::new(match name {
            "coil-blank" => Coil::blank(policy, start),
            _ => Coil::new(policy, start),
        }))
    }

    fn most_lights(&self, name: &str) -> Option<usize> {
        Some(self.get(name)?.config().max_frames)
    }

    fn network(&self, name: &str, reach: f32) -> Option<String> {
        Some(self.get(name)?.within(reach).header().network.clone())
    }
}

/// Directions nearer than this (radians, about 0.06°) count as the same light.
const SAME: f32 = 1e-3;
/// The angle that spreads points evenly when added again and again.
const GOLDEN: f32 = 2.399_963;

impl Planner for Coil {
    fn next(&mut self, view: &View) -> Result<Vec3, PlanError> {
        let run =
            self.run.get_or_insert_with(|| self.policy.start(view.mask, view.domain.reach(), view.lights));
        for seen in &view.seen[run.seen()..] {
            let grey;
            let rgb = if self.blank {
                grey = vec![[0.0; 3]; view.mask.len()];
                &grey
            } else if seen.rgb.is_empty() {
                grey = seen.grey.iter().map(|&v| [v; 3]).collect::<Vec<_>>();
                &grey
            } else {
                &seen.rgb
            };
            self.wish = run.observe(rgb, seen.light).map_err(|e| PlanError::Model(e.to_string()))?;
        }
        match view.domain {
            Domain::Candidates(_) => view.nearest_free(self.wish),
            Domain::Hemisphere { reach } => Ok(apart(self.wish, *reach, view)),
        }
    }
}

/// `wish`, or where a light has been there before, the nearest free place on a small spiral around it.
fn apart(wish: Vec3, reach: f32, view: &View) -> Vec3 {
    let taken = |d: Vec3| view.seen.iter().any(|o| light::angle(o.requested, d) < SAME);
    (0..1000)
        .map(|k| {
            let step = 2.0 * SAME * (k as f32).sqrt();
            let (s, c) = libm::sincosf(GOLDEN * k as f32);
            let moved = (wish + step * Vec3::new(c, s, 0.0)).normalize();
            light::from_azimuth_slant(light::azimuth(moved), light::slant(moved).min(reach))
        })
        .find(|&d| !taken(d))
        .unwrap_or(wish)
}
