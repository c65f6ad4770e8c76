//! Where to put the next light: one interface for every planner, learned or not.
//!
//! Discrete planners return one of the candidates; continuous ones return any unit vector within reach.
//! None repeats a light, all are deterministic for a seed.

#[cfg(feature = "policy")]
pub mod coil;
pub mod fixed;
pub mod oracle;
pub mod random;
pub mod tk22;

use crate::camera::{Camera, Domain, Observation};
use crate::light;
use crate::rng::Rng;
use crate::stack::Mask;
use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI, TAU};

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
    /// The candidates not asked for yet, as (index, direction), each direction once; empty on a continuous domain.
    pub fn free_candidates(&self) -> impl Iterator<Item = (usize, Vec3)> {
        let all = self.domain.candidates().unwrap_or_default();
        all.iter().copied().enumerate().filter(|&(i, _)| self.is_free(all, i))
    }

    /// Whether number `i` of `all` is the next to ask for: a direction that is there twice is two photos, taken in their order.
    fn is_free(&self, all: &[Vec3], i: usize) -> bool {
        let before = all[..i].iter().filter(|c| **c == all[i]).count();
        before == self.seen.iter().filter(|o| o.requested == all[i]).count()
    }

    /// What a finite set has for `wish`: the nearest candidate not asked for yet.
    ///
    /// # Errors
    /// [`PlanError::TooFewCandidates`] where none is left.
    pub fn nearest_free(&self, wish: Vec3) -> Result<Vec3, PlanError> {
        let free: Vec<Vec3> = self.free_candidates().map(|(_, c)| c).collect();
        let candidates = self.domain.candidates().map_or(0, <[Vec3]>::len);
        light::nearest(wish, &free, |_| true)
            .map(|i| free[i])
            .ok_or(PlanError::TooFewCandidates { candidates, lights: self.lights })
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

/// What a planner chooses from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Choice {
    /// One of the lights of the stack; on a rig or renderer any direction within reach.
    Candidates,
    /// A set of directions fixed beforehand, whatever the reach: each picture is under the nearest light there is.
    Fixed,
    /// Any direction within reach.
    Continuous,
}

/// What people should know of a planner.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Info {
    /// Name on the command line, in results and permalinks.
    pub name: &'static str,
    /// Name in tables and menus.
    pub label: &'static str,
    /// One line on how it chooses.
    pub about: &'static str,
    /// What it chooses from.
    pub choice: Choice,
    /// Whether it looks at the pictures taken so far.
    pub online: bool,
    /// Whether it sees the ground truth: an upper bound, not a planner.
    pub oracle: bool,
}

/// Every planner that [`build`] knows.
pub const PLANNERS: &[Info] = &[
    Info {
        name: "random",
        label: "Random",
        about: "random lights, none twice",
        choice: Choice::Candidates,
        online: false,
        oracle: false,
    },
    Info {
        name: "dc05",
        label: "DC05 ring",
        about: "even ring at 54.7° slant, optimal for i.i.d. noise (Drbohlav & Chantler 2005)",
        choice: Choice::Fixed,
        online: false,
        oracle: false,
    },
    Info {
        name: "dc05v",
        label: "DC05 ring + vertical",
        about: "one vertical light and an even ring (Drbohlav & Chantler 2005)",
        choice: Choice::Fixed,
        online: false,
        oracle: false,
    },
    Info {
        name: "tk22",
        label: "TK22",
        about: "lights the pixel that shadows left undetermined (Tanikawa et al. 2022)",
        choice: Choice::Candidates,
        online: true,
        oracle: false,
    },
    Info {
        name: "lipids",
        label: "LIPIDS",
        about: "the published learned sets of 3, 5 and 10 lights (Tiwari et al. 2025)",
        choice: Choice::Fixed,
        online: false,
        oracle: false,
    },
    Info {
        name: "coil",
        label: "COIL-PS",
        about: "a trained network looks at all pictures and names any direction",
        choice: Choice::Continuous,
        online: true,
        oracle: false,
    },
    Info {
        name: "coil-no-gate",
        label: "COIL-PS without gate",
        about: "ablation: the network without its outlier-aware gate",
        choice: Choice::Continuous,
        online: true,
        oracle: false,
    },
    Info {
        name: "coil-no-transformer",
        label: "COIL-PS without transformer",
        about: "ablation: the network without its memory of earlier pictures",
        choice: Choice::Continuous,
        online: true,
        oracle: false,
    },
    Info {
        name: "coil-blank",
        label: "COIL-PS, blanked",
        about: "the same training with black pictures: the fixed light set that it finds",
        choice: Choice::Continuous,
        online: false,
        oracle: false,
    },
    Info {
        name: "oracle",
        label: "Oracle (sees the truth)",
        about: "greedy with ground truth over the candidates: an upper bound",
        choice: Choice::Candidates,
        online: true,
        oracle: true,
    },
    Info {
        name: "oraclec",
        label: "Continuous oracle (sees the truth)",
        about: "greedy with ground truth over all directions: an upper bound",
        choice: Choice::Continuous,
        online: true,
        oracle: true,
    },
];

/// What is known of the planner `name`; `ring:DEGREES` is a ring of that slant.
///
/// # Errors
/// [`PlanError::Unknown`] with the names there are.
pub fn info(name: &str) -> Result<Info, PlanError> {
    if ring_slant(name).is_some() {
        return Ok(Info {
            name: "ring",
            label: "Ring",
            about: "even ring of a given slant",
            choice: Choice::Fixed,
            online: false,
            oracle: false,
        });
    }
    PLANNERS.iter().find(|p| p.name == name).copied().ok_or_else(|| PlanError::Unknown {
        name: name.into(),
        known: PLANNERS.iter().map(|p| p.name).chain(["ring:DEGREES"]).collect::<Vec<_>>().join(", "),
    })
}

fn ring_slant(name: &str) -> Option<f32> {
    let degrees: f32 = name.strip_prefix("ring:")?.parse().ok()?;
    (degrees > 0.0 && degrees <= 90.0).then(|| degrees.to_radians())
}

/// What a planner is built for.
#[derive(Clone, Copy)]
pub struct Setup<'a> {
    /// Number of pictures, T.
    pub lights: usize,
    /// Seed of the run.
    pub seed: u64,
    /// Which repetition. 0 is the planner as published; in the others deterministic planners start turned or
    /// jittered, so that they get an interval too.
    pub draw: usize,
    /// The camera, for oracles.
    pub camera: Option<&'a dyn Camera>,
    /// True normals of the mask pixels, for oracles.
    pub truth: Option<&'a [Vec3]>,
    /// Trained planners, for those names that stand for one.
    pub learned: Option<&'a dyn Learned>,
}

/// Trained planners by name: whoever has the model files gives them.
pub trait Learned: Sync {
    /// The planner of a name, beginning with a light at `start`; `None` where no model of that name is loaded.
    fn planner(&self, name: &str, start: Vec3) -> Option<Box<dyn Planner>>;

    /// The largest number of lights that the planner of a name plans, where that is limited.
    fn most_lights(&self, _name: &str) -> Option<usize> {
        None
    }

    /// Identity (hash) of the network behind the planner of a name where lights are within `reach` (radians), if there is one.
    fn network(&self, _name: &str, _reach: f32) -> Option<String> {
        None
    }
}

/// Refuses more lights than the trained planner `name` can plan.
///
/// # Errors
/// [`PlanError::Lights`], or [`PlanError::Unknown`].
pub fn check_lights(name: &str, lights: usize, learned: Option<&dyn Learned>) -> Result<(), PlanError> {
    let most = learned.and_then(|l| l.most_lights(name)).unwrap_or(usize::MAX);
    if lights > most {
        let hint = format!("it plans at most {most}");
        return Err(PlanError::Lights { planner: info(name)?.name, lights, hint });
    }
    Ok(())
}

/// The planner of a name in [`PLANNERS`].
///
/// # Errors
/// [`PlanError`]: unknown, not defined for so many lights, or without what it needs.
pub fn build<'a>(name: &str, setup: &Setup<'a>) -> Result<Box<dyn Planner + 'a>, PlanError> {
    let info = info(name)?;
    let mut rng = Rng::stream(setup.seed, setup.draw as u64);
    let (lights, draw) = (setup.lights, setup.draw);
    let start = |rng: &mut Rng| if draw == 0 { Vec3::Z } else { jitter(Vec3::Z, rng) };
    Ok(match info.name {
        "random" => Box::new(random::Random::new(rng)),
        "dc05" => {
            Box::new(fixed::FixedSet::new(fixed::turned(fixed::dc05_ring(lights, 0.0), draw, &mut rng)))
        }
        "dc05v" => {
            let set = fixed::dc05_ring_and_vertical(lights, 0.0)?;
            Box::new(fixed::FixedSet::new(fixed::turned(set, draw, &mut rng)))
        }
        "ring" => {
            let set = light::ring(lights, ring_slant(name).unwrap_or(FRAC_PI_2), 0.0);
            Box::new(fixed::FixedSet::new(fixed::turned(set, draw, &mut rng)))
        }
        "lipids" => Box::new(fixed::FixedSet::new(fixed::turned(fixed::lipids(lights)?, draw, &mut rng))),
        "tk22" => Box::new(tk22::Tk22::new(start(&mut rng), rng)),
        name if name.starts_with("coil") => {
            let what = "its trained network (files in models/; on the command line a build with the feature policy, as the \
                        default one)";
            let needs = || PlanError::Needs { planner: info.name, what: what.into() };
            let learned = setup.learned.ok_or_else(needs)?;
            check_lights(name, lights, Some(learned))?;
            learned.planner(name, start(&mut rng)).ok_or_else(needs)?
        }
        _ => {
            let needs = |what: &str| PlanError::Needs { planner: info.name, what: what.into() };
            let truth =
                setup.truth.ok_or_else(|| needs("the true normals, which this object does not have"))?;
            let camera = setup.camera.ok_or_else(|| needs("a camera that can show it every candidate"))?;
            Box::new(oracle::Oracle::new(camera, truth, start(&mut rng), info.name == "oraclec"))
        }
    })
}

/// `direction` moved by up to 10° in a random direction, kept on the hemisphere.
fn jitter(direction: Vec3, rng: &mut Rng) -> Vec3 {
    let radius = libm::tanf(10f32.to_radians()) * libm::sqrtf(rng.uniform());
    let phi = rng.range(0.0, TAU);
    let (u, v) = direction.any_orthonormal_pair();
    let moved = (direction + radius * (libm::cosf(phi) * u + libm::sinf(phi) * v)).normalize();
    Vec3::new(moved.x, moved.y, moved.z.max(0.0)).normalize()
}

/// The first light of an online planner: the candidate nearest to `start`, or `start` itself, no farther from the axis than the reach.
fn first(view: &View, start: Vec3) -> Result<Vec3, PlanError> {
    match view.domain {
        Domain::Candidates(all) => light::nearest(start, all, |_| true)
            .map(|i| all[i])
            .ok_or(PlanError::TooFewCandidates { candidates: 0, lights: view.lights }),
        Domain::Hemisphere { reach } => Ok(light::within(start, *reach)),
    }
}

/// The direction within `reach` where `value` is largest: the best of `scan`, then a pattern search around it with
/// shrinking steps. Directions already asked for are not returned again.
fn ascend(scan: &[Vec3], reach: f32, seen: &[Observation], value: impl Fn(Vec3) -> f32) -> Vec3 {
    let taken = |c: Vec3| seen.iter().any(|o| o.requested == c);
    let mut best = (Vec3::Z, f32::NEG_INFINITY);
    for &c in scan.iter().filter(|&&c| !taken(c)) {
        let v = value(c);
        if v > best.1 {
            best = (c, v);
        }
    }
    let mut step = 2.0 * libm::sqrtf(TAU / scan.len().max(50) as f32);
    while step > 1e-3 {
        let (u, v) = best.0.any_orthonormal_pair();
        let around = (0..8).map(|k| {
            let phi = k as f32 * PI / 4.0;
            let moved = (best.0 + step * (libm::cosf(phi) * u + libm::sinf(phi) * v)).normalize();
            light::from_azimuth_slant(light::azimuth(moved), light::slant(moved).min(reach))
        });
        let next =
            around.filter(|&c| !taken(c)).map(|c| (c, value(c))).reduce(|a, b| if b.1 > a.1 { b } else { a });
        match next {
            Some(next) if next.1 > best.1 => best = next,
            _ => step /= 2.0,
        }
    }
    best.0
}
