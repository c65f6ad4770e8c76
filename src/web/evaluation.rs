//! Comparing planners and solvers on a stack, run by run, so that the caller can pause between runs.

use super::stack::{Prepared, Stack};
use super::{fail, plain};
use crate::camera::Observation;
use crate::error;
use crate::eval::{Report, Run, RunSpec, Settings, Subject, table};
use crate::planner::{Learned, PLANNERS};
use crate::session::SessionError;
use crate::solve::{self, Measurements, SOLVERS};
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
        solvers: Vec<Named>,
        protocols: [&'static str; 2],
        version: &'static str,
    }
    #[derive(Serialize)]
    struct Named {
        name: &'static str,
        about: &'static str,
    }
    plain(&Catalogue {
        planners: PLANNERS,
        solvers: SOLVERS.iter().map(|&(name, about)| Named { name, about }).collect(),
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
        Ok(Self { of: Rc::clone(&stack.0), settings, specs, runs: Vec::new(), learned: None })
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

    /// Makes the next run. In the first run of every planner, `onStep(step, maes, thumbnail)` is called after every
    /// picture: MAE in degrees by solver (null before three lights or without truth), and the picture with sides of
    /// at most `size` pixels. A run that fails is a row with an error.
    #[wasm_bindgen(js_name = runNext)]
    pub fn run_next(
        &mut self,
        size: u32,
        #[wasm_bindgen(
            unchecked_param_type = "(step: StepInfo, maes: (number | null)[], thumbnail: Picture) => void"
        )]
        on_step: &js_sys::Function,
    ) -> Result<(), JsError> {
        let Some(spec) = self.specs.get(self.runs.len()).cloned() else {
            return Ok(());
        };
        let mut failed = None;
        let (of, settings) = (&self.of, &self.settings);
        let mut watch = |seen: &[Observation]| {
            if spec.draw == 0 && failed.is_none() {
                failed = report_step(of, settings, seen, spec.lights, size, on_step).err();
            }
        };
        let run = table::run_watched(
            &Subject::Stack(&of.stack),
            &spec,
            &settings.solvers,
            self.learned.as_deref(),
            &mut watch,
        );
        if let Some(error) = failed {
            return Err(error);
        }
        // Only the directions are of interest afterwards: the pictures can be had again.
        let run = run.map(|mut run| {
            run.forget_pixels();
            run
        });
        self.runs.push((spec, run));
        Ok(())
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
    lights: usize,
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
    let maes: Vec<Option<f64>> = settings
        .solvers
        .iter()
        .map(|name| {
            // Seconds a solution: only the last step is worth that.
            if name == "pixel" && seen.len() < lights {
                return None;
            }
            let truth = of.stack.truth.as_ref()?;
            // Less than three lights, or lights in one plane: no normals yet.
            let solution = solve::by_name(name).ok()?.solve(&Measurements::of(seen)).ok()?;
            Some(error::mae(&solution.normals, truth))
        })
        .collect();
    on_step
        .call3(&JsValue::NULL, &plain(&info)?, &plain(&maes)?, &of.photo(o, size).into())
        .map_err(|_| fail("onStep has thrown an error"))?;
    Ok(())
}
