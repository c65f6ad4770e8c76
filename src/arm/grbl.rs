//! The host's side of the link to a Grbl 1.1, as a state machine without I/O.
//!
//! Give it the bytes that arrive ([`Link::receive`]) and the time ([`Link::tick`]); write what
//! [`Link::take_output`] gives; read [`Link::take_event`]. One line is under way at a time (send, wait for its
//! `ok` or `error:N`); pushed lines (status, messages, alarms, a new banner) are no answers.
//!
//! A move is `G1 …` and `G4 P0.05`, whose `ok` comes when the motion has ended, then a status report that must
//! show the commanded position: bytes get lost and garbled on a long cable, and the firmware has no checksum.
//! Every line stands for itself (units, distance mode, feed), so that a reset in between changes nothing.

use super::Joints;
use super::codes;
use super::line::{self, Line, Splitter, State, Status};
use super::motion::{AxisLimits, Move};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// Number of a command, given back when it is done.
pub type Ticket = u32;

const fn ms(n: u64) -> Duration {
    Duration::from_millis(n)
}

/// Spacing of `?`: Grbl asks for 5 Hz at most.
const POLL: Duration = ms(200);
/// Spacing of `?` when nothing is under way.
const IDLE_POLL: Duration = ms(1000);
/// An Uno's bootloader takes 1.5 s; then the banner must come, else a soft reset asks for it.
const BANNER: Duration = ms(2500);
/// Time for an answer that needs no motion. `$$` takes 100 ms, an EEPROM write 300 ms.
const ANSWER: Duration = ms(1500);
/// No status for so long: the shown state is not known any more.
const STALE: Duration = ms(1500);
/// No status for so long: the board is gone.
const SILENT: Duration = ms(4000);
/// Between repeats of the reset after Stop, until the banner proves that it arrived.
const STOP_REPEAT: Duration = ms(300);
/// Tries of a command whose answer got lost.
const TRIES: u32 = 3;

/// What the rig asks of the arm.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// Homing cycle, `$H`.
    Home,
    /// `$X`: take the position for right and unlock.
    Unlock,
    /// Move to joint angles, degrees (work coordinates), at a feed in degrees a minute.
    Goto {
        /// Where to.
        to: Joints,
        /// Degrees a minute along the path.
        feed: f64,
    },
    /// Move by some degrees; ends early on [`Link::jog_cancel`].
    Jog {
        /// By how much.
        by: Joints,
        /// Degrees a minute.
        feed: f64,
    },
    /// LED brightness as spindle speed; 0 is off.
    Light(f64),
    /// Shutter line (coolant).
    Shutter(bool),
    /// The arm stands at these angles now: sets the work offset G54 (`G10 L20 P1`).
    SetPosition(Joints),
    /// Read all settings again.
    Settings,
    /// A line as typed. Its answer ends it.
    Raw(String),
}

/// Why a command was not carried out.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Failure {
    /// Stop was pressed; nothing is sent until it is released.
    #[error("stopped: release Stop before anything else is sent")]
    Stopped,
    /// The port is not open, or went away.
    #[error("not connected: {0}")]
    Disconnected(String),
    /// `error:N`.
    #[error("the firmware refused '{line}': error {code}, {}", codes::error(*.code))]
    Refused {
        /// What was sent.
        line: String,
        /// Number of the error.
        code: u8,
    },
    /// `ALARM:N`, or found in alarm.
    #[error("alarm{}", .0.map_or(String::from(" (locked): home or unlock first"), |n| format!(" {n}: {}", codes::alarm(n))))]
    Alarm(Option<u8>),
    /// The board restarted by itself.
    #[error("the board restarted by itself (power, reset button, cable): its position is lost, home it")]
    Restarted,
    /// An earlier command failed.
    #[error("not sent, because an earlier command failed")]
    Cancelled,
    /// The position is not known.
    #[error("the position is lost: home the arm (or set its position by hand) before moving it")]
    PositionLost,
    /// No answer, several times.
    #[error("no answer to '{0}' in {TRIES} tries: check the cable")]
    NoAnswer(String),
    /// The firmware says it is somewhere else than it was sent.
    #[error("the arm is at azimuth {:.3}°, slant {:.3}° instead of {:.3}°, {:.3}°", .at.azimuth, .at.slant, .to.azimuth, .to.slant)]
    Missed {
        /// Where it was sent.
        to: Joints,
        /// Where it says it is.
        at: Joints,
    },
    /// A number in the command is not usable.
    #[error("{0}")]
    Command(String),
}

/// How far the position can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trust {
    /// Homed since power-on.
    Homed,
    /// No homing: counted from where the arm stood, or unlocked by hand.
    Assumed,
    /// Lost: a reset in motion, a hard limit, a restart.
    Lost,
}

/// The link as a whole.
#[derive(Clone, Debug, PartialEq)]
pub enum Phase {
    /// Port closed; why, where it was lost.
    Closed(Option<String>),
    /// Port open, waiting for the banner.
    Opening,
    /// Banner seen; reading the settings.
    Reading,
    /// Takes commands.
    Ready,
    /// Stop was sent; `true` once the firmware's banner proved it.
    Stopped(bool),
}

/// Which way a console line went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// To the firmware.
    Sent,
    /// From the firmware.
    Received,
    /// A remark of the link itself.
    Note,
}

/// What happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The phase changed.
    Phase(Phase),
    /// The firmware's state changed; `None` when it is not known any more.
    State(Option<State>),
    /// A status report with a position.
    Position(Joints),
    /// `ALARM:N`.
    Alarm(u8),
    /// The board restarted without being asked.
    Restarted,
    /// The arm was halted without being asked (button, door, or a byte gone wrong).
    Halted(State),
    /// A command ended.
    Done(Ticket, Result<(), Failure>),
    /// A console line.
    Log(Way, String),
}

#[derive(Clone, Debug)]
struct Operation {
    ticket: Ticket,
    command: Command,
    /// Lines still to be sent.
    lines: VecDeque<String>,
    tries: u32,
    /// Expected time of motion.
    motion: Duration,
}

#[derive(Clone, Debug)]
enum Stage {
    /// A line was sent and not answered.
    Line { text: String, sent: Duration, deadline: Duration },
    /// The answer is overdue: asked for a status.
    Overdue { text: String, asked: Duration, times: u32 },
    /// Reset to get back in step, waiting for the banner.
    Resync { since: Duration, times: u32 },
    /// All lines answered; a status must show that it is so.
    Verify { asked: Duration, times: u32 },
    /// A jog runs until the firmware is idle again.
    Jogging { since: Duration },
}

/// The host's side of one arm.
#[derive(Clone, Debug)]
pub struct Link {
    phase: Phase,
    splitter: Splitter,
    out: Vec<u8>,
    events: VecDeque<Event>,
    queue: VecDeque<Operation>,
    current: Option<(Operation, Stage)>,
    next_ticket: Ticket,
    version: String,
    settings: BTreeMap<u16, f64>,
    work_offset: Option<[f64; 3]>,
    state: Option<State>,
    machine: Option<[f64; 3]>,
    status: Option<Status>,
    trust: Trust,
    alarm: Option<u8>,
    heard: Duration,
    asked: Option<Duration>,
    /// When `Opening` began, or the last reset after Stop was sent.
    since: Duration,
    attempts: u32,
    /// A reset of ours is on its way: the next banner is no surprise.
    resetting: bool,
    /// A hold of ours is on.
    holding: bool,
    /// Commands have been taken before: a board without homing that restarts stands anywhere.
    ever_ready: bool,
    status_time: Option<Duration>,
    wanted: bool,
}

impl Default for Link {
    fn default() -> Self {
        Self::new()
    }
}

impl Link {
    /// A link whose port is not open yet.
    #[must_use]
    pub fn new() -> Self {
        Self {
            phase: Phase::Closed(None),
            splitter: Splitter::default(),
            out: Vec::new(),
            events: VecDeque::new(),
            queue: VecDeque::new(),
            current: None,
            next_ticket: 1,
            version: String::new(),
            settings: BTreeMap::new(),
            work_offset: None,
            state: None,
            machine: None,
            status: None,
            trust: Trust::Lost,
            alarm: None,
            heard: Duration::ZERO,
            asked: None,
            since: Duration::ZERO,
            attempts: 0,
            resetting: false,
            holding: false,
            ever_ready: false,
            status_time: None,
            wanted: false,
        }
    }

    // ---- what is known ----

    /// The link as a whole.
    #[must_use]
    pub fn phase(&self) -> &Phase {
        &self.phase
    }

    /// The firmware's state, as far as it is known to be true.
    #[must_use]
    pub fn state(&self) -> Option<State> {
        self.state
    }

    /// The alarm that locked the firmware, where its number was heard.
    #[must_use]
    pub fn alarm(&self) -> Option<u8> {
        self.alarm
    }

    /// How far [`Link::joints`] can be trusted.
    #[must_use]
    pub fn trust(&self) -> Trust {
        self.trust
    }

    /// Joint angles last reported.
    #[must_use]
    pub fn joints(&self) -> Option<Joints> {
        let (machine, offset) = (self.machine?, self.work_offset?);
        Some(Joints { azimuth: machine[0] - offset[0], slant: machine[1] - offset[1] })
    }

    /// The last status report.
    #[must_use]
    pub fn status(&self) -> Option<&Status> {
        self.status.as_ref()
    }

    /// The last status report, if it came after `since`.
    #[must_use]
    pub fn status_after(&self, since: Duration) -> Option<&Status> {
        self.status.as_ref().filter(|_| self.status_time.is_some_and(|t| t > since))
    }

    /// Asks for a status report as soon as the 5 Hz allow.
    pub fn want_status(&mut self) {
        self.wanted = true;
    }

    /// Version of the firmware, as "1.1h".
    #[must_use]
    pub fn version(&self) -> &str {
        &self.version
    }

    /// Whether the board can home (setting $22); false while its settings are not known.
    #[must_use]
    pub fn homes(&self) -> bool {
        self.settings.get(&22).is_some_and(|v| *v != 0.0)
    }

    /// The `$` settings read.
    #[must_use]
    pub fn settings(&self) -> &BTreeMap<u16, f64> {
        &self.settings
    }

    /// Work coordinate offset (machine position of azimuth 0, slant 0).
    #[must_use]
    pub fn work_offset(&self) -> Option<[f64; 3]> {
        self.work_offset
    }

    /// Whether a command is under way or waits.
    #[must_use]
    pub fn busy(&self) -> bool {
        self.current.is_some() || !self.queue.is_empty()
    }

    /// Rate and acceleration of the two axes, from the settings; Grbl's defaults until they are read.
    #[must_use]
    pub fn axis_limits(&self) -> [AxisLimits; 2] {
        let get =
            |n: u16, default: f64| self.settings.get(&n).copied().filter(|v| *v > 0.0).unwrap_or(default);
        [0, 1].map(|i| AxisLimits { rate: get(110 + i, 500.0), acceleration: get(120 + i, 10.0) })
    }

    /// Spindle speed at which the LED is fully lit, the most that the firmware ever reports; Grbl's default until it is read.
    #[must_use]
    pub fn full_brightness(&self) -> f64 {
        self.settings.get(&30).copied().unwrap_or(1000.0)
    }

    /// What the LED gives at a reported spindle speed, 0 to 1. A board with `$30=0` reports 0 whatever it does.
    #[must_use]
    pub fn lit(&self, speed: f64) -> f32 {
        let full = self.full_brightness();
        if full > 0.0 { (speed / full).clamp(0.0, 1.0) as f32 } else { 0.0 }
    }

    // ---- the port ----

    /// The port was opened.
    pub fn opened(&mut self, now: Duration) {
        self.splitter.clear();
        self.out.clear();
        self.forget();
        self.since = now;
        self.heard = now;
        self.attempts = 0;
        self.resetting = false;
        self.set_phase(Phase::Opening);
    }

    /// The port was closed, or went away.
    pub fn closed(&mut self, reason: Option<String>) {
        if matches!(self.phase, Phase::Closed(_)) {
            return;
        }
        self.out.clear();
        let why = reason.clone().unwrap_or_else(|| "the port was closed".into());
        self.fail_all(Failure::Disconnected(why));
        self.forget();
        self.trust = Trust::Lost;
        self.set_phase(Phase::Closed(reason));
    }

    fn forget(&mut self) {
        self.set_state(None);
        self.machine = None;
        self.status = None;
        self.status_time = None;
        self.work_offset = None;
        self.alarm = None;
        self.asked = None;
        self.holding = false;
    }

    /// Bytes to write now, in order; empty when there are none.
    #[must_use]
    pub fn take_output(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.out)
    }

    /// The next thing that happened.
    pub fn take_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    // ---- commands ----

    /// Queues a command. [`Event::Done`] with the same ticket tells its end.
    ///
    /// # Errors
    /// [`Failure`] where it can't be taken at all; nothing is sent then.
    pub fn send(&mut self, now: Duration, command: Command) -> Result<Ticket, Failure> {
        match &self.phase {
            Phase::Ready => {}
            Phase::Stopped(_) => return Err(Failure::Stopped),
            Phase::Closed(why) => {
                return Err(Failure::Disconnected(why.clone().unwrap_or("open the port first".into())));
            }
            Phase::Opening | Phase::Reading => {
                return Err(Failure::Disconnected("the firmware has not said hello yet".into()));
            }
        }
        self.admit(&command)?;
        Ok(self.enqueue(now, command))
    }

    fn admit(&self, command: &Command) -> Result<(), Failure> {
        let finite = |j: &Joints, feed: f64| {
            let ok = j.azimuth.abs() <= 3600.0 && j.slant.abs() <= 3600.0 && feed > 0.0 && feed.is_finite();
            ok.then_some(()).ok_or_else(|| {
                let Joints { azimuth, slant } = j;
                Failure::Command(format!(
                    "azimuth {azimuth}, slant {slant}, feed {feed}: angles and a positive feed are needed"
                ))
            })
        };
        let moves = match command {
            Command::Goto { to, feed } => {
                finite(to, *feed)?;
                true
            }
            Command::Jog { by, feed } => {
                finite(by, *feed)?;
                false // a jog frees an arm whose position is lost
            }
            Command::SetPosition(at) => {
                finite(at, 1.0)?;
                false
            }
            Command::Light(s) if !(0.0..=100_000.0).contains(s) => {
                return Err(Failure::Command(format!("brightness {s}: 0 to the setting $30 is possible")));
            }
            Command::Raw(text) if !text.bytes().all(|b| (0x20..0x7f).contains(&b)) => {
                return Err(Failure::Command("a line holds plain characters only".into()));
            }
            _ => false,
        };
        let unlocks =
            matches!(command, Command::Home | Command::Unlock | Command::Settings | Command::Raw(_));
        if self.state == Some(State::Alarm) && !unlocks && self.queue.is_empty() && self.current.is_none() {
            return Err(Failure::Alarm(self.alarm));
        }
        if moves && self.trust == Trust::Lost && !self.queue.iter().any(|o| o.command == Command::Home) {
            return Err(Failure::PositionLost);
        }
        Ok(())
    }

    fn enqueue(&mut self, now: Duration, command: Command) -> Ticket {
        let ticket = self.next_ticket;
        self.next_ticket += 1;
        let operation = Operation {
            ticket,
            lines: lines_of(&command),
            motion: self.motion_of(&command),
            command,
            tries: 0,
        };
        self.queue.push_back(operation);
        self.next(now);
        ticket
    }

    /// Feed hold, at once.
    pub fn hold(&mut self) {
        if !matches!(self.phase, Phase::Closed(_)) {
            self.realtime(b'!', "!");
            self.holding = true;
        }
    }

    /// Goes on after a hold or a closed door.
    ///
    /// # Errors
    /// [`Failure::Stopped`] after Stop: nothing may move then.
    pub fn resume(&mut self) -> Result<(), Failure> {
        match self.phase {
            Phase::Stopped(_) => Err(Failure::Stopped),
            Phase::Ready => {
                self.realtime(b'~', "~");
                self.holding = false;
                Ok(())
            }
            _ => Err(Failure::Disconnected("open the port first".into())),
        }
    }

    /// Ends a jog, at once.
    pub fn jog_cancel(&mut self) {
        if !matches!(self.phase, Phase::Closed(_)) {
            self.realtime(0x85, "jog cancel");
        }
    }

    /// Stop: hold and reset, past everything queued. No line is sent after it until [`Link::release`].
    pub fn stop(&mut self, now: Duration) {
        if matches!(self.phase, Phase::Closed(_)) {
            return;
        }
        self.out.clear();
        self.out.extend(b"!\x18");
        self.note(Way::Sent, "! reset (Stop)");
        if self.state.is_none_or(State::moving)
            || self.current.as_ref().is_some_and(|(o, _)| o.motion > Duration::ZERO)
        {
            self.trust = Trust::Lost;
        }
        self.fail_all(Failure::Stopped);
        self.resetting = true;
        self.holding = false;
        self.since = now;
        self.heard = now;
        self.set_state(None);
        self.set_phase(Phase::Stopped(false));
    }

    /// Ends Stop: commands are taken again. The firmware stays locked until homed or unlocked where it lost its position.
    ///
    /// # Errors
    /// [`Failure::Stopped`] as long as the firmware has not confirmed the reset.
    pub fn release(&mut self, now: Duration) -> Result<(), Failure> {
        match self.phase {
            Phase::Stopped(true) => {
                self.set_phase(Phase::Ready);
                self.poll(now);
                Ok(())
            }
            Phase::Stopped(false) => Err(Failure::Stopped),
            _ => Ok(()),
        }
    }

    /// Soft reset (Ctrl-X): after a limit alarm the firmware takes nothing else. Drops what is queued.
    pub fn reset(&mut self, now: Duration) {
        if matches!(self.phase, Phase::Closed(_) | Phase::Stopped(_)) {
            return;
        }
        if self.state.is_none_or(State::moving) {
            self.trust = Trust::Lost;
        }
        self.fail_all(Failure::Cancelled);
        self.out.clear();
        self.realtime(0x18, "reset");
        self.resetting = true;
        self.since = now;
        self.attempts = 0;
        self.heard = now;
        self.set_state(None);
        self.set_phase(Phase::Opening);
    }

    /// Asks for a status report now (real-time `?`).
    pub fn poll(&mut self, now: Duration) {
        if !matches!(self.phase, Phase::Closed(_)) {
            self.out.push(b'?');
            self.asked = Some(now);
        }
    }

    // ---- time ----

    /// When [`Link::tick`] should be called at the latest, if nothing arrives before.
    #[must_use]
    pub fn next_wake(&self, now: Duration) -> Option<Duration> {
        if matches!(self.phase, Phase::Closed(_)) {
            return None;
        }
        let stage = match &self.current {
            Some((_, Stage::Line { deadline, .. })) => Some(*deadline),
            Some((_, Stage::Overdue { asked, .. })) => Some(*asked + ms(300)),
            Some((_, Stage::Resync { since, .. })) => Some(*since + ms(1500)),
            Some((_, Stage::Verify { asked, .. })) => Some(*asked + POLL),
            _ => None,
        };
        let phase = match self.phase {
            Phase::Opening => Some(self.since + BANNER),
            Phase::Stopped(false) => Some(self.since + STOP_REPEAT),
            _ => self.poll_due(),
        };
        [stage, phase, self.stale_at()].into_iter().flatten().min().map(|t| t.max(now + ms(1)))
    }

    fn stale_at(&self) -> Option<Duration> {
        (self.polls()).then(|| self.heard + if self.state.is_some() { STALE } else { SILENT })
    }

    /// Whether status reports are asked for and expected.
    fn polls(&self) -> bool {
        // Homing answers no '?', and after alarm 1 and 2 the firmware listens to nothing but a reset.
        let homing = matches!(&self.current, Some((o, Stage::Line { .. })) if o.command == Command::Home);
        let critical = matches!(self.alarm, Some(1 | 2)) && self.state == Some(State::Alarm);
        matches!(self.phase, Phase::Ready | Phase::Stopped(true)) && !homing && !critical
    }

    fn poll_due(&self) -> Option<Duration> {
        if !self.polls() {
            return None;
        }
        let Some(asked) = self.asked else { return Some(Duration::ZERO) };
        let mut due = asked
            + if self.wanted || self.busy() || self.state.is_none_or(|s| s != State::Idle) {
                POLL
            } else {
                IDLE_POLL
            };
        // Keep the 200 ms before the expected end of a move free, so that its check is not late.
        if let Some((o, Stage::Line { sent, .. })) = &self.current
            && o.lines.is_empty()
            && o.motion > Duration::ZERO
            && !self.halted()
        {
            let end = *sent + o.motion + ms(50);
            if due + POLL > end && due < end + POLL {
                due = end + POLL;
            }
        }
        Some(due)
    }

    fn halted(&self) -> bool {
        matches!(self.state, Some(State::Hold(_) | State::Door(_)))
    }

    /// Does what is due at `now`.
    pub fn tick(&mut self, now: Duration) {
        match self.phase {
            Phase::Closed(_) => return,
            Phase::Opening if now >= self.since + BANNER => {
                self.attempts += 1;
                if self.attempts > 3 {
                    let why =
                        "the board answers, but not as Grbl 1.1 at 115200 baud, or not at all".to_string();
                    self.closed(Some(why));
                    return;
                }
                // Boards that don't restart on opening need to be asked.
                self.realtime(0x18, "reset (no banner yet)");
                self.since = now;
            }
            Phase::Stopped(false) if now >= self.since + STOP_REPEAT => {
                self.attempts += 1;
                if now >= self.heard + SILENT + ms(2000) {
                    self.closed(Some("the board did not confirm Stop: cut its power".into()));
                    return;
                }
                self.out.extend(b"!\x18");
                self.note(Way::Sent, "! reset (Stop, again)");
                self.since = now;
            }
            _ => {}
        }
        if self.poll_due().is_some_and(|t| now >= t) {
            self.poll(now);
        }
        if self.polls() {
            if self.state.is_some() && now >= self.heard + STALE {
                self.set_state(None);
            }
            if now >= self.heard + SILENT {
                self.closed(Some("the board does not answer any more".into()));
                return;
            }
        } else if !matches!(self.phase, Phase::Stopped(false)) {
            self.heard = now;
        }
        self.stage(now);
        self.next(now);
    }

    fn stage(&mut self, now: Duration) {
        let halted = self.halted();
        let Some((operation, stage)) = &mut self.current else { return };
        match stage {
            Stage::Line { deadline, .. } if halted => {
                *deadline = (*deadline).max(now + ANSWER + operation.motion)
            }
            Stage::Line { text, deadline, .. } if now >= *deadline => {
                let text = std::mem::take(text);
                *stage = Stage::Overdue { text, asked: now, times: 1 };
                self.poll(now);
            }
            Stage::Overdue { asked, times, .. } if now >= *asked + ms(300) => {
                (*asked, *times) = (now, *times + 1);
                if *times > 12 {
                    self.closed(Some("the board does not answer any more".into()));
                    return;
                }
                self.poll(now);
            }
            Stage::Resync { since, times } if now >= *since + ms(1500) => {
                (*since, *times) = (now, *times + 1);
                if *times > 4 {
                    self.closed(Some("the board does not come back after a reset".into()));
                    return;
                }
                self.realtime(0x18, "reset (again)");
            }
            Stage::Verify { asked, times, .. } if now >= *asked + POLL => {
                (*asked, *times) = (now, *times + 1);
                if *times > 20 {
                    self.closed(Some("the board does not answer any more".into()));
                    return;
                }
                self.poll(now);
            }
            _ => {}
        }
    }

    // ---- bytes from the firmware ----

    /// Takes in bytes that arrived.
    pub fn receive(&mut self, now: Duration, bytes: &[u8]) {
        if matches!(self.phase, Phase::Closed(_)) {
            return;
        }
        let mut lines = Vec::new();
        self.splitter.feed(bytes, |l| lines.push(l.to_vec()));
        for raw in lines {
            self.line(now, &raw);
        }
        self.next(now);
    }

    fn line(&mut self, now: Duration, raw: &[u8]) {
        let parsed = line::parse(raw);
        match &parsed {
            Line::Empty => return,
            Line::Status(_) => {} // five a second would fill the console
            Line::Garbled => {
                let shown: String =
                    raw.iter().flat_map(|b| std::ascii::escape_default(*b)).map(char::from).collect();
                self.note(Way::Note, &format!("not understood: {shown}"));
            }
            _ => self.note(Way::Received, &String::from_utf8_lossy(raw)),
        }
        match parsed {
            Line::Banner(version) => self.banner(now, version),
            Line::Status(status) => self.take_status(now, status),
            Line::Alarm(code) => self.take_alarm(now, code),
            Line::Ok => self.answered(now, None),
            Line::Error(code) => self.answered(now, Some(code)),
            Line::Setting(n, value) => {
                self.settings.insert(n, value);
            }
            Line::Message { tag, text } => self.message(&tag, &text),
            Line::Empty | Line::Garbled => {}
        }
    }

    fn message(&mut self, tag: &str, text: &str) {
        match tag {
            "MSG" if text.contains("to unlock") => self.set_state(Some(State::Alarm)),
            "MSG" if text == "Reset to continue" && self.alarm.is_none() => self.alarm = Some(1),
            "G54" => {
                if let [Ok(x), Ok(y), Ok(z)] = text.split(',').map(str::parse).collect::<Vec<_>>()[..] {
                    self.work_offset = Some([x, y, z]);
                }
            }
            _ => {}
        }
    }

    fn banner(&mut self, now: Duration, version: String) {
        self.version = version;
        self.holding = false;
        self.alarm = None;
        self.heard = now;
        let expected = std::mem::take(&mut self.resetting);
        match self.phase {
            Phase::Closed(_) => {}
            Phase::Stopped(false) => {
                self.set_phase(Phase::Stopped(true));
                self.set_state(None);
                self.poll(now);
            }
            Phase::Stopped(true) => {
                // An answer to a repeated Stop, or a restart: nobody can tell, so the position is not trusted.
                self.trust = Trust::Lost;
                self.set_state(None);
                self.poll(now);
            }
            Phase::Opening => {
                // The banner may come twice; the settings are read once more then, which does no harm.
                if !expected {
                    self.trust = Trust::Lost;
                }
                self.read_settings(now);
            }
            Phase::Reading | Phase::Ready => {
                if matches!(self.current, Some((_, Stage::Resync { .. }))) && expected {
                    self.retry(now);
                } else {
                    self.restarted(now);
                }
            }
        }
    }

    /// A banner nobody asked for: RAM is gone, and with it the position.
    fn restarted(&mut self, now: Duration) {
        let reading = self.phase == Phase::Reading;
        self.out.clear();
        self.trust = Trust::Lost;
        self.set_state(None);
        self.fail_all(Failure::Restarted);
        if !reading {
            self.events.push_back(Event::Restarted);
        }
        self.read_settings(now);
    }

    fn read_settings(&mut self, now: Duration) {
        self.current = None;
        self.queue.clear();
        self.settings.clear();
        self.set_phase(Phase::Reading);
        self.enqueue(now, Command::Settings);
    }

    fn take_alarm(&mut self, now: Duration, code: u8) {
        self.heard = now;
        self.alarm = Some(code);
        if codes::loses_position(code) {
            self.trust = Trust::Lost;
        }
        self.set_state(Some(State::Alarm));
        self.events.push_back(Event::Alarm(code));
        // A reset of ours that hit a motion is told by its alarm before its banner.
        if !matches!(self.current, Some((_, Stage::Resync { .. }))) {
            self.fail_all(Failure::Alarm(Some(code)));
        }
    }

    fn take_status(&mut self, now: Duration, status: Status) {
        self.heard = now;
        self.status_time = Some(now);
        self.wanted = false;
        if let Some(offset) = status.offset {
            self.work_offset = Some(offset);
        }
        let offset = self.work_offset.unwrap_or_default();
        self.machine = status
            .machine
            .or_else(|| status.work.map(|w| [0, 1, 2].map(|i| w[i] + offset[i])))
            .or(self.machine);
        let state = status.state;
        self.status = Some(status);
        if matches!(self.phase, Phase::Closed(_) | Phase::Opening | Phase::Stopped(false)) {
            return;
        }
        let before = self.state;
        if state != State::Alarm {
            self.alarm = None;
        } else if self.alarm.is_none() {
            // Locked with no alarm told: it restarted, perhaps while Stop's own banner was awaited.
            self.trust = Trust::Lost;
        }
        self.set_state(Some(state));
        if matches!(state, State::Hold(_) | State::Door(_)) && before != Some(state) && !self.holding {
            self.events.push_back(Event::Halted(state));
        }
        if !matches!(state, State::Hold(_) | State::Door(_)) {
            self.holding = false;
        }
        if let Some(joints) = self.joints() {
            self.events.push_back(Event::Position(joints));
        }
        self.check(now, state);
    }

    /// What a status means for the command under way.
    fn check(&mut self, now: Duration, state: State) {
        let joints = self.joints();
        let spindle = self.status.as_ref().and_then(|s| s.spindle);
        let full = self.full_brightness();
        let Some((operation, stage)) = &mut self.current else { return };
        if matches!(state, State::Alarm | State::Sleep)
            && !matches!(
                operation.command,
                Command::Home | Command::Unlock | Command::Settings | Command::Raw(_)
            )
        {
            // Its ALARM line was lost.
            self.trust = Trust::Lost;
            let alarm = self.alarm;
            self.fail_all(Failure::Alarm(alarm));
            return;
        }
        match stage {
            Stage::Overdue { .. } if state.moving() || matches!(state, State::Hold(_) | State::Door(_)) => {
                let Stage::Overdue { text, .. } = stage else { return };
                let text = std::mem::take(text);
                *stage = Stage::Line { text, sent: now, deadline: now + ANSWER };
            }
            Stage::Overdue { text, .. } => {
                // At rest and no answer: it was lost, or the line was. A reset at rest keeps the position.
                let text = std::mem::take(text);
                operation.tries += 1;
                if operation.tries >= TRIES
                    || matches!(operation.command, Command::Raw(_) | Command::Jog { .. })
                {
                    self.fail_all(Failure::NoAnswer(text));
                    self.realtime(0x18, "reset");
                    self.resetting = true;
                    self.since = now;
                    self.attempts = 0;
                    self.set_phase(Phase::Opening);
                    return;
                }
                *stage = Stage::Resync { since: now, times: 1 };
                self.realtime(0x18, "reset (an answer was lost)");
                self.resetting = true;
            }
            Stage::Verify { .. } => match (&operation.command, joints) {
                (Command::Goto { to, .. }, Some(at)) if state == State::Idle => {
                    let near = |a: f64, b: f64, n: u16| {
                        let steps = self.settings.get(&n).copied().filter(|s| *s > 0.0).unwrap_or(100.0);
                        (a - b).abs() <= 1.0 / steps + 0.002
                    };
                    if near(at.azimuth, to.azimuth, 100) && near(at.slant, to.slant, 101) {
                        self.finish(now, Ok(()));
                    } else {
                        let missed = Failure::Missed { to: *to, at };
                        self.again_or(now, missed);
                    }
                }
                (Command::Light(brightness), _) if state == State::Idle => {
                    let wanted = brightness.min(full);
                    if spindle.is_none_or(|s| (s - wanted).abs() <= 1.0) {
                        self.finish(now, Ok(()));
                    } else {
                        let text = operation_text(&operation.command);
                        self.again_or(now, Failure::NoAnswer(text));
                    }
                }
                (Command::Home, Some(_)) if state == State::Idle => self.finish(now, Ok(())),
                (Command::Settings, _) => self.settings_read(now, state),
                _ => {}
            },
            Stage::Jogging { since } if state == State::Idle && now >= *since + ms(20) => {
                self.finish(now, Ok(()))
            }
            _ => {}
        }
    }

    /// Sends the command once more, or gives it up.
    fn again_or(&mut self, now: Duration, failure: Failure) {
        let Some((operation, _)) = &mut self.current else { return };
        operation.tries += 1;
        if operation.tries >= TRIES {
            self.fail_all(failure);
        } else {
            self.note(Way::Note, &format!("{failure}; trying again"));
            self.retry(now);
        }
    }

    fn retry(&mut self, now: Duration) {
        if let Some((mut operation, _)) = self.current.take() {
            operation.lines = lines_of(&operation.command);
            self.queue.push_front(operation);
            self.next(now);
        }
    }

    fn settings_read(&mut self, now: Duration, state: State) {
        let needed = [20, 22, 100, 101, 110, 111, 120, 121, 130, 131];
        if let Some(n) = needed.iter().find(|n| !self.settings.contains_key(n)) {
            let missing = format!("$$ (setting ${n} is missing)");
            self.again_or(now, Failure::NoAnswer(missing));
            return;
        }
        if self.phase == Phase::Reading {
            if state == State::Idle && !self.ever_ready && self.settings.get(&22) == Some(&0.0) {
                // No homing: all that is known is where it stood when it was switched on.
                self.trust = Trust::Assumed;
            }
            self.ever_ready = true;
            self.set_phase(Phase::Ready);
        }
        self.finish(now, Ok(()));
    }

    fn answered(&mut self, now: Duration, error: Option<u8>) {
        self.heard = now;
        let busy = !matches!(self.current, Some((_, Stage::Line { .. } | Stage::Overdue { .. })));
        if busy {
            // After a reset in mid-line the firmware answers that line on its way out.
            self.note(Way::Note, "an answer to nothing");
            return;
        }
        let Some((operation, stage)) = &mut self.current else { return };
        if let Some(code) = error {
            let (Stage::Line { text: line, .. } | Stage::Overdue { text: line, .. }) = stage else { return };
            let line = std::mem::take(line);
            self.fail_all(Failure::Refused { line, code });
            if self.phase == Phase::Reading {
                self.enqueue(now, Command::Settings);
            }
            return;
        }
        if !operation.lines.is_empty() {
            self.send_line(now);
            return;
        }
        match &operation.command {
            Command::Goto { .. } | Command::Light(_) | Command::Settings => {
                *stage = Stage::Verify { asked: now, times: 1 };
                self.poll(now);
            }
            Command::Jog { .. } => {
                *stage = Stage::Jogging { since: now };
                self.poll(now);
            }
            Command::Home => {
                // Homing sets the position: what was reported before it is no longer true.
                *stage = Stage::Verify { asked: now, times: 1 };
                self.machine = None;
                self.trust = Trust::Homed;
                self.alarm = None;
                self.set_state(Some(State::Idle));
                self.poll(now);
            }
            Command::Unlock => {
                if self.trust == Trust::Lost {
                    self.trust = Trust::Assumed;
                }
                self.alarm = None;
                if self.state == Some(State::Alarm) {
                    self.set_state(Some(State::Idle));
                }
                self.finish(now, Ok(()));
                self.poll(now);
            }
            Command::SetPosition(at) => {
                if let Some(m) = self.machine {
                    self.work_offset = Some([m[0] - at.azimuth, m[1] - at.slant, m[2]]);
                }
                self.trust = Trust::Assumed;
                self.finish(now, Ok(()));
                self.poll(now);
            }
            Command::Shutter(_) | Command::Raw(_) => {
                self.finish(now, Ok(()));
                self.poll(now);
            }
        }
    }

    // ---- the queue ----

    fn next(&mut self, now: Duration) {
        if self.current.is_some() || !matches!(self.phase, Phase::Ready | Phase::Reading) {
            return;
        }
        let Some(mut operation) = self.queue.pop_front() else { return };
        if matches!(operation.command, Command::Goto { .. } | Command::Jog { .. }) {
            operation.motion = self.motion_of(&operation.command);
        }
        self.current = Some((operation, Stage::Jogging { since: now }));
        self.send_line(now);
    }

    fn send_line(&mut self, now: Duration) {
        let Some((operation, stage)) = &mut self.current else { return };
        let Some(text) = operation.lines.pop_front() else { return };
        let wait = if operation.lines.is_empty() { operation.motion.mul_f64(1.25) } else { Duration::ZERO };
        *stage = Stage::Line { text: text.clone(), sent: now, deadline: now + ANSWER + wait };
        self.out.extend(text.as_bytes());
        self.out.push(b'\n');
        self.note(Way::Sent, &text);
    }

    fn motion_of(&self, command: &Command) -> Duration {
        let limits = self.axis_limits();
        let seconds = match command {
            Command::Goto { to, feed } => {
                // From an unknown position: the longest way there is.
                let from =
                    self.joints().unwrap_or(Joints { azimuth: to.azimuth + 360.0, slant: to.slant + 180.0 });
                Move::new([to.azimuth - from.azimuth, to.slant - from.slant], limits, *feed).seconds()
            }
            Command::Jog { by, feed } => Move::new([by.azimuth, by.slant], limits, *feed).seconds(),
            Command::Home => {
                let get = |n: u16, default: f64| {
                    self.settings.get(&n).copied().filter(|v| *v > 0.0).unwrap_or(default)
                };
                let way = 1.5 * (get(130, 400.0).max(get(131, 200.0)) * 2.0 + get(132, 200.0));
                let slow = 14.0 * get(27, 1.0);
                60.0 * (way / get(25, 500.0) + slow / get(24, 25.0)) + 8.0 * get(26, 250.0) / 1000.0 + 5.0
            }
            _ => 0.0,
        };
        Duration::from_secs_f64(seconds.clamp(0.0, 3600.0))
    }

    fn finish(&mut self, now: Duration, result: Result<(), Failure>) {
        if let Some((operation, _)) = self.current.take() {
            self.events.push_back(Event::Done(operation.ticket, result));
        }
        self.next(now);
    }

    /// The command under way failed, and what waits behind it is not sent.
    fn fail_all(&mut self, failure: Failure) {
        if let Some((operation, _)) = self.current.take() {
            self.events.push_back(Event::Done(operation.ticket, Err(failure.clone())));
        }
        let rest = if failure == Failure::Stopped { Failure::Stopped } else { Failure::Cancelled };
        for operation in std::mem::take(&mut self.queue) {
            self.events.push_back(Event::Done(operation.ticket, Err(rest.clone())));
        }
    }

    // ---- small things ----

    fn realtime(&mut self, byte: u8, name: &str) {
        self.out.push(byte);
        self.note(Way::Sent, name);
    }

    fn note(&mut self, way: Way, text: &str) {
        self.events.push_back(Event::Log(way, text.into()));
    }

    fn set_phase(&mut self, phase: Phase) {
        if self.phase != phase {
            self.phase = phase.clone();
            self.events.push_back(Event::Phase(phase));
        }
    }

    fn set_state(&mut self, state: Option<State>) {
        if self.state != state {
            self.state = state;
            self.events.push_back(Event::State(state));
        }
    }
}

/// The lines of a command. A coordinate has three decimals, as many as the firmware reports.
fn lines_of(command: &Command) -> VecDeque<String> {
    let lines = match command {
        Command::Home => vec!["$H".into()],
        Command::Unlock => vec!["$X".into()],
        Command::Goto { to, feed } => {
            vec![format!("G21G90G94G54G1X{:.3}Y{:.3}F{feed:.1}", to.azimuth, to.slant), "G4P0.05".into()]
        }
        Command::Jog { by, feed } => vec![format!("$J=G21G91X{:.3}Y{:.3}F{feed:.1}", by.azimuth, by.slant)],
        Command::Light(s) if *s > 0.0 => vec![format!("M3S{s:.0}")],
        Command::Light(_) => vec!["M5".into()],
        Command::Shutter(true) => vec!["M8".into()],
        Command::Shutter(false) => vec!["M9".into()],
        Command::SetPosition(at) => vec![format!("G21G10L20P1X{:.3}Y{:.3}", at.azimuth, at.slant)],
        Command::Settings => vec!["$$".into(), "$#".into()],
        Command::Raw(text) => vec![text.clone()],
    };
    lines.into()
}

fn operation_text(command: &Command) -> String {
    lines_of(command).into_iter().next().unwrap_or_default()
}

#[cfg(test)]
mod tests;
