//! `coil render` as a user runs it: stacks that `coil eval` reads, shards, poses, errors.
#![cfg(feature = "cli")]

#[path = "support/cli.rs"]
mod cli;

use cli::{coil, command, folder, good, refused, text};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Checksums of the objects of a manifest.
fn checksums(file: &Path) -> Vec<(String, String)> {
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    let string = |v: &serde_json::Value| v.as_str().unwrap().to_string();
    let list = json["rendered"].as_array().unwrap();
    let mut sums: Vec<_> = list.iter().map(|r| (string(&r["name"]), string(&r["checksum"]))).collect();
    sums.sort();
    sums
}

#[test]
fn what_is_rendered_can_be_evaluated() {
    let out = folder("evaluated");
    let lights = ["--lights", "fibonacci:12", "--size", "32", "--sensor", "camera"];
    good(&[&["render", "sphere", "blob:3+nylon", "--out", text(&out)][..], &lights].concat());
    let table = good(&["eval", text(&out), "--planner", "all", "--draws", "1"]);
    assert!(table.contains("sphere") && table.contains("blob-3-nylon"), "{table}");
    // The lights of an object that is there already.
    let (object, again) = (out.join("sphere"), folder("same-lights"));
    good(&["render", "bowl", "--lights", text(&object), "--size", "16", "--out", text(&again)]);
    let lights = |object: &Path| -> Vec<f32> {
        let text = std::fs::read_to_string(object.join("light_directions.txt")).unwrap();
        text.split_whitespace().map(|number| number.parse().unwrap()).collect()
    };
    let (there, here) = (lights(&object), lights(&again.join("bowl")));
    assert_eq!(there.len(), here.len());
    assert!(there.iter().zip(&here).all(|(a, b)| (a - b).abs() < 1e-6), "{here:?}");
}

/// What the page does by default: the learned planner chooses the lights, a solver makes normals of the pictures.
#[cfg(feature = "policy")]
#[test]
fn the_learned_planner_can_be_solved_with() {
    let models = concat!(env!("CARGO_MANIFEST_DIR"), "/models");
    let solve = |more: &[&str]| {
        good(&[&["solve", "blob:3+nylon", "--size", "32", "--solver", "ls"][..], more].concat())
    };
    let lit = solve(&["--planner", "coil", "--lights", "5", "--models", models]);
    assert!(lit.contains("5 lights, ls: expected"), "{lit}");
    assert_ne!(lit, solve(&["--planner", "lipids", "--lights", "5"]));
    for command in [&["solve", "--solver", "ls"][..], &["eval", "--draws", "1"]] {
        let more = ["blob:3", "--planner", "coil", "--lights", "40", "--models", models];
        let message = refused(&[command, &more].concat());
        assert!(message.contains("coil is not defined for 40 lights: it plans at most 32"), "{message}");
    }
    let nothing = folder("no-models");
    let error =
        coil(&["solve", "blob:3+nylon", "--size", "32", "--planner", "coil", "--models", text(&nothing)]);
    assert!(!error.status.success() && String::from_utf8_lossy(&error.stderr).contains("compact"));
}

/// An object that can't be solved is told; the others are solved and summed up.
#[test]
fn solving_goes_on_after_an_object_that_fails() {
    let set = folder("two-lights");
    good(&["render", "blob:4", "--lights", "fibonacci:2", "--size", "24", "--out", text(&set)]);
    let out = coil(&["solve", text(&set), "blob:3", "blob:5", "--size", "24", "--solver", "ls"]);
    let (said, log) = (String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    assert_eq!(out.status.code(), Some(1), "{said}{log}");
    assert!(log.contains("blob"), "{log}");
    assert!(said.contains("2 objects: expected") && said.contains("in the median"), "{said}");
}

/// Its first lights may lie in one plane, as DiLiGenT's do: nothing can be told from them, but from more.
#[test]
fn solving_stops_early_only_where_the_pictures_can_be_judged() {
    let set = folder("planar-first");
    let lights = ["0,0,1", "0.6,0,0.8", "-0.6,0,0.8", "0.8,0,0.6", "-0.8,0,0.6", "0,0.6,0.8", "0,-0.6,0.8"];
    let lights: Vec<&str> = lights.iter().flat_map(|l| ["--lights", l]).collect();
    let dull = ["--material", "lambert:0.8", "--bounces", "0", "--size", "24", "--out", text(&set)];
    good(&[&["render", "sphere"][..], &lights, &dull].concat());
    let solve = |stop| good(&["solve", text(&set), "--solver", "ls", "--stop-at", stop]);
    assert!(solve("80").contains("6 lights, ls: expected"), "the first five lie in a plane");
    assert!(solve("0.0001").contains("7 lights, ls: expected"));
}

#[test]
fn two_objects_of_one_name_are_two() {
    let at = folder("same-name");
    let set = |name: &str| at.join(name).join("ball");
    for (object, name) in [("sphere", "a"), ("blob:3", "b")] {
        let out = at.join(name);
        good(&["render", object, "--lights", "fibonacci:6", "--size", "24", "--out", text(&out)]);
        std::fs::rename(out.join(object.replace(':', "-")), set(name)).unwrap();
    }
    let (a, b, out) = (set("a"), set("b"), at.join("out"));
    let both = [text(&a), text(&b)];
    let table = good(&[&["eval"][..], &both, &["--planner", "all", "--out", text(&out)]].concat());
    assert!(table.lines().nth(1).unwrap().contains(" ball-2 "), "{table}");
    assert!(out.join("ball").is_dir() && out.join("ball-2").is_dir());
    let solved = good(&[&["solve"][..], &both, &["--solver", "ls"]].concat());
    assert!(solved.contains("ball: ") && solved.contains("ball-2: "), "{solved}");
    let lp = at.join("lp");
    good(&[&["export"][..], &both, &["--to", "lp", "--out", text(&lp)]].concat());
    assert!(lp.join("ball.lp").is_file() && lp.join("ball-2.lp").is_file());
    let info = good(&[&["info"][..], &both].concat());
    assert!(info.contains(text(&a)) && info.contains(text(&b)), "{info}");
}

/// `coil … | head -1`: whoever has read enough ends nothing.
#[cfg(unix)]
#[test]
fn output_that_nobody_reads_is_no_error() {
    use std::process::Stdio;
    let out = folder("pipe");
    let args = ["render", "sphere", "--lights", "fibonacci:4", "--size", "16", "--json", "--out", text(&out)];
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let done = command(&args).stdout(writer).stderr(Stdio::piped()).output().unwrap();
    let log = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success() && log.is_empty(), "{log}");
    assert!(out.join("render.json").is_file());
    if Path::new("/dev/full").exists() {
        let full = std::fs::File::create("/dev/full").unwrap();
        let done = command(&["info", text(&out)]).stdout(full).output();
        let done = done.unwrap();
        assert!(done.status.code() == Some(2) && String::from_utf8_lossy(&done.stderr).contains("disk full"));
    }
}

#[test]
fn the_study_writes_what_it_is_asked_to() {
    let out = folder("study");
    let study = |more: &[&str]| {
        let args = ["study", "k", "sphere", "--size", "16", "--k", "4,6", "--lights", "3..5"];
        let run = command(&args).args(more).current_dir(&out).output();
        let run = run.unwrap();
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        String::from_utf8(run.stdout).unwrap()
    };
    assert!(study(&[]).contains("K = 6"));
    study(&["--plot", "k.svg"]);
    for plot in ["study-k.svg", "k.svg"] {
        assert!(out.join(plot).is_file(), "{plot}");
    }
    good(&["render", "sphere", "--lights", "fibonacci:4", "--size", "16", "--out", text(&out)]);
    let args = ["study", "k", text(&out), "--k", "9", "--lights", "3..5"];
    let short = command(&args).current_dir(&out).output().unwrap();
    let log = String::from_utf8_lossy(&short.stderr);
    assert!(short.status.code() == Some(1) && log.contains("4 photos for up to 5 lights"), "{log}");
}

/// The same command begins a run and goes on with it; an option of another recipe is not ignored in silence.
#[cfg(feature = "train")]
#[test]
fn a_resumed_training_takes_no_other_recipe() {
    let out = folder("training").join("run");
    let run =
        ["train", "policy", "--size", "compact", "--objects", "3", "--lookup", "exact", "--solver", "ls"];
    let small = ["--resolution", "16", "--batch", "1", "--micro-batch", "1", "--validation-objects", "1"];
    let run = [&run[..], &small, &["--steps", "1", "--resume", text(&out)]].concat();
    for _ in 0..2 {
        let made = coil(&run);
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    }
    let resumed = ["train", "policy", "--resume", text(&out)];
    for (option, has) in [
        (&["--steps", "5"][..], "steps 1:"),
        (&["--blank"], "blank false:"),
        (&["--lookup", "soft:0.05"], "tau null:"),
        (&["--preset", "paper"], "objects 3"),
    ] {
        let message = refused(&[&resumed[..], option].concat());
        assert!(message.contains("by its own recipe, with") && message.contains(has), "{message}");
    }
    let rest = ["--threads", "2", "--validation-objects", "4", "--validate-every", "9", "--seconds", "1"];
    let more = ["--device", "cpu", "--validation-meshes", "no-such-folder"];
    let message = refused(&[&["train", "policy", "--resume", "no-such-run"], &rest[..], &more].concat());
    assert!(message.contains("no run in no-such-run"), "{message}");
    for network in ["policy", "solver"] {
        let message = refused(&["train", network, "--out", "nowhere", "--validate-every", "0"]);
        assert!(message.contains("0 is not in 1.."), "{message}");
    }
    let message = refused(&["train", "policy", "--out", "nowhere", "--validation-objects", "0"]);
    assert!(message.contains("0 is not in 1.."), "{message}");
    let message = refused(&["train", "policy", "--out", "nowhere", "--resolution", "1"]);
    assert!(message.contains("pictures of 1×1 pixels: 16 to"), "{message}");
}

#[test]
fn shards_make_the_same_set() {
    let out = folder("shards");
    let common = ["--lights", "fibonacci:3", "--size", "24"];
    let whole = out.join("whole");
    good(&[&["render", "worlds-v1:0..4", "--out", text(&whole)][..], &common].concat());
    let parts: Vec<PathBuf> = (1..=2).map(|i| out.join(format!("part{i}"))).collect();
    for (i, part) in parts.iter().enumerate() {
        let shard = format!("{}/2", i + 1);
        let args = ["render", "worlds-v1:0..4", "--shard", &shard, "--out", text(part)];
        good(&[&args[..], &common].concat());
    }
    let merged = out.join("merged");
    let message = refused(&["render", "--merge", text(&parts[1]), "--out", text(&merged)]);
    assert!(message.contains("shard 1/2 is missing"), "{message}");
    good(&["render", "--merge", text(&parts[0]), text(&parts[1]), "--out", text(&merged)]);
    let sums = checksums(&whole.join("render.json"));
    assert_eq!(sums.len(), 5);
    assert_eq!(sums, checksums(&merged.join("render.json")));
    let image = |set: &Path| std::fs::read(set.join(&sums[2].0).join("002.png")).unwrap();
    assert_eq!(image(&whole), image(&merged));
}

#[test]
fn gnu_parallel_makes_a_set() {
    if Command::new("parallel").arg("--version").output().is_err() {
        assert!(
            std::env::var("CI").as_deref() != Ok("true"),
            "GNU parallel is not installed (apt-get install parallel)"
        );
        println!("SKIPPED: GNU parallel is not installed (apt-get install parallel)");
        return;
    }
    let out = folder("parallel");
    // The command of docs/rendering.md.
    let line = format!(
        "{} render worlds-train:0..2 --lights fibonacci:2 --size 16 --shard {{}}/3 --out {}/{{}}",
        env!("CARGO_BIN_EXE_coil"),
        text(&out)
    );
    let done = Command::new("parallel").args(["-j2", &line, ":::", "1", "2", "3"]).output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let parts: Vec<PathBuf> = (1..=3).map(|i| out.join(i.to_string())).collect();
    let set = out.join("set");
    let mut args = vec!["render", "--merge"];
    args.extend(parts.iter().map(|p| text(p)));
    args.extend(["--out", text(&set)]);
    good(&args);
    assert_eq!(checksums(&set.join("render.json")).len(), 3);
}

#[test]
fn a_mesh_at_a_pose_is_ground_truth() {
    let out = folder("pose");
    let (mesh, pose) = (out.join("roof.obj"), out.join("pose.json"));
    std::fs::write(&mesh, "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n").unwrap();
    // Turned by 30° about y: the plane's normal is (½, 0, √¾).
    std::fs::write(&pose, r#"{"rotation": [[0.8660254, 0, 0.5], [0, 1, 0], [-0.5, 0, 0.8660254]]}"#).unwrap();
    let set = out.join("set");
    let args = [
        "--material",
        "lambert:0.5",
        "--bounces",
        "0",
        "--lights",
        "ring:8:40",
        "--size",
        "32",
        "--white",
        "0.6",
    ];
    good(&[&["render", text(&mesh), "--pose", text(&pose), "--out", text(&set)][..], &args].concat());
    let json: serde_json::Value =
        serde_json::from_slice(&std::fs::read(set.join("roof/pose.json")).unwrap()).unwrap();
    assert_eq!(json["rotation"][0][2], 0.5);
    // The measured normals of a plane without shadows are the true ones.
    let table = good(&["eval", text(&set), "--planner", "all", "--draws", "1"]);
    let row = table.lines().find(|l| l.starts_with("all")).unwrap();
    let error: f64 = row.split_whitespace().nth(1).unwrap().parse().unwrap();
    assert!(error < 0.1, "{table}");
}

#[test]
fn what_cannot_be_rendered_is_named() {
    let out = folder("refused");
    let nan = out.join("nan.obj");
    std::fs::write(&nan, "v 0 0 nan\nf 1 1 1\n").unwrap();
    let (o, under) = (text(&out), nan.join("file"));
    for (args, expected) in [
        (vec!["render", "--out", o], "what to render?"),
        (vec!["render", "cube:1", "--out", o], "FAMILY:SEED"),
        (vec!["render", text(&nan), "--out", o], "vertex 1"),
        (vec!["render", "missing.obj", "--out", o], "missing.obj"),
        (vec!["render", "foo.off", "--out", o], "'foo.off': meshes end in .obj, .ply or .stl"),
        (vec!["render", "sphere:1", "--out", o], "sphere takes no seed"),
        (vec!["solve", "sphere", "--lights", "5"], "--lights 5: all lights are taken unless --planner"),
        (vec!["solve", "sphere", "--planner", "dc05", "--lights", "2"], "--lights 2: 3 to 1000"),
        (vec!["solve", "sphere", "--cliff", "nan"], "a number of pixels above 0"),
        (vec!["eval", "sphere", "--planner", "random,random"], "planner: random is there twice"),
        (vec!["eval", "sphere", "--json", text(&under)], "nan.obj"),
        (vec!["eval", "sphere", "--out", text(&under)], "nan.obj"),
        (
            vec!["study", "k", "sphere", "--k", "2", "--lights", "3"],
            "--k 2: less candidates than the 3 lights",
        ),
        (vec!["tune", "--sets", "0"], "0 is not in 1.."),
        (vec!["tune", "--uncertainty", "x.json", "--objects", "0"], "0 is not in 1.."),
        (vec!["train", "solver", "--out", o, "--groups", "0"], "0 is not in 1.."),
        (vec!["train", "solver", "--out", o, "--rate", "nan"], "a number between 0 and 1"),
        (vec!["render", "sphere", "--material", "cheese", "--out", o], "no material 'cheese'"),
        (vec!["render", "sphere", "--size", "0", "--out", o], "image size 0"),
        (vec!["render", "sphere", "--lights", "0,0,-1", "--out", o], "behind the object"),
        (vec!["render", "sphere", "--lights", "ring:x:20", "--out", o], "--lights ring:x:20: ring:K:SLANT"),
        (vec!["render", "sphere", "--lights", "stars", "--out", o], "fibonacci:K"),
        (vec!["render", "sphere", "--shard", "3/2", "--out", o], "--shard 3/2"),
        (vec!["render", "worlds-v1", "--material", "brass", "--out", o], "part of it"),
        (vec!["render", "worlds-v1:100", "--out", o], "0..=99"),
        (vec!["render", "sphere", "--pose", "nowhere.json", "--out", o], "--pose takes"),
    ] {
        let message = refused(&args);
        assert!(message.contains(expected), "{args:?}: {message}");
    }
}
