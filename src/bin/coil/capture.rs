//! `coil capture`: a whole session with a rig, headless.

use crate::arm::{ArmArgs, Driver, PortArgs};
use crate::models::Models;
use crate::output;
use anyhow::{Context, bail};
use coil_ps::arm::Joints;
use coil_ps::arm::grbl::{Command, Failure, Phase, Trust};
use coil_ps::arm::kinematics::{Arm, Mount};
use coil_ps::arm::line::State;
use coil_ps::camera::Camera;
use coil_ps::dataset::Limits;
use coil_ps::dataset::diligent::normals_mat;
use coil_ps::planner::{self, Learned};
use coil_ps::rig::camera::{Sensor, SimulatedCamera, SimulatedView};
use coil_ps::rig::capture::{Action, Capture, Options, Stuck};
use coil_ps::rig::hdr::{Crop, Exposure, merge, threshold_level, threshold_mask};
use coil_ps::rig::setup::{Setup, check_board};
use coil_ps::rig::sphere::{self, Circle};
use coil_ps::rig::store::{self, RECORD, Record, Write};
use coil_ps::rig::tiff::decode_frame;
use coil_ps::solve::Measurements;
use coil_ps::solve::uncertainty::StopAt;
use coil_ps::stack::{BitDepth, Mask};
use coil_ps::{light, solve};
use glam::Vec3;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant, SystemTime};

/// Take a session: plan, move, settle, expose, merge, store, solve; T times.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: PortArgs,
    #[command(flatten)]
    arm: ArmArgs,
    /// sim (a rendered object), or folder:DIR: every new image there is an exposure.
    #[arg(long, default_value = "sim")]
    camera: String,
    /// Folder of the session: DiLiGenT layout and session.json.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Go on with the session in that folder.
    #[arg(long)]
    resume: bool,
    #[arg(long, default_value = "tk22", help = planners())]
    planner: String,
    /// Number of lights, T.
    #[arg(short = 't', long, default_value_t = 10)]
    lights: usize,
    /// Take no more lights once the solver predicts a mean error of at most this: 8deg.
    #[arg(long, value_name = "DEGREES")]
    stop_at: Option<StopAt>,
    /// Largest slant that the planner may ask for, degrees.
    #[arg(long, default_value_t = 75.0)]
    reach: f32,
    /// Prefer nearby lights: order the set of an offline planner, move the lights of an online one by up to so many degrees.
    #[arg(long, value_name = "DEGREES")]
    nearby: Option<f32>,
    /// Seed.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Solver of the normals shown after every light.
    #[arg(long, default_value = "trimmed")]
    solver: String,
    /// Exposure bracket, milliseconds.
    #[arg(long, value_delimiter = ',', default_value = "1,3.2,10")]
    exposures: Vec<f64>,
    /// Rest after a move, seconds.
    #[arg(long, default_value_t = 0.3)]
    settle: f64,
    /// LED brightness (spindle speed).
    #[arg(long, default_value_t = 800.0)]
    brightness: f64,
    /// Trigger the camera by the coolant output.
    #[arg(long)]
    shutter: bool,
    /// Take exposures with the LED off first and subtract them.
    #[arg(long)]
    dark: bool,
    /// Never home: the arm has no switches and counts from where it stood when switched on.
    #[arg(long)]
    no_home: bool,
    /// Name of the object; for the simulated camera a sculpture, as blob:7.
    #[arg(long, default_value = "blob:7")]
    object: String,
    /// Material of the simulated object.
    #[arg(long, default_value = "lambert:0.8")]
    material: String,
    /// Side of the simulated picture, pixels.
    #[arg(long, default_value_t = 96)]
    size: u32,
    /// Mask (PNG, its brightest value marks the object, of the size after the crop); without it, from the brightness under a frontal light.
    #[arg(long, value_name = "FILE")]
    mask: Option<PathBuf>,
    /// Brightness that parts the object from its background, 1 at the shortest exposure's full scale; without it, from
    /// the picture (Otsu).
    #[arg(long, value_name = "LEVEL", conflicts_with = "mask")]
    threshold: Option<f32>,
    /// Mirror sphere beside the object, which shows where the light really is: X,Y,RADIUS in pixels of the whole picture, a
    /// picture (PNG, TIFF) of it in room light, or `room` (the simulated camera takes that picture itself).
    #[arg(long, value_name = "WHERE")]
    sphere: Option<String>,
    /// How the simulated arm really stands: AZIMUTH,SLANT,TILT_X,TILT_Y in degrees. The program does not know.
    #[arg(long, value_parser = misaligned, allow_hyphen_values = true, value_name = "ANGLES")]
    misaligned: Option<Mount>,
    #[command(flatten)]
    models: crate::models::Folder,
    /// Part of the sensor that is kept: LEFT,TOP,WIDTH,HEIGHT.
    #[arg(long, value_parser = crop)]
    crop: Option<Crop>,
    /// Code value of black of a camera's files.
    #[arg(long, default_value_t = 0)]
    black: u16,
    /// Code value at which a camera's files saturate (4095 for 12 bits in 16; default: the largest of the file).
    #[arg(long)]
    white: Option<u16>,
    /// How long to wait for a file of a folder camera, seconds.
    #[arg(long, default_value_t = 60.0)]
    patience: f64,
}

/// Help on the planners that a rig can have: an oracle would need the truth.
fn planners() -> String {
    let learned = |name: &str| name.starts_with("coil");
    let possible =
        planner::PLANNERS.iter().filter(|p| !p.oracle && (cfg!(feature = "policy") || !learned(p.name)));
    let names: Vec<&str> = possible.map(|p| p.name).chain(["ring:DEGREES"]).collect();
    format!("Planner: {}", names.join(", "))
}

/// A part of a picture, written LEFT,TOP,WIDTH,HEIGHT.
pub fn crop(text: &str) -> Result<Crop, String> {
    let n: Vec<u32> = text.split(',').filter_map(|p| p.parse().ok()).collect();
    match n[..] {
        [left, top, width, height] if text.split(',').count() == 4 => Ok(Crop { left, top, width, height }),
        _ => Err("write LEFT,TOP,WIDTH,HEIGHT in pixels".into()),
    }
}

fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let n: Vec<f64> = text.split(',').map_while(|p| p.trim().parse().ok()).collect();
    let n: [f64; N] = n.try_into().ok()?;
    (text.split(',').count() == N && n.iter().all(|v| v.is_finite())).then_some(n)
}

fn misaligned(text: &str) -> Result<Mount, String> {
    let [azimuth, slant, x, y] = numbers(text).ok_or("write AZIMUTH,SLANT,TILT_X,TILT_Y in degrees")?;
    Ok(Mount { azimuth, slant, tilt: [x, y] })
}

/// A circle written X,Y,RADIUS.
pub fn circle(text: &str) -> Option<Circle> {
    let [x, y, radius] = numbers(text)?;
    (radius > 0.0).then_some(Circle { x, y, radius })
}

/// Where exposures come from.
enum Source<'a> {
    Simulated { scene: &'a dyn Camera, camera: SimulatedCamera, mount: Mount, truth: Option<&'a [Vec3]> },
    Folder { dir: PathBuf, known: BTreeSet<PathBuf>, black: u16, white: Option<u16>, patience: f64 },
}

impl Source<'_> {
    fn expose(&mut self, driver: &mut Driver, seconds: f64) -> anyhow::Result<Exposure> {
        match self {
            Self::Simulated { scene, camera, mount, .. } => {
                let (joints, led) = where_the_light_is(driver)?;
                let brightness = driver.link().lit(led);
                let direction = mount.direction(joints);
                let exposure = camera.expose(*scene, direction, brightness, seconds)?;
                // Exposure and read-out of 5 million 12-bit pixels over USB 3.
                driver.spend(Duration::from_secs_f64(seconds + 0.03));
                Ok(exposure)
            }
            Self::Folder { dir, known, black, white, patience } => {
                let file = next_file(dir, known, *patience, driver)?;
                let image = read_frame(&file)?;
                let largest = if image.bits == BitDepth::Eight { 255 } else { 65535 };
                Ok(Exposure { white: white.unwrap_or(largest), black: *black, image, seconds })
            }
        }
    }

    /// Images that are there now belong to no exposure that is still to come.
    fn forget(&mut self) -> anyhow::Result<()> {
        if let Self::Folder { dir, known, .. } = self {
            known.extend(list(dir)?);
        }
        Ok(())
    }

    /// The outline of the mirror sphere that `--sphere` names.
    fn find_sphere(&mut self, place: &str, crop: Option<Crop>, exposure: f64) -> anyhow::Result<Circle> {
        if let Some(circle) = circle(place) {
            return Ok(circle);
        }
        let (image, name) = match self {
            Self::Simulated { scene, camera, .. } if place == "room" => {
                (camera.room(*scene, exposure).image, "the picture in room light")
            }
            _ if place == "room" => {
                bail!("--sphere room is for --camera sim: give the file of a picture in room light")
            }
            _ => (read_frame(Path::new(place))?, place),
        };
        // It stands beside the object, which may be round as well.
        let object = |x: f64, y: f64| crop.is_some_and(|c| c.contains(x, y));
        let found =
            sphere::find_outline(&sphere::values(&image).view(), object).with_context(|| name.to_string())?;
        println!("mirror sphere: centre {:.1}, {:.1}, radius {:.1} pixels", found.x, found.y, found.radius);
        Ok(found)
    }
}

/// Joint angles and brightness for the simulated camera: the truth of a simulated arm, else what the firmware says next.
fn where_the_light_is(driver: &mut Driver) -> anyhow::Result<(Joints, f64)> {
    if let Some(truth) = driver.truth() {
        return Ok((truth.joints, truth.led));
    }
    let since = driver.now();
    driver.link_mut().want_status();
    while driver.now() < since + Duration::from_secs(2) {
        driver.pump()?;
        let led = driver.link().status_after(since).map(|s| s.spindle.unwrap_or(0.0));
        if let (Some(led), Some(joints)) = (led, driver.link().joints()) {
            return Ok((joints, led));
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    bail!("the firmware does not say where the arm is")
}

/// A camera's picture may be larger than what is kept of it: the mask is of the part after the crop.
const FRAME_PIXELS: usize = 1 << 28;

/// A picture file of a camera.
pub fn read_frame(path: &Path) -> anyhow::Result<coil_ps::image::Image> {
    let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
    decode_frame(&bytes, FRAME_PIXELS).with_context(|| path.display().to_string())
}

/// Waits for a file that was not there before and has stopped growing; keeps the link alive meanwhile.
fn next_file(
    dir: &Path,
    known: &mut BTreeSet<PathBuf>,
    patience: f64,
    driver: &mut Driver,
) -> anyhow::Result<PathBuf> {
    let start = Instant::now();
    let mut last: Option<(PathBuf, u64)> = None;
    while start.elapsed().as_secs_f64() < patience {
        let fresh = list(dir)?.into_iter().filter(|p| !known.contains(p));
        if let Some(path) = fresh.min_by_key(|p| (saved(p), counted(p))) {
            let size = std::fs::metadata(&path).map_or(0, |m| m.len());
            if last.as_ref() == Some(&(path.clone(), size)) && size > 0 {
                known.insert(path.clone());
                return Ok(path);
            }
            last = Some((path, size));
        }
        let until = Instant::now() + Duration::from_millis(60);
        while Instant::now() < until {
            driver.pump()?;
            if let Phase::Stopped(_) = driver.link().phase() {
                return Err(Failure::Stopped.into());
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }
    bail!(
        "{}: no new image in {patience} s: does the camera save there, and is it triggered (--shutter)?",
        dir.display()
    )
}

/// When a file was last written to.
fn saved(path: &Path) -> Option<SystemTime> {
    path.metadata().and_then(|m| m.modified()).ok()
}

/// A part of a file's name.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    /// Digits without leading zeros, and before them how many: so they are ordered as numbers of any size.
    Number(usize, Vec<u8>),
    Text(Vec<u8>),
}

/// A name in the order in which cameras count: img9 before img10.
fn counted(path: &Path) -> (Vec<Part>, PathBuf) {
    let name = path.file_stem().unwrap_or_default().as_encoded_bytes();
    let part = |run: &[u8]| {
        if !run[0].is_ascii_digit() {
            return Part::Text(run.into());
        }
        let digits: Vec<u8> = run.iter().copied().skip_while(|d| *d == b'0').collect();
        Part::Number(digits.len(), digits)
    };
    let parts = name.chunk_by(|a, b| a.is_ascii_digit() == b.is_ascii_digit()).map(part).collect();
    (parts, path.into())
}

fn list(dir: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(dir).with_context(|| dir.display().to_string())?;
    let image = |p: &PathBuf| {
        p.extension()
            .and_then(|e| e.to_str())
            .is_some_and(|e| ["png", "tif", "tiff"].contains(&e.to_lowercase().as_str()))
    };
    Ok(entries.filter_map(|e| Some(e.ok()?.path())).filter(image).collect())
}

fn write_files(dir: &Path, writes: &[Write]) -> anyhow::Result<()> {
    writes.iter().try_for_each(|w| output::replace(&dir.join(&w.name), &w.bytes))
}

/// Runs the subcommand.
///
/// # Errors
/// What went wrong, in words; the session on disk stays whole.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    check(&args)?;
    if let Some(dir) = args.camera.strip_prefix("folder:") {
        let dir = PathBuf::from(dir);
        let known = list(&dir)?.into_iter().collect();
        let source =
            Source::Folder { dir, known, black: args.black, white: args.white, patience: args.patience };
        if args.misaligned.is_some() {
            bail!("--misaligned is for --camera sim");
        }
        return capture(&args, source, None);
    }
    if args.camera != "sim" {
        bail!("--camera {}: sim or folder:DIR", args.camera);
    }
    simulated(&args)
}

fn simulated(args: &Args) -> anyhow::Result<ExitCode> {
    use coil_ps::render::{Material, Options as SceneOptions, Pose, Scene, SceneCamera, named};
    let shape = named(&args.object)?;
    let pose = Pose::fit(&shape, shape.front())?;
    let material: Material = args.material.parse()?;
    let options = SceneOptions { size: args.size, ..SceneOptions::default() };
    let scene = Scene::new(&args.object, &shape, &pose, &material.into(), &options)?;
    let camera = SceneCamera::new(&scene);
    capture(args, source(args, &camera, scene.truth()), Some(camera.mask().clone()))
}

fn source<'a>(args: &Args, scene: &'a dyn Camera, truth: &'a [Vec3]) -> Source<'a> {
    Source::Simulated {
        scene,
        camera: SimulatedCamera::new(Sensor::default(), args.seed, args.sphere.is_some()),
        mount: args.misaligned.unwrap_or_default(),
        truth: Some(truth),
    }
}

fn check(args: &Args) -> anyhow::Result<()> {
    setup(args).check()?;
    solve::check_name(&args.solver)?;
    let there = args.out.join(RECORD).exists();
    if there && !args.resume {
        bail!("{} holds a session: --resume goes on with it, or choose another folder", args.out.display());
    }
    if !there && args.resume {
        bail!("{} holds no session to go on with", args.out.display());
    }
    std::fs::create_dir_all(&args.out).with_context(|| format!("{}: can't be made", args.out.display()))
}

/// Homes and lights up as far as it is needed before the session proper (dark frames, mask).
fn prepare(args: &Args, driver: &mut Driver) -> anyhow::Result<()> {
    let link = driver.link();
    if link.state() == Some(State::Alarm) || link.trust() != Trust::Homed && !args.no_home {
        if args.no_home {
            bail!("the arm is locked: unlock it first (coil arm console, $X)");
        }
        driver.execute(Command::Home)?;
    }
    Ok(())
}

fn bracket(args: &Args, driver: &mut Driver, source: &mut Source) -> anyhow::Result<Vec<Exposure>> {
    let mut frames = Vec::new();
    source.forget()?;
    if args.shutter {
        driver.execute(Command::Shutter(true))?;
    }
    for ms in &args.exposures {
        frames.push(source.expose(driver, ms / 1000.0)?);
    }
    if args.shutter {
        driver.execute(Command::Shutter(false))?;
    }
    Ok(frames)
}

/// What is asked for.
fn setup(args: &Args) -> Setup {
    let simulated = args.camera == "sim";
    let view = SimulatedView {
        object: args.object.clone(),
        material: args.material.clone(),
        size: args.size,
        mount: args.misaligned.unwrap_or_default(),
    };
    Setup {
        object: args.object.clone(),
        planner: args.planner.clone(),
        lights: args.lights,
        seed: args.seed,
        reach: args.reach,
        nearby: args.nearby,
        camera: if simulated { view.to_string() } else { args.camera.clone() },
        black: (!simulated).then_some(args.black),
        white: args.white.filter(|_| !simulated),
        ball: args.sphere.is_some(),
        options: Options {
            exposures: args.exposures.iter().map(|ms| ms / 1000.0).collect(),
            settle: args.settle,
            brightness: args.brightness,
            shutter: args.shutter,
            dark: args.dark,
            auto_home: !args.no_home,
            ..Options::default()
        },
    }
}

fn capture(args: &Args, source: Source, mask: Option<Mask>) -> anyhow::Result<ExitCode> {
    let arm = args.arm.read()?;
    let models = args.models.load(std::slice::from_ref(&args.planner))?;
    // What it can't plan is refused before anything moves.
    setup(args).planner(&arm, Some(&models))?;
    let mut driver = Driver::connect(&args.port)?;
    let ended = session(args, &models, &mut driver, arm, source, mask);
    if matches!(ended, Ok(None)) {
        return Ok(ExitCode::SUCCESS);
    }
    // A done capture has put it out itself. Any other end leaves nobody who would.
    driver.light_off();
    ended.map(|_| ExitCode::from(3))
}

/// The session proper: `None` where it is done.
fn session(
    args: &Args,
    models: &Models,
    driver: &mut Driver,
    mut arm: Arm,
    mut source: Source,
    mask: Option<Mask>,
) -> anyhow::Result<Option<Stuck>> {
    let setup = setup(args);
    let resumed =
        if args.resume { Some(store::resume(|name| std::fs::read(args.out.join(name)).ok())?) } else { None };
    if let Some(resumed) = &resumed {
        check_same(&resumed.record, &setup)?;
        let begun = resumed.record.arm.clone();
        if begun != (Arm { axes: begun.axes, ..arm }) {
            eprintln!(
                "warning: the arm's configuration was another one until now: the session goes on with that"
            );
        }
        arm = begun;
    }
    for warning in check_board(driver.link(), &arm, args.brightness)? {
        eprintln!("warning: {}", warning.text);
    }
    arm.axes = driver.link().axis_limits();

    let mask = match (&resumed, &args.mask, mask) {
        (Some(r), ..) => r.mask.clone(),
        (_, Some(path), _) => read_mask(path)?,
        (_, _, Some(mask)) => mask,
        _ => {
            // A frontal light shows the whole object.
            prepare(args, driver)?;
            driver.execute(Command::Light(args.brightness))?;
            let front = light::from_azimuth_slant(0.0, (arm.limits.keep_out.max(1.0) as f32).to_radians());
            let plan = arm.plan(front, driver.link().joints().unwrap_or_default());
            driver.execute(Command::Goto { to: plan.joints, feed: arm.feed })?;
            let mut frames = bracket(args, driver, &mut source)?;
            if let Some(crop) = args.crop {
                for f in &mut frames {
                    f.image = crop.apply(&f.image)?;
                }
            }
            let merged = merge(&frames, None)?;
            threshold_mask(&merged, args.threshold.unwrap_or_else(|| threshold_level(&merged)))?
        }
    };

    let truth = match &source {
        Source::Simulated { truth, .. } => *truth,
        Source::Folder { .. } => None,
    };
    let learned: Option<&dyn Learned> = Some(models);
    let mut capture = match resumed {
        Some(resumed) => {
            if resumed.record.camera != setup.camera {
                eprintln!(
                    "warning: until now the camera was {}, now it is {}",
                    resumed.record.camera, setup.camera
                );
            }
            for name in &resumed.damaged {
                eprintln!("warning: {name} is damaged or gone and will be taken again");
            }
            println!("going on after {} of {} lights", resumed.seen.len(), args.lights);
            setup.go_on(driver.link(), learned, resumed)?
        }
        None => {
            let shortest = setup.options.exposures.iter().copied().fold(f64::INFINITY, f64::min);
            let crop = match &source {
                Source::Simulated { scene, camera, .. } => camera.crop(*scene),
                Source::Folder { .. } => args.crop,
            };
            let find = |place| source.find_sphere(place, crop, shortest);
            let ball = args.sphere.as_deref().map(find).transpose()?;
            setup.begin(driver.link(), learned, arm, mask.clone(), crop, ball)?
        }
    };
    write_files(&args.out, &capture.opening_writes()?)?;
    if let Some(truth) = truth {
        write_files(
            &args.out,
            &[Write { name: "Normal_gt.mat".into(), bytes: normals_mat("Normal_gt", &mask, truth) }],
        )?;
    }
    let ended = drive(args, driver, &mut source, &mut capture, truth);
    let last = Write {
        name: RECORD.into(),
        bytes: capture.record().writes().pop().map(|w| w.bytes).unwrap_or_default(),
    };
    write_files(&args.out, &[last])?;
    let ended = ended?;
    match &ended {
        None => {
            if let Ok(solution) = capture.session().solve(&*solve::by_name(&args.solver)?, args.lights) {
                let bytes = normals_mat("Normal_est", &mask, &solution.normals);
                write_files(&args.out, &[Write { name: "Normal_est.mat".into(), bytes }])?;
            }
            budget(&capture);
            println!("{}: {} lights", args.out.display(), capture.session().seen().len());
        }
        Some(stuck) => {
            let taken = capture.session().seen().len();
            eprintln!("error: {stuck}");
            eprintln!("{taken} of {} lights are in {}; --resume goes on", args.lights, args.out.display());
        }
    }
    Ok(ended)
}

/// The options that pictures of one session have in common, by name.
fn common(s: &Setup) -> BTreeMap<&'static str, String> {
    fn given<T: ToString>(name: &'static str, value: Option<T>) -> (&'static str, String) {
        (name, value.map_or_else(|| format!("no {name}"), |v| format!("{name} {}", v.to_string())))
    }
    let mut options = BTreeMap::from([
        given("--object", Some(&s.object)),
        given("--planner", Some(&s.planner)),
        given("-t", Some(s.lights)),
        given("--seed", Some(s.seed)),
        // One camera may save to another folder by now.
        given("--camera", Some(if s.camera.starts_with("sim") { "sim" } else { "folder:DIR" })),
        given("--brightness", Some(s.options.brightness)),
        given("--reach", Some(s.reach)),
        given("--nearby", s.nearby),
        ("--dark", if s.options.dark { "--dark" } else { "no --dark" }.into()),
    ]);
    if let Some(black) = s.black {
        options.extend([given("--black", Some(black)), given("--white", s.white)]);
    }
    if let Some(SimulatedView { material, size, mount, .. }) = s.view() {
        let Mount { azimuth, slant, tilt: [x, y] } = mount;
        let askew = (mount != Mount::default()).then(|| format!("{azimuth},{slant},{x},{y}"));
        options.extend([
            given("--material", Some(material)),
            given("--size", Some(size)),
            given("--misaligned", askew),
            // It is part of the simulated picture; where it stands is the same always.
            given("--sphere", s.ball.then_some("room")),
        ]);
    }
    options
}

/// Refuses to go on with a session whose pictures would be of something else.
fn check_same(record: &Record, now: &Setup) -> anyhow::Result<()> {
    let mut begun = now.clone();
    begun.follow(record);
    let after = common(now);
    let differ = |(name, said): (&str, String)| {
        let now = after.get(name).filter(|now| **now != said)?;
        Some((said, now.as_str()))
    };
    let (said, now): (Vec<String>, Vec<&str>) = common(&begun).into_iter().filter_map(differ).unzip();
    if !said.is_empty() {
        bail!("the session was begun with {} (now {}): say the same", said.join(", "), now.join(", "));
    }
    Ok(())
}

fn read_mask(path: &Path) -> anyhow::Result<Mask> {
    let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
    let image = coil_ps::image::decode_png(&bytes, Limits::default().pixels)
        .with_context(|| path.display().to_string())?;
    Mask::from_image(&image).with_context(|| path.display().to_string())
}

/// Until the capture is done (`None`) or can't go on.
fn drive(
    args: &Args,
    driver: &mut Driver,
    source: &mut Source,
    capture: &mut Capture,
    truth: Option<&[Vec3]>,
) -> anyhow::Result<Option<Stuck>> {
    let solver = solve::by_name(&args.solver)?;
    let mut reconnects = 0;
    let mut fresh = false;
    loop {
        driver.pump()?;
        let now = driver.now();
        for event in driver.take_events() {
            capture.event(now, &event);
        }
        match capture.next(now, driver.link_mut()) {
            Action::Wait(until) => driver.sleep(until),
            Action::Plan => {
                let start = Instant::now();
                source.forget()?;
                let plan = capture.plan(now, driver.link())?;
                capture.timings().plan = start.elapsed().as_secs_f64();
                if let Some(plan) = plan.filter(|p| p.projected > 0.0) {
                    eprintln!(
                        "light {}: out of reach, projected by {:.1}°",
                        capture.session().seen().len() + 1,
                        plan.projected
                    );
                }
            }
            Action::Expose { index: 0, .. } if !args.shutter && !fresh => {
                // Without a trigger, what was saved during the move shows the light elsewhere.
                source.forget()?;
                fresh = true;
            }
            Action::Expose { seconds, .. } => match source.expose(driver, seconds) {
                Ok(exposure) => {
                    fresh = false;
                    capture.exposed(exposure)?;
                }
                // That is said, and mended, as such.
                Err(_) if matches!(driver.link().phase(), Phase::Closed(_) | Phase::Stopped(_)) => {}
                Err(error) => return Ok(Some(Stuck::Failed(format!("{error:#}")))),
            },
            Action::Develop => {
                let start = Instant::now();
                let result = capture.develop(driver.link());
                capture.timings().merge = start.elapsed().as_secs_f64();
                if let Err(error) = result {
                    return Ok(Some(Stuck::Failed(error.to_string())));
                }
            }
            Action::Store(writes) => {
                write_files(&args.out, &writes)?;
                capture.stored()?;
                let count = capture.session().seen().len();
                let start = Instant::now();
                let solution = capture.session().solve(&*solver, count);
                capture.solved(start.elapsed().as_secs_f64());
                let pictures = Measurements::of(capture.session().seen());
                if let Some(stop) =
                    args.stop_at.filter(|stop| stop.enough(&*solver, &pictures, capture.session().mask()))
                {
                    println!("{count} lights are enough for a predicted error of at most {}°", stop.degrees);
                    capture.finish();
                }
                if let Some(shot) = capture.record().shots.last() {
                    let error = match (solution, truth) {
                        (Ok(s), Some(t)) => format!("  error {:.2}°", coil_ps::error::mae(&s.normals, t)),
                        _ => String::new(),
                    };
                    let seen = match (shot.measured, shot.uncertainty) {
                        (Some(m), Some(u)) => {
                            let off = f64::from(light::angle(m, shot.commanded)).to_degrees();
                            format!("  measured {off:.2}° off (±{u:.2}°)")
                        }
                        _ => String::new(),
                    };
                    println!(
                        "{:>8.2} s  {}  azimuth {:7.2}° slant {:6.2}°  saturated {:.1} %  dark {:.1} %  noise {:.1} %{seen}{error}",
                        driver.now().as_secs_f64(),
                        shot.file,
                        shot.joints.azimuth,
                        shot.joints.slant,
                        100.0 * shot.quality.saturated,
                        100.0 * shot.quality.dark,
                        100.0 * shot.quality.noise,
                    );
                }
            }
            Action::Done => return Ok(None),
            Action::Stuck(Stuck::Disconnected(why)) if reconnects < 3 => {
                reconnects += 1;
                eprintln!("disconnected ({why}); trying again for 8 s");
                match driver.reconnect() {
                    Ok(()) => capture.retry(),
                    Err(_) => return Ok(Some(Stuck::Disconnected(why))),
                }
            }
            Action::Stuck(stuck) => return Ok(Some(stuck)),
        }
    }
}

/// Where the time of a step goes.
fn budget(capture: &Capture) {
    let shots = &capture.record().shots;
    let mean = |f: fn(&store::Timings) -> f64| {
        1e3 * shots.iter().map(|s| f(&s.timings)).sum::<f64>() / shots.len().max(1) as f64
    };
    println!(
        "a step: plan {:.1} ms, move {:.0} ms, settle {:.0} ms, expose {:.0} ms, merge {:.1} ms, solve {:.1} ms",
        mean(|t| t.plan),
        mean(|t| t.r#move),
        mean(|t| t.settle),
        mean(|t| t.expose),
        mean(|t| t.merge),
        mean(|t| t.solve),
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_are_counted() {
        let sorted = |names: &[&str]| {
            let mut paths: Vec<PathBuf> = names.iter().map(|n| Path::new("cam").join(n)).collect();
            paths.sort_by_key(|p| counted(p));
            paths.iter().map(|p| p.file_name().unwrap().to_str().unwrap().to_string()).collect::<Vec<_>>()
        };
        for order in [
            &["img9.png", "img10.png", "img11.png"][..],
            &["DSC_0099-2.tif", "DSC_0099-10.tif", "DSC_0100-1.tif"],
            &["capt.png", "capt1.png", "capt02.png", "capt3.png"],
            &["20261124235959123456789.png", "20261124235959123456790.png", "120261124235959123456789.png"],
            &["007.png", "07.png", "7.png", "8.png"],
        ] {
            let turned: Vec<&str> = order.iter().rev().copied().collect();
            assert_eq!(sorted(&turned), order);
        }
    }

    #[test]
    fn a_session_goes_on_with_the_options_it_was_begun_with() {
        let mut begun = Record::new("bust", "tk22", 1, 8, Arm::default());
        begun.camera = "folder:/cam".into();
        (begun.reach, begun.dark, begun.black) = (Some(75.0), Some(true), Some(16));
        let mut same = Setup {
            object: "bust".into(),
            planner: "tk22".into(),
            lights: 8,
            seed: 1,
            reach: 75.0,
            nearby: None,
            camera: "folder:/elsewhere".into(),
            black: Some(16),
            white: None,
            ball: false,
            options: Options { dark: true, ..Options::default() },
        };
        check_same(&begun, &same).unwrap();
        let refused = |begun: &Record, now: &Setup| check_same(begun, now).unwrap_err().to_string();
        let simulated = Setup { camera: "sim bust+lambert:0.8 96 0 0 0 0".into(), ..same.clone() };
        assert!(refused(&begun, &simulated).contains("--camera folder:DIR (now --camera sim)"));
        let askew = Record { camera: "sim bust+lambert:0.8 64 4 -2 1.5 -1".into(), ..begun.clone() };
        assert!(
            refused(&askew, &simulated)
                .contains("--misaligned 4,-2,1.5,-1, --size 64 (now no --misaligned, --size 96)")
        );
        let ball = Setup { ball: true, camera: askew.camera.clone(), ..same.clone() };
        assert!(refused(&askew, &ball).contains("begun with no --sphere (now --sphere room)"));
        (same.white, same.options.dark) = (Some(4095), false);
        assert_eq!(
            refused(&begun, &same),
            "the session was begun with --dark, no --white (now no --dark, --white 4095): say the same"
        );
        // Sessions from before did not say these.
        let mut old = serde_json::to_value(&begun).unwrap();
        for field in ["black", "white", "dark", "reach", "nearby", "brightness"] {
            old.as_object_mut().unwrap().remove(field);
        }
        check_same(&serde_json::from_value(old).unwrap(), &same).unwrap();
    }
}
