//! What can go wrong between host and firmware: a transport that spoils what passes through it.

use super::simulated::Simulated;
use super::{Transport, TransportError};
use crate::rng::Rng;
use std::collections::VecDeque;
use std::time::Duration;

/// A kind of fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// A byte to the firmware is lost.
    DropSent,
    /// A byte from the firmware is lost.
    DropReceived,
    /// A bit of a byte to the firmware flips.
    GarbleSent,
    /// A bit of a byte from the firmware flips.
    GarbleReceived,
    /// Twenty bytes to the firmware are lost.
    BurstSent,
    /// Twenty bytes from the firmware are lost.
    BurstReceived,
    /// A byte to the firmware arrives twice.
    DoubleSent,
    /// A byte from the firmware arrives twice.
    DoubleReceived,
    /// The last line from the firmware arrives twice.
    RepeatLine,
    /// Everything from the firmware comes in single bytes, late.
    Split,
    /// Nothing comes through for 0.8 s, then all at once.
    Stall,
    /// Nothing comes through for 10 s, then all at once.
    LongStall,
    /// Noise from the firmware's side.
    NoiseReceived,
    /// The cable is pulled and plugged in again after 2 s; the board loses power.
    Unplug,
    /// The cable is pulled for good.
    UnplugForever,
    /// The USB side re-enumerates: the port is gone for 1 s, the board keeps its power.
    Reenumerate,
    /// The board restarts (brown-out, reset button).
    Restart,
    /// The board restarts twice in a row.
    RestartTwice,
    /// A limit switch reports.
    HardLimit,
    /// Somebody presses feed hold, and resume 3 s later.
    HoldButton,
    /// Somebody presses feed hold and leaves.
    HoldForever,
    /// Somebody opens and closes the safety door, resume 3 s later.
    Door,
    /// Somebody presses the board's abort button (soft reset).
    Abort,
    /// A motor loses steps: the arm is not where the firmware thinks.
    LostSteps,
    /// The board hangs: no byte comes any more.
    Hang,
    /// The firmware goes to sleep.
    Sleep,
    /// Power is cut and the settings in EEPROM are gone.
    SettingsLost,
}

impl Fault {
    /// Every kind.
    pub const ALL: [Self; 27] = [
        Self::DropSent,
        Self::DropReceived,
        Self::GarbleSent,
        Self::GarbleReceived,
        Self::BurstSent,
        Self::BurstReceived,
        Self::DoubleSent,
        Self::DoubleReceived,
        Self::RepeatLine,
        Self::Split,
        Self::Stall,
        Self::LongStall,
        Self::NoiseReceived,
        Self::Unplug,
        Self::UnplugForever,
        Self::Reenumerate,
        Self::Restart,
        Self::RestartTwice,
        Self::HardLimit,
        Self::HoldButton,
        Self::HoldForever,
        Self::Door,
        Self::Abort,
        Self::LostSteps,
        Self::Hang,
        Self::Sleep,
        Self::SettingsLost,
    ];

    /// The kind with this name, as its `Debug` form in any case.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|f| format!("{f:?}").eq_ignore_ascii_case(name))
    }
}

/// A simulated board behind a line on which one fault happens at one moment.
#[derive(Clone, Debug)]
pub struct Faulty {
    /// The board.
    pub board: Simulated,
    fault: Fault,
    at: Duration,
    rng: Rng,
    happened: bool,
    /// Bytes still to be spoiled, once the fault has begun.
    left: usize,
    gone_until: Option<Duration>,
    later: VecDeque<(Duration, u8)>,
    trickle: VecDeque<(Duration, u8)>,
    last_line: Vec<u8>,
    this_line: Vec<u8>,
}

const FOREVER: Duration = Duration::from_secs(1 << 40);

impl Faulty {
    /// `fault` happens at the first chance from `at` on.
    #[must_use]
    pub fn new(board: Simulated, fault: Fault, at: Duration, seed: u64) -> Self {
        Self {
            board,
            fault,
            at,
            rng: Rng::new(seed),
            happened: false,
            left: 0,
            gone_until: None,
            later: VecDeque::new(),
            trickle: VecDeque::new(),
            last_line: Vec::new(),
            this_line: Vec::new(),
        }
    }

    /// Whether the fault has taken place.
    #[must_use]
    pub fn happened(&self) -> bool {
        self.happened
    }

    /// Opens the port.
    ///
    /// # Errors
    /// [`TransportError::Lost`] while the cable is out.
    pub fn open(&mut self, now: Duration) -> Result<(), TransportError> {
        self.check(now)?;
        self.board.open(now);
        Ok(())
    }

    fn check(&self, now: Duration) -> Result<(), TransportError> {
        match self.gone_until {
            Some(t) if now < t => Err(TransportError::Lost("no such device".into())),
            _ => Ok(()),
        }
    }

    /// Faults that need no byte to pass.
    fn strike(&mut self, now: Duration) {
        while let Some((_, b)) = self.later.pop_front_if(|(t, _)| *t <= now) {
            self.board.press(now, b);
        }
        if self.happened || now < self.at {
            return;
        }
        let second = Duration::from_secs(1);
        let mut away = |board: &mut Simulated, time: Duration, power: bool| {
            if power {
                board.power_on();
            }
            board.close(now);
            self.gone_until = Some(now.saturating_add(time));
        };
        match self.fault {
            Fault::Unplug => away(&mut self.board, 2 * second, true),
            Fault::UnplugForever => away(&mut self.board, FOREVER, true),
            Fault::Reenumerate => away(&mut self.board, second, false),
            Fault::SettingsLost => {
                self.board.settings = super::simulated::Settings::default();
                away(&mut self.board, second, true);
            }
            Fault::Restart => self.board.power_on(),
            Fault::RestartTwice => {
                self.board.power_on();
                self.fault = Fault::Restart;
                self.at = now + second * 2;
                return;
            }
            Fault::HardLimit => {
                self.board.settings.set(21, 1.0);
                self.board.hit_limit(now);
                self.board.settings.set(21, 0.0);
            }
            Fault::HoldButton | Fault::HoldForever | Fault::Door | Fault::Abort => {
                let byte = match self.fault {
                    Fault::Door => 0x84,
                    Fault::Abort => 0x18,
                    _ => b'!',
                };
                self.board.press(now, byte);
                if matches!(self.fault, Fault::HoldButton | Fault::Door) {
                    self.later.push_back((now + 3 * second, b'~'));
                }
            }
            Fault::LostSteps => {
                let by = |rng: &mut Rng| f64::from(rng.range(-8.0, 8.0));
                let degrees = [by(&mut self.rng), by(&mut self.rng)];
                self.board.slip(now, degrees);
            }
            Fault::Sleep => self.board.feed(now, b"\n$SLP\n"),
            Fault::Hang => self.left = usize::MAX,
            Fault::Stall => self.gone_quiet(now, Duration::from_millis(800)),
            Fault::LongStall => self.gone_quiet(now, 10 * second),
            Fault::Split => self.left = 400,
            _ => return,
        }
        self.happened = true;
    }

    fn gone_quiet(&mut self, now: Duration, time: Duration) {
        self.left = 1;
        self.trickle.push_back((now + time, 0)); // the end of the silence; its byte is not delivered
    }

    fn begins(&mut self, now: Duration, bytes: usize) {
        if !self.happened && now >= self.at {
            self.happened = true;
            self.left = bytes;
        }
    }
}

impl Transport for Faulty {
    fn write(&mut self, now: Duration, bytes: &[u8]) -> Result<(), TransportError> {
        self.strike(now);
        self.check(now)?;
        let mut out = Vec::with_capacity(bytes.len());
        for &b in bytes {
            match self.fault {
                Fault::DropSent => self.begins(now, 1),
                Fault::BurstSent => self.begins(now, 20),
                Fault::GarbleSent | Fault::DoubleSent => self.begins(now, 1),
                _ => {}
            }
            let spoil = self.left > 0;
            match self.fault {
                Fault::DropSent | Fault::BurstSent if spoil => self.left -= 1,
                Fault::GarbleSent if spoil => {
                    self.left -= 1;
                    out.push(b ^ (1 << self.rng.below(8)));
                }
                Fault::DoubleSent if spoil => {
                    self.left -= 1;
                    out.extend([b, b]);
                }
                Fault::Hang if spoil => {}
                _ => out.push(b),
            }
        }
        self.board.write(now, &out)
    }

    fn read(&mut self, now: Duration, into: &mut Vec<u8>) -> Result<(), TransportError> {
        self.strike(now);
        self.check(now)?;
        let mut bytes = Vec::new();
        self.board.read(now, &mut bytes)?;
        for b in bytes {
            match self.fault {
                Fault::DropReceived | Fault::GarbleReceived | Fault::DoubleReceived => self.begins(now, 1),
                Fault::BurstReceived => self.begins(now, 20),
                Fault::NoiseReceived => self.begins(now, 40),
                Fault::RepeatLine if b == b'\n' => self.begins(now, 1),
                _ => {}
            }
            self.this_line.push(b);
            if b == b'\n' {
                self.last_line = std::mem::take(&mut self.this_line);
            }
            let spoil = self.left > 0;
            match self.fault {
                Fault::DropReceived | Fault::BurstReceived if spoil => self.left -= 1,
                Fault::GarbleReceived if spoil => {
                    self.left -= 1;
                    into.push(b ^ (1 << self.rng.below(8)));
                }
                Fault::DoubleReceived if spoil => {
                    self.left -= 1;
                    into.extend([b, b]);
                }
                Fault::NoiseReceived if spoil => {
                    while self.left > 0 {
                        self.left -= 1;
                        into.push(self.rng.next_u64() as u8);
                    }
                    into.push(b);
                }
                Fault::RepeatLine if spoil && b == b'\n' => {
                    self.left = 0;
                    into.push(b);
                    into.extend(self.last_line.iter());
                }
                Fault::Split if spoil => {
                    self.left -= 1;
                    let after = self.trickle.back().map_or(now, |t| t.0).max(now);
                    self.trickle.push_back((after + Duration::from_micros(600), b));
                }
                Fault::Stall | Fault::LongStall if spoil => {
                    let end = self.trickle.front().map_or(now, |t| t.0);
                    self.trickle.push_back((end, b));
                }
                Fault::Hang if spoil => {}
                _ if !self.trickle.is_empty() => {
                    let after = self.trickle.back().map_or(now, |t| t.0);
                    self.trickle.push_back((after, b));
                }
                _ => into.push(b),
            }
        }
        let stalled = matches!(self.fault, Fault::Stall | Fault::LongStall);
        while let Some((_, b)) = self.trickle.pop_front_if(|(t, _)| *t <= now) {
            if stalled && self.left == 1 {
                self.left = 0; // the marker of the end
            } else {
                into.push(b);
            }
        }
        Ok(())
    }

    fn next_event(&self) -> Option<Duration> {
        let gone = self.gone_until.filter(|t| *t < FOREVER);
        let trickle = self.trickle.front().map(|t| t.0);
        let later = self.later.front().map(|t| t.0);
        let strike = (!self.happened).then_some(self.at);
        [self.board.next_event(), gone, trickle, later, strike].into_iter().flatten().min()
    }
}
