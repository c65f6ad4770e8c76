//! The learned planner in JavaScript: a module of its own, fetched when it is first used.

use super::picture::Picture;
use super::stack::Observations;
use super::{direction, fail, mask_of, plain};
use crate::light;
use crate::planner::Learned;
use crate::planner::coil::Policies;
use crate::policy;
use crate::view;
use std::rc::Rc;
use wasm_bindgen::prelude::*;

#[wasm_bindgen(typescript_custom_section)]
const TYPES: &str = r#"
/** What a policy's files say of themselves. */
export interface PolicyInfo {
  /** Identity of the trained network. */
  network: string;
  /** How it was trained, one line. */
  note: string;
  size: string;
  /** Side of the input frame and of the gate map, pixels. */
  input: number;
  gating: boolean;
  transformer: boolean;
  /** Largest number of pictures that it was trained to plan for and is told; 0: it isn't told how many there will be. */
  horizon: number;
  /** Most pictures a sequence may have. */
  maxFrames: number;
}
"#;

/// A loaded policy, ready to plan for any number of objects.
#[wasm_bindgen]
pub struct PolicyRunner {
    policy: policy::Policy,
    run: Option<policy::Sequence>,
}

#[wasm_bindgen]
impl PolicyRunner {
    /// Loads the two ONNX files of a policy (the bytes of `encoder.onnx` and `step.onnx`).
    #[wasm_bindgen(constructor)]
    pub fn new(encoder: Vec<u8>, step: Vec<u8>) -> Result<Self, JsError> {
        let policy = policy::Policy::load(&policy::ModelFiles { encoder, step }).map_err(fail)?;
        Ok(Self { policy, run: None })
    }

    /// What the files say of themselves.
    #[wasm_bindgen(unchecked_return_type = "PolicyInfo")]
    pub fn info(&self) -> Result<JsValue, JsError> {
        let header = self.policy.header();
        let c = &header.config;
        plain(&serde_json::json!({
            "network": header.network,
            "note": header.note,
            "size": c.size,
            "input": c.input,
            "gating": c.gating,
            "transformer": c.transformer,
            "horizon": c.horizon,
            "maxFrames": c.max_frames,
        }))
    }

    /// Begins an object: its mask (a byte for each pixel of a `width × height` image, not 0 on the object) and the largest
    /// slant of a light, degrees; and how many pictures there will be.
    pub fn start(
        &mut self,
        mask: &[u8],
        width: u32,
        height: u32,
        reach: f32,
        lights: usize,
    ) -> Result<(), JsError> {
        let mask = mask_of(mask, width, height)?;
        self.run = Some(self.policy.start(&mask, reach.to_radians(), lights));
        Ok(())
    }

    /// Takes in the newest picture (the direction of its light; linear RGB of the mask pixels, three numbers each) and
    /// gives the next direction. The first picture's light is the caller's choice: (0, 0, 1) as in training.
    pub fn observe(&mut self, light: &[f32], rgb: &[f32]) -> Result<Vec<f32>, JsError> {
        let light = direction(light)?;
        let run = self.run.as_mut().ok_or_else(|| fail("call start with the object's mask first"))?;
        let next = run.observe(rgb.as_chunks().0, light).map_err(fail)?;
        Ok(next.to_array().to_vec())
    }

    /// The gate of the newest picture, `input × input` numbers in 0..1 (1: trusted), over the square around the mask;
    /// undefined for a network without gate or before the first picture.
    #[wasm_bindgen(unchecked_return_type = "Float32Array | undefined")]
    pub fn gate(&self) -> Option<Vec<f32>> {
        Some(self.run.as_ref()?.gate()?.to_vec())
    }
}

/// Trained planners by name, for an [`Evaluation`](super::Evaluation).
#[wasm_bindgen]
#[derive(Default)]
pub struct Models(Rc<Policies>);

impl Models {
    pub(super) fn shared(&self) -> Rc<dyn Learned> {
        self.0.clone()
    }
}

#[wasm_bindgen]
impl Models {
    /// None yet.
    #[wasm_bindgen(constructor)]
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Loads the planner `name` from its two ONNX files (`encoder.onnx` and `step.onnx`).
    pub fn add(&mut self, name: String, encoder: Vec<u8>, step: Vec<u8>) -> Result<(), JsError> {
        let policy = policy::Policy::load(&policy::ModelFiles { encoder, step }).map_err(fail)?;
        Rc::make_mut(&mut self.0).insert(name, policy);
        Ok(())
    }

    /// Loads the network with which the planner `name`, which is loaded, plans where lights have a limited reach.
    #[wasm_bindgen(js_name = addLimited)]
    pub fn add_limited(&mut self, name: &str, encoder: Vec<u8>, step: Vec<u8>) -> Result<(), JsError> {
        let limited = policy::Policy::load(&policy::ModelFiles { encoder, step }).map_err(fail)?;
        let policies = Rc::make_mut(&mut self.0);
        let whole = policies.get(name).cloned().ok_or_else(|| fail(format!("'{name}' is not loaded")))?;
        policies.insert(name, whole.with_limited(limited));
        Ok(())
    }

    /// What the planner `name` makes of the first pictures of a run of `lights`; undefined where it is not loaded.
    #[must_use]
    pub fn insight(&self, name: &str, pictures: &Observations, lights: usize) -> Option<Insight> {
        let stack = &pictures.of.stack;
        let run = self.0.get(name)?.start(&stack.mask, light::reach(&stack.lights), lights);
        Some(Insight(run))
    }
}

/// The network at work on one object.
#[wasm_bindgen]
pub struct Insight(policy::Sequence);

#[wasm_bindgen]
impl Insight {
    /// Takes in picture `i`, and gives the direction in which the network wants the next light.
    pub fn observe(&mut self, pictures: &Observations, i: usize) -> Result<Vec<f32>, JsError> {
        let o =
            pictures.seen.get(i).ok_or_else(|| fail(format!("picture {i} of {}", pictures.seen.len())))?;
        Ok(self.0.observe(&o.rgb, o.light).map_err(fail)?.to_array().to_vec())
    }

    /// The newest picture with what the network's gate does not trust in magenta; undefined for one without gate.
    #[wasm_bindgen(js_name = gatePicture)]
    #[must_use]
    pub fn gate_picture(&self, pictures: &Observations) -> Option<Picture> {
        let (trust, o) = (self.0.trust()?, pictures.seen.get(self.0.seen().checked_sub(1)?)?);
        Some(Picture(view::gated(&pictures.of.stack.mask, &o.grey, &trust, &pictures.of.tone)))
    }
}
