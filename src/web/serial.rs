//! The arm in the page: the link behind any serial port, and a simulated board that looks like a port.
//!
//! Times are milliseconds of `performance.now()`; the page brings the port and its streams.

use super::studio::Studio;
use super::{fail, plain};
use crate::arm::Joints;
use crate::arm::codes;
use crate::arm::grbl::{Command, Event, Link, Phase, Trust, Way};
use crate::arm::kinematics::{Arm, Severity, check_settings};
use crate::arm::simulated::Simulated;
use crate::light;
use crate::planner::Learned;
use crate::rig::capture::Options;
use glam::Vec3;
use serde::Serialize;
#[cfg(feature = "policy")]
use std::rc::Rc;
use std::time::Duration;
use wasm_bindgen::prelude::*;

pub(super) fn time(ms: f64) -> Duration {
    Duration::from_secs_f64((ms / 1000.0).clamp(0.0, 1e9))
}

pub(super) fn millis(t: Duration) -> f64 {
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

#[derive(Serialize, Default)]
struct Shown {
    phase: &'static str,
    reason: Option<String>,
    confirmed: bool,
    state: Option<String>,
    moving: bool,
    trust: &'static str,
    homes: bool,
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

/// The host's side: link, arm and capture.
#[wasm_bindgen]
pub struct Rig {
    pub(super) link: Link,
    pub(super) arm: Arm,
    pub(super) studio: Option<Studio>,
    pub(super) learned: Option<&'static dyn Learned>,
    log: Vec<Said>,
}

#[wasm_bindgen]
impl Rig {
    /// Not connected.
    #[wasm_bindgen(constructor)]
    #[allow(clippy::new_without_default)]
    pub fn new() -> Self {
        Self { link: Link::new(), arm: Arm::default(), studio: None, learned: None, log: Vec::new() }
    }

    /// Lends it trained planners.
    #[cfg(feature = "policy")]
    #[wasm_bindgen(js_name = useModels)]
    pub fn use_models(&mut self, models: &super::Models) {
        // As long as the page lives: a planner of a capture goes on using it.
        let lent: &'static Rc<dyn Learned> = Box::leak(Box::new(models.shared()));
        self.learned = Some(&**lent);
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

    /// Puts a line of the program's own on the console.
    pub(super) fn note(&mut self, text: String) {
        self.log.push(Said { kind: "note", text });
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
            homes: link.homes(),
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
        // What a capture asks for in the end is checked when it begins.
        let brightness = Options::default().brightness;
        let found = check_settings(self.link.settings(), self.link.work_offset(), &self.arm, brightness);
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
}
