//! `coil solve`: normals, expected error and surface of objects, as files.

use crate::models::{self, Models};
use crate::objects::Selection;
use crate::output;
use anyhow::bail;
use coil_ps::error::{self, ErrorMap};
use coil_ps::eval::plot;
use coil_ps::eval::run;
use coil_ps::eval::settings::ALL_LIGHTS;
use coil_ps::eval::statistics::{mean, median};
use coil_ps::eval::{Protocol, RunSpec, Subject};
use coil_ps::pixels::tune::rank_correlation;
use coil_ps::planner;
use coil_ps::relight::Lookup;
use coil_ps::solve::uncertainty::{self, StopAt};
use coil_ps::solve::{self, Measurements, Solution, near};
use coil_ps::stack::BitDepth;
use coil_ps::surface::export::Format;
use coil_ps::surface::{Integration, Surface, integrate};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// Solve objects and write normal maps, expected errors and surfaces.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    selection: Selection,
    /// Solver.
    #[arg(long, default_value = "context")]
    solver: String,
    /// Planner that chooses the lights; `all` takes every light of the stack.
    #[arg(long, default_value = ALL_LIGHTS)]
    planner: String,
    #[command(flatten)]
    models: models::Folder,
    /// Number of lights that the planner chooses; 10 without it.
    #[arg(long)]
    lights: Option<usize>,
    /// Take no more lights once the predicted mean error is at most this: 8deg.
    #[arg(long, value_name = "DEGREES")]
    stop_at: Option<StopAt>,
    /// From code values to linear values: official or 128.
    #[arg(long, default_value = "official")]
    protocol: Protocol,
    /// Seed of the planner.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder to write to; nothing is written without it.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Integrate the normals and write the surface in these formats: ply, obj, glb.
    #[arg(long, value_delimiter = ',', value_name = "FORMATS", requires = "out")]
    depth: Vec<Format>,
    /// Leave the surface open where it breaks by more than this many pixels.
    #[arg(long, default_value_t = 8.0, value_parser = pixels)]
    cliff: f32,
}

fn pixels(text: &str) -> Result<f32, String> {
    let number = text.parse::<f32>().ok().filter(|v| *v > 0.0 && v.is_finite());
    number.ok_or_else(|| "a number of pixels above 0".into())
}

/// Lights where none are asked for.
const LIGHTS: usize = 10;

/// Largest expected error on the colour scale, degrees.
const SCALE: f32 = 45.0;

pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let solver = solve::by_name(&args.solver)?;
    if let (Some(lights), ALL_LIGHTS) = (args.lights, args.planner.as_str()) {
        bail!("--lights {lights}: all lights are taken unless --planner chooses some, as --planner dc05");
    }
    if let Some(lights) = args.lights.filter(|t| !(3..=1000).contains(t)) {
        bail!("--lights {lights}: 3 to 1000 (a normal needs at least three lights)");
    }
    let models = args.models.load(std::slice::from_ref(&args.planner))?;
    planner::check_lights(&args.planner, args.lights.unwrap_or(LIGHTS), Some(&models))?;
    let mut failed = false;
    let mut predictions = Vec::new();
    args.selection.for_each(args.protocol, |name, object| {
        let object = match object {
            Ok(object) => object,
            Err(error) => {
                eprintln!("{name}: {error:#}");
                failed = true;
                return Ok(());
            }
        };
        let reach = args.selection.reach.to_radians();
        let both = object.with_subject(reach, |subject| one(subject, solver.as_ref(), &models, &args));
        match both {
            Ok(both) => predictions.extend(both),
            // The others may do: hours of work are not for nothing.
            Err(error) => {
                eprintln!("{name}: {error:#}");
                failed = true;
            }
        }
        Ok(())
    })?;
    if predictions.len() > 1 {
        let near = predictions.iter().filter(|p| (p.expected - p.truth).abs() <= 2.0).count();
        let all = |f: fn(&Prediction) -> f64| predictions.iter().map(f).collect::<Vec<_>>();
        println!(
            "{} objects: expected {:.2}°, true {:.2}°; within 2° on {near} of them; rank correlation {:.2} in the median",
            predictions.len(),
            mean(&all(|p| p.expected)),
            mean(&all(|p| p.truth)),
            median(&all(|p| p.rank))
        );
    }
    Ok(ExitCode::from(u8::from(failed)))
}

/// What was expected of one object, and what is so; degrees.
struct Prediction {
    expected: f64,
    truth: f64,
    /// Rank correlation of expected and true error over the pixels.
    rank: f64,
}

/// Solves one object; what was expected where both that and the truth are known.
fn one(
    subject: &Subject,
    solver: &dyn solve::Solver,
    models: &Models,
    args: &Args,
) -> anyhow::Result<Option<Prediction>> {
    let lookup = Lookup::Nearest;
    let spec = RunSpec {
        planner: args.planner.clone(),
        lights: args.lights.unwrap_or(LIGHTS),
        lookup,
        draw: 0,
        seed: args.seed,
        stop_at: None,
    };
    let mut seen = run::run(subject, &spec, &[], Some(models))?.seen;
    // Planners look back only, so stopping early and cutting the whole run short are the same.
    if let Some(stop) = args.stop_at {
        let mask = subject.mask();
        let enough = |&count: &usize| stop.enough(solver, &Measurements::of(&seen[..count]), mask);
        seen.truncate((1..seen.len()).find(enough).unwrap_or(seen.len()));
    }
    let count = seen.len();
    let begun = Instant::now();
    let ready = solve::prepare(solver.name(), Measurements::of(&seen), &near::places(subject.mask()))?;
    let measurements = ready.measurements();
    let mut solution = solver.solve(&measurements)?;
    let solved = begun.elapsed().as_secs_f64();
    let begun = Instant::now();
    uncertainty::complete(solver.name(), &measurements, &mut solution)?;
    solve::finish(solver.name(), subject.mask(), &mut solution)?;
    let seconds = (solved, begun.elapsed().as_secs_f64());
    let truth = subject.truth().map(|t| error::error_map(&solution.normals, t));
    let expected = uncertainty::predicted_mae(&solution).unwrap_or(f32::NAN);
    let prediction = truth.as_ref().map(|t| {
        let each = solution.uncertainty.as_deref().unwrap_or_default();
        Prediction { expected: f64::from(expected), truth: t.mae, rank: rank_correlation(each, &t.degrees) }
    });
    let lamps = match ready.nearness {
        0.0 => String::new(),
        nearness => format!(", lamps about {:.0} half widths away", 1.0 / nearness),
    };
    println!(
        "{}: {} pixels, {count} lights{lamps}, {}: expected {:.2}°{}, {:.1} % valid, {:.0} ms, expected errors {:.0} ms",
        subject.name(),
        solution.normals.len(),
        solver.name(),
        expected,
        prediction.as_ref().map_or(String::new(), |p| {
            format!(", true {:.2}° (rank correlation {:.2})", p.truth, p.rank)
        }),
        100.0 * uncertainty::coverage(&solution),
        1e3 * seconds.0,
        1e3 * seconds.1,
    );
    if let Some(dir) = &args.out {
        write(subject, &solution, truth.as_ref(), &dir.join(output::safe(subject.name())), args)?;
    }
    Ok(prediction.filter(|p| p.expected.is_finite()))
}

fn write(
    subject: &Subject,
    solution: &Solution,
    truth: Option<&ErrorMap>,
    dir: &Path,
    args: &Args,
) -> anyhow::Result<()> {
    let mask = subject.mask();
    output::write(&dir.join("normals.png"), &plot::normal_map(mask, &solution.normals, BitDepth::Sixteen)?)?;
    if let Some(degrees) = solution.uncertainty.clone() {
        let mae = f64::from(uncertainty::predicted_mae(solution).unwrap_or(0.0));
        let expected = ErrorMap { degrees, mae, unknown: 0 };
        output::write(&dir.join("expected-error.png"), &plot::error_map(mask, &expected, SCALE)?)?;
    }
    if let Some(errors) = truth {
        output::write(&dir.join("error.png"), &plot::error_map(mask, errors, SCALE)?)?;
    }
    if args.depth.is_empty() {
        return Ok(());
    }
    let begun = Instant::now();
    let depth = integrate(mask, &solution.normals, &Integration::default(), || false)?;
    println!("  surface: {} rounds, {:.1} s", depth.rounds, begun.elapsed().as_secs_f64());
    let surface = Surface::new(mask, &depth.heights, &solution.normals, &solution.albedo, args.cliff);
    for format in &args.depth {
        output::write(&dir.join(format!("surface.{}", format.extension())), &surface.write(*format))?;
    }
    Ok(())
}
