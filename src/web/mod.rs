//! The crate in JavaScript: newtypes that convert, make one call and convert back.
//!
//! Directions are `[x, y, z]` unit vectors or `Float32Array`s of three numbers each: x right, y up, z to the camera.
//! Angles are degrees here. Every function that can fail throws an `Error` with the message of the crate's error.
#![allow(clippy::new_without_default, clippy::should_implement_trait)] // JavaScript's constructors and names

mod evaluation;
mod object;
mod picture;
#[cfg(feature = "policy")]
mod policy;
#[cfg(feature = "render")]
mod render;
#[cfg(feature = "render")]
mod serial;
mod session;
mod stack;
#[cfg(feature = "render")]
mod studio;
mod tiles;

pub use evaluation::{Evaluation, catalogue};
pub use object::{CapturedObject, ObjectFiles, ObjectHeader, Pixels, decode_pixels};
pub use picture::{Picture, colour_bar};
#[cfg(feature = "policy")]
pub use policy::{Insight, Models, PolicyRunner};
#[cfg(feature = "render")]
pub use render::{Capture, families, materials};
#[cfg(feature = "render")]
pub use serial::{Rig, SimulatedBoard};
pub use session::Session;
pub use stack::{Observations, Relit, Solution, Stack, Surface, integrate_normals};
#[cfg(feature = "render")]
pub use studio::{Frame, FrameAverage, MaskDrawing, SessionFile, SessionFiles, fit_circle};
pub use tiles::{Tiles, Values, solve_piece};

use crate::solve::pixel::{self, PixelNetwork, onnx};
use crate::solve::{self, InContext, Solver, context};
use crate::stack::Mask;
use glam::Vec3;
use serde::Serialize;
use std::sync::{Arc, OnceLock};
use wasm_bindgen::prelude::*;

/// What the functions that return plain objects return.
#[wasm_bindgen(typescript_custom_section)]
const TYPES: &str = r#"
/** A unit direction towards a light: x right, y up, z to the camera. */
export type Direction = [number, number, number];

/** What this build can compute. */
export interface Catalogue {
  planners: PlannerInfo[];
  solvers: { name: string; label: string; about: string }[];
  protocols: ("official" | "128")[];
  version: string;
}

/** A planner. */
export interface PlannerInfo {
  name: string;
  label: string;
  /** One line on how it chooses. */
  about: string;
  choice: "candidates" | "fixed" | "continuous";
  /** Whether it looks at the pictures taken so far. */
  online: boolean;
  /** Whether it sees the ground truth: an upper bound, not a planner. */
  oracle: boolean;
}

/** What to compare; the same names and values as on the command line of `coil eval`. */
export interface Settings {
  planners: string[];
  solvers: string[];
  /** Numbers of lights, T. */
  lights: number[];
  protocol: "official" | "128";
  /** `nearest` or `soft:TAU`. */
  lookups: string[];
  /** Repetitions. */
  draws: number;
  seed: number;
  /** Runs end before T lights where the first solver predicts a mean error of at most so many degrees. */
  stop_at?: number;
}

/** One picture of a run. */
export interface StepInfo {
  /** The direction that was asked for. */
  requested: Direction;
  /** The direction of the light in the picture. */
  used: Direction;
  /** Angle between the two, degrees. */
  deviation: number;
  /** Number of the stored photo, where it is a single one. */
  image: number | null;
  /** Its file name. */
  name: string | null;
  /** How many stored photos the picture is made of. */
  effective: number;
}

/** One line of the table; `benchmarks/results.schema.json` says what each field is. */
export interface ResultRow {
  object: string;
  bits: number | null;
  protocol: "official" | "128" | null;
  lookup: string;
  planner: string;
  oracle: boolean;
  solver: string;
  lights: number;
  lights_taken?: number;
  draws: number;
  seed: number;
  mae: number | null;
  ci95: [number, number] | null;
  mae_as_published: number | null;
  maes: number[];
  predicted_mae?: number;
  effective_images: number | null;
  deviation: number | null;
  error?: string;
}

/** A table, as `coil eval --json` writes it. */
export interface Report {
  schema: string;
  generator: string;
  settings: Settings;
  results: ResultRow[];
  means: ResultRow[];
}
"#;

/// A panic says where it was in the browser's console; what JavaScript catches is only "unreachable".
#[wasm_bindgen(start)]
fn start() {
    console_error_panic_hook::set_once();
}

fn fail(error: impl std::fmt::Display) -> JsError {
    JsError::new(&error.to_string())
}

/// A plain JavaScript object; numbers of 64 bits become numbers, absent options become null.
fn plain(value: &impl Serialize) -> Result<JsValue, JsError> {
    let json = serde_wasm_bindgen::Serializer::json_compatible();
    value.serialize(&json).map_err(fail)
}

static LEARNED: OnceLock<PixelNetwork> = OnceLock::new();

/// Gives the solvers `pixel` and `context` their network: the bytes of `models/pixel.onnx`, which this module does not contain.
#[wasm_bindgen(js_name = loadPixelNetwork)]
pub fn load_pixel_network(bytes: &[u8]) -> Result<(), JsError> {
    let network = onnx::read(bytes).map_err(fail)?.network;
    LEARNED.get_or_init(|| PixelNetwork::new(Arc::new(network)));
    Ok(())
}

fn solver(name: &str) -> Result<Box<dyn Solver>, JsError> {
    if !in_pieces(name) {
        return solve::by_name(name).map_err(fail);
    }
    let none = || fail(format!("the solver '{name}' has no network: give it to loadPixelNetwork first"));
    let network = LEARNED.get().ok_or_else(none)?.clone();
    Ok(if name == context::NAME { Box::new(InContext(network)) } else { Box::new(network) })
}

/// Whether the solver of this name takes seconds: the pixel network and what builds on it.
fn in_pieces(name: &str) -> bool {
    name == pixel::NAME || name == context::NAME
}

fn direction(values: &[f32]) -> Result<Vec3, JsError> {
    match *values {
        [x, y, z] => Ok(Vec3::new(x, y, z)),
        _ => Err(fail(format!("a direction has 3 numbers, not {}", values.len()))),
    }
}

fn directions(values: &[f32]) -> Result<Vec<Vec3>, JsError> {
    if values.len().is_multiple_of(3) {
        Ok(values.chunks_exact(3).map(Vec3::from_slice).collect())
    } else {
        Err(fail(format!("{} numbers: a list of directions has three for each", values.len())))
    }
}

/// The object's pixels from a byte for each pixel of a `width × height` image, not 0 on the object.
fn mask_of(bytes: &[u8], width: u32, height: u32) -> Result<Mask, JsError> {
    let inside: Vec<bool> = bytes.iter().map(|&b| b != 0).collect();
    Mask::new(width, height, &inside).map_err(fail)
}

fn flat(directions: &[Vec3]) -> Vec<f32> {
    bytemuck::cast_slice(directions).to_vec()
}
