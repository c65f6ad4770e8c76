//! The whole rig in simulated time: capture, link, a line that fails, the board, a camera, a disk.

use super::*;
use crate::arm::Transport as _;
use crate::arm::fault::{Fault, Faulty};
use crate::arm::kinematics::Arm;
use crate::arm::simulated::Simulated;
use crate::camera::{Camera as _, Domain};
use crate::planner::{self, Setup};
use crate::rig::camera::{Sensor, SimulatedCamera, Sphere, misplacement};
use crate::rng::Rng;
use crate::solve::{LeastSquares, Measurements, Solver as _};
use std::collections::BTreeMap;

const LIGHTS: usize = 4;

fn ms(n: u64) -> Duration {
    Duration::from_millis(n)
}

struct Rig<'a> {
    sphere: &'a Sphere,
    now: Duration,
    link: Link,
    port: Faulty,
    capture: Capture<'a>,
    camera: SimulatedCamera,
    disk: BTreeMap<String, Vec<u8>>,
    /// Where the light really was, one a stored shot.
    truth: Vec<Vec3>,
    in_flight: Vec3,
    stop_at: Option<Duration>,
    stopped: bool,
    reconnects: u32,
}

fn session(sphere: &Sphere, lights: usize) -> Session<'static> {
    let setup = Setup { lights, seed: 7, draw: 0, camera: None, truth: None, learned: None };
    let planner = planner::build("random", &setup).unwrap();
    Session::new(sphere.mask().clone(), Domain::Hemisphere { reach: 1.2 }, planner, lights)
}

impl<'a> Rig<'a> {
    fn new(sphere: &'a Sphere, fault: Fault, at: Duration, seed: u64, lights: usize) -> Self {
        let record = Record::new("sphere", "random", 7, lights, Arm::default());
        let capture =
            Capture::new(session(sphere, lights), record, Options { settle: 0.1, ..Options::default() });
        let mut rig = Self {
            sphere,
            now: Duration::ZERO,
            link: Link::new(),
            port: Faulty::new(Simulated::arm(), fault, at, seed),
            capture,
            camera: SimulatedCamera::new(Sensor { full_well: 0.0, ..Sensor::default() }, seed, false),
            disk: BTreeMap::new(),
            truth: Vec::new(),
            in_flight: Vec3::Z,
            stop_at: None,
            stopped: false,
            reconnects: 0,
        };
        rig.write(rig.capture.opening_writes().unwrap());
        rig.reopen();
        rig
    }

    fn write(&mut self, writes: Vec<Write>) {
        for w in writes {
            self.disk.insert(w.name, w.bytes);
        }
    }

    /// Tries for eight seconds, as the page does.
    fn reopen(&mut self) -> bool {
        let end = self.now + ms(8000);
        while self.now < end {
            if self.port.open(self.now).is_ok() {
                self.link.opened(self.now);
                return true;
            }
            self.now += ms(250);
        }
        false
    }

    /// Link and port, once.
    fn pump(&mut self) {
        self.now += Duration::from_micros(20);
        let out = self.link.take_output();
        if self.stopped {
            assert!(
                out.iter().all(|b| b"!\x18?".contains(b)),
                "sent after Stop: {:?}",
                String::from_utf8_lossy(&out)
            );
        }
        let mut bytes = Vec::new();
        let mut lost = None;
        if !matches!(self.link.phase(), Phase::Closed(_)) {
            if !out.is_empty() {
                lost = self.port.write(self.now, &out).err();
            }
            lost = lost.or(self.port.read(self.now, &mut bytes).err());
        }
        self.link.receive(self.now, &bytes);
        self.link.tick(self.now);
        if let Some(error) = lost {
            self.link.closed(Some(error.to_string()));
        }
        while let Some(event) = self.link.take_event() {
            self.capture.event(self.now, &event);
        }
    }

    fn sleep(&mut self, until: Option<Duration>) {
        let next = [until, self.link.next_wake(self.now), self.port.next_event(), self.stop_at]
            .into_iter()
            .flatten()
            .min();
        let next = next.unwrap_or(self.now + ms(50)).min(self.now + ms(50));
        self.now = next.max(self.now + Duration::from_micros(200));
    }

    /// Until the capture is done or can't go on.
    fn run(&mut self) -> Result<(), Stuck> {
        let limit = self.now + Duration::from_secs(1500);
        loop {
            assert!(self.now < limit, "does not end: {} {:?}", self.capture.doing(), self.link);
            if self.stop_at.is_some_and(|t| self.now >= t) {
                self.stop_at = None;
                self.link.stop(self.now);
                self.stopped |= !matches!(self.link.phase(), Phase::Closed(_));
            }
            self.pump();
            match self.capture.next(self.now, &mut self.link) {
                Action::Wait(until) => self.sleep(until),
                Action::Plan => _ = self.capture.plan(self.now, &self.link).unwrap(),
                Action::Expose { seconds, .. } => {
                    // The shutter is open at some moment of the exposure; where the light is then is what counts.
                    self.port.board.drain(self.now, &mut Vec::new());
                    let real = self.port.board.truth();
                    self.in_flight = self.capture.record().arm.direction(real.joints);
                    let brightness = (real.led / 800.0) as f32;
                    let e = self.camera.expose(self.sphere, self.in_flight, brightness, seconds).unwrap();
                    self.now += Duration::from_secs_f64(seconds) + ms(20);
                    self.capture.exposed(e).unwrap();
                }
                Action::Develop => self.capture.develop(&self.link).unwrap(),
                Action::Store(writes) => {
                    self.write(writes);
                    self.truth.push(self.in_flight);
                    self.capture.stored().unwrap();
                }
                Action::Done => return Ok(()),
                Action::Stuck(Stuck::Disconnected(why)) if !self.stopped && self.reconnects < 3 => {
                    self.reconnects += 1;
                    if !self.reopen() {
                        return Err(Stuck::Disconnected(why));
                    }
                    self.capture.retry();
                }
                Action::Stuck(stuck) => return Err(stuck),
            }
        }
    }

    fn settle(&mut self, seconds: u64) {
        let end = self.now + Duration::from_secs(seconds);
        while self.now < end {
            self.pump();
            self.sleep(Some(end));
        }
    }
}

#[test]
fn ten_lights_in_simulation_at_the_speed_of_the_arm() {
    let sphere = Sphere::new(24).unwrap();
    let mut rig = Rig::new(&sphere, Fault::Split, Duration::from_secs(100_000), 1, 10);
    rig.run().unwrap();
    let record = rig.capture.record().clone();
    assert_eq!(record.shots.len(), 10);
    for (shot, real) in record.shots.iter().zip(&rig.truth) {
        assert!(misplacement(*real, shot.commanded) < 0.03);
        // What the link and the firmware add to the pure motion: dwell 50 ms, lines, answers, one status.
        let pure = shot.timings.r#move;
        assert!(pure > 0.05 && pure < 10.0, "{:?}", shot.timings);
    }
    let solution = rig.capture.session().solve(&LeastSquares, 10).unwrap();
    let mae = crate::error::mae(&solution.normals, sphere.truth());
    // The same lights seen without exposure, noise and quantisation.
    let ideal: Vec<_> = record.shots.iter().map(|s| sphere.capture(s.commanded, &[]).unwrap()).collect();
    let ideal = LeastSquares.solve(&Measurements::of(&ideal)).unwrap();
    assert!((mae - crate::error::mae(&ideal.normals, sphere.truth())).abs() < 0.1, "{mae}");
    assert!(!rig.port.board.truth().moving && rig.port.board.truth().led == 0.0);
}

/// One run: a fault at a random moment, in half of the runs Stop at another.
fn one(fault: Fault, seed: u64, sphere: &Sphere, span: Duration) -> (bool, bool) {
    let mut rng = Rng::stream(seed, fault as u64);
    let at = span.mul_f32(rng.uniform());
    let mut rig = Rig::new(sphere, fault, at, seed, LIGHTS);
    if rng.below(2) == 0 {
        rig.stop_at = Some(span.mul_f32(rng.uniform() * 1.3));
    }
    let ended = rig.run();
    let text = format!("{fault:?} seed {seed} at {at:?} stop {}: {ended:?}", rig.stopped);
    // Everything that was captured is on disk, whole, and of the light that the record says.
    let disk = rig.disk.clone();
    let back = store::resume(|n| disk.get(n).cloned()).unwrap();
    assert!(back.damaged.is_empty(), "{text}");
    assert_eq!(back.seen.len(), rig.truth.len(), "{text}");
    assert_eq!(back.seen.len(), rig.capture.session().seen().len(), "{text}");
    if ended.is_ok() {
        assert_eq!(back.seen.len(), LIGHTS, "{text}");
    }
    for (shot, (real, picture)) in back.record.shots.iter().zip(rig.truth.iter().zip(&back.seen)) {
        if fault != Fault::LostSteps {
            assert!(
                misplacement(*real, shot.commanded) < 0.05,
                "{text}: {shot:?} but the light was at {real}"
            );
        }
        assert!(picture.grey.iter().copied().fold(0.0, f32::max) > 0.05, "{text}: the LED was off");
    }
    // The state shown is the true one, or none.
    // Also after a fault that comes late.
    rig.settle(8 + at.saturating_sub(rig.now).as_secs());
    let real = rig.port.board.truth();
    let kind = |s: State| std::mem::discriminant(&s);
    if let Some(shown) = rig.link.state() {
        assert_eq!(kind(shown), kind(real.state), "{text}: {:?}", rig.link.phase());
    }
    if rig.link.trust() == Trust::Homed && fault != Fault::LostSteps {
        assert!(real.position_true, "{text}: {real:?}");
    }
    if rig.stopped {
        assert!(!real.moving, "{text}");
        assert!(
            matches!(rig.link.phase(), Phase::Stopped(true) | Phase::Closed(_)),
            "{text} {:?}",
            rig.link.phase()
        );
    }
    // From what is on disk, a sound rig goes on to the end.
    if seed.is_multiple_of(10) {
        let mut sound = Rig::new(sphere, Fault::Split, Duration::from_secs(100_000), 1, LIGHTS);
        sound.truth = rig.truth.clone();
        sound.disk = rig.disk.clone();
        sound.capture = Capture::resume(session(sphere, LIGHTS), back, Options::default()).unwrap();
        sound.run().unwrap();
        let whole = store::resume(|n| sound.disk.get(n).cloned()).unwrap();
        assert_eq!((whole.seen.len(), whole.damaged.len()), (LIGHTS, 0), "{text}");
    }
    (ended.is_ok(), rig.port.happened())
}

#[test]
fn every_fault_at_random_moments() {
    let sphere = Sphere::new(8).unwrap();
    // A whole session: connect, home, four lights.
    let mut calm = Rig::new(&sphere, Fault::Split, Duration::from_secs(100_000), 1, LIGHTS);
    calm.run().unwrap();
    let span = calm.now;
    // All 500 take a minute of two cores: CI does them, and COIL_FAULT_MOMENTS=500.
    let default = if std::env::var_os("CI").is_some() { 500 } else { 40 };
    let moments = std::env::var("COIL_FAULT_MOMENTS").ok().and_then(|v| v.parse().ok()).unwrap_or(default);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let faults = std::sync::Mutex::new(Fault::ALL.to_vec());
    std::thread::scope(|scope| {
        for _ in 0..cores {
            scope.spawn(|| {
                loop {
                    let Some(fault) = faults.lock().unwrap().pop() else { return };
                    let runs: Vec<(bool, bool)> =
                        (0..moments).map(|seed| one(fault, seed, &sphere, span)).collect();
                    let done = runs.iter().filter(|r| r.0).count();
                    let happened = runs.iter().filter(|r| r.1).count();
                    println!(
                        "{fault:?}: {happened} of {moments} happened, {done} sessions came to their end"
                    );
                    assert!(happened * 2 > runs.len(), "{fault:?} hardly ever happened");
                }
            });
        }
    });
}

#[test]
fn a_damaged_image_is_taken_again() {
    let sphere = Sphere::new(8).unwrap();
    let mut rig = Rig::new(&sphere, Fault::Split, Duration::from_secs(100_000), 1, LIGHTS);
    rig.run().unwrap();
    rig.disk.get_mut("002.png").unwrap()[60] ^= 4;
    let back = store::resume(|n| rig.disk.get(n).cloned()).unwrap();
    assert_eq!(back.damaged, ["002.png"]);
    rig.capture = Capture::resume(session(&sphere, LIGHTS), back, Options::default()).unwrap();
    rig.run().unwrap();
    let whole = store::resume(|n| rig.disk.get(n).cloned()).unwrap();
    assert_eq!((whole.seen.len(), whole.record.shots[3].file.as_str()), (LIGHTS, "005.png"));
}

#[test]
fn a_board_that_does_not_fit_moves_nothing() {
    let sphere = Sphere::new(8).unwrap();
    let mut rig = Rig::new(&sphere, Fault::Split, Duration::from_secs(100_000), 1, LIGHTS);
    rig.settle(3);
    rig.link.send(rig.now, Command::Raw("$32=1".into())).unwrap();
    rig.settle(3);
    rig.reopen();
    let stuck = rig.run().unwrap_err().to_string();
    assert!(stuck.contains("don't fit the arm's configuration: $32=1 (laser mode)"), "{stuck}");
    assert!(rig.truth.is_empty() && rig.port.board.truth().state == State::Alarm, "not even homed");
    // Mended, and read again.
    for line in ["$32=0", "$$"] {
        rig.link.send(rig.now, Command::Raw(line.into())).unwrap();
        rig.settle(3);
    }
    rig.capture.retry();
    rig.run().unwrap();
    assert_eq!(rig.truth.len(), LIGHTS);
}

#[test]
fn a_wrong_order_is_refused() {
    let sphere = Sphere::new(8).unwrap();
    let mut rig = Rig::new(&sphere, Fault::Split, Duration::from_secs(100_000), 1, LIGHTS);
    let e = rig.camera.expose(&sphere, Vec3::Z, 1.0, 1e-3).unwrap();
    assert!(matches!(rig.capture.exposed(e), Err(CaptureError::Order(_))));
    assert!(matches!(rig.capture.stored(), Err(CaptureError::Order(_))));
    assert!(matches!(rig.capture.plan(rig.now, &rig.link), Err(CaptureError::Order(_))));
}
