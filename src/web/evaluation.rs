//! Comparing planners and solvers on a stack, run by run, so that the caller can pause between runs.

use super::stack::{Prepared, Solution, Stack};
use super::tiles::Tiles;
use super::{fail, in_pieces, plain};
use crate::camera::Observation;
use crate::eval::{Report, Run, RunSpec, Score, Settings, Subject, run, table};
use crate::planner::{Learned, PLANNERS};
use crate::session::SessionError;
use crate::solve::{self, Measurements, SOLVERS, pixel};
use glam::Vec3;
use serde::Serialize;
use std::rc::Rc;
use wasm_bindgen::prelude::*;

/// What this build can compute.
#[wasm_bindgen(unchecked_return_type = "Catalogue")]
pub fn catalogue() -> Result<JsValue, JsError> {
    #[derive(Serialize)]
    struct Catalogue {
        planners: &'static [crate::planner::Info],
        solvers: &'static [solve::Info],
        protocols: [&'static str; 2],
        version: &'static str,
    }
    plain(&Catalogue {
        planners: PLANNERS,
        solvers: SOLVERS,
        protocols: ["official", "128"],
        version: env!("CARGO_PKG_VERSION"),
    })
}

/// A table in the making.
#[wasm_bindgen]
pub struct Evaluation {
    of: Rc<Prepared>,
    settings: Settings,
    specs: Vec<RunSpec>,
    runs: Vec<(RunSpec, Result<Run, SessionError>)>,
    learned: Option<Rc<dyn Learned>>,
    /// The pictures of the last run, as long as its normals are still to be solved in pieces.
    open: Option<Rc<Vec<Observation>>>,
}

#[derive(Serialize)]
struct StepInfo {
    requested: Vec3,
    used: Vec3,
    deviation: f32,
    image: Option<usize>,
    name: Option<String>,
    effective: f32,
}

#[wasm_bindgen]
impl Evaluation {
    /// Of these settings on this stack.
    #[wasm_bindgen(constructor)]
    pub fn new(
        stack: &Stack,
        #[wasm_bindgen(unchecked_param_type = "Settings")] settings: JsValue,
    ) -> Result<Self, JsError> {
        let settings: Settings = serde_wasm_bindgen::from_value(settings).map_err(fail)?;
        let specs = settings.runs().map_err(fail)?;
        Ok(Self { of: Rc::clone(&stack.0), settings, specs, runs: Vec::new(), learned: None, open: None })
    }

    /// Lends it trained planners.
    #[cfg(feature = "policy")]
    #[wasm_bindgen(js_name = useModels)]
    pub fn use_models(&mut self, models: &super::Models) {
        self.learned = Some(models.shared());
    }

    /// Number of runs.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn total(&self) -> usize {
        self.specs.len()
    }

    /// Number of runs made.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn done(&self) -> usize {
        self.runs.len()
    }

    /// Planner of the next run; undefined when all are made.
    #[wasm_bindgen(getter, js_name = nextPlanner)]
    #[must_use]
    pub fn next_planner(&self) -> Option<String> {
        self.specs.get(self.runs.len()).map(|s| s.planner.clone())
    }

    /// Makes the next run. In the first run of every planner, `onStep(step, errors, thumbnail)` is called after every
    /// picture: MAE in degrees by solver (without truth what the solver expects it to be; null before three lights),
    /// and the picture with sides of at most `size` pixels. A run that fails is a row with an error. The solvers `pixel` and `context` take seconds: `tiles` and
    /// `settle` are for them.
    #[wasm_bindgen(js_name = runNext)]
    pub fn run_next(
        &mut self,
        size: u32,
        #[wasm_bindgen(
            unchecked_param_type = "(step: StepInfo, errors: (number | null)[], thumbnail: Picture) => void"
        )]
        on_step: &js_sys::Function,
    ) -> Result<(), JsError> {
        let Some(spec) = self.specs.get(self.runs.len()).cloned() else {
            return Ok(());
        };
        let mut failed = None;
        let (of, settings) = (&self.of, &self.settings);
        let judge = match (spec.stop_at, settings.solvers.first()) {
            (Some(stop), Some(name)) => Some((stop, super::solver(name)?)),
            _ => None,
        };
        let mut watch = |seen: &[Observation]| {
            if spec.draw == 0 && failed.is_none() {
                failed = report_step(of, settings, seen, size, on_step).err();
            }
            judge
                .as_ref()
                .is_none_or(|(stop, solver)| !stop.enough(&**solver, &Measurements::of(seen), &of.stack.mask))
        };
        let (slow, at_once): (Vec<_>, Vec<_>) =
            settings.solvers.iter().cloned().enumerate().partition(|(_, name)| in_pieces(name));
        let at_once: Vec<String> = at_once.into_iter().map(|(_, name)| name).collect();
        let run = run::run_watched(
            &Subject::Stack(&of.stack),
            &spec,
            &at_once,
            self.learned.as_deref(),
            &mut watch,
        );
        if let Some(error) = failed {
            return Err(error);
        }
        self.open = None;
        let run = run.map(|mut run| {
            for &(place, _) in &slow {
                run.scores.insert(place, Score::default());
            }
            if !slow.is_empty() {
                let seen = run
                    .seen
                    .iter()
                    .map(|o| Observation { grey: Vec::new(), rgb: Vec::new(), saturated: Vec::new(), ..*o })
                    .collect();
                self.open = Some(Rc::new(std::mem::replace(&mut run.seen, seen)));
            }
            // Only the directions are of interest afterwards: the pictures can be had again.
            run.forget_pixels();
            run
        });
        self.runs.push((spec, run));
        Ok(())
    }

    /// The last run's pieces for the solvers `pixel` and `context`, where the settings ask for them: what comes of them is
    /// given to `settle`.
    pub fn tiles(&self) -> Result<Option<Tiles>, JsError> {
        self.open.as_ref().map(|seen| Tiles::new(&self.of, seen, pixel::NAME)).transpose()
    }

    /// Puts the last run's solution by `solver` into the table.
    pub fn settle(&mut self, solver: &str, solution: &Solution) {
        self.open = None;
        let place = self.settings.solvers.iter().position(|name| name == solver);
        if let (Some(place), Some((_, Ok(run)))) = (place, self.runs.last_mut()) {
            run.scores[place] = solution.score();
        }
    }

    /// The table of the runs made so far.
    #[wasm_bindgen(unchecked_return_type = "Report")]
    pub fn report(&self) -> Result<JsValue, JsError> {
        let rows = table::rows(&Subject::Stack(&self.of.stack), &self.settings, &self.runs);
        plain(&Report::new(self.settings.clone(), rows))
    }
}

fn report_step(
    of: &Prepared,
    settings: &Settings,
    seen: &[Observation],
    size: u32,
    on_step: &js_sys::Function,
) -> Result<(), JsError> {
    let Some(o) = seen.last() else { return Ok(()) };
    let info = StepInfo {
        requested: o.requested,
        used: o.light.normalize_or(Vec3::Z),
        deviation: o.deviation().to_degrees(),
        image: o.index,
        name: o.index.map(|k| of.stack.names[k].clone()),
        effective: o.effective_images,
    };
    let errors: Vec<Option<f64>> = settings
        .solvers
        .iter()
        .map(|name| {
            if in_pieces(name) {
                return None;
            }
            let solver = solve::by_name(name).ok()?;
            // Less than three lights, or lights in one plane: no normals yet.
            let truth = of.stack.truth.as_deref();
            Score::of(&*solver, Measurements::of(seen), &of.stack.mask, truth).ok()?.degrees()
        })
        .collect();
    on_step
        .call3(&JsValue::NULL, &plain(&info)?, &plain(&errors)?, &of.photo(o, size).into())
        .map_err(|_| fail("onStep has thrown an error"))?;
    Ok(())
}
