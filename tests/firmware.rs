//! The simulated Grbl against the firmware itself: both get the same bytes and must say the same.
//!
//! Needs a port with stock Grbl 1.1h whose settings may be overwritten, named in `GRBL_PORT`: `tests/avr/run` gives one in an
//! AVR simulator. Without it this test says that it was skipped.

use coil_ps::arm::simulated::Simulated;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Write as _};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// A conversation: bytes, and how long to listen after them.
type Script = &'static [(&'static str, f64)];

/// As flashed.
const STOCK: Script = &[
    ("\n", 0.2),
    ("?", 0.2),
    ("?", 0.2),
    ("?", 0.2),
    ("$$\n", 0.5),
    ("$#\n", 0.5),
    ("$G\n", 0.2),
    ("$I\n", 0.2),
    ("$N\n", 0.2),
    ("$\n", 0.2),
    ("$H\n", 0.2),
    ("$X\n", 0.2),
    ("$20=1\n", 0.6),
    ("$99=1\n", 0.6),
    ("$133=1\n", 0.6),
    ("$0=2\n", 0.6),
    ("$10=-1\n", 0.6),
    ("$10=x\n", 0.6),
    ("$J=\n", 0.2),
    ("$J=G91X1\n", 0.2),
    ("$J=G91X1F100S5\n", 0.2),
    ("$J=G91X1F100M3\n", 0.2),
    ("$JX1\n", 0.2),
    ("$q\n", 0.2),
    ("$GG\n", 0.2),
    ("G1 X1\n", 0.2),
    ("hello\n", 0.2),
    ("1\n", 0.2),
    ("G4\n", 0.2),
    ("G4P-1\n", 0.2),
    ("M7\n", 0.2),
    ("G0 G1 X1\n", 0.2),
    ("G90 G91\n", 0.2),
    ("X1 X2\n", 0.2),
    ("G1.5X1F10\n", 0.2),
    ("G5\n", 0.2),
    ("G10L2P1\n", 0.2),
    ("G10L2X0\n", 0.6),
    ("G10L3P1X1\n", 0.2),
    ("G10L2P9X1\n", 0.2),
    ("G80X1\n", 0.2),
    ("G0\n", 0.2),
    ("G1F100\n", 0.2),
    ("G49\n", 0.2),
    ("G43.1X1\n", 0.2),
    ("G4P0.05F\n", 0.2),
    ("G4P0.05X1\n", 1.0),
    ("(comment) ; more\n", 0.2),
    ("g 90 (x) g21 ; y\n", 0.2),
    ("/G90\n", 0.2),
    ("\r\n", 0.2),
    ("G1X1F500G4P0.1234567890123456789012345678901234567890123456789012345678901234567890123\n", 0.5),
    ("M3S500\n", 0.2),
    ("?", 0.2),
    ("M8\n", 0.2),
    ("?", 0.2),
    ("S0.5\n", 0.2),
    ("?", 0.2),
    ("S5000\n", 0.2),
    ("?", 0.2),
    ("M5\n", 0.2),
    ("M9\n", 0.2),
    ("?", 0.2),
    ("M3S0\n", 0.2),
    ("?", 0.2),
    ("$G\n", 0.2),
    ("M2\n", 0.3),
    ("$G\n", 0.2),
    ("!", 0.2),
    ("?", 0.2),
    ("~", 0.2),
    ("?", 0.2),
    ("!", 0.2),
    ("G4P0.05\n", 0.3),
    ("~", 0.5),
    ("\u{18}", 1.0),
    ("?", 0.2),
    ("$C\n", 0.2),
    ("?", 0.2),
    ("G1X1F100\n", 0.2),
    ("$C\n", 1.0),
    ("$13=1\n", 0.6),
    ("?", 0.2),
    ("$13=0\n", 0.6),
    ("$10=3\n", 0.6),
    ("?", 0.2),
    ("$10=0\n", 0.6),
    ("?", 0.2),
    ("$10=1\n", 0.6),
    ("G10L20P1X5Y5\n", 0.6),
    ("?", 0.2),
    ("G92X1\n", 0.3),
    ("?", 0.2),
    ("G92.1\n", 0.3),
    ("G10L2P1X0Y0\n", 0.6),
    ("$N0=G20\n", 1.0),
    ("\u{18}", 1.0),
    ("$G\n", 0.2),
    ("$N0=\n", 1.0),
    ("$SLP\n", 0.5),
    ("?", 0.2),
    ("G4P0.05\n", 0.3),
    ("\u{18}", 1.0),
    ("?", 0.2),
    ("$X\n", 0.2),
    ("\u{84}", 0.5),
    ("?", 0.2),
    ("~", 0.5),
    ("?", 0.2),
    ("\u{85}", 0.2),
    ("\u{91}\u{91}\u{97}\u{9b}", 0.2),
    ("?", 0.2),
    ("\u{90}\u{95}\u{99}", 0.2),
    ("?", 0.2),
];

/// With the guide's settings, switches and work offset; begins locked.
const ARM: Script = &[
    ("?", 0.2),
    ("G90\n", 0.2),
    ("G4P0.05\n", 0.2),
    ("$J=G91X1F100\n", 0.2),
    ("$#\n", 0.5),
    ("$H\n", 16.0),
    ("?", 0.2),
    ("$X\n", 0.2),
    ("G90G21G1X30Y40F3600\n", 0.1),
    ("G4P0.05\n", 8.0),
    ("?", 0.2),
    ("G1X30Y40F3600\n", 0.2),
    ("G4P0.05\n", 0.4),
    ("?", 0.2),
    // Refused or stopped in motion.
    ("G1X-170Y-40F600\n", 1.5),
    ("?", 0.2),
    ("$$\n", 0.2),
    ("$X\n", 0.2),
    ("$J=G91X1F100\n", 0.2),
    ("!", 1.5),
    ("?", 0.2),
    ("M3S10\n", 0.3),
    ("~", 1.0),
    ("?", 0.2),
    ("!", 1.5),
    ("~", 0.3),
    ("\u{18}", 1.5),
    ("?", 0.2),
    ("G90\n", 0.2),
    ("$X\n", 0.2),
    ("?", 0.2),
    ("$H\n", 16.0),
    // Hold, then reset at rest in hold.
    ("G1X100Y40F600\n", 1.5),
    ("!", 1.5),
    ("?", 0.2),
    ("\u{18}", 1.5),
    ("?", 0.2),
    ("G4P0.05\n", 0.4),
    ("$H\n", 16.0),
    // Jog.
    ("$J=G91X-100F600\n", 1.5),
    ("?", 0.2),
    ("G4P0.05\n", 0.2),
    ("$J=G91Y-1F600\n", 0.2),
    ("\u{85}", 1.5),
    ("?", 0.2),
    ("$J=G91X1000F600\n", 0.2),
    ("$J=G91X-100F600\n", 1.5),
    ("!", 1.5),
    ("?", 0.2),
    ("$J=G91X-100F600\n", 1.5),
    ("\u{18}", 1.5),
    ("?", 0.2),
    ("$X\n", 0.2),
    // Door in motion.
    ("M3S700\n", 0.2),
    ("M8\n", 0.2),
    ("?", 0.2),
    ("G1X60Y40F60\n", 1.5),
    ("\u{84}", 1.5),
    ("?", 0.2),
    ("~", 12.0),
    ("?", 0.2),
    ("\u{18}", 1.5),
    ("?", 0.2),
    ("$H\n", 16.0),
    // Soft limit.
    ("G1X500F3600\n", 1.5),
    ("?", 0.4),
    ("G90\n", 0.4),
    ("\u{18}", 1.0),
    ("?", 0.2),
    ("$X\n", 0.2),
    ("?", 0.2),
    ("G1X-100F1800\n", 0.5),
    ("G1X500F3600\n", 4.0),
    ("?", 0.4),
    ("\u{18}", 1.0),
    ("$X\n", 0.2),
    ("?", 0.2),
    // A reset while homing.
    ("$H\n", 3.0),
    ("?", 0.5),
    ("\u{18}", 1.5),
    ("?", 0.2),
    ("$H\n", 16.0),
    ("?", 0.2),
    // Two moves in the buffer, a dwell behind them, brightness.
    ("M3S800\n", 0.2),
    ("G90G21G1X0Y0F3600\nG90G21G1X40Y40F3600\nG4P0.05\nM5\n", 12.0),
    ("?", 0.2),
];

enum Board {
    Simulated(Box<Simulated>, Duration),
    Real(File, Receiver<Vec<u8>>),
}

/// One byte for each character: the extended commands are single bytes.
fn bytes(text: &str) -> Vec<u8> {
    text.chars().map(|c| c as u8).collect()
}

impl Board {
    fn real(port: &str) -> Self {
        let file = OpenOptions::new().read(true).write(true).open(port).unwrap();
        let mut reading = file.try_clone().unwrap();
        let (send, receive) = channel();
        std::thread::spawn(move || {
            let mut buffer = [0; 256];
            while let Ok(n) = reading.read(&mut buffer) {
                if send.send(buffer[..n].to_vec()).is_err() {
                    break;
                }
            }
        });
        Self::Real(file, receive)
    }

    /// What comes in that time; of the firmware, whose simulator may lag, until so many lines are there, in ten times it.
    fn say(&mut self, text: &str, seconds: f64, lines: usize) -> String {
        let mut out = Vec::new();
        match self {
            Self::Simulated(board, now) => {
                board.feed(*now, &bytes(text));
                *now += Duration::from_secs_f64(seconds);
                board.drain(*now, &mut out);
            }
            Self::Real(file, receive) => {
                file.write_all(&bytes(text)).unwrap();
                let start = Instant::now();
                let mut end = start + Duration::from_secs_f64(seconds);
                let last = start + Duration::from_secs_f64(10.0 * seconds + 5.0);
                loop {
                    match receive.recv_timeout(end.saturating_duration_since(Instant::now())) {
                        Ok(some) => {
                            out.extend(some);
                            end = end.max(Instant::now() + Duration::from_millis(200));
                        }
                        Err(_)
                            if out.iter().filter(|b| **b == b'\n').count() < lines
                                && Instant::now() < last =>
                        {
                            end = Instant::now() + Duration::from_millis(200);
                        }
                        Err(_) => break,
                    }
                }
            }
        }
        String::from_utf8_lossy(&out).into_owned()
    }
}

/// Where it is and how fast, in motion, is a matter of the moment; switches are a matter of the wiring.
fn comparable(said: &str) -> String {
    let moving = ["<Run", "<Jog", "<Home", "<Hold:1"];
    let line = |l: &str| match l.split_once('|') {
        Some((state, fields)) if moving.contains(&state) => {
            let names: Vec<_> = fields.split('|').map(|f| f.split(':').next().unwrap_or("")).collect();
            format!("{state}|{}", names.join("|"))
        }
        _ => l.to_string(),
    };
    let switches = |l: &str| match l.split_once("|Pn:") {
        Some((before, after)) => format!("{before}{}", after.trim_start_matches(char::is_alphabetic)),
        None => l.to_string(),
    };
    said.split_inclusive("\r\n").map(|l| line(&switches(l))).collect()
}

/// The largest difference of the positions told at rest, degrees; the texts without them.
fn without_positions(said: &str) -> (String, Vec<f64>) {
    let Some((before, rest)) = said.split_once("Pos:") else { return (said.into(), Vec::new()) };
    let end = rest.find(['|', '>']).unwrap_or(rest.len());
    let numbers = rest[..end].split(',').filter_map(|n| n.parse().ok()).collect();
    (format!("{before}Pos:{}", &rest[end..]), numbers)
}

fn compare(name: &str, script: Script, simulated: &mut Board, real: &mut Board) -> usize {
    let mut different = 0;
    for (k, (text, seconds)) in script.iter().enumerate() {
        let ours = simulated.say(text, *seconds, 0);
        let theirs = comparable(&real.say(text, *seconds, ours.lines().count()));
        let ours = comparable(&ours);
        let ((a, x), (b, y)) = (without_positions(&ours), without_positions(&theirs));
        // Positions within a step or two; after a stop in motion they are a matter of the moment as well.
        let near = x.len() == y.len() && x.iter().zip(&y).all(|(x, y)| (x - y).abs() < 0.03);
        if a != b || !near {
            let kind = if a == b { "position" } else { "DIFFERENT" };
            different += usize::from(a != b);
            println!("{name} {k} {text:?}: {kind}\n  simulated {ours:?}\n  firmware  {theirs:?}");
        }
    }
    different
}

#[test]
fn the_simulated_grbl_says_what_the_firmware_says() {
    let Ok(port) = std::env::var("GRBL_PORT") else {
        println!("skipped: no GRBL_PORT (see tests/avr/run)");
        return;
    };
    let mut real = Board::real(&port);
    real.say("\u{18}", 1.5, 2);
    let reset = real.say("$X\n", 0.5, 1) + &real.say("$RST=*\n", 8.0, 4);
    assert!(reset.contains("Grbl 1.1"), "{reset:?}");
    // Wherever an earlier run has left it.
    real.say("G0X0Y0Z0\nG4P0.01\n", 4.0, 2);

    let on = |mut board: Simulated| {
        board.open(Duration::ZERO);
        let mut board = Board::Simulated(Box::new(board), Duration::ZERO);
        let banner = board.say("", 2.0, 0);
        (board, banner)
    };
    let (mut simulated, _) = on(Simulated::stock());
    simulated.say("\u{18}", 1.5, 0);
    real.say("\u{18}", 1.5, 2);
    let mut different = compare("stock", STOCK, &mut simulated, &mut real);

    real.say("\u{18}", 1.5, 2);
    real.say("$X\n", 0.5, 1);
    let board = Simulated::arm();
    // Soft limits need homing to be on.
    for n in (0..20).chain(21..=132).chain([20]) {
        let value = board.settings.get(n);
        if [0, 1, 20, 21, 22, 24, 25, 27, 30, 100, 101, 102, 110, 111, 112, 120, 121, 122, 130, 131, 132]
            .contains(&n)
        {
            let said = real.say(&format!("${n}={value}\n"), 0.2, 1);
            assert!(said.contains("ok"), "${n}={value}: {said:?}");
        }
    }
    real.say("G10L2P1X-185Y-100\n", 0.6, 1);
    // Power on: locked.
    let (mut simulated, banner) = on(board);
    assert!(banner.contains("unlock"));
    real.say("$H\n", 1.0, 0);
    real.say("\u{18}", 1.5, 2);
    different += compare("arm", ARM, &mut simulated, &mut real);
    assert_eq!(different, 0, "answers that differ, see above");
}
