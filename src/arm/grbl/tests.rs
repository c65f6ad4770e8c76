use super::*;
use crate::arm::Transport as _;
use crate::arm::simulated::Simulated;

/// A link and a board, driven event by event.
struct Bench {
    link: Link,
    board: Simulated,
    now: Duration,
    events: Vec<(Duration, Event)>,
}

impl Bench {
    fn open(board: Simulated) -> Self {
        let mut b = Self { link: Link::new(), board, now: Duration::ZERO, events: Vec::new() };
        b.board.open(b.now);
        b.link.opened(b.now);
        b
    }

    fn step(&mut self) {
        let out = self.link.take_output();
        if !out.is_empty() {
            self.board.write(self.now, &out).unwrap();
        }
        let wake = [self.link.next_wake(self.now), self.board.next_event()].into_iter().flatten().min();
        self.now = wake.unwrap_or(self.now).max(self.now + Duration::from_micros(50)).min(self.now + ms(100));
        let mut bytes = Vec::new();
        self.board.read(self.now, &mut bytes).unwrap();
        self.link.receive(self.now, &bytes);
        self.link.tick(self.now);
        while let Some(e) = self.link.take_event() {
            self.events.push((self.now, e));
        }
    }

    fn run(&mut self, seconds: f64) {
        let end = self.now + Duration::from_secs_f64(seconds);
        while self.now < end {
            self.step();
        }
    }

    fn until_done(&mut self, command: Command) -> Result<(), Failure> {
        let ticket = self.link.send(self.now, command)?;
        let from = self.events.len();
        loop {
            self.step();
            if let Some((_, Event::Done(_, result))) =
                self.events[from..].iter().find(|(_, e)| matches!(e, Event::Done(t, _) if *t == ticket))
            {
                return result.clone();
            }
            assert!(self.now < Duration::from_secs(600), "{:?}", self.link);
        }
    }
}

fn homed() -> Bench {
    let mut b = Bench::open(Simulated::arm());
    b.run(3.0);
    assert_eq!(b.link.phase(), &Phase::Ready);
    assert_eq!(b.link.state(), Some(State::Alarm));
    b.until_done(Command::Home).unwrap();
    b
}

fn goto(azimuth: f64, slant: f64) -> Command {
    Command::Goto { to: Joints { azimuth, slant }, feed: 6000.0 }
}

#[test]
fn connects_reads_homes_and_moves() {
    let mut b = homed();
    assert_eq!((b.link.version(), b.link.trust()), ("1.1h", Trust::Homed));
    assert_eq!(b.link.settings().len(), 34);
    b.until_done(goto(30.0, 40.0)).unwrap();
    let at = b.link.joints().unwrap();
    assert!((at.azimuth - 30.0).abs() < 0.02 && (at.slant - 40.0).abs() < 0.02);
    b.until_done(Command::Light(800.0)).unwrap();
    b.until_done(Command::Shutter(true)).unwrap();
    assert_eq!((b.board.truth().led, b.board.truth().shutter), (800.0, true));
}

#[test]
fn a_move_takes_the_firmwares_time_and_little_more() {
    let mut b = homed();
    b.until_done(goto(0.0, 20.0)).unwrap();
    for (azimuth, slant) in [(1.0, 20.0), (40.0, 55.0), (-120.0, 10.0), (-121.0, 10.0)] {
        let motion = b.link.motion_of(&goto(azimuth, slant)).as_secs_f64();
        let start = b.now;
        let before = b.board.lines().len();
        b.until_done(goto(azimuth, slant)).unwrap();
        // Time until the firmware has read the first line: what the link adds to a move.
        let line = &b.board.lines()[before];
        let wire = 87e-6 * (line.1.len() + 1) as f64;
        let added = (line.0 - start).as_secs_f64() - wire;
        assert!(added < 0.005, "{added}");
        // And whole: motion, 50 ms dwell, two answers, two lines parsed, one status on the wire.
        let total = (b.now - start).as_secs_f64();
        assert!(total < motion + 0.050 + 0.020, "{total} for {motion}");
    }
}

#[test]
fn polls_at_five_hertz_at_most() {
    let mut b = homed();
    b.until_done(goto(0.0, 0.0)).unwrap();
    b.link.send(b.now, goto(150.0, 50.0)).unwrap();
    let mut asked = Vec::new();
    let end = b.now + ms(5000);
    while b.now < end {
        if let Some(at) = b.link.asked
            && asked.last() != Some(&at)
        {
            asked.push(at);
        }
        b.step();
    }
    assert!(asked.len() > 8, "{}", asked.len());
    assert!(asked.windows(2).all(|w| w[1] - w[0] >= ms(199)), "{asked:?}");
}

#[test]
fn stop_comes_before_everything_and_nothing_after_it() {
    let mut b = homed();
    for k in 0..5 {
        b.link.send(b.now, goto(20.0 * f64::from(k), 30.0)).unwrap();
    }
    b.run(0.3);
    b.link.stop(b.now);
    assert_eq!(b.link.take_output(), b"!\x18");
    b.link.stop(b.now);
    let lines = b.board.lines().len();
    b.run(3.0);
    assert_eq!(b.link.phase(), &Phase::Stopped(true));
    assert_eq!(b.board.lines().len(), lines, "no line after Stop");
    assert_eq!(b.link.state(), Some(State::Alarm));
    assert_eq!(b.link.send(b.now, goto(0.0, 0.0)), Err(Failure::Stopped));
    assert_eq!(b.link.resume(), Err(Failure::Stopped));
    let failed = b.events.iter().filter(|(_, e)| matches!(e, Event::Done(_, Err(Failure::Stopped)))).count();
    assert_eq!(failed, 5);
    b.link.release(b.now).unwrap();
    assert!(b.link.send(b.now, goto(0.0, 0.0)).is_err(), "the position is lost");
    b.until_done(Command::Home).unwrap();
    b.until_done(goto(5.0, 5.0)).unwrap();
}

#[test]
fn errors_and_alarms_are_named() {
    let mut b = homed();
    let refused = b.until_done(Command::Raw("G1 Q3".into())).unwrap_err();
    assert!(refused.to_string().contains("error 20, a G-code word is not supported"), "{refused}");
    let alarm = b.until_done(goto(300.0, 0.0)).unwrap_err();
    assert!(alarm.to_string().contains("soft limits"), "{alarm}");
    assert_eq!(b.link.trust(), Trust::Homed, "a soft limit keeps the position");
    b.link.reset(b.now);
    b.run(2.0);
    assert_eq!(b.link.phase(), &Phase::Ready);
    b.until_done(Command::Unlock).unwrap();
    b.until_done(goto(10.0, 10.0)).unwrap();
}

#[test]
fn a_restart_in_motion_loses_the_position() {
    let mut b = homed();
    b.link.send(b.now, goto(100.0, 30.0)).unwrap();
    b.run(0.5);
    b.board.power_on();
    b.run(5.0);
    assert!(b.events.iter().any(|(_, e)| *e == Event::Restarted));
    assert_eq!((b.link.trust(), b.link.state()), (Trust::Lost, Some(State::Alarm)));
    assert!(matches!(b.link.send(b.now, goto(0.0, 0.0)), Err(Failure::Alarm(_))));
    b.until_done(Command::Unlock).unwrap();
}

#[test]
fn a_lost_answer_is_made_good() {
    let mut b = homed();
    b.until_done(goto(10.0, 10.0)).unwrap();
    b.link.send(b.now, goto(20.0, 20.0)).unwrap();
    // The line never arrives.
    assert!(!b.link.take_output().is_empty());
    b.run(6.0);
    let at = b.board.truth().joints;
    assert!((at.azimuth - 20.0).abs() < 0.02, "{at:?}");
    assert!(matches!(b.events.last().unwrap().1, Event::Position(_)));
    assert!(!b.link.busy() && b.link.trust() == Trust::Homed);
}

#[test]
fn works_with_stock_settings_and_boards_that_do_not_reset() {
    let mut board = Simulated::stock();
    board.open(Duration::ZERO);
    board.read(Duration::from_secs(3), &mut Vec::new()).unwrap();
    board.reset_on_open = false;
    let mut b = Bench::open(board);
    b.now = Duration::from_secs(3);
    b.link.opened(b.now);
    b.run(5.0);
    assert_eq!((b.link.phase(), b.link.trust()), (&Phase::Ready, Trust::Assumed));
    b.until_done(goto(3.0, 4.0)).unwrap();
    assert!(matches!(b.until_done(Command::Home), Err(Failure::Refused { code: 5, .. })));
}

#[test]
fn hold_stretches_a_move_and_jog_can_be_cancelled() {
    let mut b = homed();
    let ticket = b.link.send(b.now, goto(90.0, 20.0)).unwrap();
    b.run(0.5);
    b.link.hold();
    b.run(20.0);
    assert_eq!(b.link.state(), Some(State::Hold(0)));
    b.link.resume().unwrap();
    b.run(20.0);
    assert!(b.events.iter().any(|(_, e)| *e == Event::Done(ticket, Ok(()))));
    assert!(!b.events.iter().any(|(_, e)| matches!(e, Event::Halted(_))));
    b.link.send(b.now, Command::Jog { by: Joints { azimuth: -60.0, slant: 0.0 }, feed: 600.0 }).unwrap();
    b.run(1.0);
    assert_eq!(b.link.state(), Some(State::Jog));
    b.link.jog_cancel();
    b.run(1.0);
    assert_eq!((b.link.state(), b.link.busy()), (Some(State::Idle), false));
}
