//! `coil arm`, `coil capture` and `coil calibrate` as a user runs them, against the simulated board.
#![cfg(feature = "cli")]

#[path = "support/cli.rs"]
mod cli;

use cli::{bad, coil, command, folder, good, text};
use coil_ps::camera::Camera as _;
use coil_ps::image::encode_rgb;
use coil_ps::rig::camera::{Sensor, SimulatedCamera, Sphere};
use coil_ps::rig::store::{Record, resume};
use coil_ps::rng::Rng;
use coil_ps::solve::{LeastSquares, Measurements, Solver as _};
use coil_ps::{error, light};
use glam::Vec3;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Command, Stdio};

fn record(session: &Path) -> Record {
    let back = resume(|name| std::fs::read(session.join(name)).ok()).unwrap();
    assert!(back.damaged.is_empty());
    back.record
}

#[test]
fn the_arm_tells_its_state_and_goes_where_it_is_sent() {
    let status = good(&["arm", "status"]);
    assert!(status.contains("Grbl 1.1h") && status.contains("locked: home it"), "{status}");
    assert!(status.contains("settings fit the configuration"), "{status}");
    assert!(good(&["arm", "home"]).contains("azimuth 182.998°, slant 97.998° (homed)"));
    let went = good(&["arm", "goto", "30", "40"]);
    assert!(went.contains("azimuth 29.99") || went.contains("azimuth 30.0"), "{went}");
    let near = good(&["arm", "goto", "30", "0"]);
    assert!(near.contains("out of the arm's range") && near.contains("8.00° off"), "{near}");
    // Homing leaves it in the corner of its travel: one way is free, the other is not.
    assert!(good(&["arm", "jog", "-5", "-3"]).contains("azimuth 178.00"));
    assert!(bad(2, &["arm", "jog", "5", "-3"]).contains("error 15, the jog would leave the travel"));
    assert!(bad(2, &["arm", "goto", "30", "40", "--no-home"]).contains("the arm is locked"));
    let sweep = good(&["arm", "sweep", "--lights", "3"]);
    assert!(sweep.contains("3 moves: "), "{sweep}");
    assert!(bad(2, &["arm", "goto", "400", "3"]).contains("-360 to 360"));
    assert!(bad(2, &["arm", "status", "--fault", "help"]).contains("garblesent"));
    let config = folder("config").join("arm.json");
    let status = |written: &str| {
        std::fs::write(&config, written).unwrap();
        bad(2, &["arm", "status", "--config", text(&config)])
    };
    let crossed =
        r#"{"limits": {"azimuth": [180, -180], "slant": [-85, 85], "keep_out": 8, "may_cross": false}}"#;
    assert!(status(crossed).contains("limits.azimuth is [180, -180]"));
    assert!(status(r#"{"limit": {}}"#).contains("unknown field `limit`"));
}

#[cfg(all(feature = "serial", unix))]
#[test]
fn ports_that_are_not_there_are_told() {
    assert!(bad(2, &["arm", "status", "--arm", "/dev/no-such-port"]).contains("coil arm ports"));
}

#[test]
fn the_console_takes_a_script() {
    let mut child = command(&["arm", "console"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(b"G0X9\n$H\n?\nG0X999\n$X\nstop\nG0X1\nquit\n").unwrap();
    let out = child.wait_with_output().unwrap();
    let (said, log) = (String::from_utf8(out.stdout).unwrap(), String::from_utf8(out.stderr).unwrap());
    assert!(out.status.success(), "{log}");
    assert!(said.contains("Idle: azimuth 182.998°, slant 97.998° (homed)"), "{said}");
    for part in ["> G0X9", "error 9", "> $H", "ALARM:2", "! reset (Stop)", "stopped: release Stop"] {
        assert!(log.contains(part), "{part} is not in {log}");
    }
    assert!(!log.contains("> G0X1\n"), "sent after Stop: {log}");
}

#[test]
fn a_session_is_captured_kept_and_continued() {
    let at = folder("session");
    let out = at.join("ball");
    let base = ["capture", "--size", "32", "--object", "sphere", "-t", "5", "--out", text(&out)];
    let said = good(&base);
    assert!(said.contains("5 lights") && said.contains("a step: plan"), "{said}");
    let taken = record(&out);
    assert_eq!((taken.shots.len(), taken.firmware.as_str()), (5, "Grbl 1.1h"));
    assert!(taken.shots.iter().all(|s| s.timings.r#move > 0.0 && s.measured.is_none()));
    // Any reader of the layout opens it.
    assert!(good(&["info", text(&out)]).contains('5'));
    assert!(bad(2, &base).contains("--resume goes on with it"));
    assert!(
        bad(2, &[&base[..7], &["--out", text(&at.join("none")), "--resume"]].concat()).contains("no session")
    );

    // Five lights are the least from which an error is predicted.
    let early = ["capture", "--size", "32", "--object", "sphere", "-t", "9", "--stop-at", "80deg", "--out"];
    let said = good(&[&early[..], &[text(&at.join("early"))]].concat());
    assert!(said.contains("5 lights are enough for a predicted error of at most 80°"), "{said}");
    assert_eq!(record(&at.join("early")).shots.len(), 5);

    // The cable is pulled and comes back: it goes on by itself.
    let pulled = at.join("pulled");
    let args = [&base[..7], &["--out", text(&pulled), "--fault", "unplug@18"]].concat();
    assert!(good(&args).contains("5 lights"));
    // A port that does not come back ends it; what is there is kept, and continued with the same planner only.
    let silent = at.join("silent");
    let out = coil(&[&base[..7], &["--out", text(&silent), "--fault", "unplugforever@20"]].concat());
    assert_eq!(out.status.code(), Some(3), "{}", String::from_utf8_lossy(&out.stderr));
    let before = record(&silent).shots.len();
    assert!((1..5).contains(&before), "{before}");
    let again = [&base[..7], &["--out", text(&silent), "--resume"]].concat();
    for (more, says) in [
        (["--seed", "9"], "--seed 1 (now --seed 9)"),
        (["--material", "ggx:0.3"], "--material lambert:0.8 (now --material ggx:0.3)"),
        (["--misaligned", "1,0,0,0"], "no --misaligned (now --misaligned 1,0,0,0)"),
        (["--camera", &format!("folder:{}", text(&at))], "--camera sim (now --camera folder:DIR)"),
    ] {
        let said = bad(2, &[&again[..], &more].concat());
        assert!(said.contains(says) && said.contains("say the same"), "{said}");
    }
    let forgotten = ["capture", "--size", "32", "-t", "5", "--out", text(&silent), "--resume"];
    assert!(bad(2, &forgotten).contains("begun with --object sphere (now --object blob:7)"));
    assert!(good(&again).contains(&format!("going on after {before} of 5 lights")));
    assert_eq!(record(&silent).shots.len(), 5);
}

#[test]
fn the_light_is_out_however_it_ends() {
    let at = folder("dark");
    let out = at.join("session");
    // The camera saves nothing.
    let camera = format!("folder:{}", text(&at));
    let log = bad(2, &["capture", "--camera", &camera, "--patience", "0.2", "--trace", "--out", text(&out)]);
    assert!(log.contains("no new image in 0.2 s"), "{log}");
    assert!(log.rfind("> M5") > log.rfind("> M3S800"), "{log}");
    // Somebody presses hold and leaves: a held firmware takes no line.
    let held = ["capture", "--size", "32", "-t", "5", "--fault", "holdforever@20", "--trace", "--out"];
    let log = bad(3, &[&held[..], &[text(&at.join("held"))]].concat());
    assert!(log.rfind("reset (Stop)") > log.rfind("> M3S800"), "{log}");
}

/// `coil capture … 2>&1 | head -1`: the session goes on to its end, and the light goes out.
#[cfg(unix)]
#[test]
fn a_reader_that_leaves_leaves_no_light_on() {
    let out = folder("unread").join("session");
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let args = ["capture", "--size", "32", "-t", "5", "--planner", "random", "--trace", "--out", text(&out)];
    let mut command = command(&args);
    let done = command.stdout(writer.try_clone().unwrap()).stderr(writer).status().unwrap();
    assert!(done.success(), "{done}");
    assert_eq!(record(&out).shots.len(), 5);
}

#[test]
fn what_a_planner_cannot_plan_is_refused_before_anything_moves() {
    let out = folder("unplanned").join("session");
    let refused = |more: &[&str]| {
        let log = bad(2, &[&["capture", "--size", "32", "--trace", "--out", text(&out)][..], more].concat());
        assert!(!log.contains("> "), "{log}");
        log
    };
    assert!(refused(&["--planner", "lipids", "-t", "7"]).contains("3, 5 and 10"));
    assert!(refused(&["--solver", "magic"]).contains("magic"));
    assert!(refused(&["--brightness", "0"]).contains("brightness 0: above 0 and up to 100000"));
    assert!(refused(&["--nearby", "45"]).contains("nearby 45: 0 to 30 degrees"));
    if cfg!(feature = "policy") {
        let log = refused(&["--planner", "coil", "-t", "40"]);
        assert!(log.contains("coil is not defined for 40 lights: it plans at most 32"), "{log}");
    }
}

#[cfg(unix)]
#[test]
fn an_interrupt_stops_the_arm_and_keeps_the_session() {
    let out = folder("interrupted").join("session");
    let base = ["capture", "--size", "32", "-t", "5", "--planner", "random", "--out", text(&out)];
    let mut child = command(&base)
        .args(["--pace", "real", "--trace"])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut log = String::new();
    let mut moves = 0;
    for line in BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok) {
        log += &format!("{line}\n");
        // At the second move the first light is on disk.
        if line.contains("G1X") {
            moves += 1;
            if moves == 2 {
                let id = child.id().to_string();
                assert!(Command::new("kill").args(["-INT", &id]).status().unwrap().success());
            }
        }
    }
    assert_eq!(child.wait().unwrap().code(), Some(3), "{log}");
    assert!(log.rfind("! reset (Stop)") > log.rfind("> M3S800"), "{log}");
    assert!(log.contains("error: stopped") && log.contains("--resume goes on"), "{log}");
    let taken = record(&out).shots.len();
    assert!((1..5).contains(&taken), "{taken}: {log}");
    assert!(good(&[&base[..], &["--resume"]].concat()).contains("5 lights"));
}

/// A camera that saves to a folder: it looks at a sphere under the light that the arm's last move names, and takes a
/// bracket whenever the shutter line goes high. It knows the arm only from the lines that pass.
#[test]
fn another_process_fills_the_folder() {
    let at = folder("watched");
    let (images, out) = (at.join("images"), at.join("session"));
    std::fs::create_dir_all(&images).unwrap();
    std::fs::write(images.join("0000-old.png"), b"left from yesterday").unwrap();
    let scene = Sphere::new(48).unwrap();
    let mut camera = SimulatedCamera::new(Sensor::default(), 3, false);
    let mut child = command(&["capture", "--camera", &format!("folder:{}", text(&images))])
        .args(["--black", "16", "--white", "4095", "--shutter", "--trace", "--dark", "--patience", "20"])
        .args(["-t", "6", "--planner", "random", "--reach", "60", "--out", text(&out)])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // A bracket begins at 8: its names are not in the order of their letters.
    let (mut joints, mut led, mut number) = ((0.0f32, 0.0f32), 0.0f32, 2);
    let mut log = String::new();
    for line in BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok) {
        log += &format!("{line}\n");
        let Some((_, sent)) = line.split_once("> ") else { continue };
        if let Some((x, y)) = sent.split_once("G1X").and_then(|(_, rest)| rest.split_once('Y')) {
            joints = (x.parse().unwrap(), y.split('F').next().unwrap().parse().unwrap());
        }
        match sent {
            "M3S800" => led = 0.8,
            "M5" => led = 0.0,
            "M8" => {
                let (a, s) = (joints.0.to_radians(), joints.1.to_radians());
                let towards = Vec3::new(s.sin() * a.cos(), s.sin() * a.sin(), s.cos());
                for seconds in [0.001, 0.0032, 0.01] {
                    let e = camera.expose(&scene, towards, led, seconds).unwrap();
                    let bytes = encode_rgb(48, 48, e.image.bits, &e.image.rgb).unwrap();
                    std::fs::write(images.join(format!("img{number}.png")), bytes).unwrap();
                    number += 1;
                }
            }
            _ => {}
        }
    }
    let mut said = String::new();
    child.stdout.take().unwrap().read_to_string(&mut said).unwrap();
    assert!(child.wait().unwrap().success(), "{log}");
    assert!(said.contains("6 lights"), "{said}");
    // Mask from the picture, six brackets, the dark one.
    assert_eq!(number - 2, 3 * 8);
    let back = resume(|name| std::fs::read(out.join(name)).ok()).unwrap();
    assert_eq!((back.seen.len(), back.record.camera.starts_with("folder:")), (6, true));
    let inside = back.mask.len() as f32 / scene.mask().len() as f32;
    assert!((0.9..=1.0).contains(&inside), "{inside}");
    let normals = LeastSquares.solve(&Measurements::of(&back.seen)).unwrap().normals;
    let truth = back.mask.gather(&scene.mask().scatter(scene.truth(), Vec3::Z));
    let ideal: Vec<_> = back.seen.iter().map(|o| scene.capture(o.light, &[]).unwrap()).collect();
    let ideal = LeastSquares.solve(&Measurements::of(&ideal)).unwrap().normals;
    let ideal = back.mask.gather(&scene.mask().scatter(&ideal, Vec3::Z));
    let (got, best) = (error::mae(&normals, &truth), error::mae(&ideal, &truth));
    assert!((got - best).abs() < 0.3, "{got} instead of {best}");
}

#[test]
fn a_folder_that_stays_empty_is_told() {
    let at = folder("empty");
    let (camera, out) = (format!("folder:{}", text(&at)), at.join("session"));
    let said = bad(2, &["capture", "--camera", &camera, "--patience", "0.5", "--out", text(&out)]);
    assert!(said.contains("no new image in 0.5 s"), "{said}");
    assert!(
        bad(2, &["capture", "--camera", "window", "--out", text(&at.join("t"))])
            .contains("sim or folder:DIR")
    );
}

#[test]
fn the_mirror_sphere_corrects_an_arm_that_stands_askew() {
    let at = folder("askew");
    let (first, second, fitted) = (at.join("first"), at.join("second"), at.join("arm.json"));
    let base = |out: &Path| {
        [
            "capture",
            "--object",
            "sphere",
            "--size",
            "96",
            "--planner",
            "random",
            "-t",
            "8",
            "--sphere",
            "room",
        ]
        .into_iter()
        .chain(["--misaligned", "4,-2,1.5,-1", "--reach", "60", "--out"])
        .map(String::from)
        .chain([text(out).to_string()])
        .collect::<Vec<_>>()
    };
    let run = |args: Vec<String>| good(&args.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(run(base(&first)).contains("measured"));
    let taken = record(&first);
    // What the sphere shows is what the solver and every reader of the session gets.
    let off = |r: &Record| {
        let each = |s: &coil_ps::rig::store::Shot| {
            light::angle(s.measured.expect("a measured direction"), s.commanded).to_degrees()
        };
        r.shots.iter().map(each).fold(0.0, f32::max)
    };
    assert!(off(&taken) > 2.0, "{}", off(&taken));
    let listed = std::fs::read_to_string(first.join("light_directions.txt")).unwrap();
    let m = taken.shots[0].measured.unwrap();
    assert_eq!(listed.lines().next().unwrap(), format!("{} {} {}", m.x, m.y, m.z));

    let said = good(&["calibrate", "arm", text(&first), "--out", text(&fitted)]);
    assert!(said.contains("8 directions"), "{said}");
    let arm: coil_ps::arm::kinematics::Arm =
        serde_json::from_slice(&std::fs::read(&fitted).unwrap()).unwrap();
    let mount = arm.mount;
    for (got, truth) in
        [mount.azimuth, mount.slant, mount.tilt[0], mount.tilt[1]].iter().zip([4.0, -2.0, 1.5, -1.0])
    {
        assert!((got - truth).abs() < 0.7, "{mount:?}");
    }
    let mut args = base(&second);
    args.extend(["--config".into(), text(&fitted).into()]);
    run(args);
    assert!(off(&record(&second)) < 1.0, "{}", off(&record(&second)));
    assert!(bad(2, &["calibrate", "arm", text(&folder("nothing"))]).contains("session.json"));
}

#[test]
fn directions_from_pictures_of_a_sphere() {
    let at = folder("pictures");
    let scene = Sphere::new(120).unwrap();
    let mut camera = SimulatedCamera::new(Sensor::default(), 8, true);
    let save = |name: &str, e: &coil_ps::rig::hdr::Exposure| {
        let bytes = encode_rgb(e.image.width, e.image.height, e.image.bits, &e.image.rgb).unwrap();
        std::fs::write(at.join(name), bytes).unwrap();
        text(&at.join(name)).to_string()
    };
    let room = save("room.png", &camera.room(&scene, 1e-3));
    let mut rng = Rng::new(4);
    let truth: Vec<Vec3> = (0..5).map(|_| rng.direction(1.1)).collect();
    let pictures: Vec<String> = truth
        .iter()
        .enumerate()
        .map(|(k, d)| save(&format!("{k}.png"), &camera.expose(&scene, *d, 1.0, 1e-3).unwrap()))
        .collect();
    let dark = save("dark.png", &camera.expose(&scene, Vec3::Z, 0.0, 1e-3).unwrap());
    let lp = at.join("lights.lp");
    let circle = camera.ball(&scene).unwrap();
    let points = [0.3f64, 2.0, 4.1]
        .map(|a| format!("{},{}", circle.x + circle.radius * a.cos(), circle.y + circle.radius * a.sin()));
    let ways: [Vec<&str>; 3] = [
        vec!["--room", &room, "--within", "120,0,120,120"],
        vec!["--circle", "180,60,50.4"],
        vec!["--points", &points[0], &points[1], &points[2]],
    ];
    for way in ways {
        let mut args = vec!["calibrate", "sphere", "--json", "--dark", &dark, "--lp", text(&lp)];
        args.extend(pictures.iter().map(String::as_str));
        args.extend(way);
        let found: serde_json::Value = serde_json::from_str(&good(&args)).unwrap();
        for (row, truth) in found["lights"].as_array().unwrap().iter().zip(&truth) {
            let got: Vec3 = serde_json::from_value(row["direction"].clone()).unwrap();
            let (error, told) =
                (light::angle(got, *truth).to_degrees(), row["uncertainty"].as_f64().unwrap());
            assert!(error < 1.5 && told < 1.5, "{error} ± {told}");
        }
    }
    assert_eq!(std::fs::read_to_string(&lp).unwrap().lines().next(), Some("5"));
    assert!(bad(2, &["calibrate", "sphere", &pictures[0]]).contains("where is the sphere"));
    // Nothing is lit in the dark frame: the others are measured all the same.
    let out = coil(&["calibrate", "sphere", "--circle", "180,60,50.4", &dark, &pictures[0]]);
    let said = String::from_utf8(out.stdout).unwrap();
    assert!(out.status.code() == Some(1) && said.contains("no highlight") && said.contains("±"), "{said}");
}
