//! The capture as a state machine without I/O: plan, move, settle, expose, merge, store, and again.
//!
//! The command line, the page and the fault tests drive this one. They pass on what the link says
//! ([`Capture::event`]), ask what to do ([`Capture::next`]), do it and say so. Whatever happens to arm or cable,
//! the session holds every light before the one in flight, and goes on from there.

use super::hdr::{Exposure, HdrError, merge};
use super::setup::check_board;
use super::sphere;
use super::store::{self, Record, Resumed, Shot, StoreError, Timings, Write};
use crate::arm::grbl::{Command, Event, Failure, Link, Phase, Ticket, Trust};
use crate::arm::kinematics::Plan;
use crate::arm::line::State;
use crate::camera::Observation;
use crate::light;
use crate::session::{Session, SessionError, Step};
use glam::Vec3;
use std::time::Duration;

/// A highlight so far from the commanded direction is not the arm's LED, degrees.
const FOREIGN: f64 = 25.0;

/// How a capture is made.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Exposure times of the bracket, seconds.
    pub exposures: Vec<f64>,
    /// Rest between the end of a motion and the first exposure, seconds.
    pub settle: f64,
    /// LED brightness, spindle speed S.
    pub brightness: f64,
    /// Whether the shutter line goes high for every exposure.
    pub shutter: bool,
    /// Whether a bracket with the LED off is taken first, and subtracted.
    pub dark: bool,
    /// Whether the arm is homed without asking, at the start and after a fault. Without it, an arm that has no homing
    /// counts from where it stood when it was switched on.
    pub auto_home: bool,
    /// Faults that may be recovered from by homing before the capture gives up.
    pub recoveries: u32,
    /// How long a hold or an open door is waited for, seconds.
    pub patience: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            exposures: vec![1e-3, 3.2e-3, 10e-3],
            settle: 0.3,
            brightness: 800.0,
            shutter: false,
            dark: false,
            auto_home: true,
            recoveries: 5,
            patience: 120.0,
        }
    }
}

/// What the caller should do.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Nothing until then, or until something arrives.
    Wait(Option<Duration>),
    /// Call [`Capture::plan`].
    Plan,
    /// Take an exposure of so many seconds, then [`Capture::exposed`].
    Expose {
        /// Number of the light, from 1; 0 for a dark frame.
        number: usize,
        /// Number of the exposure, from 0.
        index: usize,
        /// Exposure time.
        seconds: f64,
    },
    /// Call [`Capture::develop`]: merge and encode.
    Develop,
    /// Write these files in this order, then [`Capture::stored`].
    Store(Vec<Write>),
    /// All lights are there and the LED is off.
    Done,
    /// It can't go on by itself. [`Capture::retry`] when what is wrong was mended.
    Stuck(Stuck),
}

/// Why a capture can't go on by itself.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Stuck {
    /// Stop was pressed.
    #[error("stopped")]
    Stopped,
    /// The port is gone.
    #[error("disconnected: {0}")]
    Disconnected(String),
    /// The arm must be homed or unlocked by a person.
    #[error("the arm is locked: {0}")]
    Locked(String),
    /// Something else.
    #[error("{0}")]
    Failed(String),
}

/// Why a step of the capture failed.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// Planner or solver.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The bracket can't be merged.
    #[error(transparent)]
    Hdr(#[from] HdrError),
    /// The session can't be written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The image does not fit the mask.
    #[error("the image is {found:?} pixels after the crop, the mask {expected:?}")]
    Size {
        /// Width and height found.
        found: (u32, u32),
        /// Those of the mask.
        expected: (u32, u32),
    },
    /// Not asked for now.
    #[error("{0} was not asked for now")]
    Order(&'static str),
    /// The bracket of a stored session began at another time.
    #[error(
        "the stored session's shortest exposure is {0} s, now {1} s: its images would not fit; use the same"
    )]
    Unit(f64, f64),
    /// A stored session belongs to another planner, seed or object.
    #[error(
        "the stored session has other pictures than this planner asks for: light {0} differs; use the same planner and seed"
    )]
    Replay(usize),
}

#[derive(Clone, Debug)]
enum Stage {
    /// Make sure that the arm can move and the LED is on.
    Ready,
    /// A command that makes it so is under way.
    Preparing(Ticket),
    Planning,
    Moving {
        plan: Plan,
        ticket: Option<Ticket>,
        since: Duration,
    },
    Settling {
        plan: Plan,
        until: Duration,
    },
    /// Without a plan: a dark frame.
    Shutter {
        plan: Option<Plan>,
        ticket: Ticket,
        open: bool,
    },
    Exposing {
        plan: Option<Plan>,
        since: Duration,
    },
    /// A status that came after the last exposure must show that nothing moved and the LED was on.
    Confirming {
        plan: Plan,
        since: Duration,
    },
    Developing {
        plan: Plan,
    },
    Storing {
        writes: Vec<Write>,
        shot: Box<Shot>,
        picture: Box<Observation>,
    },
    Closing(Option<Ticket>),
    Done,
    Stuck(Stuck),
}

/// A capture in progress.
pub struct Capture<'a> {
    session: Session<'a>,
    record: Record,
    options: Options,
    dark: Option<Vec<Exposure>>,
    stage: Stage,
    bracket: Vec<Exposure>,
    timings: Timings,
    lit: bool,
    /// The LED was switched off for the dark frames.
    unlit: bool,
    disturbed: bool,
    /// The board's settings were looked at since the port was opened.
    fits: bool,
    halted_since: Option<Duration>,
    recoveries: u32,
    next_number: usize,
}

impl<'a> Capture<'a> {
    /// A new capture.
    #[must_use]
    pub fn new(session: Session<'a>, mut record: Record, options: Options) -> Self {
        record.unit_exposure = options.exposures.iter().copied().fold(f64::INFINITY, f64::min);
        Self {
            session,
            record,
            options,
            dark: None,
            stage: Stage::Ready,
            bracket: Vec::new(),
            timings: Timings::default(),
            lit: false,
            unlit: false,
            disturbed: false,
            fits: false,
            halted_since: None,
            recoveries: 0,
            next_number: 1,
        }
    }

    /// Goes on with a session that was read back: its pictures are shown to the planner again.
    ///
    /// # Errors
    /// [`CaptureError::Replay`] where the planner would have asked for other lights.
    pub fn resume(session: Session<'a>, resumed: Resumed, options: Options) -> Result<Self, CaptureError> {
        let before = resumed.record.unit_exposure;
        let mut capture = Self::new(session, resumed.record, options);
        let now = capture.record.unit_exposure;
        if !resumed.seen.is_empty() && (before - now).abs() > 1e-6 * before {
            return Err(CaptureError::Unit(before, now));
        }
        let complete = resumed.damaged.is_empty();
        for (k, picture) in resumed.seen.into_iter().enumerate() {
            if let Step::Capture(direction) = capture.session.step()?
                && complete
                && (direction - picture.requested).length() > 1e-3
            {
                return Err(CaptureError::Replay(k + 1));
            }
            capture.session.observe(picture)?;
        }
        let number = |s: &Shot| s.file.split('.').next().and_then(|n| n.parse::<usize>().ok()).unwrap_or(0);
        capture.next_number = capture.record.shots.iter().map(number).max().unwrap_or(0) + 1;
        capture.note(format!(
            "continued after {} of {} lights",
            capture.session.seen().len(),
            capture.session.lights()
        ));
        Ok(capture)
    }

    /// Takes no further light: what there is is good enough. The LED is switched off as at the end.
    pub fn finish(&mut self) {
        self.session.finish();
    }

    /// The session so far.
    #[must_use]
    pub fn session(&self) -> &Session<'a> {
        &self.session
    }

    /// What is or will be in `session.json`.
    #[must_use]
    pub fn record(&self) -> &Record {
        &self.record
    }

    /// To set what the caller knows: camera, firmware, model.
    pub fn record_mut(&mut self) -> &mut Record {
        &mut self.record
    }

    /// How this capture is made.
    #[must_use]
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The plan of the light under way.
    #[must_use]
    pub fn current_plan(&self) -> Option<&Plan> {
        match &self.stage {
            Stage::Moving { plan, .. }
            | Stage::Settling { plan, .. }
            | Stage::Confirming { plan, .. }
            | Stage::Developing { plan } => Some(plan),
            Stage::Shutter { plan, .. } | Stage::Exposing { plan, .. } => plan.as_ref(),
            _ => None,
        }
    }

    /// What is being done, in a word.
    #[must_use]
    pub fn doing(&self) -> &'static str {
        match self.stage {
            Stage::Ready | Stage::Preparing(_) => "preparing",
            Stage::Planning => "planning",
            Stage::Moving { .. } => "moving",
            Stage::Settling { .. } => "settling",
            Stage::Shutter { .. } | Stage::Exposing { .. } | Stage::Confirming { .. } => "exposing",
            Stage::Developing { .. } => "merging",
            Stage::Storing { .. } => "storing",
            Stage::Closing(_) => "closing",
            Stage::Done => "done",
            Stage::Stuck(_) => "stuck",
        }
    }

    /// Files to write before the first light: the mask and the empty lists.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn opening_writes(&self) -> Result<Vec<Write>, StoreError> {
        let mut writes = vec![Record::mask_file(self.session.mask())?];
        writes.extend(self.record.writes());
        Ok(writes)
    }

    fn note(&mut self, text: String) {
        self.record.notes.push(text);
    }

    fn in_flight(&self) -> bool {
        self.current_plan().is_some() || matches!(self.stage, Stage::Exposing { .. } | Stage::Shutter { .. })
    }

    /// Takes in what the link says. Every event, in order.
    pub fn event(&mut self, now: Duration, event: &Event) {
        match event {
            Event::Done(ticket, result) => self.done(now, *ticket, result),
            Event::Phase(Phase::Stopped(_)) => {
                self.lit = false;
                self.stick(Stuck::Stopped);
            }
            Event::Phase(Phase::Closed(why)) => {
                self.lit = false;
                self.stick(Stuck::Disconnected(why.clone().unwrap_or_else(|| "the port was closed".into())));
            }
            Event::Alarm(_) | Event::Restarted | Event::Phase(Phase::Opening) => {
                // It may be another board by now.
                self.fits = false;
                self.lit = false;
                self.disturbed = true;
            }
            Event::Halted(State::Door(_)) => {
                self.lit = false;
                self.disturbed = true;
            }
            // A hold is noticed, but a picture at rest stays good: nothing moved and the LED is on.
            Event::State(Some(State::Run | State::Jog | State::Home))
                if matches!(self.stage, Stage::Exposing { .. } | Stage::Settling { .. }) =>
            {
                self.disturbed = true;
            }
            _ => {}
        }
    }

    fn done(&mut self, now: Duration, ticket: Ticket, result: &Result<(), Failure>) {
        let mine = match &self.stage {
            Stage::Preparing(t) | Stage::Shutter { ticket: t, .. } | Stage::Closing(Some(t)) => *t == ticket,
            Stage::Moving { ticket: Some(t), .. } => *t == ticket,
            _ => false,
        };
        if !mine {
            return;
        }
        if let Err(failure) = result {
            self.failed(failure);
            return;
        }
        self.stage = match std::mem::replace(&mut self.stage, Stage::Ready) {
            Stage::Moving { plan, since, .. } => {
                self.timings.r#move = (now.saturating_sub(since)).as_secs_f64();
                Stage::Settling {
                    plan,
                    until: now
                        + Duration::try_from_secs_f64(self.options.settle.min(60.0)).unwrap_or_default(),
                }
            }
            Stage::Shutter { plan, open: true, .. } => Stage::Exposing { plan, since: now },
            Stage::Shutter { plan: Some(plan), open: false, .. } => Stage::Confirming { plan, since: now },
            Stage::Closing(_) => Stage::Done,
            _ => Stage::Ready,
        };
    }

    fn failed(&mut self, failure: &Failure) {
        if matches!(self.stage, Stage::Stuck(_)) {
            return;
        }
        if matches!(self.stage, Stage::Closing(_)) {
            // All pictures are there; the LED could not be switched off.
            self.note(format!("at the end: {failure}"));
            self.stage = Stage::Done;
            return;
        }
        (self.lit, self.unlit) = (false, false);
        match failure {
            Failure::Stopped => self.stick(Stuck::Stopped),
            Failure::Disconnected(why) => self.stick(Stuck::Disconnected(why.clone())),
            Failure::Restarted | Failure::PositionLost | Failure::NoAnswer(_) | Failure::Cancelled => {
                self.recover(failure)
            }
            // A soft limit, a failed homing: moving again would give the same.
            Failure::Alarm(Some(2 | 8 | 9)) => self.stick(Stuck::Locked(failure.to_string())),
            Failure::Alarm(_) => self.recover(failure),
            Failure::Refused { .. } | Failure::Missed { .. } | Failure::Command(_) => {
                self.stick(Stuck::Failed(failure.to_string()));
            }
        }
    }

    fn recover(&mut self, failure: &Failure) {
        self.recoveries += 1;
        self.note(format!("light {}: {failure}", self.session.seen().len() + 1));
        if self.recoveries > self.options.recoveries {
            self.stick(Stuck::Failed(format!("{failure} (after {} recoveries)", self.options.recoveries)));
        } else {
            self.stage = Stage::Ready;
        }
    }

    fn stick(&mut self, stuck: Stuck) {
        // What was captured before it is stored; what is being stored is finished by the caller.
        if !matches!(self.stage, Stage::Done | Stage::Storing { .. } | Stage::Stuck(_)) {
            self.note(format!("light {}: {stuck}", self.session.seen().len() + 1));
            self.stage = Stage::Stuck(stuck);
        }
    }

    /// Goes on after [`Action::Stuck`].
    pub fn retry(&mut self) {
        if matches!(self.stage, Stage::Stuck(_)) {
            self.stage = Stage::Ready;
            self.halted_since = None;
        }
    }

    /// What to do now. Sends what is needed to `link`.
    pub fn next(&mut self, now: Duration, link: &mut Link) -> Action {
        if let Some(stuck) = self.waited_too_long(now, link) {
            self.stick(stuck);
        }
        if self.disturbed
            && self.in_flight()
            && !matches!(self.stage, Stage::Moving { .. } | Stage::Shutter { .. })
        {
            self.note(format!(
                "light {}: disturbed while at rest, taken again",
                self.session.seen().len() + 1
            ));
            self.stage = Stage::Ready;
        }
        match &self.stage {
            Stage::Ready => self.prepare(now, link),
            Stage::Preparing(_) | Stage::Shutter { .. } | Stage::Closing(Some(_)) => Action::Wait(None),
            Stage::Planning => Action::Plan,
            Stage::Moving { plan, ticket: None, .. } => {
                let (to, feed) = (plan.joints, self.record.arm.feed);
                match link.send(now, Command::Goto { to, feed }) {
                    Ok(ticket) => {
                        let plan = *plan;
                        self.stage = Stage::Moving { plan, ticket: Some(ticket), since: now };
                    }
                    Err(failure) => self.failed(&failure),
                }
                Action::Wait(None)
            }
            Stage::Moving { .. } => Action::Wait(None),
            Stage::Settling { until, .. } if now < *until => Action::Wait(Some(*until)),
            Stage::Settling { plan, .. } => {
                let plan = *plan;
                if link.state() != Some(State::Idle) {
                    return Action::Wait(None);
                }
                self.timings.settle = self.options.settle;
                self.expose(now, link, Some(plan))
            }
            Stage::Exposing { plan, since } => {
                let index = self.bracket.len();
                if let Some(&seconds) = self.options.exposures.get(index) {
                    let number = plan.map_or(0, |_| self.session.seen().len() + 1);
                    return Action::Expose { number, index, seconds };
                }
                let Some(plan) = *plan else {
                    self.dark = Some(std::mem::take(&mut self.bracket));
                    self.stage = Stage::Ready;
                    if self.options.shutter {
                        self.shutter(now, link, None, false);
                    }
                    return self.next(now, link);
                };
                self.timings.expose = now.saturating_sub(*since).as_secs_f64();
                if self.options.shutter {
                    self.shutter(now, link, Some(plan), false);
                    return Action::Wait(None);
                }
                self.stage = Stage::Confirming { plan, since: now };
                link.want_status();
                Action::Wait(None)
            }
            Stage::Confirming { plan, since } => {
                let plan = *plan;
                let Some(status) = link.status_after(*since) else { return Action::Wait(None) };
                let wanted = self.options.brightness.min(link.full_brightness());
                let led = status.spindle.is_none_or(|s| (s - wanted).abs() <= 1.0);
                if status.state == State::Idle && led {
                    self.stage = Stage::Developing { plan };
                    return Action::Develop;
                }
                if matches!(status.state, State::Hold(_)) {
                    link.want_status();
                    self.stage = Stage::Confirming { plan, since: now };
                    return Action::Wait(None);
                }
                self.lit = false;
                let what = if led {
                    format!("the arm was in state {}", status.state)
                } else {
                    "the LED was off".into()
                };
                self.note(format!(
                    "light {}: {what} after the exposure, taken again",
                    self.session.seen().len() + 1
                ));
                self.stage = Stage::Ready;
                self.prepare(now, link)
            }
            Stage::Developing { .. } => Action::Develop,
            Stage::Storing { writes, .. } => Action::Store(writes.clone()),
            Stage::Closing(None) => {
                match link.send(now, Command::Light(0.0)) {
                    Ok(ticket) => self.stage = Stage::Closing(Some(ticket)),
                    Err(failure) => self.failed(&failure),
                }
                Action::Wait(None)
            }
            Stage::Done => Action::Done,
            Stage::Stuck(stuck) => Action::Stuck(stuck.clone()),
        }
    }

    /// Begins a bracket; without a plan that of the dark frames.
    fn expose(&mut self, now: Duration, link: &mut Link, plan: Option<Plan>) -> Action {
        self.bracket.clear();
        if self.options.shutter {
            self.shutter(now, link, plan, true);
            return Action::Wait(None);
        }
        self.stage = Stage::Exposing { plan, since: now };
        self.next(now, link)
    }

    fn shutter(&mut self, now: Duration, link: &mut Link, plan: Option<Plan>, open: bool) {
        match link.send(now, Command::Shutter(open)) {
            Ok(ticket) => self.stage = Stage::Shutter { plan, ticket, open },
            Err(failure) => self.failed(&failure),
        }
    }

    /// Whether a hold has lasted longer than anybody would wait for.
    fn waited_too_long(&mut self, now: Duration, link: &Link) -> Option<Stuck> {
        let halted = matches!(link.state(), Some(State::Hold(_) | State::Door(_)));
        if !halted {
            self.halted_since = None;
            return None;
        }
        let since = *self.halted_since.get_or_insert(now);
        (now > since + Duration::from_secs_f64(self.options.patience))
            .then(|| Stuck::Failed("the arm was put on hold (button or door) and not resumed".into()))
    }

    /// Brings the arm to where it takes moves, and the LED on.
    fn prepare(&mut self, now: Duration, link: &mut Link) -> Action {
        match link.phase() {
            Phase::Ready => {}
            Phase::Stopped(_) => {
                self.stick(Stuck::Stopped);
                return self.next_stuck();
            }
            Phase::Closed(why) => {
                let why = why.clone().unwrap_or_else(|| "the port is not open".into());
                self.stick(Stuck::Disconnected(why));
                return self.next_stuck();
            }
            Phase::Opening | Phase::Reading => return Action::Wait(None),
        }
        let Some(state) = link.state() else { return Action::Wait(None) };
        if link.busy() {
            return Action::Wait(None);
        }
        if matches!(state, State::Hold(_) | State::Door(_)) || state.moving() {
            return Action::Wait(None);
        }
        self.disturbed = false;
        if !self.fits {
            if let Err(error) = check_board(link, &self.record.arm, self.options.brightness) {
                self.stick(Stuck::Failed(error.to_string()));
                return self.next_stuck();
            }
            self.fits = true;
        }
        let command = if matches!(state, State::Sleep | State::Check)
            || (state == State::Alarm && matches!(link.alarm(), Some(1 | 2)))
        {
            link.reset(now);
            return Action::Wait(None);
        } else if state == State::Alarm
            || link.trust() == Trust::Lost
            || (self.options.auto_home && link.trust() != Trust::Homed)
        {
            if !link.homes() {
                self.stick(Stuck::Locked("it has no homing ($22=0) and its position is not known: put it to azimuth 0, slant 0 by hand, there say “Here is 0°, 0°” in the page or switch the board off and on, and capture without homing".into()));
                return self.next_stuck();
            }
            if !self.options.auto_home {
                self.stick(Stuck::Locked("home it first".into()));
                return self.next_stuck();
            }
            Command::Home
        } else if self.session.seen().len() >= self.session.lights() {
            self.stage = Stage::Closing(None);
            return self.next(now, link);
        } else if self.options.dark && self.dark.is_none() {
            if self.unlit {
                self.unlit = false;
                return self.expose(now, link, None);
            }
            self.unlit = true;
            self.lit = false;
            Command::Light(0.0)
        } else if !self.lit {
            self.lit = true; // any fault from now on takes it back
            Command::Light(self.options.brightness)
        } else {
            self.stage = Stage::Planning;
            return Action::Plan;
        };
        match link.send(now, command) {
            Ok(ticket) => self.stage = Stage::Preparing(ticket),
            Err(failure) => self.failed(&failure),
        }
        Action::Wait(None)
    }

    fn next_stuck(&self) -> Action {
        match &self.stage {
            Stage::Stuck(stuck) => Action::Stuck(stuck.clone()),
            _ => Action::Wait(None),
        }
    }

    /// Asks the planner for the next light and the arm's kinematics for the way there.
    ///
    /// # Errors
    /// [`CaptureError::Session`] where the planner fails.
    pub fn plan(&mut self, now: Duration, link: &Link) -> Result<Option<Plan>, CaptureError> {
        if !matches!(self.stage, Stage::Planning) {
            return Err(CaptureError::Order("a plan"));
        }
        match self.session.step()? {
            Step::Done => {
                self.stage = Stage::Closing(None);
                Ok(None)
            }
            Step::Capture(direction) => {
                let from = link.joints().unwrap_or_default();
                self.record.arm.axes = link.axis_limits();
                let plan = self.record.arm.plan(direction, from);
                self.timings = Timings::default();
                self.stage = Stage::Moving { plan, ticket: None, since: now };
                Ok(Some(plan))
            }
        }
    }

    /// Durations that only the caller can measure.
    pub fn timings(&mut self) -> &mut Timings {
        match &mut self.stage {
            Stage::Storing { shot, .. } => &mut shot.timings,
            _ => &mut self.timings,
        }
    }

    /// Time of the solve of the light that was stored last; on disk with the next light.
    pub fn solved(&mut self, seconds: f64) {
        if let Some(shot) = self.record.shots.last_mut() {
            shot.timings.solve = seconds;
        }
    }

    /// Takes in an exposure.
    ///
    /// # Errors
    /// [`CaptureError::Order`] where none was asked for.
    pub fn exposed(&mut self, exposure: Exposure) -> Result<(), CaptureError> {
        if !matches!(self.stage, Stage::Exposing { .. }) || self.bracket.len() >= self.options.exposures.len()
        {
            return Err(CaptureError::Order("an exposure"));
        }
        self.bracket.push(exposure);
        Ok(())
    }

    /// Merges the bracket, and measures the light's direction where the record knows a mirror sphere.
    ///
    /// # Errors
    /// [`CaptureError`]; the light is then taken again after [`Capture::retry`].
    pub fn develop(&mut self, link: &Link) -> Result<(), CaptureError> {
        let Stage::Developing { plan } = self.stage else { return Err(CaptureError::Order("developing")) };
        let measured = self.measured(&plan);
        let result = self.developed(plan, link, measured);
        if let Err(error) = &result {
            self.stick(Stuck::Failed(error.to_string()));
        }
        result
    }

    /// What the mirror sphere shows in the shortest exposure. A highlight far from where the arm was sent is that of
    /// another lamp: it is noted and not used.
    fn measured(&mut self, plan: &Plan) -> Option<(Vec3, f64)> {
        let circle = self.record.sphere?;
        let by_time = |a: &&Exposure, b: &&Exposure| a.seconds.total_cmp(&b.seconds);
        let lit = self.bracket.iter().min_by(by_time)?;
        let dark = self.dark.as_ref().and_then(|d| d.iter().min_by(by_time));
        let said = match sphere::measure(lit, dark, &circle) {
            Ok(seen) => {
                let off = f64::from(light::angle(seen.direction, plan.commanded)).to_degrees();
                if off <= FOREIGN {
                    return Some((seen.direction, seen.uncertainty));
                }
                format!("the mirror sphere shows a light {off:.1}° from where the arm was sent")
            }
            Err(error) => error.to_string(),
        };
        self.note(format!(
            "light {}: {said}; the commanded direction is used",
            self.session.seen().len() + 1
        ));
        None
    }

    fn developed(
        &mut self,
        plan: Plan,
        link: &Link,
        measured: Option<(Vec3, f64)>,
    ) -> Result<(), CaptureError> {
        let crop = |frames: &[Exposure]| -> Result<Vec<Exposure>, CaptureError> {
            let cut = |e: &Exposure| -> Result<Exposure, CaptureError> {
                match self.record.crop {
                    Some(crop) => Ok(Exposure { image: crop.apply(&e.image)?, ..e.clone() }),
                    None => Ok(e.clone()),
                }
            };
            frames.iter().map(cut).collect()
        };
        let dark = self.dark.as_deref().map(crop).transpose()?;
        let merged = merge(&crop(&self.bracket)?, dark.as_deref())?;
        let mask = self.session.mask();
        let (found, expected) = ((merged.width, merged.height), (mask.width(), mask.height()));
        if found != expected {
            return Err(CaptureError::Size { found, expected });
        }
        let (codes, scale) = store::quantise(&mask.gather(&merged.rgb), &mask.gather(&merged.saturated));
        let (image, crc32) = store::encode_shot(self.next_number, &codes, mask)?;
        let used = measured.map_or(plan.commanded, |m| m.0);
        let picture = store::observation(plan.requested, used, &codes, scale);
        let shot = Shot {
            file: image.name.clone(),
            requested: plan.requested,
            commanded: plan.commanded,
            projected: plan.projected,
            measured: measured.map(|m| m.0),
            uncertainty: measured.map(|m| m.1),
            joints: plan.joints,
            reported: link.joints(),
            exposures: self.options.exposures.clone(),
            scale,
            quality: merged.quality(mask),
            crc32,
            timings: self.timings,
        };
        let mut next = self.record.clone();
        next.shots.push(shot.clone());
        let mut writes = vec![image];
        writes.extend(next.writes());
        self.bracket.clear();
        self.stage = Stage::Storing { writes, shot: Box::new(shot), picture: Box::new(picture) };
        Ok(())
    }

    /// The files were written: the light counts.
    ///
    /// # Errors
    /// [`CaptureError`].
    pub fn stored(&mut self) -> Result<(), CaptureError> {
        match std::mem::replace(&mut self.stage, Stage::Ready) {
            Stage::Storing { shot, picture, .. } => {
                self.session.observe(*picture)?;
                self.record.shots.push(*shot);
                self.next_number += 1;
                Ok(())
            }
            other => {
                self.stage = other;
                Err(CaptureError::Order("storing"))
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
