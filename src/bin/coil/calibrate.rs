//! `coil calibrate`: light directions from pictures of a mirror sphere, and the arm's zero and tilt from those.

use crate::arm::read_config;
use crate::capture::{circle, crop, read_frame};
use anyhow::{Context, bail};
use clap::Subcommand;
use coil_ps::dataset::lp::write_lp;
use coil_ps::light;
use coil_ps::rig::calibration::{Sighting, fit_mount};
use coil_ps::rig::hdr::{Crop, Exposure, merge};
use coil_ps::rig::sphere::{self, Circle};
use coil_ps::rig::store::{RECORD, Record};
use coil_ps::stack::BitDepth;
use glam::{DVec2, Vec3};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Measure light directions with a mirror sphere, and fit how the arm stands.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Subcommand)]
enum Action {
    /// The light's direction in each picture of a mirror sphere, with its uncertainty.
    Sphere(SphereArgs),
    /// Zero and tilt of the arm, from sessions captured with a mirror sphere (coil capture --sphere).
    Arm(FitArgs),
}

#[derive(clap::Args)]
struct SphereArgs {
    /// Pictures of the sphere under the light (PNG or TIFF, linear), all from one camera that stood still.
    #[arg(required = true)]
    images: Vec<PathBuf>,
    /// Picture of the sphere in room light: its outline is found there.
    #[arg(long, value_name = "IMAGE")]
    room: Option<PathBuf>,
    /// Part of that picture to look in, where something else is round: LEFT,TOP,WIDTH,HEIGHT.
    #[arg(long, value_parser = crop, requires = "room")]
    within: Option<Crop>,
    /// Outline: X,Y,RADIUS in pixels.
    #[arg(long, conflicts_with = "room", value_parser = |t: &str| circle(t).ok_or("write X,Y,RADIUS in pixels"))]
    circle: Option<Circle>,
    /// Points on the outline, three or more: X,Y in pixels.
    #[arg(long, num_args = 3.., value_name = "X,Y", conflicts_with_all = ["room", "circle"], value_parser = point)]
    points: Vec<DVec2>,
    /// Picture with the light off, to subtract.
    #[arg(long, value_name = "IMAGE")]
    dark: Option<PathBuf>,
    /// Write the directions as .lp (image and direction a line).
    #[arg(long, value_name = "FILE")]
    lp: Option<PathBuf>,
    /// Print JSON instead of lines.
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args)]
struct FitArgs {
    /// Folders of sessions, or their session.json.
    #[arg(required = true)]
    sessions: Vec<PathBuf>,
    /// Limits, mount and feed of the arm as JSON (what session.json holds under "arm"); without it those of the first session.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Write the arm's configuration with the fitted mount there: for --config of coil arm and coil capture.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

fn point(text: &str) -> Result<DVec2, String> {
    let (x, y) = text.split_once(',').ok_or("write X,Y in pixels")?;
    let number = |t: &str| t.trim().parse::<f64>().ok().filter(|v| v.is_finite());
    Ok(DVec2::new(number(x).ok_or("X is no number")?, number(y).ok_or("Y is no number")?))
}

/// Runs the subcommand. The status is 1 where a picture shows no highlight, after all others were measured.
///
/// # Errors
/// What went wrong, in words.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.action {
        Action::Sphere(args) => measure(&args),
        Action::Arm(args) => fit(&args),
    }
}

#[derive(Serialize)]
struct Row {
    image: String,
    direction: Option<Vec3>,
    azimuth: Option<f32>,
    slant: Option<f32>,
    uncertainty: Option<f64>,
    /// Radius of the highlight, pixels.
    spot: Option<f64>,
    error: Option<String>,
}

fn measure(args: &SphereArgs) -> anyhow::Result<ExitCode> {
    let skip = |x: f64, y: f64| args.within.is_some_and(|w| !w.contains(x, y));
    let outline = match (&args.room, args.circle, &args.points[..]) {
        (Some(path), ..) => sphere::find_outline(&sphere::values(&read_frame(path)?).view(), skip)
            .with_context(|| path.display().to_string())?,
        (_, Some(circle), _) => circle,
        (_, _, points) if !points.is_empty() => sphere::fit_circle(points)?,
        _ => bail!("where is the sphere? --room IMAGE, --circle X,Y,RADIUS or --points X,Y X,Y X,Y"),
    };
    let full = |path: &Path| -> anyhow::Result<Exposure> {
        let image = read_frame(path)?;
        let white = if image.bits == BitDepth::Eight { 255 } else { u16::MAX };
        Ok(Exposure { image, seconds: 1.0, black: 0, white })
    };
    let dark = args.dark.as_deref().map(full).transpose()?;
    let mut rows = Vec::new();
    for path in &args.images {
        let exposure = full(path)?;
        if let Some(dark) = &dark {
            // Says which sizes don't fit.
            merge(std::slice::from_ref(&exposure), Some(std::slice::from_ref(dark)))
                .with_context(|| path.display().to_string())?;
        }
        let seen = sphere::measure(&exposure, dark.as_ref(), &outline);
        let found = seen.as_ref().ok();
        rows.push(Row {
            image: path.display().to_string(),
            direction: found.map(|r| r.direction),
            azimuth: found.map(|r| light::azimuth(r.direction).to_degrees()),
            slant: found.map(|r| light::slant(r.direction).to_degrees()),
            uncertainty: found.map(|r| r.uncertainty),
            spot: found.map(|r| r.spot),
            error: seen.as_ref().err().map(ToString::to_string),
        });
    }
    if args.json {
        let all = serde_json::json!({ "circle": outline, "lights": rows });
        println!("{}", serde_json::to_string_pretty(&all)?);
    } else {
        println!("sphere: centre {:.2}, {:.2}, radius {:.2} pixels", outline.x, outline.y, outline.radius);
        for row in &rows {
            match (row.direction, row.azimuth, row.slant, row.uncertainty, row.spot) {
                (Some(d), Some(azimuth), Some(slant), Some(u), Some(spot)) => println!(
                    "{}  {:.5} {:.5} {:.5}  azimuth {azimuth:.2}° slant {slant:.2}° ±{u:.2}°  spot {spot:.1} px",
                    row.image, d.x, d.y, d.z
                ),
                _ => println!("{}  {}", row.image, row.error.as_deref().unwrap_or_default()),
            }
        }
    }
    if let Some(path) = &args.lp {
        let lights = rows.iter().filter_map(|r| Some((r.image.as_str(), r.direction?)));
        std::fs::write(path, write_lp(lights)).with_context(|| path.display().to_string())?;
    }
    Ok(if rows.iter().any(|r| r.error.is_some()) { ExitCode::from(1) } else { ExitCode::SUCCESS })
}

fn read_record(path: &Path) -> anyhow::Result<Record> {
    let path = if path.is_dir() { path.join(RECORD) } else { path.into() };
    let bytes = std::fs::read(&path).with_context(|| path.display().to_string())?;
    serde_json::from_slice(&bytes).with_context(|| format!("{}: not the record of a session", path.display()))
}

fn fit(args: &FitArgs) -> anyhow::Result<ExitCode> {
    let records: Vec<Record> = args.sessions.iter().map(|p| read_record(p)).collect::<anyhow::Result<_>>()?;
    let mut arm = match (&args.config, records.first()) {
        (Some(path), _) => read_config(path)?,
        (None, Some(first)) => first.arm.clone(),
        (None, None) => bail!("no session was given"),
    };
    let sightings: Vec<Sighting> = records.iter().flat_map(Record::sightings).collect();
    let found = fit_mount(&sightings, arm.mount)?;
    println!("azimuth  slant  uncertainty  before  after  (degrees)");
    for (s, (before, after)) in sightings.iter().zip(found.before.iter().zip(&found.residuals)) {
        println!(
            "{:7.2} {:6.2}  {:11.2}  {before:6.2}  {after:5.2}",
            s.joints.azimuth, s.joints.slant, s.uncertainty
        );
    }
    let m = found.mount;
    println!(
        "zero: azimuth {:.3}°, slant {:.3}°; tilt of the axis {:.3}°, {:.3}°; rms {:.3}° of {} directions",
        m.azimuth,
        m.slant,
        m.tilt[0],
        m.tilt[1],
        found.rms(),
        sightings.len()
    );
    if let Some(path) = &args.out {
        arm.mount = m;
        let text = format!("{}\n", serde_json::to_string_pretty(&arm)?);
        std::fs::write(path, text).with_context(|| path.display().to_string())?;
    }
    Ok(ExitCode::SUCCESS)
}
