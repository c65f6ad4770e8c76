//! One run on an object: a planner's lights, their pictures, and what solvers make of them.

use super::settings::{ALL_LIGHTS, RunSpec};
use super::statistics::mean;
use crate::camera::{Camera, Domain, Observation};
use crate::error;
use crate::light;
use crate::planner::oracle::ORACLE_CANDIDATES;
use crate::planner::{self, Choice, Learned, Setup};
use crate::session::{Session, SessionError, Step};
use crate::solve::uncertainty;
use crate::solve::{self, Measurements, SolveError, Solver};
use crate::stack::{Mask, Stack};
use glam::Vec3;
use std::f32::consts::FRAC_PI_2;

/// An object to plan on.
#[derive(Clone, Copy)]
pub enum Subject<'a> {
    /// A stack of stored images, seen through a look-up.
    Stack(&'a Stack),
    /// A camera that can take a picture under any direction within `reach` (radians).
    Scene {
        /// Its name in the table.
        name: &'a str,
        /// Takes the pictures.
        camera: &'a (dyn Camera + Sync),
        /// True normals of its mask pixels.
        truth: Option<&'a [Vec3]>,
        /// Largest slant of its light, radians.
        reach: f32,
    },
}

impl Subject<'_> {
    /// The object's name.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::Stack(stack) => &stack.name,
            Self::Scene { name, .. } => name,
        }
    }

    /// Bits a channel of the images; `None` for a rendered object.
    #[must_use]
    pub fn bits(&self) -> Option<u8> {
        match self {
            Self::Stack(stack) => Some(stack.bits.bits()),
            Self::Scene { .. } => None,
        }
    }

    /// The object's pixels.
    #[must_use]
    pub fn mask(&self) -> &Mask {
        match self {
            Self::Stack(stack) => &stack.mask,
            Self::Scene { camera, .. } => camera.mask(),
        }
    }

    /// True normals of the mask pixels.
    #[must_use]
    pub fn truth(&self) -> Option<&[Vec3]> {
        match self {
            Self::Stack(stack) => stack.truth.as_deref(),
            Self::Scene { truth, .. } => *truth,
        }
    }

    /// Where a planner that chooses in the way of `choice` may ask for a light of this object.
    #[must_use]
    pub fn domain(&self, choice: Choice) -> Domain {
        match (self, choice) {
            (_, Choice::Fixed) => Domain::Hemisphere { reach: FRAC_PI_2 },
            (Self::Stack(stack), Choice::Candidates) => Domain::Candidates(stack.lights.clone()),
            (Self::Stack(stack), Choice::Continuous) => {
                Domain::Hemisphere { reach: light::reach(&stack.lights) }
            }
            (Self::Scene { reach, .. }, _) => Domain::Hemisphere { reach: *reach },
        }
    }
}

/// How far off the normals of a run are on average over the object, degrees: known, or else foreseen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score {
    /// Mean angular error; `None` without ground truth.
    pub mae: Option<f64>,
    /// What the solver expects it to be ([`uncertainty::predicted_mae`]), where the truth is not known.
    pub predicted: Option<f64>,
}

impl Score {
    /// Judges what `solver` makes of the pictures, which show all pixels of `mask`.
    ///
    /// # Errors
    /// As [`solve::whole`].
    pub fn of(
        solver: &dyn Solver,
        pictures: Measurements,
        mask: &Mask,
        truth: Option<&[Vec3]>,
    ) -> Result<Self, SolveError> {
        let solution = solve::whole(solver, pictures, mask, truth.is_none())?.solution;
        if let Some(truth) = truth {
            return Ok(Self { mae: Some(error::mae(&solution.normals, truth)), predicted: None });
        }
        Ok(Self { mae: None, predicted: uncertainty::predicted_mae(&solution).map(f64::from) })
    }

    /// The one or the other.
    #[must_use]
    pub fn degrees(&self) -> Option<f64> {
        self.mae.or(self.predicted)
    }
}

/// One run, made.
#[derive(Clone, Debug)]
pub struct Run {
    /// The pictures, in order.
    pub seen: Vec<Observation>,
    /// By solver, in the order of the settings.
    pub scores: Vec<Score>,
}

impl Run {
    /// How many stored photos the pictures are made of on average (geometric mean of exp(entropy)).
    #[must_use]
    pub fn effective_images(&self) -> f64 {
        let logs: f64 = self.seen.iter().map(|o| libm::log(f64::from(o.effective_images))).sum();
        libm::exp(logs / self.seen.len().max(1) as f64)
    }

    /// Drops the pictures' values and keeps directions and numbers: thousands of runs would not fit into memory.
    pub fn forget_pixels(&mut self) {
        for o in &mut self.seen {
            (o.grey, o.rgb, o.saturated) = (Vec::new(), Vec::new(), Vec::new());
        }
    }

    /// Mean angle between requested and used light, degrees.
    #[must_use]
    pub fn deviation(&self) -> f64 {
        mean(&self.seen.iter().map(|o| f64::from(o.deviation().to_degrees())).collect::<Vec<_>>())
    }
}

/// Makes one run on an object and solves it with each of `solvers`, the first of which also says when to stop early.
/// `learned` are the trained planners there are.
///
/// # Errors
/// [`SessionError`]: the planner is not defined there, or the camera or a solver failed.
pub fn run(
    subject: &Subject,
    spec: &RunSpec,
    solvers: &[String],
    learned: Option<&dyn Learned>,
) -> Result<Run, SessionError> {
    let judge = spec.stop_at.zip(solvers.first().and_then(|name| solve::by_name(name).ok()));
    run_watched(subject, spec, solvers, learned, &mut |seen| match &judge {
        Some((stop, solver)) => !stop.enough(&**solver, &Measurements::of(seen), subject.mask()),
        None => true,
    })
}

/// [`run`], with a look at the pictures so far after each of them; the run ends where `watch` gives `false`.
///
/// # Errors
/// As [`run`].
pub fn run_watched(
    subject: &Subject,
    spec: &RunSpec,
    solvers: &[String],
    learned: Option<&dyn Learned>,
    watch: &mut dyn FnMut(&[Observation]) -> bool,
) -> Result<Run, SessionError> {
    let seen =
        if spec.planner == ALL_LIGHTS { every_light(subject)? } else { plan(subject, spec, learned, watch)? };
    let mut scores = Vec::with_capacity(solvers.len());
    for name in solvers {
        let solver = solve::by_name(name).map_err(|e| SolveError::Model(e.to_string()))?;
        scores.push(Score::of(&*solver, Measurements::of(&seen), subject.mask(), subject.truth())?);
    }
    Ok(Run { seen, scores })
}

/// Every image of a stack; of a scene as many pictures as the oracle has candidates.
fn every_light(subject: &Subject) -> Result<Vec<Observation>, SessionError> {
    match *subject {
        Subject::Stack(stack) => Ok((0..stack.len())
            .map(|k| Observation {
                saturated: stack.saturated[k].clone(),
                index: Some(k),
                ..Observation::new(stack.lights[k], stack.lights[k], stack.grey[k].clone(), Vec::new())
            })
            .collect()),
        Subject::Scene { camera, reach, .. } => {
            let lights = light::fibonacci_cap(ORACLE_CANDIDATES, reach);
            Ok(lights.into_iter().map(|l| camera.capture(l, &[])).collect::<Result<_, _>>()?)
        }
    }
}

fn plan(
    subject: &Subject,
    spec: &RunSpec,
    learned: Option<&dyn Learned>,
    watch: &mut dyn FnMut(&[Observation]) -> bool,
) -> Result<Vec<Observation>, SessionError> {
    let info = planner::info(&spec.planner)?;
    let stored;
    let (camera, truth): (&dyn Camera, _) = match *subject {
        Subject::Stack(stack) => {
            stored = crate::relight::StackCamera::new(stack, spec.lookup);
            (&stored, stack.truth.as_deref())
        }
        Subject::Scene { camera, truth, .. } => (camera, truth),
    };
    let (lights, seed, draw) = (spec.lights, spec.seed, spec.draw);
    let setup = Setup { lights, seed, draw, camera: Some(camera), truth, learned };
    let planner = planner::build(&spec.planner, &setup)?;
    let mut session = Session::new(camera.mask().clone(), subject.domain(info.choice), planner, spec.lights);
    while let Step::Capture(requested) = session.step()? {
        // A stack has its nearest photo for any direction, but a lamp goes no farther than its reach.
        let there = match (subject, info.choice) {
            (Subject::Scene { reach, .. }, Choice::Fixed) => light::within(requested, *reach),
            _ => requested,
        };
        let picture = camera.capture(there, session.seen())?;
        session.observe(Observation { requested, ..picture })?;
        if !watch(session.seen()) {
            break;
        }
    }
    Ok(session.into_seen())
}

#[cfg(all(test, feature = "render"))]
mod tests {
    use super::*;
    use crate::relight::Lookup;

    #[test]
    fn a_fixed_set_goes_as_far_as_the_light_of_a_scene_reaches() {
        use crate::render::{Options, SceneCamera, worlds};
        let options = Options { size: 16, bounces: 0, ..Options::default() };
        let scene = worlds::objects("sphere+lambert:0.8").unwrap()[0].scene(&options).unwrap();
        let camera = SceneCamera::new(&scene);
        let reach = 20f32.to_radians();
        let subject = Subject::Scene { name: "ball", camera: &camera, truth: Some(scene.truth()), reach };
        let of = |planner: &str, lights| {
            let (planner, lookup) = (planner.to_owned(), Lookup::Nearest);
            let spec = RunSpec { planner, lights, lookup, draw: 1, seed: 1, stop_at: None };
            run(&subject, &spec, &["ls".into()], None).unwrap()
        };
        for (planner, lights, degrees) in [("dc05", 10, 34.7), ("ring:30", 10, 10.0), ("dc05v", 5, 36.7)] {
            let run = of(planner, lights);
            assert!(run.seen.iter().all(|o| light::slant(o.light) < reach + 1e-4), "{planner}");
            let azimuths = run.seen.iter().map(|o| light::azimuth(o.light) - light::azimuth(o.requested));
            assert!(azimuths.filter(|d| d.abs() < 6.0).all(|d| d.abs() < 1e-4), "{planner}");
            assert!((run.deviation() - degrees).abs() < 0.1, "{planner}: {}", run.deviation());
        }
        assert!(of("ring:15", 5).deviation() < 1e-3);
        assert!(of("lipids", 10).deviation() > 1.0);
    }
}
