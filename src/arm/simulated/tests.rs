use super::*;

/// Talks to a board and collects what it says.
struct Host {
    board: Simulated,
    now: Duration,
}

impl Host {
    fn open(mut board: Simulated) -> Self {
        board.open(Duration::ZERO);
        Self { board, now: Duration::ZERO }
    }

    fn wait(&mut self, seconds: f64) -> String {
        self.now += Duration::from_secs_f64(seconds);
        let mut out = Vec::new();
        self.board.drain(self.now, &mut out);
        String::from_utf8(out).unwrap()
    }

    fn send(&mut self, text: &str, seconds: f64) -> String {
        self.board.feed(self.now, text.as_bytes());
        self.wait(seconds)
    }
}

fn stock() -> Host {
    let mut host = Host::open(Simulated::stock());
    assert_eq!(host.wait(2.0), "\r\nGrbl 1.1h ['$' for help]\r\n");
    host
}

fn homed() -> Host {
    let mut host = Host::open(Simulated::arm());
    assert_eq!(host.wait(2.0), "\r\nGrbl 1.1h ['$' for help]\r\n[MSG:'$H'|'$X' to unlock]\r\n");
    assert_eq!(host.send("$H\n", 60.0), "ok\r\n");
    host
}

#[test]
fn answers_as_stock_grbl_does() {
    let mut h = stock();
    assert_eq!(h.send("\n", 0.1), "ok\r\n");
    assert_eq!(h.send("?", 0.1), "<Idle|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>\r\n");
    assert_eq!(h.send("?", 0.1), "<Idle|MPos:0.000,0.000,0.000|FS:0,0|Ov:100,100,100>\r\n");
    assert_eq!(h.send("?", 0.1), "<Idle|MPos:0.000,0.000,0.000|FS:0,0>\r\n");
    assert_eq!(h.send("$G\n", 0.1), "[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]\r\nok\r\n");
    assert_eq!(h.send("$I\n", 0.1), "[VER:1.1h.20190830:]\r\n[OPT:V,15,128]\r\nok\r\n");
    assert_eq!(h.send("$N\n", 0.1), "$N0=\r\n$N1=\r\nok\r\n");
    assert_eq!(h.send("$H\n", 0.1), "error:5\r\n");
    assert_eq!(h.send("$20=1\n", 1.0), "error:10\r\n");
    assert_eq!(h.send("$99=1\n", 1.0), "error:3\r\n");
    assert_eq!(h.send("G1 X1\n", 0.1), "error:22\r\n");
    assert_eq!(h.send("hello\n", 0.1), "error:2\r\n");
    assert_eq!(h.send("G4\n", 0.1), "error:28\r\n");
    assert_eq!(h.send("M7\n", 0.1), "error:20\r\n");
    assert_eq!(h.send("G0 G1 X1\n", 0.1), "error:24\r\n");
    assert_eq!(h.send("G90 G91\n", 0.1), "error:21\r\n");
    assert_eq!(h.send("X1 X2\n", 0.1), "error:25\r\n");
    assert_eq!(h.send("$J=X1\n", 0.1), "error:22\r\n");
    assert_eq!(h.send("$J=M3 X1 F10\n", 0.1), "error:16\r\n");
    assert_eq!(h.send(&format!("{}\n", "X1".repeat(50)), 0.2), "error:11\r\n");
    assert_eq!(h.send("(a comment) ; and one more\n", 0.1), "ok\r\n");
    let settings = h.send("$$\n", 0.3);
    assert!(settings.starts_with("$0=10\r\n$1=25\r\n") && settings.ends_with("$132=200.000\r\nok\r\n"));
    assert_eq!(settings.matches('$').count(), 34);
    assert_eq!(h.send("$#\n", 0.3).matches('[').count(), 11);
}

#[test]
fn a_move_takes_as_long_as_its_acceleration_asks() {
    let mut h = stock();
    // 10 units at 500/min and 10/s²: v = 8.33, ramps 0.833 s each over 6.94 units, cruise 0.367 s.
    let seconds = 2.0 * 8.3333 / 10.0 + (10.0 - 8.3333 * 8.3333 / 10.0) / 8.3333;
    assert_eq!(h.send("G1 X10 F500\n", 0.01), "ok\r\n");
    assert!(h.send("?", 0.02).starts_with("<Run|"));
    assert_eq!(h.send("$$\n", 0.02), "error:8\r\n");
    assert_eq!(h.send("G4 P0.05\n", seconds - 0.06 - 0.03), "");
    assert_eq!(h.wait(0.15), "ok\r\n");
    assert!(h.send("?", 0.02).starts_with("<Idle|MPos:10.000,0.000,0.000|"));
}

#[test]
fn the_planner_holds_fifteen_moves_and_then_waits() {
    let mut h = stock();
    h.board.settings.set(10, 3.0);
    let mut oks = 0;
    for k in 1..=25 {
        oks += h.send(&format!("G1 X{k} F60\n"), 0.005).matches("ok").count();
    }
    assert_eq!(oks, 15);
    assert!(h.send("?", 0.02).contains("|Bf:0,"));
    assert_eq!(h.wait(60.0).matches("ok").count(), 10);
    // Moves in one direction are joined without stopping: 25 units at 1/s.
    assert!(h.send("?", 0.02).contains("<Idle|MPos:25.000"));
}

#[test]
fn hold_slows_down_and_resume_goes_on() {
    let mut h = stock();
    h.send("G1 X20 F500\n", 1.5);
    assert!(h.send("!?", 0.02).starts_with("<Hold:1|"));
    assert!(h.send("?", 2.0).starts_with("<Hold:"));
    let held = h.send("?", 0.02);
    assert!(held.starts_with("<Hold:0|"), "{held}");
    assert_eq!(h.send("G1 X0\n", 0.5), "", "nothing is answered while holding");
    assert!(h.send("~", 0.1).contains("ok"));
    assert!(h.send("?", 0.02).starts_with("<Run|"));
    h.wait(10.0);
    assert!(h.send("?", 0.02).starts_with("<Idle|MPos:0.000"));
}

#[test]
fn reset_while_moving_is_alarm_three() {
    let mut h = stock();
    h.send("G1 X20 F500\n", 1.0);
    h.board.feed(h.now, b"G4 P0\n");
    h.wait(0.1);
    assert_eq!(
        h.send("\x18", 1.0),
        "ALARM:3\r\nok\r\n\r\nGrbl 1.1h ['$' for help]\r\n[MSG:'$H'|'$X' to unlock]\r\n"
    );
    assert_eq!(h.send("G1 X1 F100\n", 0.1), "error:9\r\n");
    assert_eq!(h.send("$X\n", 0.1), "[MSG:Caution: Unlocked]\r\nok\r\n");
    assert_eq!(h.send("\x18", 0.1), "\r\nGrbl 1.1h ['$' for help]\r\n");
}

#[test]
fn homing_finds_the_switches_and_sets_the_position() {
    let mut h = homed();
    assert!(h.board.truth().position_true);
    let status = h.send("?", 0.02);
    assert!(
        status.starts_with("<Idle|MPos:-2.002,-2.002,-2.000|FS:0,0|WCO:-185.000,-100.000,0.000>"),
        "{status}"
    );
    // Outside the travel: alarm 2, nothing but a reset helps, the position is kept.
    assert_eq!(h.send("G1 X200 F1000\n", 1.0), "ALARM:2\r\n[MSG:Reset to continue]\r\n");
    assert_eq!(h.send("$X\n?", 1.0), "");
    assert!(h.send("\x18", 1.0).ends_with("Grbl 1.1h ['$' for help]\r\n[MSG:'$H'|'$X' to unlock]\r\n"));
    assert!(h.board.truth().position_true);
    h.send("$X\n", 0.1);
    assert_eq!(h.send("$J=G91 X10 F1000\n", 0.1), "error:15\r\n");
}

#[test]
fn homing_without_a_switch_is_alarm_nine_and_stuck_is_eight() {
    for (switch, alarm) in [(Switch::Absent, "ALARM:9"), (Switch::Stuck, "ALARM:8")] {
        let mut board = Simulated::arm();
        board.switches[1] = switch;
        let mut h = Host::open(board);
        h.wait(2.0);
        let said = h.send("$H\n", 120.0);
        assert!(said.starts_with(alarm) && said.contains("Grbl 1.1h"), "{said}");
    }
    let mut h = Host::open(Simulated::arm());
    h.wait(2.0);
    h.send("$H\n", 1.0);
    assert_eq!(h.send("?", 1.0), "", "no status while homing");
    assert!(h.send("\x18", 1.0).starts_with("ALARM:6\r\n"));
}

#[test]
fn jog_and_jog_cancel() {
    let mut h = homed();
    h.send("G1 X0 Y0 F3000\nG4 P0.05\n", 30.0);
    assert_eq!(h.send("$J=G91 X30 F600\n", 1.0), "ok\r\n");
    assert!(h.send("?", 0.02).starts_with("<Jog|"));
    assert_eq!(h.send("G1 X0\n", 0.02), "error:9\r\n");
    h.board.feed(h.now, &[0x85]);
    h.wait(0.5);
    let at = h.board.truth();
    assert!(
        at.state == State::Idle && at.joints.azimuth > 5.0 && at.joints.azimuth < 15.0 && at.position_true
    );
}

#[test]
fn led_and_shutter_wait_for_the_motion() {
    let mut h = stock();
    h.send("G1 X1 F500\n", 0.01);
    assert_eq!(h.send("M3 S800\n", 0.05), "");
    assert_eq!(h.wait(2.0), "ok\r\n");
    assert_eq!(h.send("M8\n", 0.1), "ok\r\n");
    assert_eq!((h.board.truth().led, h.board.truth().shutter), (800.0, true));
    assert!(h.send("?", 0.1).contains("|FS:0,800|"));
    assert!(h.send("?", 0.1).contains("|A:SF>"));
    assert_eq!(h.send("M5 M9\n", 0.1), "ok\r\n");
    assert_eq!((h.board.truth().led, h.board.truth().shutter), (0.0, false));
}

#[test]
fn hard_limit_door_sleep_and_check_mode() {
    let mut h = homed();
    h.board.settings.set(21, 1.0);
    h.send("G1 X0 Y0 F3000\n", 0.5);
    h.board.hit_limit(h.now);
    assert_eq!(h.wait(0.5), "ALARM:1\r\n[MSG:Reset to continue]\r\n");
    h.send("\x18", 1.0);
    h.send("$X\nM3 S500\n", 0.5);
    h.board.feed(h.now, &[0x84]);
    assert_eq!(h.wait(0.2), "[MSG:Check Door]\r\n");
    assert!(h.send("?", 0.1).starts_with("<Door:0|"));
    assert_eq!(h.board.truth().led, 0.0);
    assert!(h.send("~?", 0.1).starts_with("<Door:3|"));
    h.wait(5.0);
    assert!(h.send("?", 0.1).starts_with("<Idle|"));
    assert_eq!(h.board.truth().led, 500.0);
    assert_eq!(h.send("$C\n", 0.1), "[MSG:Enabled]\r\nok\r\n");
    assert_eq!(h.send("$C\n", 0.1), "[MSG:Disabled]\r\nok\r\n\r\nGrbl 1.1h ['$' for help]\r\n");
    assert_eq!(h.send("$SLP\n", 0.1), "ok\r\n[MSG:Sleeping]\r\n");
    assert!(h.send("?", 0.1).starts_with("<Sleep|"));
    assert!(h.send("\x18", 1.0).ends_with("[MSG:'$H'|'$X' to unlock]\r\n"));
}

/// Each of these was found by `tests/firmware.rs` against the firmware.
#[test]
fn odd_lines_are_answered_as_by_the_firmware() {
    let mut h = stock();
    assert_eq!(h.send("$J=G91X1F100S5\n", 0.2), "error:36\r\n");
    assert_eq!(h.send("G1.5X1F10\n", 0.2), "error:23\r\n");
    assert_eq!(h.send("G10L2X0\n", 1.0), "ok\r\n");
    assert_eq!(h.send("G1F100\n", 0.2), "ok\r\n");
    h.send("?", 0.1);
    h.send("?", 0.1);
    // The work offset is told again only when it was set; a half is rounded up.
    assert_eq!(h.send("M3S0.5\n", 0.2), "ok\r\n");
    assert_eq!(h.send("?", 0.1), "<Idle|MPos:0.000,0.000,0.000|FS:0,1|Ov:100,100,100|A:S>\r\n");
    assert_eq!(h.send("G92X1\n", 0.2), "ok\r\n");
    assert_eq!(h.send("?", 0.1), "<Idle|MPos:0.000,0.000,0.000|FS:0,1|WCO:-1.000,0.000,0.000>\r\n");
    assert_eq!(h.send("G92.1\n$13=1\n", 1.0), "ok\r\nok\r\n");
    assert_eq!(h.send("?", 0.1), "<Idle|MPos:0.0000,0.0000,0.0000|FS:0.0,1|WCO:0.0000,0.0000,0.0000>\r\n");
}
