//! The table: every planner, solver, number of lights and look-up on every object, repeated.
//!
//! [`Settings::runs_on`] lists the runs, [`run`] makes one (the command line in threads, the page in its worker), and
//! [`rows`] sums the runs of one object up. The JSON of a [`Report`] is documented in `benchmarks/results.schema.json`.

use super::Protocol;
use super::statistics::{interval95, mean};
use crate::camera::{Camera, Domain, Observation};
use crate::error;
use crate::light;
use crate::planner::oracle::ORACLE_CANDIDATES;
use crate::planner::{self, Choice, Learned, PlanError, Setup};
use crate::relight::Lookup;
use crate::session::{Session, SessionError, Step};
use crate::solve::uncertainty::{self, StopAt};
use crate::solve::{self, Measurements, Solution, SolveError, UnknownSolver};
use crate::stack::{Mask, Stack};
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::f32::consts::FRAC_PI_2;

/// Version of the results' JSON.
pub const SCHEMA: &str = "coil-ps/results/1";

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
    /// Judges what `solver` made of the pictures.
    ///
    /// # Errors
    /// As [`uncertainty::complete`].
    pub fn of(
        solver: &str,
        pictures: &Measurements,
        mut solution: Solution,
        truth: Option<&[Vec3]>,
    ) -> Result<Self, SolveError> {
        if let Some(truth) = truth {
            return Ok(Self { mae: Some(error::mae(&solution.normals, truth)), predicted: None });
        }
        uncertainty::complete(solver, pictures, &mut solution)?;
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
        Some((stop, solver)) => !stop.enough(&**solver, &Measurements::of(seen)),
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
    let pictures = Measurements::of(&seen);
    let mut scores = Vec::with_capacity(solvers.len());
    for name in solvers {
        let solver = solve::by_name(name).map_err(|e| SolveError::Model(e.to_string()))?;
        scores.push(Score::of(name, &pictures, solver.solve(&pictures)?, subject.truth())?);
    }
    Ok(Run { seen, scores })
}

/// Every image of a stack; of a scene as many pictures as the oracle has candidates.
fn every_light(subject: &Subject) -> Result<Vec<Observation>, SessionError> {
    match *subject {
        Subject::Stack(stack) => Ok((0..stack.len())
            .map(|k| Observation {
                requested: stack.lights[k],
                light: stack.lights[k],
                grey: stack.grey[k].clone(),
                rgb: Vec::new(),
                saturated: stack.saturated[k].clone(),
                effective_images: 1.0,
                index: Some(k),
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

/// One line of the table: an object, or the mean over objects, under one combination of settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Object name; `mean` in [`Report::means`].
    pub object: String,
    /// Bits a channel of the images; `null` for a rendered object.
    pub bits: Option<u8>,
    /// Protocol; `null` for a rendered object.
    pub protocol: Option<Protocol>,
    /// `nearest`, `soft:TAU`, or `exact` for a rendered object.
    pub lookup: String,
    /// Planner.
    pub planner: String,
    /// Whether the planner sees the ground truth.
    pub oracle: bool,
    /// Solver.
    pub solver: String,
    /// Number of lights, T.
    pub lights: usize,
    /// Lights that were taken on average, where [`Settings::stop_at`] may end runs before T.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lights_taken: Option<f64>,
    /// Repetitions.
    pub draws: usize,
    /// Seed.
    pub seed: u64,
    /// Mean over draws of the mean angular error, degrees; `null` without ground truth or with an error.
    pub mae: Option<f64>,
    /// 95 % interval of `mae`, degrees. Both ends are `mae` where nothing was repeated because nothing is random.
    pub ci95: Option<[f64; 2]>,
    /// MAE of draw 0: the planner as published, not turned, and beginning where it should.
    pub mae_as_published: Option<f64>,
    /// MAE of each draw, degrees.
    pub maes: Vec<f64>,
    /// Mean over draws of what the solver expects its error to be, degrees, where the truth is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub predicted_mae: Option<f64>,
    /// How many stored photos a picture is made of on average; 1 for real ones.
    pub effective_images: Option<f64>,
    /// Mean angle between requested and used light, degrees.
    pub deviation: Option<f64>,
    /// Why there is no result.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub error: Option<String>,
}

impl Row {
    fn empty(object: &str, spec: &RunSpec, settings: &Settings, solver: &str) -> Self {
        Self {
            object: object.into(),
            bits: None,
            protocol: Some(settings.protocol),
            lookup: spec.lookup.to_string(),
            planner: spec.planner.clone(),
            oracle: planner::info(&spec.planner).is_ok_and(|i| i.oracle),
            solver: solver.into(),
            lights: spec.lights,
            lights_taken: None,
            draws: if spec.planner == ALL_LIGHTS { 1 } else { settings.draws },
            seed: spec.seed,
            mae: None,
            ci95: None,
            mae_as_published: None,
            maes: Vec::new(),
            predicted_mae: None,
            effective_images: None,
            deviation: None,
            error: None,
        }
    }
}

/// Rows of an object that could not be read: each combination with the error.
///
/// # Errors
/// [`SettingsError`] for settings that can't be run.
pub fn failed_rows(object: &str, settings: &Settings, error: &str) -> Result<Vec<Row>, SettingsError> {
    let mut rows = Vec::new();
    for spec in settings.runs()?.iter().filter(|s| s.draw == 0) {
        for solver in &settings.solvers {
            let error = Some(error.to_owned());
            rows.push(Row { error, ..Row::empty(object, spec, settings, solver) });
        }
    }
    Ok(rows)
}

/// Makes every run on one object, one after the other, and sums them up.
///
/// # Errors
/// [`SettingsError`] for settings that can't be run; a run that fails is a row with an error.
pub fn evaluate(subject: &Subject, settings: &Settings) -> Result<Vec<Row>, SettingsError> {
    let runs: Vec<_> = settings
        .runs_on(subject)?
        .into_iter()
        .map(|spec| {
            let mut made = run(subject, &spec, &settings.solvers, None);
            if let Ok(made) = &mut made {
                made.forget_pixels();
            }
            (spec, made)
        })
        .collect();
    Ok(rows(subject, settings, &runs))
}

/// Sums up the runs of one object (in the order of [`Settings::runs_on`]): one row for each combination.
#[must_use]
pub fn rows(
    subject: &Subject,
    settings: &Settings,
    runs: &[(RunSpec, Result<Run, SessionError>)],
) -> Vec<Row> {
    let same =
        |a: &RunSpec, b: &RunSpec| (&a.planner, a.lights, a.lookup) == (&b.planner, b.lights, b.lookup);
    let mut rows = Vec::new();
    for group in runs.chunk_by(|a, b| same(&a.0, &b.0)) {
        for (s, solver) in settings.solvers.iter().enumerate() {
            rows.push(summarise(subject, settings, group, s, solver));
        }
    }
    rows
}

fn summarise(
    subject: &Subject,
    settings: &Settings,
    group: &[(RunSpec, Result<Run, SessionError>)],
    solver_index: usize,
    solver: &str,
) -> Row {
    let mut row = Row::empty(subject.name(), &group[0].0, settings, solver);
    row.bits = subject.bits();
    if let Subject::Scene { .. } = subject {
        (row.protocol, row.lookup) = (None, "exact".into());
    }
    let mut done = Vec::with_capacity(group.len());
    for (_, run) in group {
        match run {
            Ok(run) => done.push(run),
            Err(error) => {
                row.error = Some(error.to_string());
                return row;
            }
        }
    }
    if row.planner == ALL_LIGHTS {
        row.lights = done[0].seen.len();
    }
    row.lights_taken =
        settings.stop_at.map(|_| mean(&done.iter().map(|r| r.seen.len() as f64).collect::<Vec<_>>()));
    row.maes = done.iter().filter_map(|r| r.scores[solver_index].mae).collect();
    let predicted: Vec<f64> = done.iter().filter_map(|r| r.scores[solver_index].predicted).collect();
    row.predicted_mae = (!predicted.is_empty()).then(|| mean(&predicted));
    if !row.maes.is_empty() {
        let m = mean(&row.maes);
        row.mae = Some(m);
        row.mae_as_published = row.maes.first().copied();
        row.ci95 = if row.planner == ALL_LIGHTS { Some([m, m]) } else { interval95(&row.maes) };
    }
    row.effective_images = Some(mean(&done.iter().map(|r| r.effective_images()).collect::<Vec<_>>()));
    row.deviation = Some(mean(&done.iter().map(|r| r.deviation()).collect::<Vec<_>>()));
    row
}

/// Results of an evaluation, as written to JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// [`SCHEMA`].
    pub schema: String,
    /// Program and version that made it.
    pub generator: String,
    /// What was asked for.
    pub settings: Settings,
    /// One entry for each object and combination.
    pub results: Vec<Row>,
    /// Mean over the objects without error, one for each combination that more than one object has.
    pub means: Vec<Row>,
}

impl Report {
    /// The report of these rows.
    #[must_use]
    pub fn new(settings: Settings, results: Vec<Row>) -> Self {
        Self {
            schema: SCHEMA.into(),
            generator: concat!("coil-ps ", env!("CARGO_PKG_VERSION")).into(),
            settings,
            means: means(&results),
            results,
        }
    }

    /// Whether an entry has an error.
    #[must_use]
    pub fn has_errors(&self) -> bool {
        self.results.iter().any(|r| r.error.is_some())
    }
}

/// Means over objects. The interval is that of the mean over objects of each draw.
fn means(results: &[Row]) -> Vec<Row> {
    let key = |r: &Row| {
        let lights = if r.planner == ALL_LIGHTS { 0 } else { r.lights };
        (r.lookup.clone(), r.planner.clone(), lights, r.solver.clone())
    };
    let mut means: Vec<Row> = Vec::new();
    let mut done = Vec::new();
    for first in results {
        let k = key(first);
        if done.contains(&k) {
            continue;
        }
        let group: Vec<&Row> = results.iter().filter(|r| r.mae.is_some() && key(r) == k).collect();
        done.push(k);
        let [head, _, ..] = group[..] else { continue };
        let over = |f: &dyn Fn(&Row) -> Option<f64>| {
            Some(mean(&group.iter().filter_map(|r| f(r)).collect::<Vec<_>>()))
        };
        let draws = group.iter().map(|r| r.maes.len()).min().unwrap_or(0);
        let maes: Vec<f64> =
            (0..draws).map(|d| mean(&group.iter().map(|r| r.maes[d]).collect::<Vec<_>>())).collect();
        let same_bits = group.iter().all(|r| r.bits == head.bits);
        means.push(Row {
            object: "mean".into(),
            bits: if same_bits { head.bits } else { None },
            ci95: if head.planner == ALL_LIGHTS {
                over(&|r| r.mae).map(|m| [m, m])
            } else {
                interval95(&maes)
            },
            mae: over(&|r| r.mae),
            mae_as_published: over(&|r| r.mae_as_published),
            effective_images: over(&|r| r.effective_images),
            deviation: over(&|r| r.deviation),
            lights_taken: head.lights_taken.and_then(|_| over(&|r| r.lights_taken)),
            maes,
            ..head.clone()
        });
    }
    means
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::fibonacci_cap;
    use crate::stack::BitDepth;

    fn settings() -> Settings {
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

    /// A sphere cap with attached shadows and a bright spot: no planner is perfect on it.
    fn stack() -> Stack {
        let normals = fibonacci_cap(256, 1.2);
        let lights = fibonacci_cap(40, 0.9);
        let shade = |l: &Vec3| -> Vec<f32> {
            normals
                .iter()
                .map(|n| n.dot(*l).max(0.0) + libm::powf(n.dot((*l + Vec3::Z).normalize()).max(0.0), 60.0))
                .collect()
        };
        Stack {
            name: "cap".into(),
            mask: Mask::full(16, 16).unwrap(),
            bits: BitDepth::Sixteen,
            grey: lights.iter().map(shade).collect(),
            rgb: lights.iter().map(|l| shade(l).into_iter().map(|v| [v; 3]).collect()).collect(),
            saturated: vec![Vec::new(); 40],
            names: (1..=40).map(|k| format!("{k:03}.png")).collect(),
            lights,
            truth: Some(normals),
        }
    }

    fn table(stack: &Stack, settings: &Settings) -> Vec<Row> {
        evaluate(&Subject::Stack(stack), settings).unwrap()
    }

    #[test]
    fn one_row_for_each_combination_and_the_oracle_is_best() {
        let (stack, settings) = (stack(), settings());
        let rows = table(&stack, &settings);
        assert_eq!(rows.len(), 2 * (1 + 6 * 2)); // look-ups × (all + planners × light counts)
        assert!(rows.iter().all(|r| r.error.is_none()), "{rows:?}");
        let mae = |planner: &str| {
            rows.iter()
                .find(|r| r.planner == planner && r.lights == 10 && r.lookup == "nearest")
                .unwrap()
                .mae
                .unwrap()
        };
        for p in ["random", "dc05", "dc05v", "tk22", "lipids"] {
            assert!(mae("oracle") < mae(p), "{p}");
        }
        let all = rows.iter().find(|r| r.planner == "all").unwrap();
        assert_eq!((all.lights, all.draws, all.maes.len()), (40, 1, 1));
        let soft = rows.iter().find(|r| r.planner == "random" && r.lookup == "soft:0.05").unwrap();
        assert!(soft.effective_images.unwrap() > 1.05);
        assert_eq!(table(&stack, &settings), rows); // deterministic
    }

    #[test]
    fn a_run_ends_where_the_predicted_error_is_low_enough() {
        let stack = stack();
        let mut s = settings();
        (s.planners, s.lights, s.lookups) = (vec!["random".into()], vec![20], vec!["nearest".into()]);
        let taken = |s: &Settings| table(&stack, s)[0].lights_taken;
        assert_eq!(taken(&s), None);
        s.stop_at = Some(0.01);
        assert_eq!(taken(&s), Some(20.0));
        s.stop_at = Some(89.0);
        assert_eq!(taken(&s), Some(5.0), "five lights are the least");
        s.stop_at = Some(95.0);
        assert!(s.check().unwrap_err().to_string().contains("stop_at"));
    }

    #[test]
    fn what_is_not_defined_is_an_entry_with_an_error() {
        let mut s = settings();
        (s.planners, s.lights, s.lookups) =
            (vec!["lipids".into(), "random".into()], vec![20], vec!["nearest".into()]);
        let rows = table(&stack(), &s);
        assert!(rows[0].error.as_ref().unwrap().contains("3, 5 and 10") && rows[0].mae.is_none());
        assert!(rows[1].error.is_none());
        let report = Report::new(s, rows);
        assert!(report.has_errors() && report.means.is_empty());
    }

    #[test]
    fn without_truth_the_error_is_foreseen() {
        let mut s = settings();
        (s.planners, s.solvers, s.lights) =
            (vec!["random".into()], vec!["ls".into(), "sbr".into()], vec![10]);
        let known = table(&stack(), &s);
        assert!(known.iter().all(|r| r.mae.is_some() && r.predicted_mae.is_none()));
        let rows = table(&Stack { truth: None, ..stack() }, &s);
        assert!(rows.iter().all(|r| r.mae.is_none() && r.maes.is_empty() && r.ci95.is_none()), "{rows:?}");
        for (row, known) in rows.iter().zip(&known) {
            let off = row.predicted_mae.unwrap() - known.mae.unwrap();
            assert!(off.abs() < 6.0, "{}: {off}", row.solver);
        }
        assert!(Report::new(s, rows).means.is_empty());
    }

    #[test]
    fn means_are_over_objects() {
        let (one, mut two) = (stack(), stack());
        two.name = "other".into();
        let mut s = settings();
        (s.planners, s.lights, s.lookups) =
            (vec!["all".into(), "random".into()], vec![5], vec!["nearest".into()]);
        let results = [table(&one, &s), table(&two, &s)].concat();
        let report = Report::new(s, results);
        assert_eq!(report.means.len(), 2);
        assert!((report.means[1].mae.unwrap() - report.results[1].mae.unwrap()).abs() < 1e-9);
    }

    #[cfg(feature = "render")]
    #[test]
    fn a_scene_is_counted_once_whatever_the_lookups() {
        use crate::render::{Options, SceneCamera, worlds};
        let options = Options { size: 16, bounces: 0, ..Options::default() };
        let scene = worlds::objects("sphere+lambert:0.8").unwrap()[0].scene(&options).unwrap();
        let camera = SceneCamera::new(&scene);
        let subject =
            Subject::Scene { name: "ball", camera: &camera, truth: Some(scene.truth()), reach: 1.0 };
        let mut s = settings();
        (s.planners, s.lights) = (vec!["dc05".into(), "all".into()], vec![5]);
        assert_eq!(s.lookups.len(), 2);
        let rows = evaluate(&subject, &s).unwrap();
        assert!(rows.len() == 2 && rows.iter().all(|r| r.lookup == "exact"), "{rows:?}");
        assert!(Report::new(s, rows).means.is_empty());
    }

    #[cfg(feature = "render")]
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
