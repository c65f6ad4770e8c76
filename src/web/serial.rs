//! The rig in the page: an arm behind any serial port, a capture, and a simulated board that looks like a port.
//!
//! Times are milliseconds of `performance.now()`; the page brings the port, its streams and its storage.

use super::picture::Picture;
use super::{fail, plain};
use crate::arm::Joints;
use crate::arm::codes;
use crate::arm::grbl::{Command, Event, Link, Phase, Trust, Way};
use crate::arm::kinematics::{Arm, Mount, Severity, check_settings};
use crate::arm::simulated::Simulated;
use crate::camera::{Camera as _, Domain};
use crate::dataset::archive::write_zip;
use crate::light;
use crate::planner::{self, Setup};
use crate::render::{self, Material, Options as SceneOptions, Pose, Scene, SceneCamera};
use crate::rig::camera::Sensor;
use crate::rig::capture::{Action, Capture, Options, Stuck};
use crate::rig::store::{self, Record, Write};
use crate::rng::Rng;
use crate::session::Session;
use crate::solve::{self, Solution};
use crate::view;
use glam::Vec3;
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Duration;
use wasm_bindgen::prelude::*;

fn time(ms: f64) -> Duration {
    Duration::from_secs_f64((ms / 1000.0).clamp(0.0, 1e9))
}

fn millis(t: Duration) -> f64 {
    t.as_secs_f64() * 1000.0
}

/// A simulated board: stock Grbl 1.1h on an Uno with the arm of the guide. A page makes a serial port of it.
#[wasm_bindgen]
pub struct SimulatedBoard(Simulated);

#[wasm_bindgen]
impl SimulatedBoard {
    /// With the settings of the integration guide (`guide`), or as flashed (`stock`).
    #[wasm_bindgen(constructor)]
    pub fn new(kind: &str) -> Result<Self, JsError> {
        match kind {
            "guide" => Ok(Self(Simulated::arm())),
            "stock" => Ok(Self(Simulated::stock())),
            _ => Err(fail(format!("no board '{kind}': guide or stock"))),
        }
    }

    /// The port is opened: the board restarts.
    pub fn open(&mut self, now: f64) {
        self.0.open(time(now));
    }

    /// The port is closed.
    pub fn close(&mut self, now: f64) {
        self.0.close(time(now));
    }

    /// Power is cut and comes back.
    pub fn restart(&mut self) {
        self.0.power_on();
    }

    /// Bytes from the host.
    pub fn write(&mut self, now: f64, bytes: &[u8]) {
        self.0.feed(time(now), bytes);
    }

    /// Bytes that have reached the host.
    pub fn read(&mut self, now: f64) -> Vec<u8> {
        let mut out = Vec::new();
        self.0.drain(time(now), &mut out);
        out
    }

    /// When more may come, if known.
    pub fn next(&self) -> Option<f64> {
        self.0.next().map(millis)
    }

    /// Where the light really is, joint angles in degrees, and its brightness.
    pub fn truth(&self) -> Vec<f64> {
        let t = self.0.truth();
        vec![t.joints.azimuth, t.joints.slant, t.led]
    }

    /// Lines the firmware has read so far, for tests.
    pub fn lines(&self) -> Vec<String> {
        self.0.lines().iter().map(|l| l.1.clone()).collect()
    }
}

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

    /// What the session is, or why it is none.
    #[wasm_bindgen(
        unchecked_return_type = "{ object: string; planner: string; lights: number; taken: number; damaged: string[] }"
    )]
    pub fn summary(&self) -> Result<JsValue, JsError> {
        let r = store::resume(|n| self.0.get(n).cloned()).map_err(fail)?;
        plain(&Summary {
            object: r.record.object,
            planner: r.record.planner,
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
    lights: usize,
    taken: usize,
    damaged: Vec<String>,
}

#[derive(Serialize, Default)]
struct Shown {
    phase: &'static str,
    reason: Option<String>,
    confirmed: bool,
    state: Option<String>,
    moving: bool,
    trust: &'static str,
    alarm: Option<u8>,
    advice: Option<&'static str>,
    azimuth: Option<f64>,
    slant: Option<f64>,
    direction: Option<Vec3>,
    led: Option<f64>,
    version: String,
    busy: bool,
}

#[derive(Serialize)]
struct Said {
    kind: &'static str,
    text: String,
}

#[derive(Serialize, Default)]
struct Doing {
    action: &'static str,
    until: Option<f64>,
    reason: Option<String>,
    doing: &'static str,
    taken: usize,
    lights: usize,
    requested: Option<Vec3>,
    commanded: Option<Vec3>,
    projected: f64,
}

#[derive(Serialize)]
struct Light {
    requested: Vec3,
    used: Vec3,
    file: String,
    projected: f64,
    saturated: f32,
    dark: f32,
    noise: f32,
    #[serde(rename = "move")]
    moved: f64,
    expose: f64,
}

struct Studio {
    scene: Scene,
    sensor: Sensor,
    rng: Rng,
    capture: Capture<'static>,
    files: Vec<Write>,
    solution: Option<Solution>,
}

/// The host's side: link, arm and capture.
#[wasm_bindgen]
pub struct Rig {
    link: Link,
    arm: Arm,
    studio: Option<Studio>,
    log: Vec<Said>,
}

#[wasm_bindgen]
impl Rig {
    /// Not connected.
    #[wasm_bindgen(constructor)]
    #[allow(clippy::new_without_default)]
    pub fn new() -> Self {
        Self { link: Link::new(), arm: Arm::default(), studio: None, log: Vec::new() }
    }

    // ---- port ----

    /// The port was opened.
    pub fn opened(&mut self, now: f64) {
        self.link.opened(time(now));
    }

    /// The port was closed, or lost (then with the reason).
    pub fn closed(&mut self, reason: Option<String>) {
        self.link.closed(reason);
        self.events(0.0);
    }

    /// Bytes that arrived.
    pub fn receive(&mut self, now: f64, bytes: &[u8]) {
        self.link.receive(time(now), bytes);
        self.events(now);
    }

    /// Does what is due, and returns the bytes to write.
    pub fn tick(&mut self, now: f64) -> Vec<u8> {
        self.link.tick(time(now));
        self.events(now);
        self.link.take_output()
    }

    /// Bytes to write now.
    #[wasm_bindgen(js_name = takeOutput)]
    pub fn take_output(&mut self) -> Vec<u8> {
        self.link.take_output()
    }

    /// When `tick` is due at the latest.
    pub fn wake(&self, now: f64) -> Option<f64> {
        self.link.next_wake(time(now)).map(millis)
    }

    fn events(&mut self, now: f64) {
        while let Some(event) = self.link.take_event() {
            if let Some(studio) = &mut self.studio {
                studio.capture.event(time(now), &event);
            }
            let said = match &event {
                Event::Log(Way::Sent, text) => Some(("sent", text.clone())),
                Event::Log(Way::Received, text) => Some(("received", text.clone())),
                Event::Log(Way::Note, text) => Some(("note", text.clone())),
                Event::Done(_, Err(failure)) => Some(("failed", failure.to_string())),
                Event::Alarm(code) => Some(("failed", format!("alarm {code}: {}", codes::alarm(*code)))),
                Event::Restarted => {
                    Some(("failed", "the board restarted by itself: its position is lost, home it".into()))
                }
                Event::Halted(state) => {
                    Some(("failed", format!("the arm was halted ({state}): resume when all is clear")))
                }
                _ => None,
            };
            if let Some((kind, text)) = said {
                self.log.push(Said { kind, text });
            }
        }
    }

    /// Console lines and failures since the last call: `{ kind, text }`.
    #[wasm_bindgen(js_name = takeLog, unchecked_return_type = "{ kind: string; text: string }[]")]
    pub fn take_log(&mut self) -> Result<JsValue, JsError> {
        plain(&std::mem::take(&mut self.log))
    }

    /// What is shown of the arm.
    #[wasm_bindgen(unchecked_return_type = "Record<string, any>")]
    pub fn shown(&self) -> Result<JsValue, JsError> {
        let link = &self.link;
        let joints = link.joints();
        let (phase, reason, confirmed) = match link.phase() {
            Phase::Closed(why) => ("closed", why.clone(), false),
            Phase::Opening => ("opening", None, false),
            Phase::Reading => ("reading", None, false),
            Phase::Ready => ("ready", None, false),
            Phase::Stopped(confirmed) => ("stopped", None, *confirmed),
        };
        plain(&Shown {
            phase,
            reason,
            confirmed,
            state: link.state().map(|s| s.to_string()),
            moving: link.state().is_some_and(|s| s.moving()),
            trust: match link.trust() {
                Trust::Homed => "homed",
                Trust::Assumed => "assumed",
                Trust::Lost => "lost",
            },
            alarm: link.alarm(),
            advice: link.alarm().map(codes::alarm),
            azimuth: joints.map(|j| j.azimuth),
            slant: joints.map(|j| j.slant),
            direction: joints.map(|j| self.arm.direction(j)),
            led: link.status().and_then(|s| s.spindle),
            version: link.version().into(),
            busy: link.busy(),
        })
    }

    /// What does not fit in the firmware's settings: `{ kind: "error" | "warning", text }`.
    #[wasm_bindgen(unchecked_return_type = "{ kind: \"error\" | \"warning\"; text: string }[]")]
    pub fn findings(&self) -> Result<JsValue, JsError> {
        let found = check_settings(self.link.settings(), self.link.work_offset(), &self.arm, 800.0);
        let said: Vec<Said> = found
            .into_iter()
            .map(|f| Said {
                kind: if f.severity == Severity::Error { "error" } else { "warning" },
                text: f.text,
            })
            .collect();
        plain(&said)
    }

    /// Limits of the arm, degrees: azimuth from, to, slant from, to, half-angle of the keep-out cone.
    pub fn limits(&self) -> Vec<f64> {
        let l = self.arm.limits;
        vec![l.azimuth[0], l.azimuth[1], l.slant[0], l.slant[1], l.keep_out]
    }

    // ---- commands ----

    fn command(&mut self, now: f64, command: Command) -> Result<(), JsError> {
        let sent = self.link.send(time(now), command).map_err(fail);
        self.events(now);
        sent.map(|_| ())
    }

    /// Homing cycle.
    pub fn home(&mut self, now: f64) -> Result<(), JsError> {
        self.command(now, Command::Home)
    }

    /// Unlock: takes the position for right.
    pub fn unlock(&mut self, now: f64) -> Result<(), JsError> {
        self.command(now, Command::Unlock)
    }

    /// Bring the light to a direction, degrees; returns by how much it had to be projected.
    pub fn goto(&mut self, now: f64, azimuth: f64, slant: f64) -> Result<f64, JsError> {
        if !(azimuth.abs() <= 360.0 && slant.abs() <= 90.0) {
            return Err(fail("azimuth −360 to 360 and slant −90 to 90 are possible"));
        }
        let d = light::from_azimuth_slant(azimuth.to_radians() as f32, slant.to_radians() as f32);
        self.arm.axes = self.link.axis_limits();
        let plan = self.arm.plan(d, self.link.joints().unwrap_or_default());
        self.command(now, Command::Goto { to: plan.joints, feed: self.arm.feed })?;
        Ok(plan.projected)
    }

    /// Move the joints by some degrees.
    pub fn jog(&mut self, now: f64, azimuth: f64, slant: f64) -> Result<(), JsError> {
        self.command(now, Command::Jog { by: Joints { azimuth, slant }, feed: 1200.0 })
    }

    /// End a jog.
    #[wasm_bindgen(js_name = jogCancel)]
    pub fn jog_cancel(&mut self) {
        self.link.jog_cancel();
    }

    /// LED brightness, 0 is off.
    pub fn light(&mut self, now: f64, brightness: f64) -> Result<(), JsError> {
        self.command(now, Command::Light(brightness))
    }

    /// Here is azimuth, slant.
    #[wasm_bindgen(js_name = setPosition)]
    pub fn set_position(&mut self, now: f64, azimuth: f64, slant: f64) -> Result<(), JsError> {
        self.command(now, Command::SetPosition(Joints { azimuth, slant }))
    }

    /// A line as typed.
    pub fn raw(&mut self, now: f64, line: &str) -> Result<(), JsError> {
        self.command(now, Command::Raw(line.into()))
    }

    /// Feed hold.
    pub fn hold(&mut self) {
        self.link.hold();
    }

    /// Resume.
    pub fn resume(&mut self) -> Result<(), JsError> {
        self.link.resume().map_err(fail)
    }

    /// Stop. The bytes are in `takeOutput` alone and first.
    pub fn stop(&mut self, now: f64) {
        self.link.stop(time(now));
        self.events(now);
    }

    /// Ends Stop.
    pub fn release(&mut self, now: f64) -> Result<(), JsError> {
        let done = self.link.release(time(now)).map_err(fail);
        self.events(now);
        done
    }

    /// Soft reset, after a limit alarm.
    pub fn reset(&mut self, now: f64) {
        self.link.reset(time(now));
        self.events(now);
    }

    // ---- capture ----

    /// A capture of a rendered object under the arm's light. With `files` it goes on with that session.
    #[wasm_bindgen(js_name = startCapture)]
    #[allow(clippy::too_many_arguments)]
    pub fn start_capture(
        &mut self,
        object: &str,
        material: &str,
        size: u32,
        planner_name: &str,
        lights: usize,
        seed: u32,
        files: Option<SessionFiles>,
    ) -> Result<(), JsError> {
        let resumed = match files {
            Some(files) => Some(store::resume(|n| files.0.get(n).cloned()).map_err(fail)?),
            None => None,
        };
        // The record knows what the scene was: "sim OBJECT+MATERIAL SIZE".
        let stored = resumed.as_ref().map(|r| r.record.camera.clone());
        let (object, material, size) = match stored.as_deref().and_then(parse_scene) {
            Some(scene) => scene,
            None => (object.to_string(), material.to_string(), size),
        };
        let (planner_name, lights, seed) = match &resumed {
            Some(r) => (r.record.planner.clone(), r.record.lights, r.record.seed),
            None => (planner_name.to_string(), lights, u64::from(seed)),
        };
        if !(3..=500).contains(&lights) {
            return Err(fail(format!("{lights} lights: 3 to 500 are possible")));
        }
        let shape = render::named(&object).map_err(fail)?;
        let pose = Pose::fit(&shape, shape.front()).map_err(fail)?;
        let made: Material = material.parse().map_err(fail)?;
        let options = SceneOptions { size, ..SceneOptions::default() };
        let scene = Scene::new(&object, &shape, &pose, &made.into(), &options).map_err(fail)?;
        let mask = SceneCamera::new(&scene).mask().clone();
        let setup = Setup { lights, seed, draw: 0, camera: None, truth: None, learned: None };
        let planner = planner::build(&planner_name, &setup).map_err(fail)?;
        let reach = 75f32.to_radians();
        let session = Session::new(mask, Domain::Hemisphere { reach }, planner, lights);
        let capture = match resumed {
            Some(resumed) => Capture::resume(session, resumed, Options::default(), None).map_err(fail)?,
            None => {
                let mut record = Record::new(&object, &planner_name, seed, lights, self.arm.clone());
                record.camera = format!("sim {object}+{material} {size}");
                record.firmware = format!("Grbl {}", self.link.version());
                Capture::new(session, record, Options::default(), None)
            }
        };
        let files = capture.opening_writes().map_err(fail)?;
        let mut studio =
            Studio { scene, sensor: Sensor::default(), rng: Rng::new(seed), capture, files, solution: None };
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
            capture.plan(time(now), link).map_err(fail)?;
            action = capture.next(time(now), link);
        }
        if action == Action::Develop {
            capture.develop(link, None).map_err(fail)?;
            action = capture.next(time(now), link);
        }
        let plan = capture.current_plan();
        let mut doing = Doing {
            doing: capture.doing(),
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
            Action::Expose { seconds, .. } => {
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

    /// The simulated camera's exposure, with the light at these joint angles and brightness (of `SimulatedBoard.truth`,
    /// or as the firmware reports them).
    #[wasm_bindgen(js_name = exposeSimulated)]
    pub fn expose_simulated(
        &mut self,
        azimuth: f64,
        slant: f64,
        led: f64,
        seconds: f64,
    ) -> Result<(), JsError> {
        let studio = self.studio.as_mut().ok_or_else(|| fail("no capture is under way"))?;
        let direction = Mount::default().direction(Joints { azimuth, slant });
        let mask = &studio.scene.view.mask;
        let brightness = (led / 1000.0).clamp(0.0, 1.0) as f32;
        let mut rgb = vec![[0.0; 3]; mask.len()];
        if brightness > 0.0 && direction.z > 0.0 {
            rgb = studio.scene.render(direction);
            rgb.iter_mut().flatten().for_each(|v| *v *= brightness);
        }
        let picture = mask.scatter(&rgb, [0.0; 3]);
        let exposure = studio.sensor.expose(mask.width(), mask.height(), &picture, seconds, &mut studio.rng);
        studio.capture.exposed(exposure).map_err(fail)
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
    #[wasm_bindgen(unchecked_return_type = "Record<string, any>[]")]
    pub fn lights(&self) -> Result<JsValue, JsError> {
        let shots = self.studio.as_ref().map(|s| s.capture.record().shots.as_slice()).unwrap_or_default();
        let lights: Vec<Light> = shots
            .iter()
            .map(|s| Light {
                requested: s.requested,
                used: s.light(),
                file: s.file.clone(),
                projected: s.projected,
                saturated: s.quality.saturated,
                dark: s.quality.dark,
                noise: s.quality.noise,
                moved: s.timings.r#move,
                expose: s.timings.expose,
            })
            .collect();
        plain(&lights)
    }

    /// Normals as a picture, after three lights.
    pub fn normals(&self) -> Option<Picture> {
        let studio = self.studio.as_ref()?;
        Some(Picture(view::normals(studio.capture.session().mask(), &studio.solution.as_ref()?.normals)))
    }

    /// Mean angular error of the normals against the object's true ones, degrees.
    pub fn error(&self) -> Option<f64> {
        let studio = self.studio.as_ref()?;
        Some(crate::error::mae(&studio.solution.as_ref()?.normals, studio.scene.truth()))
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

impl Studio {
    fn solve(&mut self) {
        let session = self.capture.session();
        self.solution =
            solve::by_name("ls").ok().and_then(|solver| session.solve(&*solver, session.seen().len()).ok());
    }
}

fn parse_scene(camera: &str) -> Option<(String, String, u32)> {
    let (scene, size) = camera.strip_prefix("sim ")?.rsplit_once(' ')?;
    let (object, material) = scene.split_once('+')?;
    Some((object.into(), material.into(), size.parse().ok()?))
}
