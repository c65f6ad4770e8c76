//! `coil arm`: the arm from the command line.

mod link;

pub use link::{Driver, Pace, PortArgs};

use anyhow::{Context, bail};
use clap::{Args as ClapArgs, Subcommand};
use coil_ps::arm::Joints;
use coil_ps::arm::grbl::{Command, Event, Phase, Trust, Way};
use coil_ps::arm::kinematics::{Arm, Severity, check_settings};
use coil_ps::arm::line::State;
use coil_ps::light;
use coil_ps::rig::capture::Options;
use std::collections::VecDeque;
use std::io::{BufRead, IsTerminal};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

/// Drive the arm that carries the light (stock Grbl 1.1 on a serial port, or a simulated one).
#[derive(ClapArgs)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(ClapArgs)]
struct Rig {
    #[command(flatten)]
    port: PortArgs,
    #[command(flatten)]
    arm: ArmArgs,
    /// Do not home the arm, whatever its state.
    #[arg(long)]
    no_home: bool,
}

/// The arm's configuration.
#[derive(ClapArgs)]
pub struct ArmArgs {
    /// Limits, mount and feed of the arm as JSON (what session.json holds under "arm"); without it those of the guide.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

impl ArmArgs {
    /// The configuration.
    ///
    /// # Errors
    /// Where the file can't be read, or holds no arm.
    pub fn read(&self) -> anyhow::Result<Arm> {
        self.config.as_deref().map_or_else(|| Ok(Arm::default()), read_config)
    }
}

/// The configuration in a file.
///
/// # Errors
/// Where it can't be read, or holds no arm.
pub fn read_config(path: &Path) -> anyhow::Result<Arm> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let value: serde_json::Value = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
    let arm = value.get("arm").cloned().unwrap_or(value);
    let wrong = || format!("{}: not the configuration of an arm", path.display());
    let arm: Arm = serde_json::from_value(arm).with_context(wrong)?;
    arm.check().with_context(wrong)?;
    Ok(arm)
}

#[derive(Subcommand)]
enum Action {
    /// List the serial ports of this machine.
    Ports,
    /// Connect, and tell state, position and what is wrong with the settings.
    Status(Rig),
    /// Find the limit switches.
    Home(Rig),
    /// Bring the light to a direction, degrees.
    Goto {
        /// Azimuth of the light: from +x (right) towards +y (up).
        #[arg(allow_negative_numbers = true)]
        azimuth: f64,
        /// Slant of the light: 0 is at the camera, 90 beside the object.
        #[arg(allow_negative_numbers = true)]
        slant: f64,
        #[command(flatten)]
        rig: Rig,
    },
    /// Move the joints by some degrees, without looking at the limits of the configuration.
    Jog {
        /// By how much in azimuth.
        #[arg(allow_negative_numbers = true)]
        azimuth: f64,
        /// By how much in slant.
        #[arg(allow_negative_numbers = true)]
        slant: f64,
        #[command(flatten)]
        rig: Rig,
    },
    /// Visit evenly spread directions, to see that all is free and to measure the travel.
    Sweep {
        /// Number of directions.
        #[arg(long, default_value_t = 10)]
        lights: usize,
        /// Largest slant, degrees.
        #[arg(long, default_value_t = 70.0)]
        reach: f32,
        #[command(flatten)]
        rig: Rig,
    },
    /// Type lines for the firmware. `!` holds, `~` resumes, `stop` stops, `release` ends a stop, `quit` leaves.
    Console(Rig),
}

/// Runs the subcommand.
///
/// # Errors
/// What went wrong, in words.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.action {
        Action::Ports => ports(),
        Action::Status(rig) => status(&rig),
        Action::Home(rig) => {
            let mut driver = Driver::connect(&rig.port)?;
            driver.execute(Command::Home)?;
            tell(&driver);
            Ok(ExitCode::SUCCESS)
        }
        Action::Goto { azimuth, slant, rig } => goto(azimuth, slant, &rig),
        Action::Jog { azimuth, slant, rig } => {
            let arm = rig.arm.read()?;
            let mut driver = Driver::connect(&rig.port)?;
            ready(&mut driver, &rig)?;
            driver.execute(Command::Jog { by: Joints { azimuth, slant }, feed: arm.feed })?;
            tell(&driver);
            Ok(ExitCode::SUCCESS)
        }
        Action::Sweep { lights, reach, rig } => sweep(lights, reach, &rig),
        Action::Console(rig) => console(&rig),
    }
}

fn ports() -> anyhow::Result<ExitCode> {
    let ports = link::ports()?;
    if ports.is_empty() {
        println!(
            "no serial port found: is the cable a data cable, and does the board need a driver (CH340)?"
        );
        return Ok(ExitCode::from(1));
    }
    for (name, about) in ports {
        println!("{name}  {about}");
    }
    println!("sim  simulated arm: stock Grbl 1.1h with the settings of the guide");
    Ok(ExitCode::SUCCESS)
}

fn tell(driver: &Driver) {
    let link = driver.link();
    let state = link.state().map_or("unknown".to_string(), |s| s.to_string());
    let trust = match link.trust() {
        Trust::Homed => "homed",
        Trust::Assumed => "counted from where it stood when switched on",
        Trust::Lost => "position lost",
    };
    match link.joints() {
        Some(at) => println!("{state}: azimuth {:.3}°, slant {:.3}° ({trust})", at.azimuth, at.slant),
        None => println!("{state} ({trust})"),
    }
}

fn status(rig: &Rig) -> anyhow::Result<ExitCode> {
    let arm = rig.arm.read()?;
    let driver = Driver::connect(&rig.port)?;
    let link = driver.link();
    println!("Grbl {}", link.version());
    tell(&driver);
    if let Some(code) = link.alarm() {
        println!("alarm {code}: {}", coil_ps::arm::codes::alarm(code));
    } else if link.state() == Some(State::Alarm) {
        println!("locked: home it (coil arm home)");
    }
    let found = check_settings(link.settings(), link.work_offset(), &arm, Options::default().brightness);
    for finding in &found {
        let kind = if finding.severity == Severity::Error { "error" } else { "warning" };
        println!("{kind}: {}", finding.text);
    }
    if found.is_empty() {
        println!("settings fit the configuration");
    }
    Ok(ExitCode::SUCCESS)
}

/// Homes where the firmware is locked: opening the port restarts most boards.
fn ready(driver: &mut Driver, rig: &Rig) -> anyhow::Result<()> {
    let link = driver.link();
    let homing = link.homes();
    if link.state() == Some(State::Alarm) || link.trust() == Trust::Lost {
        if rig.no_home || !homing {
            bail!(
                "the arm is locked or its position is lost: home it (coil arm home), or unlock it in the console ($X)"
            );
        }
        eprintln!("homing first: the board restarts when its port is opened (--no-home to refuse)");
        driver.execute(Command::Home)?;
    }
    Ok(())
}

fn goto(azimuth: f64, slant: f64, rig: &Rig) -> anyhow::Result<ExitCode> {
    if !(-360.0..=360.0).contains(&azimuth) || !(-90.0..=90.0).contains(&slant) {
        bail!("azimuth {azimuth}°, slant {slant}°: -360 to 360 and -90 to 90 are possible");
    }
    let mut arm = rig.arm.read()?;
    let mut driver = Driver::connect(&rig.port)?;
    ready(&mut driver, rig)?;
    arm.axes = driver.link().axis_limits();
    let direction = light::from_azimuth_slant(azimuth.to_radians() as f32, slant.to_radians() as f32);
    let plan = arm.plan(direction, driver.link().joints().unwrap_or_default());
    if plan.projected > 0.0 {
        println!(
            "out of the arm's range: going to the nearest reachable direction, {:.2}° off",
            plan.projected
        );
    }
    let start = driver.now();
    driver.execute(Command::Goto { to: plan.joints, feed: arm.feed })?;
    tell(&driver);
    println!("{:.2} s (planned {:.2} s)", (driver.now() - start).as_secs_f64(), plan.seconds);
    Ok(ExitCode::SUCCESS)
}

fn sweep(lights: usize, reach: f32, rig: &Rig) -> anyhow::Result<ExitCode> {
    if !(1..=1000).contains(&lights) || !(0.0..=90.0).contains(&reach) {
        bail!("{lights} lights up to {reach}°: 1 to 1000 lights up to 90° are possible");
    }
    let mut arm = rig.arm.read()?;
    let mut driver = Driver::connect(&rig.port)?;
    ready(&mut driver, rig)?;
    arm.axes = driver.link().axis_limits();
    let set = light::fibonacci_cap(lights, reach.to_radians());
    let from = driver.link().joints().unwrap_or_default();
    let path = coil_ps::rig::thrifty::short_path(&arm, from, set);
    let (mut planned, mut took) = (0.0, 0.0);
    for (k, direction) in path.iter().enumerate() {
        let plan = arm.plan(*direction, driver.link().joints().unwrap_or_default());
        let start = driver.now();
        driver.execute(Command::Goto { to: plan.joints, feed: arm.feed })?;
        let seconds = (driver.now() - start).as_secs_f64();
        planned += plan.seconds;
        took += seconds;
        println!(
            "{:3}  azimuth {:8.2}°  slant {:6.2}°  {seconds:6.3} s (motion {:.3} s){}",
            k + 1,
            plan.joints.azimuth,
            plan.joints.slant,
            plan.seconds,
            if plan.projected > 0.0 {
                format!("  projected by {:.1}°", plan.projected)
            } else {
                String::new()
            }
        );
    }
    println!("{lights} moves: {took:.2} s, {planned:.2} s of it pure motion");
    Ok(ExitCode::SUCCESS)
}

fn console(rig: &Rig) -> anyhow::Result<ExitCode> {
    // Nobody types in simulated time.
    let pace = if std::io::stdin().is_terminal() { Pace::Real } else { rig.port.pace };
    let mut driver = Driver::connect(&PortArgs { pace, ..rig.port.clone() })?;
    driver.show_log = true;
    tell(&driver);
    let (send, receive) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            if send.send(line).is_err() {
                return;
            }
        }
    });
    // Typed lines go out as they come. Those of a script wait for the answer to the one before.
    let patient = !std::io::stdin().is_terminal();
    let mut waiting = VecDeque::new();
    let mut ended = false;
    loop {
        match receive.recv_timeout(Duration::from_millis(2)) {
            Ok(line) => waiting.push_back(line),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => ended = true,
        }
        let urgent = |line: &String| ["stop", "!", "~"].contains(&line.trim());
        let free = !driver.link().busy();
        if waiting.front().is_some_and(|line| free || !patient && line.trim() != "quit" || urgent(line)) {
            let line = waiting.pop_front().unwrap_or_default();
            match line.trim() {
                "quit" => return Ok(ExitCode::SUCCESS),
                "stop" => driver.stop(),
                "release" => report(driver.release()),
                "!" => driver.hold(),
                "~" => report(driver.resume()),
                "?" => tell(&driver),
                "" => {}
                text => {
                    let now = driver.now();
                    let command = if text == "$H" { Command::Home } else { Command::Raw(text.into()) };
                    report(driver.link_mut().send(now, command));
                }
            }
        } else if ended && free && waiting.is_empty() {
            return Ok(ExitCode::SUCCESS);
        } else if !free {
            driver.sleep(None);
        }
        driver.pump()?;
        for event in driver.take_events() {
            match event {
                Event::Done(_, Err(failure)) => eprintln!("{failure}"),
                Event::Phase(Phase::Closed(why)) => bail!("{}", why.unwrap_or_default()),
                _ => {}
            }
        }
    }
}

fn report<T, E: std::fmt::Display>(result: Result<T, E>) {
    if let Err(error) = result {
        eprintln!("{error}");
    }
}

/// How a console line is shown.
pub fn log_line(now: Duration, way: Way, text: &str) -> String {
    let arrow = match way {
        Way::Sent => '>',
        Way::Received => '<',
        Way::Note => '#',
    };
    format!("{:9.3} {arrow} {text}", now.as_secs_f64())
}
