//! The table: every planner, solver, number of lights and look-up on every object, repeated.
//!
//! [`Settings::runs`] lists the runs, [`run`](super::run::run) makes one (the command line in threads, the page in its worker), and
//! [`rows`] sums the runs of one object up. The JSON of a [`Report`] is documented in `benchmarks/results.schema.json`.

use super::settings::{ALL_LIGHTS, RunSpec, Settings, SettingsError};
use super::statistics::{interval95, mean};
use super::{Protocol, Run, Subject, run};
use crate::planner;
use crate::session::SessionError;
use serde::{Deserialize, Serialize};

/// Version of the results' JSON.
pub const SCHEMA: &str = "coil-ps/results/1";

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
            let mut made = run::run(subject, &spec, &settings.solvers, None);
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
    use crate::eval::settings::tests::settings;
    use crate::light::fibonacci_cap;
    use crate::stack::{BitDepth, Mask, Stack};
    use glam::Vec3;

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
}
