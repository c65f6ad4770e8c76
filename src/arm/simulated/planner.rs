//! The firmware's motion: blocks in a buffer, joined at their junctions, run with limited acceleration.
//!
//! Same rules as Grbl's `planner.c` (acceleration along the path, junction deviation, look-ahead over the
//! whole buffer); speeds are exact functions of time here instead of step segments.

use super::Micros;
use super::settings::Settings;
use std::collections::VecDeque;

/// Blocks that fit (Grbl keeps 16, one of them in use).
pub const BLOCKS: usize = 15;

#[derive(Clone, Debug)]
struct Block {
    start: [f64; 3],
    unit: [f64; 3],
    length: f64,
    acceleration: f64,
    programmed: f64,
    rapid_rate: f64,
    rapid: bool,
    /// Fastest entry that the corner allows, per second.
    junction: f64,
    entry: f64,
    exit: f64,
}

/// Motion along the current block from `time` on: constant accelerations one after the other.
#[derive(Clone, Debug)]
struct Run {
    time: Micros,
    travelled: f64,
    speed: f64,
    phases: Vec<(f64, f64)>, // seconds, acceleration
}

impl Run {
    /// Distance along the block and speed at `now`.
    fn at(&self, now: Micros) -> (f64, f64) {
        let mut t = now.saturating_sub(self.time) as f64 * 1e-6;
        let (mut s, mut v) = (self.travelled, self.speed);
        for &(seconds, a) in &self.phases {
            let dt = t.min(seconds);
            s += v * dt + 0.5 * a * dt * dt;
            v += a * dt;
            t -= dt;
            if t <= 0.0 {
                break;
            }
        }
        (s, v.max(0.0))
    }

    fn seconds(&self) -> f64 {
        self.phases.iter().map(|p| p.0).sum()
    }

    /// When the distance `s` is reached, if on the way.
    fn when(&self, target: f64) -> Option<Micros> {
        let (mut s, mut v, mut t) = (self.travelled, self.speed, 0.0);
        for &(seconds, a) in &self.phases {
            let end = s + v * seconds + 0.5 * a * seconds * seconds;
            if target <= end {
                let d = target - s;
                let root = libm::sqrt((v * v + 2.0 * a * d).max(0.0));
                let dt = if v + root > 0.0 { 2.0 * d / (v + root) } else { 0.0 };
                return Some(self.time + micros(t + dt.clamp(0.0, seconds)));
            }
            (s, v, t) = (end, v + a * seconds, t + seconds);
        }
        None
    }
}

fn micros(seconds: f64) -> Micros {
    (seconds * 1e6).ceil() as Micros
}

/// The planner buffer and the stepper that empties it.
#[derive(Clone, Debug, Default)]
pub struct Planner {
    blocks: VecDeque<Block>,
    run: Option<Run>,
    holding: bool,
    /// Where the last queued block ends.
    end: [f64; 3],
    /// Where the arm is when nothing runs.
    rest: [f64; 3],
}

impl Planner {
    /// Empty, at `position` (machine coordinates).
    pub fn reset(&mut self, position: [f64; 3]) {
        *self = Self { end: position, rest: position, ..Self::default() };
    }

    pub fn is_empty(&self) -> bool {
        self.blocks.is_empty()
    }

    pub fn is_full(&self) -> bool {
        self.blocks.len() >= BLOCKS
    }

    /// Free blocks, as `Bf` reports them.
    pub fn free(&self) -> usize {
        BLOCKS - self.blocks.len()
    }

    pub fn running(&self) -> bool {
        self.run.is_some()
    }

    /// Position at `now`.
    pub fn position(&self, now: Micros) -> [f64; 3] {
        match (&self.run, self.blocks.front()) {
            (Some(run), Some(b)) => {
                let s = run.at(now).0.min(b.length);
                std::array::from_fn(|i| b.start[i] + b.unit[i] * s)
            }
            _ => self.rest,
        }
    }

    /// Speed at `now`, a minute.
    pub fn rate(&self, now: Micros) -> f64 {
        self.run.as_ref().map_or(0.0, |r| r.at(now).1 * 60.0)
    }

    /// Direction in which axis `i` moves: −1, 0, 1.
    pub fn heading(&self, i: usize) -> f64 {
        match (&self.run, self.blocks.front()) {
            (Some(_), Some(b)) if b.unit[i] != 0.0 => b.unit[i].signum(),
            _ => 0.0,
        }
    }

    /// Queues a straight move; a target on the last step of the path is no move.
    pub fn queue(
        &mut self,
        target: [f64; 3],
        feed: f64,
        rapid: bool,
        settings: &Settings,
        overrides: [u32; 3],
        now: Micros,
    ) {
        let per_unit = settings.axes(100);
        let snap = |p: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|i| libm::round(p[i] * per_unit[i]) / per_unit[i])
        };
        let (start, target) = (snap(self.end), snap(target));
        let delta: [f64; 3] = std::array::from_fn(|i| target[i] - start[i]);
        let length = libm::sqrt(delta.iter().map(|d| d * d).sum());
        if length <= 0.0 {
            return;
        }
        let unit = delta.map(|d| d / length);
        let along = |limits: [f64; 3]| {
            unit.iter()
                .zip(limits)
                .filter(|(u, _)| **u != 0.0)
                .map(|(u, l)| (l / u).abs())
                .fold(f64::INFINITY, f64::min)
        };
        let acceleration = along(settings.axes(120));
        let rapid_rate = along(settings.axes(110));
        let junction = match self.blocks.back() {
            None => 0.0,
            Some(last) => {
                let cos = -(0..3).map(|i| last.unit[i] * unit[i]).sum::<f64>();
                if cos > 0.999_999 {
                    0.0
                } else if cos < -0.999_999 {
                    f64::INFINITY
                } else {
                    let half = libm::sqrt(0.5 * (1.0 - cos));
                    libm::sqrt(acceleration.min(last.acceleration) * settings.get(11) * half / (1.0 - half))
                }
            }
        };
        self.blocks.push_back(Block {
            start,
            unit,
            length,
            acceleration,
            programmed: feed,
            rapid_rate,
            rapid,
            junction,
            entry: 0.0,
            exit: 0.0,
        });
        self.end = target;
        self.replan(overrides, now);
    }

    fn nominal(b: &Block, overrides: [u32; 3]) -> f64 {
        let rate = if b.rapid {
            b.rapid_rate * f64::from(overrides[1]) / 100.0
        } else {
            (b.programmed * f64::from(overrides[0]) / 100.0).min(b.rapid_rate)
        };
        rate.max(1.0) / 60.0
    }

    /// Speeds at the junctions, backwards from a stop and forwards from the current speed.
    pub fn replan(&mut self, overrides: [u32; 3], now: Micros) {
        let (travelled, speed) = self.run.as_ref().map_or((0.0, 0.0), |r| r.at(now));
        let n = self.blocks.len();
        let mut exit = 0.0;
        for k in (0..n).rev() {
            let before = if k > 0 { Self::nominal(&self.blocks[k - 1], overrides) } else { f64::INFINITY };
            let nominal = Self::nominal(&self.blocks[k], overrides);
            let b = &mut self.blocks[k];
            b.exit = exit;
            let reach = libm::sqrt(exit * exit + 2.0 * b.acceleration * b.length);
            b.entry = if k == 0 { 0.0 } else { b.junction.min(before).min(nominal).min(reach) };
            exit = b.entry;
        }
        let mut v = speed;
        for k in 0..n {
            let left = self.blocks[k].length - if k == 0 { travelled } else { 0.0 };
            let reach = libm::sqrt(v * v + 2.0 * self.blocks[k].acceleration * left.max(0.0));
            let exit = self.blocks[k].exit.min(reach);
            self.blocks[k].exit = exit;
            if k + 1 < n {
                self.blocks[k + 1].entry = exit;
            }
            v = exit;
        }
        if self.run.is_some() && !self.holding {
            self.begin(travelled, speed, overrides, now);
        }
    }

    /// Runs the current block on from `travelled` with `speed`.
    fn begin(&mut self, travelled: f64, speed: f64, overrides: [u32; 3], now: Micros) {
        let Some(b) = self.blocks.front() else {
            self.run = None;
            return;
        };
        let a = b.acceleration;
        let left = (b.length - travelled).max(0.0);
        let mut phases = Vec::with_capacity(3);
        if self.holding {
            let stop = speed * speed / (2.0 * a);
            if stop <= left {
                phases.push((speed / a, -a));
            } else {
                let end = libm::sqrt((speed * speed - 2.0 * a * left).max(0.0));
                phases.push(((speed - end) / a, -a));
            }
        } else {
            let cap = Self::nominal(b, overrides);
            let (mut v, mut left) = (speed, left);
            if v > cap {
                // An override lowered the speed: slow down first.
                let d = ((v * v - cap * cap) / (2.0 * a)).min(left);
                let end = libm::sqrt((v * v - 2.0 * a * d).max(0.0));
                phases.push(((v - end) / a, -a));
                (v, left) = (end, left - d);
            }
            let exit = b.exit;
            let peak = libm::sqrt(((v * v + exit * exit) / 2.0 + a * left).max(0.0)).min(cap).max(v);
            let down = ((peak * peak - exit * exit) / (2.0 * a)).max(0.0);
            let up = (peak * peak - v * v) / (2.0 * a);
            phases.push(((peak - v) / a, a));
            let flat = left - up - down;
            if flat > 0.0 && peak > 0.0 {
                phases.push((flat / peak, 0.0));
            }
            phases.push((((peak - exit) / a).max(0.0), -a));
        }
        self.run = Some(Run { time: now, travelled, speed, phases });
    }

    /// Starts (or goes on with) the queued blocks.
    pub fn start(&mut self, overrides: [u32; 3], now: Micros) {
        self.holding = false;
        if self.run.is_none() && !self.blocks.is_empty() {
            self.replan(overrides, now);
            self.begin(0.0, 0.0, overrides, now);
        }
    }

    /// Slows down to a stop on the path.
    pub fn hold(&mut self, overrides: [u32; 3], now: Micros) {
        if let Some(run) = &self.run
            && !self.holding
        {
            let (s, v) = run.at(now);
            self.holding = true;
            self.begin(s, v, overrides, now);
        }
    }

    /// When the current block (or the slowing down in it) ends.
    pub fn next_end(&self) -> Option<Micros> {
        self.run.as_ref().map(|r| r.time + micros(r.seconds()))
    }

    /// When axis `i` comes to machine position `at`, if the current block leads there.
    pub fn when_at(&self, i: usize, at: f64) -> Option<Micros> {
        let (run, b) = (self.run.as_ref()?, self.blocks.front()?);
        if b.unit[i] == 0.0 {
            return None;
        }
        let s = (at - b.start[i]) / b.unit[i];
        (s >= run.travelled && s <= b.length).then(|| run.when(s))?
    }

    /// Takes up the next block at the end of one. True when the motion has come to rest.
    pub fn finish(&mut self, overrides: [u32; 3], now: Micros) -> bool {
        let Some(run) = self.run.take() else { return true };
        let Some(b) = self.blocks.front().cloned() else { return true };
        let (s, v) = run.at(now);
        let at_end = s >= b.length - 1e-9 * b.length.max(1.0) - 1e-7;
        self.rest = std::array::from_fn(|i| b.start[i] + b.unit[i] * s.min(b.length));
        if at_end {
            self.rest = std::array::from_fn(|i| b.start[i] + b.unit[i] * b.length);
            self.blocks.pop_front();
            let v = if self.holding { v } else { b.exit };
            if self.blocks.is_empty() || (self.holding && v < 1e-9) {
                self.cut_front(0.0);
                return true;
            }
            self.begin(0.0, v, overrides, now);
            return false;
        }
        // Held within the block: what is left of it becomes the first block.
        self.cut_front(s);
        true
    }

    fn cut_front(&mut self, s: f64) {
        if let Some(b) = self.blocks.front_mut() {
            b.start = std::array::from_fn(|i| b.start[i] + b.unit[i] * s);
            b.length -= s;
            b.entry = 0.0;
        }
    }

    /// Stops at once where the arm is, and forgets the rest. Returns the position.
    pub fn kill(&mut self, now: Micros) -> [f64; 3] {
        let here = self.position(now);
        self.reset(here);
        here
    }
}
