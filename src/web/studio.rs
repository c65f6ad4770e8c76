//! The capture in the page: frames of a camera, the drawn mask, the mirror sphere, and the session under way.

use super::picture::Picture;
use super::serial::{Rig, millis, time};
use super::{fail, plain};
use crate::arm::Joints;
use crate::arm::kinematics::{Arm, Mount};
use crate::camera::Camera as _;
use crate::dataset::Limits;
use crate::dataset::archive::write_zip;
use crate::light;
use crate::render::{self, Material, Options as SceneOptions, Pose, Scene, SceneCamera};
use crate::rig::calibration::fit_mount;
use crate::rig::camera::{Average, Sensor, SimulatedCamera, SimulatedView};
use crate::rig::capture::{Action, Capture, Options, Stuck};
use crate::rig::drawing::{self, preview};
use crate::rig::hdr::{Crop, Exposure, merge, threshold_level, threshold_mask};
use crate::rig::setup::{Setup, check_board, with_axes};
use crate::rig::sphere::{self, Circle};
use crate::rig::store::{self, Write};
use crate::rig::tiff::decode_frame;
use crate::solve::uncertainty::StopAt;
use crate::solve::{self, Measurements, Solution, Solver};
use crate::stack::{BitDepth, Mask};
use crate::view;
use glam::{DVec2, Vec3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use wasm_bindgen::prelude::*;

#[wasm_bindgen]
extern "C" {
    #[wasm_bindgen(js_namespace = performance, js_name = now)]
    fn clock() -> f64;
}

#[wasm_bindgen(typescript_custom_section)]
const TYPES: &str = r#"
/** What a capture of the rig is of. */
export interface CaptureSettings {
  /** The simulated camera, or frames given to `Rig.expose`. */
  camera: "sim" | "frames";
  /** Name of the object; of the simulated camera a sculpture. */
  object: string;
  material: string;
  /** Side of the simulated picture, pixels. */
  size: number;
  planner: string;
  lights: number;
  /** Takes no more lights once the predicted mean error is at most so many degrees; null: always `lights`. */
  stop_at: number | null;
  seed: number;
  /** Solver of the normals shown after every light. */
  solver: string;
  /** Largest slant that the planner may ask for, degrees. */
  reach: number;
  /** By how much a light may be moved to save travel, degrees; null: not at all. */
  nearby: number | null;
  /** Exposure times, milliseconds. */
  exposures: number[];
  /** Rest after a move, seconds. */
  settle: number;
  /** LED brightness, spindle speed. */
  brightness: number;
  shutter: boolean;
  dark: boolean;
  /** Whether the arm may be homed without asking. */
  homing: boolean;
  /** Outline of a mirror sphere in the whole picture; of the simulated camera, whether there is one. */
  sphere: Outline | null;
  /** How the simulated arm really stands: azimuth, slant, tilt about x and y; degrees. */
  misaligned: [number, number, number, number];
}

/** A circle, pixels; the first pixel's centre is (0.5, 0.5). */
export interface Outline { x: number; y: number; radius: number; }

/** A light seen in a mirror sphere; angles in degrees. */
export interface Measured { direction: Direction; azimuth: number; slant: number; uncertainty: number; at: [number, number]; spot: number; }

/** How good a picture is, shares of the mask's pixels. */
export interface FrameQuality { saturated: number; dark: number; noise: number; }

/** One light of a capture. */
export interface LightTaken {
  requested: Direction; commanded: Direction; measured: Direction | null; used: Direction; file: string;
  /** Degrees. */
  projected: number; off: number | null; uncertainty: number | null;
  saturated: number; dark: number; noise: number;
  /** Seconds. */
  plan: number; move: number; settle: number; expose: number; merge: number; solve: number;
}
"#;

/// A file of a session.
#[wasm_bindgen]
pub struct SessionFile(Write);

#[wasm_bindgen]
impl SessionFile {
    /// Its name in the session's folder.
    #[wasm_bindgen(getter)]
    pub fn name(&self) -> String {
        self.0.name.clone()
    }

    /// Its bytes.
    #[wasm_bindgen(getter)]
    pub fn bytes(&self) -> Vec<u8> {
        self.0.bytes.clone()
    }
}

/// The files of a session as they were read back, to continue it or to pack it.
#[wasm_bindgen]
#[derive(Default)]
pub struct SessionFiles(BTreeMap<String, Vec<u8>>);

#[wasm_bindgen]
impl SessionFiles {
    /// None yet.
    #[wasm_bindgen(constructor)]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds one.
    pub fn add(&mut self, name: &str, bytes: Vec<u8>) {
        self.0.insert(name.into(), bytes);
    }

    /// All of them as a zip archive, in a folder `folder`.
    pub fn zip(&self, folder: &str) -> Result<Vec<u8>, JsError> {
        let files: Vec<_> = self.0.iter().map(|(n, b)| (format!("{folder}/{n}"), b.clone())).collect();
        write_zip(&files).map_err(fail)
    }

    /// Whether `other` is the same session, perhaps some lights behind or ahead.
    #[wasm_bindgen(js_name = isSame)]
    pub fn is_same(&self, other: &SessionFiles) -> bool {
        let record = |files: &Self| store::resume(|n| files.0.get(n).cloned()).map(|r| r.record);
        matches!((record(self), record(other)), (Ok(a), Ok(b)) if a.same_session(&b))
    }

    /// What the session is, or why it is none.
    #[wasm_bindgen(
        unchecked_return_type = "{ object: string; planner: string; simulated: boolean; lights: number; taken: number; damaged: string[] }"
    )]
    pub fn summary(&self) -> Result<JsValue, JsError> {
        let r = store::resume(|n| self.0.get(n).cloned()).map_err(fail)?;
        plain(&Summary {
            object: r.record.object,
            planner: r.record.planner,
            simulated: SimulatedView::parse(&r.record.camera).is_some(),
            lights: r.record.lights,
            taken: r.seen.len(),
            damaged: r.damaged,
        })
    }
}

#[derive(Serialize)]
struct Summary {
    object: String,
    planner: String,
    simulated: bool,
    lights: usize,
    taken: usize,
    damaged: Vec<String>,
}

/// One linear exposure of a camera.
#[wasm_bindgen]
pub struct Frame(Exposure);

#[derive(Serialize)]
struct Measured {
    direction: Vec3,
    azimuth: f32,
    slant: f32,
    uncertainty: f64,
    at: (f64, f64),
    spot: f64,
}

#[wasm_bindgen]
impl Frame {
    /// From a file (PNG or TIFF, linear) of `milliseconds`; `white` is the code value of saturation, by default the file's
    /// largest.
    pub fn decode(bytes: &[u8], milliseconds: f64, black: u16, white: Option<u16>) -> Result<Self, JsError> {
        let image = decode_frame(bytes, Limits::default().pixels).map_err(fail)?;
        let largest = if image.bits == BitDepth::Eight { 255 } else { u16::MAX };
        Ok(Self(Exposure { image, seconds: milliseconds / 1000.0, black, white: white.unwrap_or(largest) }))
    }

    /// Width in pixels.
    #[wasm_bindgen(getter)]
    pub fn width(&self) -> u32 {
        self.0.image.width
    }

    /// Height in pixels.
    #[wasm_bindgen(getter)]
    pub fn height(&self) -> u32 {
        self.0.image.height
    }

    /// To look at, at most `side` pixels wide and high: what is outside the mask is dim, saturation magenta.
    pub fn preview(&self, side: u32, mask: Option<MaskDrawing>) -> Picture {
        Picture(preview(&self.0, mask.as_ref().map(|m| m.0.inside()), side))
    }

    /// Saturation and noise within the mask.
    #[wasm_bindgen(unchecked_return_type = "FrameQuality")]
    pub fn quality(&self, mask: &MaskDrawing) -> Result<JsValue, JsError> {
        let merged = merge(std::slice::from_ref(&self.0), None).map_err(fail)?;
        plain(&merged.quality(&mask.0.mask().map_err(fail)?))
    }

    /// The outline of a mirror sphere in room light, outside of the object's mask where it is drawn already.
    #[wasm_bindgen(unchecked_return_type = "Outline")]
    pub fn outline(&self, object: Option<MaskDrawing>) -> Result<JsValue, JsError> {
        let bounds = object.and_then(|o| cut(&o.0.mask().ok()?).ok()).map(|(crop, _)| crop);
        let skip = |x: f64, y: f64| bounds.is_some_and(|c| c.contains(x, y));
        plain(&sphere::find_outline(&sphere::values(&self.0.image).view(), skip).map_err(fail)?)
    }

    /// The light's direction from a mirror sphere.
    #[wasm_bindgen(unchecked_return_type = "Measured")]
    pub fn measure(
        &self,
        #[wasm_bindgen(unchecked_param_type = "Outline")] circle: JsValue,
    ) -> Result<JsValue, JsError> {
        let circle: Circle = serde_wasm_bindgen::from_value(circle).map_err(fail)?;
        let r = sphere::measure(&self.0, None, &circle).map_err(fail)?;
        plain(&Measured {
            direction: r.direction,
            azimuth: light::azimuth(r.direction).to_degrees(),
            slant: light::slant(r.direction).to_degrees(),
            uncertainty: r.uncertainty,
            at: r.at,
            spot: r.spot,
        })
    }
}

/// The circle through points on the outline of a sphere: x, y in pixels, three points or more.
#[wasm_bindgen(js_name = fitCircle, unchecked_return_type = "Outline")]
pub fn fit_circle(points: &[f64]) -> Result<JsValue, JsError> {
    let points: Vec<DVec2> = points.as_chunks::<2>().0.iter().map(|p| DVec2::from_array(*p)).collect();
    plain(&sphere::fit_circle(&points).map_err(fail)?)
}

/// The mean of several pictures of a webcam, made linear.
#[wasm_bindgen]
pub struct FrameAverage(Average);

#[wasm_bindgen]
impl FrameAverage {
    /// No picture yet.
    #[wasm_bindgen(constructor)]
    pub fn new(width: u32, height: u32) -> Self {
        Self(Average::new(width, height))
    }

    /// Adds a picture: the bytes of its `ImageData`.
    pub fn add(&mut self, rgba: &[u8]) -> Result<(), JsError> {
        self.0.add(rgba).map_err(fail)
    }

    /// The mean, as an exposure of so many milliseconds.
    pub fn frame(&self, milliseconds: f64) -> Frame {
        Frame(self.0.exposure(milliseconds / 1000.0))
    }
}

/// The object's mask in the making.
#[wasm_bindgen]
#[derive(Clone)]
pub struct MaskDrawing(drawing::Drawing);

#[wasm_bindgen]
impl MaskDrawing {
    /// Nothing drawn yet.
    #[wasm_bindgen(constructor)]
    pub fn new(width: u32, height: u32) -> Self {
        Self(drawing::Drawing::new(width, height))
    }

    /// Width in pixels.
    #[wasm_bindgen(getter)]
    pub fn width(&self) -> u32 {
        self.0.width()
    }

    /// Height in pixels.
    #[wasm_bindgen(getter)]
    pub fn height(&self) -> u32 {
        self.0.height()
    }

    /// A byte for each pixel, not 0 inside.
    pub fn bytes(&self) -> Vec<u8> {
        self.0.inside().iter().map(|i| u8::from(*i)).collect()
    }

    /// From such bytes.
    pub fn of(width: u32, height: u32, bytes: &[u8]) -> Result<Self, JsError> {
        let inside: Vec<bool> = bytes.iter().map(|b| *b != 0).collect();
        Ok(Self(drawing::Drawing::of(&Mask::new(width, height, &inside).map_err(fail)?)))
    }

    /// The same once more.
    pub fn copy(&self) -> Self {
        self.clone()
    }

    /// Number of pixels inside.
    #[wasm_bindgen(getter)]
    pub fn pixels(&self) -> usize {
        self.0.inside().iter().filter(|i| **i).count()
    }

    /// Adds a polygon (x, y in pixels), or takes it away.
    pub fn polygon(&mut self, corners: &[f64], value: bool) {
        self.0.polygon(corners.as_chunks().0, value);
    }

    /// Adds what a round brush passes over, or takes it away.
    pub fn stroke(&mut self, x0: f64, y0: f64, x1: f64, y1: f64, radius: f64, value: bool) {
        self.0.stroke([x0, y0], [x1, y1], radius, value);
    }

    /// What is brighter than `level` (0 to 1 of full scale) in `frame`: its largest piece, holes filled. Without a level,
    /// the one that parts it best. Returns the level.
    pub fn threshold(&mut self, frame: &Frame, level: Option<f32>) -> Result<f32, JsError> {
        let merged = merge(std::slice::from_ref(&frame.0), None).map_err(fail)?;
        let level = level.unwrap_or_else(|| threshold_level(&merged));
        self.0 = drawing::Drawing::of(&threshold_mask(&merged, level).map_err(fail)?);
        Ok(level)
    }
}

#[derive(Serialize, Default)]
struct Doing {
    action: &'static str,
    until: Option<f64>,
    reason: Option<String>,
    doing: &'static str,
    number: usize,
    index: usize,
    exposures: usize,
    taken: usize,
    lights: usize,
    requested: Option<Vec3>,
    commanded: Option<Vec3>,
    projected: f64,
}

#[derive(Serialize)]
struct Light {
    requested: Vec3,
    commanded: Vec3,
    measured: Option<Vec3>,
    used: Vec3,
    file: String,
    projected: f64,
    off: Option<f32>,
    uncertainty: Option<f64>,
    saturated: f32,
    dark: f32,
    noise: f32,
    plan: f64,
    #[serde(rename = "move")]
    moved: f64,
    settle: f64,
    expose: f64,
    merge: f64,
    solve: f64,
}

/// How a capture is made, as the page says it.
#[derive(Clone, Deserialize)]
struct Settings {
    camera: String,
    object: String,
    material: String,
    size: u32,
    planner: String,
    solver: String,
    lights: usize,
    stop_at: Option<f32>,
    seed: u32,
    reach: f32,
    nearby: Option<f32>,
    exposures: Vec<f64>,
    settle: f64,
    brightness: f64,
    shutter: bool,
    dark: bool,
    homing: bool,
    sphere: Option<Circle>,
    misaligned: [f64; 4],
}

struct Simulation {
    scene: Scene,
    camera: SimulatedCamera,
    mount: Mount,
}

/// What a capture needs.
pub(super) struct Studio {
    simulation: Option<Simulation>,
    pub(super) capture: Capture<'static>,
    solver: Box<dyn Solver>,
    files: Vec<Write>,
    solution: Option<Solution>,
    stop_at: Option<StopAt>,
}

/// A mask over a part of the picture: what lies within the mask's bounds, and a margin for the eye.
fn cut(mask: &Mask) -> Result<(Crop, Mask), JsError> {
    const MARGIN: u32 = 4;
    let (x, y, w, h) = mask.bounds();
    let (left, top) = (x.saturating_sub(MARGIN), y.saturating_sub(MARGIN));
    let width = (x + w + MARGIN).min(mask.width()) - left;
    let height = (y + h + MARGIN).min(mask.height()) - top;
    let whole = mask.scatter(&vec![true; mask.len()], false);
    let inside: Vec<bool> = (0..width * height)
        .map(|i| whole[((top + i / width) * mask.width() + left + i % width) as usize])
        .collect();
    Ok((Crop { left, top, width, height }, Mask::new(width, height, &inside).map_err(fail)?))
}

#[wasm_bindgen]
impl Rig {
    /// Starts a capture; with `files` it goes on with that session, and what its record says counts before the settings.
    /// `mask` is needed for frames: the pixels of the object in the whole picture.
    #[wasm_bindgen(js_name = startCapture)]
    pub fn start_capture(
        &mut self,
        #[wasm_bindgen(unchecked_param_type = "CaptureSettings")] settings: JsValue,
        mask: Option<MaskDrawing>,
        files: Option<SessionFiles>,
    ) -> Result<(), JsError> {
        let wanted: Settings = serde_wasm_bindgen::from_value(settings).map_err(fail)?;
        let resumed = match files {
            Some(files) => Some(store::resume(|n| files.0.get(n).cloned()).map_err(fail)?),
            None => None,
        };
        let mut setup = wanted.setup();
        if let Some(resumed) = &resumed {
            setup.follow(&resumed.record);
        }
        setup.check().map_err(fail)?;
        let arm = resumed.as_ref().map_or(&self.arm, |r| &r.record.arm);
        match check_board(&self.link, arm, setup.options.brightness) {
            Ok(found) => {
                // The rest was told when the arm was connected.
                let told = check_board(&self.link, arm, Options::default().brightness).unwrap_or_default();
                found.into_iter().filter(|f| !told.contains(f)).for_each(|f| self.note(f.text));
            }
            Err(error) if resumed.is_none() => return Err(fail(error)),
            // A session is shown whatever the board; it does not go on with this one.
            Err(_) => {}
        }
        let simulation = setup.view().map(|view| Simulation::new(&setup, view)).transpose()?;
        let capture = match (resumed, &simulation) {
            (Some(resumed), _) => setup.go_on(&self.link, self.learned, resumed),
            (_, Some(sim)) => {
                let scene = SceneCamera::new(&sim.scene);
                let (crop, ball) = (sim.camera.crop(&scene), sim.camera.ball(&scene));
                let mask = scene.mask().clone();
                setup.begin(&self.link, self.learned, self.arm.clone(), mask, crop, ball)
            }
            _ => {
                let drawn = mask.ok_or_else(|| fail("draw the object's mask first"))?;
                let (crop, mask) = cut(&drawn.0.mask().map_err(fail)?)?;
                let (arm, ball) = (self.arm.clone(), wanted.sphere);
                setup.begin(&self.link, self.learned, arm, mask, Some(crop), ball)
            }
        };
        let capture = capture.map_err(fail)?;
        let files = capture.opening_writes().map_err(fail)?;
        let solver = solve::by_name(&wanted.solver).map_err(fail)?;
        let stop_at = wanted.stop_at.map(StopAt::new);
        let mut studio = Studio { simulation, capture, solver, files, solution: None, stop_at };
        studio.solve();
        self.studio = Some(studio);
        Ok(())
    }

    /// Ends the capture; its files stay.
    #[wasm_bindgen(js_name = endCapture)]
    pub fn end_capture(&mut self) {
        self.studio = None;
    }

    /// What the capture wants: `{ action, … }`. Plans, merges and solves by itself; `expose` and `store` are the caller's.
    #[wasm_bindgen(unchecked_return_type = "Record<string, any>")]
    pub fn step(&mut self, now: f64) -> Result<JsValue, JsError> {
        let Self { link, studio, .. } = self;
        let Some(studio) = studio else {
            return plain(&Doing { action: "none", doing: "nothing", ..Doing::default() });
        };
        let capture = &mut studio.capture;
        let mut action = capture.next(time(now), link);
        if action == Action::Plan {
            let start = clock();
            capture.plan(time(now), link).map_err(fail)?;
            capture.timings().plan = (clock() - start) / 1000.0;
            action = capture.next(time(now), link);
        }
        if action == Action::Develop {
            let start = clock();
            capture.develop(link).map_err(fail)?;
            capture.timings().merge = (clock() - start) / 1000.0;
            action = capture.next(time(now), link);
        }
        let plan = capture.current_plan();
        let mut doing = Doing {
            doing: capture.doing(),
            exposures: capture.options().exposures.len(),
            taken: capture.session().seen().len(),
            lights: capture.session().lights(),
            requested: plan.map(|p| p.requested),
            commanded: plan.map(|p| p.commanded),
            projected: plan.map_or(0.0, |p| p.projected),
            ..Doing::default()
        };
        doing.action = match action {
            Action::Wait(until) => {
                doing.until = until.map(millis);
                "wait"
            }
            Action::Expose { number, index, seconds } => {
                (doing.number, doing.index) = (number, index);
                doing.until = Some(seconds * 1000.0);
                "expose"
            }
            Action::Store(writes) => {
                studio.files = writes;
                "store"
            }
            Action::Done => "done",
            Action::Stuck(stuck) => {
                doing.reason = Some(stuck.to_string());
                if stuck == Stuck::Stopped { "stopped" } else { "stuck" }
            }
            Action::Plan | Action::Develop => "wait",
        };
        plain(&doing)
    }

    /// Takes in the exposure that was asked for.
    pub fn expose(&mut self, frame: Frame) -> Result<(), JsError> {
        let studio = self.studio.as_mut().ok_or_else(|| fail("no capture is under way"))?;
        studio.capture.exposed(frame.0).map_err(fail)
    }

    /// The simulated camera's exposure, with the light at these joint angles and brightness (of `SimulatedBoard.truth`,
    /// or as the firmware reports them).
    #[wasm_bindgen(js_name = exposeSimulated)]
    pub fn expose_simulated(
        &mut self,
        azimuth: f64,
        slant: f64,
        led: f64,
        milliseconds: f64,
    ) -> Result<(), JsError> {
        let brightness = self.link.lit(led);
        let studio = self.studio.as_mut().ok_or_else(|| fail("no capture is under way"))?;
        let sim = studio.simulation.as_mut().ok_or_else(|| fail("this capture has a camera of its own"))?;
        let direction = sim.mount.direction(Joints { azimuth, slant });
        let scene = SceneCamera::new(&sim.scene);
        let exposure =
            sim.camera.expose(&scene, direction, brightness, milliseconds / 1000.0).map_err(fail)?;
        studio.capture.exposed(exposure).map_err(fail)
    }

    /// Whether the capture's camera is simulated.
    #[wasm_bindgen(getter)]
    pub fn simulated(&self) -> bool {
        self.studio.as_ref().is_some_and(|s| s.simulation.is_some())
    }

    /// Files to write, in order: at the start, and after `store`.
    #[wasm_bindgen(js_name = takeFiles)]
    pub fn take_files(&mut self) -> Vec<SessionFile> {
        self.studio
            .as_mut()
            .map(|s| std::mem::take(&mut s.files).into_iter().map(SessionFile).collect())
            .unwrap_or_default()
    }

    /// The files of `store` are written.
    pub fn stored(&mut self) -> Result<(), JsError> {
        let studio = self.studio.as_mut().ok_or_else(|| fail("no capture is under way"))?;
        studio.capture.stored().map_err(fail)?;
        studio.solve();
        Ok(())
    }

    /// Goes on after `stuck` or `stopped`.
    pub fn retry(&mut self) {
        if let Some(studio) = &mut self.studio {
            studio.capture.retry();
        }
    }

    /// The lights so far.
    #[wasm_bindgen(unchecked_return_type = "LightTaken[]")]
    pub fn lights(&self) -> Result<JsValue, JsError> {
        let shots = self.studio.as_ref().map(|s| s.capture.record().shots.as_slice()).unwrap_or_default();
        let lights: Vec<Light> = shots
            .iter()
            .map(|s| Light {
                requested: s.requested,
                commanded: s.commanded,
                measured: s.measured,
                used: s.light(),
                file: s.file.clone(),
                projected: s.projected,
                off: s.measured.map(|m| light::angle(m, s.commanded).to_degrees()),
                uncertainty: s.uncertainty,
                saturated: s.quality.saturated,
                dark: s.quality.dark,
                noise: s.quality.noise,
                plan: s.timings.plan,
                moved: s.timings.r#move,
                settle: s.timings.settle,
                expose: s.timings.expose,
                merge: s.timings.merge,
                solve: s.timings.solve,
            })
            .collect();
        plain(&lights)
    }

    /// What was odd in this session: faults, lights taken again.
    pub fn notes(&self) -> Vec<String> {
        self.studio.as_ref().map(|s| s.capture.record().notes.clone()).unwrap_or_default()
    }

    /// Fits how the arm stands to what the mirror sphere showed in this capture; the arm then goes by it. Degrees:
    /// azimuth zero, slant zero, tilt about x and y, largest deviation before and after, number of directions.
    #[wasm_bindgen(js_name = fitMount)]
    pub fn fit_mount(&mut self) -> Result<Vec<f64>, JsError> {
        let studio = self.studio.as_ref().ok_or_else(|| fail("capture with a mirror sphere first"))?;
        let record = studio.capture.record();
        let fit = fit_mount(&record.sightings(), record.arm.mount).map_err(fail)?;
        self.arm.mount = fit.mount;
        let largest = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
        let m = fit.mount;
        let (before, after) = (largest(&fit.before), largest(&fit.residuals));
        Ok(vec![m.azimuth, m.slant, m.tilt[0], m.tilt[1], before, after, fit.residuals.len() as f64])
    }

    /// The arm's configuration as JSON, as `--config` of the command line takes it; with the board's axes, for a `Rig` that
    /// plans before it has read them itself.
    #[wasm_bindgen(js_name = armConfig)]
    pub fn arm_config(&self) -> Result<String, JsError> {
        serde_json::to_string_pretty(&with_axes(self.arm.clone(), &self.link)).map_err(fail)
    }

    /// Takes a configuration of the arm.
    #[wasm_bindgen(js_name = configureArm)]
    pub fn configure_arm(&mut self, json: &str) -> Result<(), JsError> {
        let arm: Arm = serde_json::from_str(json).map_err(fail)?;
        arm.check().map_err(fail)?;
        self.arm = arm;
        Ok(())
    }

    /// Normals as a picture, after three lights.
    pub fn normals(&self) -> Option<Picture> {
        let studio = self.studio.as_ref()?;
        Some(Picture(view::normals(studio.capture.session().mask(), &studio.solution.as_ref()?.normals)))
    }

    /// Mean angular error of the normals against the object's true ones, degrees; where those are known.
    pub fn error(&self) -> Option<f64> {
        let studio = self.studio.as_ref()?;
        let truth = studio.simulation.as_ref()?.scene.truth();
        Some(crate::error::mae(&studio.solution.as_ref()?.normals, truth))
    }

    /// The picture of light `k`, from 0.
    pub fn photo(&self, k: usize) -> Option<Picture> {
        let session = self.studio.as_ref()?.capture.session();
        let o = session.seen().get(k)?;
        let white = o.grey.iter().copied().fold(1e-6, f32::max);
        Some(Picture(view::photo(session.mask(), &o.grey, &o.rgb, &view::Tone::new(white))))
    }

    /// The object under another light: azimuth and slant in degrees.
    pub fn relight(&self, azimuth: f32, slant: f32) -> Option<Picture> {
        let studio = self.studio.as_ref()?;
        let solution = studio.solution.as_ref()?;
        let d: Vec3 = light::from_azimuth_slant(azimuth.to_radians(), slant.to_radians());
        let shaded: Vec<f32> =
            solution.normals.iter().zip(&solution.albedo).map(|(n, a)| a * n.dot(d).max(0.0)).collect();
        let white = solution.albedo.iter().copied().fold(1e-6, f32::max);
        Some(Picture(view::photo(studio.capture.session().mask(), &shaded, &[], &view::Tone::new(white))))
    }
}

impl Settings {
    /// What is asked for.
    fn setup(&self) -> Setup {
        let [azimuth, slant, x, y] = self.misaligned;
        let view = SimulatedView {
            object: self.object.clone(),
            material: self.material.clone(),
            size: self.size,
            mount: Mount { azimuth, slant, tilt: [x, y] },
        };
        Setup {
            object: self.object.clone(),
            planner: self.planner.clone(),
            lights: self.lights,
            seed: self.seed.into(),
            reach: self.reach,
            nearby: self.nearby,
            camera: if self.camera == "sim" { view.to_string() } else { "frames of the page".into() },
            black: None,
            white: None,
            ball: self.sphere.is_some(),
            options: Options {
                exposures: self.exposures.iter().map(|ms| ms / 1000.0).collect(),
                settle: self.settle,
                brightness: self.brightness,
                shutter: self.shutter,
                dark: self.dark,
                auto_home: self.homing,
                ..Options::default()
            },
        }
    }
}

impl Simulation {
    fn new(setup: &Setup, view: SimulatedView) -> Result<Self, JsError> {
        let shape = render::named(&view.object).map_err(fail)?;
        let pose = Pose::fit(&shape, shape.front()).map_err(fail)?;
        let made: Material = view.material.parse().map_err(fail)?;
        let options = SceneOptions { size: view.size, ..SceneOptions::default() };
        let scene = Scene::new(&view.object, &shape, &pose, &made.into(), &options).map_err(fail)?;
        let camera = SimulatedCamera::new(Sensor::default(), setup.seed, setup.ball);
        Ok(Self { scene, camera, mount: view.mount })
    }
}

impl Studio {
    fn solve(&mut self) {
        let start = clock();
        let session = self.capture.session();
        self.solution = session.solve(&*self.solver, session.seen().len()).ok();
        let pictures = Measurements::of(session.seen());
        if self.stop_at.is_some_and(|stop| stop.enough(&*self.solver, &pictures, session.mask())) {
            self.capture.finish();
        }
        self.capture.solved((clock() - start) / 1000.0);
    }
}
