//! A Grbl 1.1h on an Arduino Uno with the arm on it, true to the byte: what it prints, what it answers and
//! when, how it moves. No clock: time is a value, so a test runs an hour in a moment.
//!
//! Written from Grbl's documentation and behaviour (`protocol.c`, `report.c`, `limits.c`), not its code. Differences:
//! no arcs, no probing; speeds are continuous where the real stepper works in segments of 10 ms; parsing takes a
//! fixed time.

mod gcode;
mod planner;
mod settings;

use super::line::State;
use super::{Transport, TransportError};
use gcode::{Action, Coordinates, Modal};
use planner::Planner;
pub use settings::Settings;
use std::collections::VecDeque;
use std::time::Duration;

/// Microseconds since the start.
type Micros = u64;

/// One byte at 115200 8-N-1 takes 86.8 µs.
const BYTE: Micros = 87;
/// Receive buffer of the firmware.
const RX: usize = 128;
/// Send buffer of the firmware: printing more than this waits.
const TX: Micros = 104;
/// Longest line.
const LINE: usize = 80;
/// Time to read, check and queue a line.
const PARSE: Micros = 900;
/// The firmware sits still after an alarm so that its message gets out.
const ALARM_DELAY: Micros = 500_000;
/// Bootloader of an Uno.
const BOOT: Micros = 1_500_000;
const DWELL_STEP: Micros = 50_000;

/// A limit switch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Switch {
    /// Closes at the end of the axis.
    Works,
    /// Never closes (broken wire, or none there).
    Absent,
    /// Always closed.
    Stuck,
}

/// What is really so, whatever was reported: for tests and for the simulated camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// Machine state.
    pub state: State,
    /// Where the arm physically is, in the coordinates it has when homed: degrees, with the work offset of G54 taken off.
    pub joints: super::Joints,
    /// Whether the firmware's idea of the position is the physical one (within a step).
    pub position_true: bool,
    /// Whether an axis is moving.
    pub moving: bool,
    /// LED brightness, 0 when off.
    pub led: f64,
    /// Shutter line.
    pub shutter: bool,
}

#[derive(Clone, Debug, PartialEq)]
enum Wait {
    None,
    /// A dwell: steps left, end of this step.
    Dwell(u32, Micros),
    /// After a hard or soft limit: reset and nothing else.
    Critical,
    Homing(Homing),
    /// Resuming from the door: spindle and coolant come back.
    Restore(Micros),
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Homing {
    /// 0: Z, 1: X and Y.
    cycle: u8,
    /// Passes left of this cycle: approach, pull off, approach, pull off.
    pass: u8,
    /// Axes that still move.
    active: [bool; 3],
    /// End of the debounce delay after the pass.
    pause: Option<Micros>,
}

/// Real-time requests not yet carried out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Flags {
    status: bool,
    hold: bool,
    resume: bool,
    door: bool,
    cancel: bool,
    sleep: bool,
    reset: bool,
}

/// The simulated board.
#[derive(Clone, Debug)]
pub struct Simulated {
    now: Micros,
    /// `$` settings in EEPROM.
    pub settings: Settings,
    coordinates: Coordinates,
    startup: [String; 2],
    build_info: String,
    /// Limit switches of X, Y, Z.
    pub switches: [Switch; 3],
    /// Bootloader time after the port opens, microseconds.
    pub boot: u64,
    /// Whether opening the port resets the board (a real Uno does, a native pty does not).
    pub reset_on_open: bool,
    open: bool,
    powered: bool,
    booting: Option<Micros>,
    wire: VecDeque<(Micros, u8)>,
    wire_free: Micros,
    rx: VecDeque<u8>,
    tx: VecDeque<(Micros, u8)>,
    tx_free: Micros,
    line: Vec<u8>,
    comment: Option<u8>,
    overflow: bool,
    queue: VecDeque<Action>,
    /// Until then nothing is done, not even real-time commands.
    deaf: Option<Micros>,
    wait: Wait,
    flags: Flags,
    alarm: u8,
    state: State,
    held: bool,
    ajar: bool,
    jog_cancel: bool,
    soft_limit: bool,
    modal: Modal,
    planner: Planner,
    /// Physical minus machine position.
    slip: [f64; 3],
    led: f64,
    flood: bool,
    door_led: f64,
    door_flood: bool,
    overrides: [u32; 3],
    wco_counter: u32,
    ovr_counter: u32,
    lines: Vec<(Duration, String)>,
}

impl Simulated {
    /// A board with these settings, its arm at machine position `physical` (as it would be if homed), switched on
    /// but with the port closed.
    #[must_use]
    pub fn new(settings: Settings, physical: [f64; 3]) -> Self {
        let homing = settings.on(22);
        let mut s = Self {
            now: 0,
            settings,
            coordinates: Coordinates::default(),
            startup: [String::new(), String::new()],
            build_info: String::new(),
            switches: [Switch::Works; 3],
            boot: BOOT,
            reset_on_open: true,
            open: false,
            powered: true,
            booting: None,
            wire: VecDeque::new(),
            wire_free: 0,
            rx: VecDeque::new(),
            tx: VecDeque::new(),
            tx_free: 0,
            line: Vec::new(),
            comment: None,
            overflow: false,
            queue: VecDeque::new(),
            deaf: None,
            wait: Wait::None,
            flags: Flags::default(),
            alarm: 0,
            state: if homing { State::Alarm } else { State::Idle },
            held: false,
            ajar: false,
            jog_cancel: false,
            soft_limit: false,
            modal: Modal::default(),
            planner: Planner::default(),
            slip: physical,
            led: 0.0,
            flood: false,
            door_led: 0.0,
            door_flood: false,
            overrides: [100; 3],
            wco_counter: 0,
            ovr_counter: 0,
            lines: Vec::new(),
        };
        s.planner.reset([0.0; 3]);
        s
    }

    /// Stock Grbl with the settings of the integration guide: azimuth ±185°, slant ±100°, homing and soft limits on.
    #[must_use]
    pub fn arm() -> Self {
        let mut s = Self::new(Settings::arm(), [-185.0, -100.0, -5.0]);
        s.coordinates.systems[0] = [-185.0, -100.0, 0.0];
        s
    }

    /// Stock Grbl as flashed: no homing, slow, small steps.
    #[must_use]
    pub fn stock() -> Self {
        let mut s = Self::new(Settings::default(), [0.0; 3]);
        s.switches = [Switch::Absent; 3];
        s
    }

    /// The lines the firmware has read so far, with their times; for tests.
    #[must_use]
    pub fn lines(&self) -> &[(Duration, String)] {
        &self.lines
    }

    /// What is really so at the last time it was told.
    #[must_use]
    pub fn truth(&self) -> Truth {
        let machine = self.planner.position(self.now);
        let offset = self.coordinates.systems[0];
        let at = |i: usize| machine[i] + self.slip[i] - offset[i];
        let homed = (0..2).all(|i| self.slip[i].abs() <= 1.5 / self.settings.get(100 + i as u8));
        Truth {
            state: self.state,
            joints: super::Joints { azimuth: at(0), slant: at(1) },
            position_true: homed,
            moving: self.planner.running(),
            led: self.led,
            shutter: self.flood,
        }
    }

    /// Opens the port: the board resets and says hello after its bootloader.
    pub fn open(&mut self, now: Duration) {
        self.advance(micros(now));
        self.open = true;
        self.tx.clear();
        if self.reset_on_open {
            self.power_on();
        }
    }

    /// Closes the port. The firmware does not notice.
    pub fn close(&mut self, now: Duration) {
        self.advance(micros(now));
        self.open = false;
        self.tx.clear();
    }

    /// Brown-out, reset button or watchdog: everything in RAM is gone, also the position.
    pub fn power_on(&mut self) {
        let machine = self.planner.kill(self.now);
        self.slip = std::array::from_fn(|i| self.slip[i] + machine[i]);
        self.planner.reset([0.0; 3]);
        self.state = if self.settings.on(22) { State::Alarm } else { State::Idle };
        self.booting = Some(self.now + self.boot);
        self.wire.clear();
        self.tx.retain(|(ready, _)| *ready <= self.now);
        self.tx_free = self.now;
        self.modal = Modal::default();
        self.forget();
    }

    /// The arm hits a limit switch, or noise on its wire says so. Does nothing where hard limits are off or the arm rests.
    pub fn hit_limit(&mut self, now: Duration) {
        self.advance(micros(now));
        if self.settings.on(21) && self.booting.is_none() && self.state != State::Alarm && self.alarm == 0 {
            self.mc_reset();
            self.alarm = 1;
            self.run();
        }
    }

    /// The arm is pushed, or a motor loses steps: physical and counted position part by `degrees`.
    pub fn slip(&mut self, now: Duration, degrees: [f64; 2]) {
        self.advance(micros(now));
        self.slip[0] += degrees[0];
        self.slip[1] += degrees[1];
    }

    /// A real-time byte from the board's own buttons: `!`, `~`, 0x84, 0x18.
    pub fn press(&mut self, now: Duration, byte: u8) {
        self.advance(micros(now));
        self.realtime_byte(byte);
        self.run();
    }

    /// Bytes from the host.
    pub fn feed(&mut self, now: Duration, bytes: &[u8]) {
        self.advance(micros(now));
        for &b in bytes {
            self.wire_free = self.wire_free.max(self.now) + BYTE;
            self.wire.push_back((self.wire_free, b));
        }
    }

    /// Bytes that have reached the host by `now`.
    pub fn drain(&mut self, now: Duration, into: &mut Vec<u8>) {
        self.advance(micros(now));
        while let Some((_, b)) = self.tx.pop_front_if(|(ready, _)| *ready <= self.now) {
            into.push(b);
        }
    }

    /// When something happens next inside, if anything is under way.
    #[must_use]
    pub fn next(&self) -> Option<Duration> {
        let sent = self.tx.front().map(|(ready, _)| *ready);
        [self.next_micros(), sent].into_iter().flatten().min().map(Duration::from_micros)
    }

    fn next_micros(&self) -> Option<Micros> {
        let wire = self.wire.front().map(|w| w.0);
        let wait = match &self.wait {
            Wait::Dwell(_, t) if !self.suspended() => Some(*t),
            Wait::Restore(t) => Some(*t),
            Wait::Homing(h) => h.pause,
            _ => None,
        };
        let wait = self.deaf.or(wait);
        [wire, wait, self.booting, self.motion_event()].into_iter().flatten().min()
    }

    /// End of a block, or an axis at its switch.
    fn motion_event(&self) -> Option<Micros> {
        let end = self.planner.next_end()?;
        let watch: [bool; 3] = match &self.wait {
            Wait::Homing(h) if h.pass % 2 == 0 => h.active,
            _ if self.settings.on(21) => [true; 3],
            _ => [false; 3],
        };
        let switch = (0..3)
            .filter(|&i| watch[i] && self.switches[i] == Switch::Works)
            .filter_map(|i| {
                let (at, towards) = self.switch_at(i);
                // Already past it and moving on: now.
                if (self.physical(i) - at) * towards >= -1e-9 && self.planner.heading(i) == towards {
                    return Some(self.now);
                }
                (self.planner.heading(i) == towards).then(|| self.planner.when_at(i, at - self.slip[i]))?
            })
            .min();
        Some(switch.map_or(end, |s| s.min(end)))
    }

    fn physical(&self, i: usize) -> f64 {
        self.planner.position(self.now)[i] + self.slip[i]
    }

    /// Physical position of the homing switch of axis `i`, and the direction towards it.
    fn switch_at(&self, i: usize) -> (f64, f64) {
        let negative = self.settings.get(23) as u8 & (1 << i) != 0;
        if negative { (-self.settings.get(130 + i as u8), -1.0) } else { (0.0, 1.0) }
    }

    fn closed(&self, i: usize) -> bool {
        let (at, towards) = self.switch_at(i);
        match self.switches[i] {
            Switch::Works => (self.physical(i) - at) * towards >= -1e-6,
            Switch::Absent => false,
            Switch::Stuck => true,
        }
    }

    fn advance(&mut self, to: Micros) {
        while let Some(t) = self.next_micros().filter(|t| *t <= to) {
            self.now = self.now.max(t);
            self.event();
        }
        self.now = self.now.max(to);
    }

    /// Handles everything due now.
    fn event(&mut self) {
        if let Some((_, byte)) = self.wire.pop_front_if(|(t, _)| *t <= self.now) {
            // The bootloader swallows what comes too early.
            if self.booting.is_none() && self.powered {
                self.receive(byte);
            }
        }
        if self.booting.is_some_and(|t| t <= self.now) {
            self.booting = None;
            self.start();
        }
        if self.booting.is_some() {
            return;
        }
        if self.motion_event().is_some_and(|t| t <= self.now) {
            self.motion();
        }
        self.run();
    }

    /// One byte in the serial interrupt.
    fn receive(&mut self, byte: u8) {
        if matches!(byte, 0x18 | b'?' | b'~' | b'!') || byte > 0x7f {
            self.realtime_byte(byte);
        } else if self.rx.len() < RX {
            self.rx.push_back(byte);
        }
    }

    fn realtime_byte(&mut self, byte: u8) {
        match byte {
            0x18 => self.mc_reset(),
            b'?' => self.flags.status = true,
            b'~' => self.flags.resume = true,
            b'!' => self.flags.hold = true,
            0x84 => self.flags.door = true,
            0x85 => self.flags.cancel |= self.state == State::Jog,
            0x90..=0x9d => self.override_by(byte),
            _ => {}
        }
    }

    fn override_by(&mut self, byte: u8) {
        let [feed, rapid, spindle] = &mut self.overrides;
        let step = |v: &mut u32, by: i64| *v = (i64::from(*v) + by).clamp(10, 200) as u32;
        match byte {
            0x90 => *feed = 100,
            0x91 => step(feed, 10),
            0x92 => step(feed, -10),
            0x93 => step(feed, 1),
            0x94 => step(feed, -1),
            0x95 => *rapid = 100,
            0x96 => *rapid = 50,
            0x97 => *rapid = 25,
            0x99 => *spindle = 100,
            0x9a => step(spindle, 10),
            0x9b => step(spindle, -10),
            0x9c => step(spindle, 1),
            0x9d => step(spindle, -1),
            _ => return,
        }
        self.ovr_counter = 0;
        self.planner.replan(self.overrides, self.now);
    }

    /// `mc_reset`: in the interrupt, so it works whatever the main loop waits for.
    fn mc_reset(&mut self) {
        if self.flags.reset || self.booting.is_some() {
            return;
        }
        self.flags.reset = true;
        self.led = 0.0;
        self.flood = false;
        let homing = matches!(self.wait, Wait::Homing(_));
        if homing || self.planner.running() {
            if self.alarm == 0 {
                self.alarm = if homing { 6 } else { 3 };
            }
            self.planner.kill(self.now);
        }
    }

    fn forget(&mut self) {
        self.rx.clear();
        self.line.clear();
        self.comment = None;
        self.overflow = false;
        self.queue.clear();
        self.deaf = None;
        self.wait = Wait::None;
        self.flags = Flags::default();
        self.alarm = 0;
        self.held = false;
        self.ajar = false;
        self.jog_cancel = false;
        self.soft_limit = false;
        self.led = 0.0;
        self.flood = false;
        self.overrides = [100; 3];
        self.wco_counter = 0;
        self.ovr_counter = 0;
    }

    /// The start of the main program: after power-on and after every reset.
    fn start(&mut self) {
        let here = self.planner.kill(self.now);
        self.forget();
        self.modal = Modal { position: here, ..Modal::default() };
        self.print("\r\nGrbl 1.1h ['$' for help]\r\n");
        if matches!(self.state, State::Alarm | State::Sleep) {
            self.print("[MSG:'$H'|'$X' to unlock]\r\n");
            self.state = State::Alarm;
        } else {
            self.state = State::Idle;
            self.run_startup();
        }
    }

    fn run_startup(&mut self) {
        for n in 0..2 {
            if !self.startup[n].is_empty() {
                let line = self.startup[n].clone();
                self.print(&format!(">{line}:"));
                self.gcode(line.as_bytes(), false);
            }
        }
    }

    fn print(&mut self, text: &str) {
        for b in text.bytes() {
            self.tx_free = self.tx_free.max(self.now) + BYTE;
            if self.open {
                self.tx.push_back((self.tx_free, b));
            }
        }
    }

    /// The main program, until it has nothing to do at this moment.
    fn run(&mut self) {
        for _ in 0..10_000 {
            if self.booting.is_some() {
                return;
            }
            if self.deaf.is_some_and(|t| t > self.now) {
                return;
            }
            self.deaf = None;
            if self.homing() || self.critical() {
                return;
            }
            self.realtime();
            if self.deaf.is_some() || self.wait == Wait::Critical {
                continue;
            }
            if self.flags.reset {
                self.abort();
                continue;
            }
            if self.tx_free > self.now + TX * BYTE {
                self.deaf = Some(self.tx_free - TX * BYTE);
                continue;
            }
            if self.suspended() || !self.step() {
                return;
            }
        }
    }

    fn suspended(&self) -> bool {
        self.held || self.ajar || matches!(self.wait, Wait::Restore(_)) || self.state == State::Sleep
    }

    /// After a limit alarm nothing but a reset helps.
    fn critical(&mut self) -> bool {
        if self.wait == Wait::Critical {
            if self.flags.reset {
                self.wait = Wait::None;
                self.alarm = 0;
                return false;
            }
            return true;
        }
        false
    }

    /// Back to the start of the main program. The line under way is answered on the way out.
    fn abort(&mut self) {
        if self.queue.iter().any(|a| matches!(a, Action::Reply(_))) {
            self.print("ok\r\n");
        }
        self.start();
    }

    /// One piece of work of the main loop; false where there is none now.
    fn step(&mut self) -> bool {
        let Some(action) = self.queue.front().cloned() else { return self.read() };
        match action {
            Action::Sync => {
                self.auto_start();
                if !self.planner.is_empty() || self.state == State::Run {
                    return false;
                }
            }
            Action::Dwell(steps) => match self.wait {
                Wait::Dwell(left, t) => {
                    if t > self.now {
                        return false;
                    }
                    if left > 1 {
                        self.wait = Wait::Dwell(left - 1, self.now + DWELL_STEP);
                        return true;
                    }
                    self.wait = Wait::None;
                }
                _ if steps > 0 && self.state != State::Check => {
                    self.wait = Wait::Dwell(steps, self.now + DWELL_STEP);
                    return false;
                }
                _ => {}
            },
            Action::Busy(t) => {
                self.queue.pop_front();
                self.deaf = Some(self.now + t);
                return true;
            }
            Action::Spindle(on, speed) => {
                if self.state != State::Check {
                    self.led = if on { speed.clamp(0.0, self.settings.get(30)) } else { 0.0 };
                    self.ovr_counter = 0;
                }
            }
            Action::Coolant(on) => {
                if self.state != State::Check {
                    self.flood = on;
                    self.ovr_counter = 0;
                }
            }
            Action::Line { target, feed, rapid, jog } => {
                if self.state == State::Check && !jog {
                    self.queue.pop_front();
                    return true;
                }
                if self.settings.on(20) && !jog && !gcode::within_travel(target, &self.settings) {
                    return self.soft_limit();
                }
                if self.planner.is_full() {
                    self.auto_start();
                    return false;
                }
                self.planner.queue(target, feed, rapid, &self.settings, self.overrides, self.now);
                if jog && self.state == State::Idle && !self.planner.is_empty() {
                    self.state = State::Jog;
                    self.planner.start(self.overrides, self.now);
                }
            }
            Action::ProgramEnd => {
                self.led = 0.0;
                self.flood = false;
                self.overrides = [100; 3];
                self.wco_counter = 0;
                self.ovr_counter = 0;
                self.print("[MSG:Pgm End]\r\n");
            }
            Action::Offset => self.wco_counter = 0,
            Action::Pause => self.flags.hold = true,
            Action::Sleep => self.flags.sleep = true,
            Action::Home => {
                self.queue.pop_front();
                self.state = State::Home;
                self.wait = Wait::Homing(Homing { cycle: 0, pass: 0, active: [false; 3], pause: None });
                self.homing_pass();
                return true;
            }
            Action::Reply(code) => {
                if code == 0 {
                    self.print("ok\r\n");
                } else {
                    self.print(&format!("error:{code}\r\n"));
                }
            }
        }
        self.queue.pop_front();
        true
    }

    /// A target outside the travel: stop, alarm 2, nothing but reset.
    fn soft_limit(&mut self) -> bool {
        if self.state == State::Run {
            self.soft_limit = true;
            self.flags.hold = true;
            return true;
        }
        if self.planner.running() {
            return false;
        }
        self.mc_reset();
        self.alarm = 2;
        true
    }

    /// Bytes into a line, a whole line into work.
    fn read(&mut self) -> bool {
        let Some(c) = self.rx.pop_front() else {
            self.auto_start();
            return false;
        };
        match c {
            b'\n' | b'\r' => {
                let line = std::mem::take(&mut self.line);
                let overflow = std::mem::take(&mut self.overflow);
                self.comment = None;
                self.execute(&line, overflow);
            }
            _ if self.comment.is_some() || self.overflow => {
                if c == b')' && self.comment == Some(b'(') {
                    self.comment = None;
                }
            }
            0..=b' ' | b'/' => {}
            b'(' | b';' => self.comment = Some(c),
            _ if self.line.len() >= LINE - 1 => self.overflow = true,
            _ => self.line.push(c.to_ascii_uppercase()),
        }
        true
    }

    fn execute(&mut self, line: &[u8], overflow: bool) {
        self.lines.push((Duration::from_micros(self.now), String::from_utf8_lossy(line).into_owned()));
        self.queue.push_back(Action::Busy(PARSE));
        if overflow {
            self.queue.push_back(Action::Reply(11));
        } else if line.is_empty() {
            self.queue.push_back(Action::Reply(0));
        } else if let Some(command) = line.strip_prefix(b"$") {
            if let Err(code) = self.system(command) {
                self.queue.push_back(Action::Reply(code));
            }
        } else if matches!(self.state, State::Alarm | State::Jog) {
            self.queue.push_back(Action::Reply(9));
        } else {
            self.gcode(line, false);
        }
    }

    fn gcode(&mut self, line: &[u8], jog: bool) {
        match gcode::parse(line, jog, &mut self.modal, &mut self.coordinates, &self.settings) {
            Ok(actions) => self.queue.extend(actions),
            Err(code) => self.queue.push_back(Action::Reply(code)),
        }
    }

    /// A `$` line; replies by itself where it succeeds.
    fn system(&mut self, command: &[u8]) -> Result<(), u8> {
        let busy_state = matches!(self.state, State::Run | State::Hold(_));
        let done = Action::Reply(0);
        match command {
            b"" => self.print("[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\n"),
            [b'J', rest @ ..] => {
                if !matches!(self.state, State::Idle | State::Jog) {
                    return Err(8);
                }
                let Some(words) = rest.strip_prefix(b"=") else { return Err(3) };
                self.gcode(words, true);
                return Ok(());
            }
            b"$" if busy_state => return Err(8),
            b"$" => self.print(&self.settings.report()),
            b"G" => self.print(&format!("[{}]\r\n", self.modal.report())),
            b"C" if self.state == State::Check => {
                self.mc_reset();
                self.print("[MSG:Disabled]\r\n");
            }
            b"C" if self.state == State::Idle => {
                self.state = State::Check;
                self.print("[MSG:Enabled]\r\n");
            }
            b"C" => return Err(8),
            b"X" => {
                if self.state == State::Alarm {
                    self.print("[MSG:Caution: Unlocked]\r\n");
                    self.state = State::Idle;
                }
            }
            [b'$' | b'G' | b'C' | b'X', ..] => return Err(3),
            _ if !matches!(self.state, State::Idle | State::Alarm) => return Err(8),
            b"#" => self.print(&self.parameters()),
            b"H" => {
                if !self.settings.on(22) {
                    return Err(5);
                }
                self.queue.extend([Action::Home, done]);
                return Ok(());
            }
            [b'H', ..] => return Err(3),
            b"SLP" => {
                self.queue.extend([done, Action::Sleep]);
                return Ok(());
            }
            b"I" => self.print(&format!(
                "[VER:1.1h.20190830:{}]\r\n[OPT:V,{},{RX}]\r\n",
                self.build_info,
                planner::BLOCKS
            )),
            [b'I', b'=', text @ ..] => {
                self.build_info = String::from_utf8_lossy(text).into_owned();
                self.queue.push_back(Action::Busy(80 * 3300));
            }
            [b'R', b'S', b'T', b'=', what @ (b'$' | b'#' | b'*')] => {
                if matches!(what, b'$' | b'*') {
                    self.settings = Settings::default();
                }
                if matches!(what, b'#' | b'*') {
                    self.coordinates = Coordinates::default();
                }
                self.print("[MSG:Restoring defaults]\r\n");
                self.mc_reset();
            }
            b"N" => self.print(&format!("$N0={}\r\n$N1={}\r\n", self.startup[0], self.startup[1])),
            [b'N', n @ (b'0' | b'1'), b'=', text @ ..] => {
                if self.state != State::Idle {
                    return Err(8);
                }
                let mut probe = self.modal.clone();
                gcode::parse(text, false, &mut probe, &mut self.coordinates.clone(), &self.settings)?;
                self.startup[usize::from(n - b'0')] = String::from_utf8_lossy(text).into_owned();
                self.queue.push_back(Action::Busy(80 * 3300));
            }
            _ => {
                let mut at = 0;
                let number = gcode::read_number(command, &mut at).ok_or(2u8)?;
                if command.get(at) != Some(&b'=') {
                    return Err(3);
                }
                at += 1;
                let value = gcode::read_number(command, &mut at).ok_or(2u8)?;
                if at != command.len() || !(0.0..=255.0).contains(&number) {
                    return Err(3);
                }
                self.settings.store(number as u8, value)?;
                if number as u8 == 13 {
                    self.wco_counter = 0;
                }
                self.queue.push_back(Action::Busy(88 * 3300));
            }
        }
        self.queue.push_back(done);
        Ok(())
    }

    /// What `$#` prints.
    fn parameters(&self) -> String {
        let triple = |p: [f64; 3]| format!("{:.3},{:.3},{:.3}", p[0], p[1], p[2]);
        let mut out = String::new();
        for (n, p) in self.coordinates.systems.iter().enumerate() {
            out += &format!("[G{}:{}]\r\n", 54 + n, triple(*p));
        }
        out += &format!("[G28:{}]\r\n", triple(self.coordinates.stored[0]));
        out += &format!("[G30:{}]\r\n", triple(self.coordinates.stored[1]));
        out += &format!("[G92:{}]\r\n[TLO:{:.3}]\r\n", triple(self.modal.g92), self.modal.tool_offset);
        out + "[PRB:0.000,0.000,0.000:0]\r\n"
    }

    fn auto_start(&mut self) {
        if !self.planner.is_empty() && self.state == State::Idle && !self.suspended() {
            self.state = State::Run;
            self.planner.start(self.overrides, self.now);
        }
    }

    /// `protocol_exec_rt_system`.
    fn realtime(&mut self) {
        if let Wait::Restore(t) = self.wait
            && t <= self.now
        {
            self.wait = Wait::None;
            self.led = self.door_led;
            self.flood = self.door_flood;
            if self.led > 0.0 || self.flood {
                self.ovr_counter = 0;
            }
            self.resume_motion();
        }
        if self.alarm != 0 {
            let code = std::mem::take(&mut self.alarm);
            self.state = State::Alarm;
            self.print(&format!("ALARM:{code}\r\n"));
            if matches!(code, 1 | 2) {
                self.print("[MSG:Reset to continue]\r\n");
                self.flags.reset = false;
                self.wait = Wait::Critical;
                return;
            }
            self.deaf = Some(self.now + ALARM_DELAY);
            return;
        }
        if self.flags.reset {
            return;
        }
        if std::mem::take(&mut self.flags.status) {
            self.report();
        }
        let Flags { hold, door, cancel, sleep, .. } = self.flags;
        if hold || door || cancel || sleep {
            (self.flags.hold, self.flags.door, self.flags.cancel, self.flags.sleep) =
                (false, false, false, false);
            self.stop_for(hold, door, sleep);
        }
        if std::mem::take(&mut self.flags.resume) && !(hold || door || cancel) {
            self.resume();
        }
        if self.ajar {
            // No door switch is wired: it reads closed at once.
            self.ajar = false;
            self.held = true;
        }
    }

    fn stop_for(&mut self, hold: bool, door: bool, sleep: bool) {
        if !matches!(self.state, State::Alarm | State::Check) {
            let moving = matches!(self.state, State::Run | State::Jog);
            if moving {
                self.planner.hold(self.overrides, self.now);
                self.jog_cancel |= self.state == State::Jog && !sleep;
            }
            if self.state == State::Idle {
                self.held = true;
            }
            if hold && matches!(self.state, State::Idle | State::Run) {
                self.state = State::Hold(u8::from(moving));
            }
            if door {
                self.print("[MSG:Check Door]\r\n");
                if !self.jog_cancel && self.state != State::Sleep {
                    if !matches!(self.state, State::Door(_)) {
                        (self.door_led, self.door_flood) = (self.led, self.flood);
                        self.ovr_counter = 0;
                    }
                    (self.led, self.flood) = (0.0, false);
                    self.state = State::Door(if self.planner.running() { 2 } else { 0 });
                    if let Wait::Restore(_) = self.wait {
                        self.wait = Wait::None;
                    }
                    self.held |= !self.planner.running();
                }
            }
        }
        if sleep {
            self.print("[MSG:Sleeping]\r\n");
            (self.led, self.flood) = (0.0, false);
            self.state = State::Sleep;
        }
    }

    /// `~`.
    fn resume(&mut self) {
        match self.state {
            State::Hold(_) if self.held => self.resume_motion(),
            State::Door(0) if self.held => {
                self.state = State::Door(3);
                self.held = false;
                let spindle = if self.door_led > 0.0 { 4_000_000 } else { 0 };
                let coolant = if self.door_flood { 1_000_000 } else { 0 };
                self.wait = Wait::Restore(self.now + spindle + coolant);
            }
            _ => {}
        }
    }

    fn resume_motion(&mut self) {
        self.held = false;
        if self.planner.is_empty() {
            self.state = State::Idle;
        } else {
            self.state = State::Run;
            self.planner.start(self.overrides, self.now);
        }
    }

    /// The stepper at the end of a block, or a switch on the way.
    fn motion(&mut self) {
        let hit: [bool; 3] =
            std::array::from_fn(|i| self.closed(i) && self.planner.heading(i) == self.switch_at(i).1);
        if let Wait::Homing(h) = self.wait {
            if h.pass % 2 == 0 && (0..3).any(|i| h.active[i] && hit[i]) {
                self.homing_hit(hit);
                return;
            }
        } else if self.settings.on(21) && hit.iter().any(|h| *h) {
            self.mc_reset();
            self.alarm = 1;
            return;
        }
        if self.planner.next_end().is_some_and(|t| t <= self.now)
            && self.planner.finish(self.overrides, self.now)
        {
            self.cycle_stop();
        }
    }

    fn cycle_stop(&mut self) {
        if matches!(self.wait, Wait::Homing(_)) {
            return;
        }
        match self.state {
            State::Hold(_) if !self.soft_limit => {
                self.state = State::Hold(0);
                self.held = true;
            }
            State::Door(_) => {
                self.state = State::Door(0);
                self.held = true;
            }
            State::Sleep => {}
            _ => {
                if std::mem::take(&mut self.jog_cancel) {
                    let here = self.planner.kill(self.now);
                    self.modal.position = here;
                }
                self.state = State::Idle;
                self.soft_limit = false;
            }
        }
    }

    /// Goes on with homing; true while it waits.
    fn homing(&mut self) -> bool {
        let Wait::Homing(mut h) = self.wait else { return false };
        if self.flags.reset || self.flags.door {
            if !self.flags.reset {
                self.alarm = 7;
                self.fail_homing();
            }
            self.flags.door = false;
            self.wait = Wait::None;
            return false;
        }
        if let Some(t) = h.pause {
            if t > self.now {
                return true;
            }
            h.pause = None;
            h.pass += 1;
            self.wait = Wait::Homing(h);
            self.homing_pass();
            return matches!(self.wait, Wait::Homing(_));
        }
        if self.planner.running() {
            return true;
        }
        let axes = axes_of(h.cycle);
        if h.pass % 2 == 0 {
            if (0..3).any(|i| h.active[i]) {
                self.alarm = 9; // ran its whole way without meeting the switch
                self.fail_homing();
                return false;
            }
        } else if (0..3).any(|i| axes[i] && self.closed(i)) {
            self.alarm = 8;
            self.fail_homing();
            return false;
        }
        h.pause = Some(self.now + self.settings.get(26) as Micros * 1000);
        self.wait = Wait::Homing(h);
        true
    }

    fn fail_homing(&mut self) {
        self.wait = Wait::None;
        self.planner.kill(self.now);
        self.flags.reset = true;
        self.led = 0.0;
        self.flood = false;
        self.state = State::Alarm;
    }

    /// Starts the next pass, cycle, or ends homing.
    fn homing_pass(&mut self) {
        let Wait::Homing(mut h) = self.wait else { return };
        if h.pass >= 4 {
            // The position is known now: the pull-off from the switch.
            let here = self.planner.kill(self.now);
            let pulloff = self.settings.get(27);
            let mut machine = here;
            for i in (0..3).filter(|&i| axes_of(h.cycle)[i]) {
                let (at, towards) = self.switch_at(i);
                machine[i] = at - towards * pulloff;
                self.slip[i] += here[i] - machine[i];
            }
            self.planner.reset(machine);
            if h.cycle == 1 {
                self.wait = Wait::None;
                self.modal.position = machine;
                self.state = State::Idle;
                self.run_startup();
                return;
            }
            h = Homing { cycle: 1, pass: 0, active: [false; 3], pause: None };
        }
        let axes = axes_of(h.cycle);
        let approach = h.pass % 2 == 0;
        h.active = axes;
        let pulloff = self.settings.get(27);
        let reach = match (h.pass, approach) {
            (0, _) => {
                1.5 * (0..3)
                    .filter(|&i| axes[i])
                    .map(|i| self.settings.get(130 + i as u8))
                    .fold(0.0, f64::max)
            }
            (_, true) => 5.0 * pulloff,
            (_, false) => pulloff,
        };
        let feed = if approach && h.pass > 0 { self.settings.get(24) } else { self.settings.get(25) };
        self.wait = Wait::Homing(h);
        self.homing_move(reach, feed, approach);
        // A switch that is closed from the start ends the approach of its axis at once.
        if approach {
            let closed = std::array::from_fn(|i| self.closed(i));
            if (0..3).any(|i| axes[i] && closed[i]) {
                self.homing_hit(closed);
            }
        }
    }

    fn homing_move(&mut self, reach: f64, feed: f64, approach: bool) {
        let Wait::Homing(h) = self.wait else { return };
        let here = self.planner.kill(self.now);
        let moving = (0..3).filter(|&i| h.active[i]).count().max(1);
        let target = std::array::from_fn(|i| {
            let towards = self.switch_at(i).1;
            if h.active[i] { here[i] + towards * if approach { reach } else { -reach } } else { here[i] }
        });
        self.planner.queue(
            target,
            feed * libm::sqrt(moving as f64),
            false,
            &self.settings,
            [100; 3],
            self.now,
        );
        self.planner.start([100; 3], self.now);
    }

    /// Axes at their switch stop; the others go on.
    fn homing_hit(&mut self, hit: [bool; 3]) {
        let Wait::Homing(mut h) = self.wait else { return };
        for (active, hit) in h.active.iter_mut().zip(hit) {
            *active &= !hit;
        }
        self.wait = Wait::Homing(h);
        if h.active.iter().any(|a| *a) {
            let reach = 1.5 * (0..3).map(|i| self.settings.get(130 + i as u8)).fold(0.0, f64::max);
            let feed = if h.pass > 0 { self.settings.get(24) } else { self.settings.get(25) };
            self.homing_move(reach, feed, true);
        } else {
            self.planner.kill(self.now);
        }
    }

    /// A status report, with the fields a stock build sends and when it sends them.
    fn report(&mut self) {
        let state = match self.state {
            State::Hold(_) => State::Hold(u8::from(!self.held)),
            other => other,
        };
        let per_unit = self.settings.axes(100);
        let machine = self.planner.position(self.now);
        let machine: [f64; 3] = std::array::from_fn(|i| libm::round(machine[i] * per_unit[i]) / per_unit[i]);
        let offset: [f64; 3] =
            std::array::from_fn(|i| self.coordinates.systems[self.modal.system][i] + self.modal.g92[i]);
        let mask = self.settings.get(10) as u8;
        let (name, shown) = if mask & 1 != 0 {
            ("MPos", machine)
        } else {
            ("WPos", std::array::from_fn(|i| machine[i] - offset[i]))
        };
        let inches = self.settings.on(13);
        let triple = |p: [f64; 3]| {
            if inches {
                let [x, y, z] = p.map(|v| clean(v * INCH_PER_MM));
                return format!("{x:.4},{y:.4},{z:.4}");
            }
            format!("{:.3},{:.3},{:.3}", clean(p[0]), clean(p[1]), clean(p[2]))
        };
        let mut out = format!("<{state}|{name}:{}", triple(shown));
        if mask & 2 != 0 {
            out += &format!("|Bf:{},{}", self.planner.free(), RX - self.rx.len());
        }
        // Grbl rounds a half up.
        let rate = self.planner.rate(self.now);
        let rate = if inches {
            format!("{:.1}", libm::floor(rate * INCH_PER_MM * 10.0 + 0.5) / 10.0)
        } else {
            format!("{}", libm::floor(rate + 0.5))
        };
        out += &format!("|FS:{rate},{}", libm::floor(self.led + 0.5));
        let pins: String = (0..3).filter(|&i| self.closed(i)).map(|i| ['X', 'Y', 'Z'][i]).collect();
        if !pins.is_empty() {
            out += &format!("|Pn:{pins}");
        }
        let busy =
            matches!(self.state, State::Home | State::Run | State::Hold(_) | State::Jog | State::Door(_));
        if self.wco_counter > 0 {
            self.wco_counter -= 1;
        } else {
            self.wco_counter = if busy { 29 } else { 9 };
            self.ovr_counter = self.ovr_counter.max(1);
            out += &format!("|WCO:{}", triple(offset));
        }
        if self.ovr_counter > 0 {
            self.ovr_counter -= 1;
        } else {
            self.ovr_counter = if busy { 19 } else { 9 };
            let [f, r, s] = self.overrides;
            out += &format!("|Ov:{f},{r},{s}");
            let accessories =
                format!("{}{}", if self.led > 0.0 { "S" } else { "" }, if self.flood { "F" } else { "" });
            if !accessories.is_empty() {
                out += &format!("|A:{accessories}");
            }
        }
        self.print(&(out + ">\r\n"));
    }
}

/// Axes of a homing cycle: stock Grbl homes Z first, then X and Y together.
fn axes_of(cycle: u8) -> [bool; 3] {
    if cycle == 0 { [false, false, true] } else { [true, true, false] }
}

/// Grbl's own.
const INCH_PER_MM: f64 = 0.0393701;

/// No "-0.000".
fn clean(v: f64) -> f64 {
    if v.abs() < 5e-4 { 0.0 } else { v }
}

fn micros(t: Duration) -> Micros {
    t.as_micros() as Micros
}

impl Transport for Simulated {
    fn write(&mut self, now: Duration, bytes: &[u8]) -> Result<(), TransportError> {
        if !self.open {
            return Err(TransportError::Lost("the simulated port is closed".into()));
        }
        self.feed(now, bytes);
        Ok(())
    }

    fn read(&mut self, now: Duration, into: &mut Vec<u8>) -> Result<(), TransportError> {
        if !self.open {
            return Err(TransportError::Lost("the simulated port is closed".into()));
        }
        self.drain(now, into);
        Ok(())
    }

    fn next_event(&self) -> Option<Duration> {
        self.next()
    }
}

#[cfg(test)]
mod tests;
