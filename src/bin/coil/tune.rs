//! `coil tune`: the robust solvers' parameters and every solver's expected errors, from synthetic pixels.

use crate::objects::read_meshes;
use crate::{models, output};
use coil_ps::eval::statistics::mean;
use coil_ps::pixels::tune::{Score, bench, score};
use coil_ps::pixels::{Generator, context, expectation, nearness, neighbourhood};
use coil_ps::render::worlds::Split;
use coil_ps::solve::expectation::Judge;
use coil_ps::solve::{self, Irls, Loss, Solver, SparseBayes, Thresholds, Trimmed, near};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// Prints, for every solver without training, the mean angular error on synthetic pixels over a grid of its
/// parameters.
#[derive(clap::Args)]
pub struct Args {
    /// Seed of the pixels.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Light sets for each number of lights (64 pixels each).
    #[arg(long, default_value_t = 200, value_parser = output::at_least_one())]
    sets: usize,
    /// Instead fit what errors to expect of every solver, and write the weights to FILE (models/expected-error.json).
    #[arg(long, value_name = "FILE")]
    uncertainty: Option<PathBuf>,
    /// Instead fit what makes the lamps' nearness of the pictures, and write the weights to FILE (models/nearness.json).
    #[arg(long, value_name = "FILE", conflicts_with = "uncertainty")]
    nearness: Option<PathBuf>,
    /// Instead fit what corrects normals by what is around them, and write the weights to FILE (models/context.json).
    #[arg(long, value_name = "FILE", conflicts_with_all = ["uncertainty", "nearness"])]
    context: Option<PathBuf>,
    /// Folder of meshes (.obj, .ply, .stl) that a third of the objects for --context are; the rest are sculptures.
    #[arg(long, value_name = "DIR", requires = "context")]
    meshes: Option<PathBuf>,
    /// Folder of meshes that this is looked at on too.
    #[arg(long, value_name = "DIR", requires = "context")]
    validation_meshes: Option<PathBuf>,
    #[command(flatten)]
    models: models::Folder,
    /// Rendered objects that this is fitted to.
    #[arg(long, default_value_t = 800, value_parser = output::at_least_one())]
    objects: usize,
    /// Rendered validation objects that it is looked at on.
    #[arg(long, default_value_t = 50, value_parser = output::at_least_one())]
    checks: usize,
    /// Their size in pixels.
    #[arg(long, default_value_t = 64)]
    size: u32,
}

/// Numbers of lights that count alike.
const LIGHTS: [usize; 4] = [5, 10, 20, 60];

pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    if let Some(out) = &args.uncertainty {
        return fit_expected(&args, out);
    }
    if let Some(out) = &args.nearness {
        return fit_nearness(&args, out);
    }
    if let Some(out) = &args.context {
        return fit_context(&args, out);
    }
    let generator = Generator::new(Split::Train);
    let benches: Vec<_> = LIGHTS.iter().map(|&t| bench(&generator, args.seed, t, args.sets, 64)).collect();
    println!(
        "mean angular error in degrees at T = {LIGHTS:?} and over all; seed {}, {} sets",
        args.seed, args.sets
    );
    for (family, candidates) in grid() {
        println!("\n{family}");
        let mut best: Option<(f64, String)> = None;
        for (text, solver) in candidates {
            let scores = benches.iter().map(|b| score(&*solver, b)).collect::<Result<Vec<_>, _>>()?;
            let means: Vec<f64> = scores.iter().map(Score::mean).collect();
            let all = means.iter().sum::<f64>() / means.len() as f64;
            let cells: String = means.iter().map(|m| format!("{m:7.2}")).collect();
            println!("  {text:44}{cells}{all:9.3}");
            if best.as_ref().is_none_or(|(b, _)| all < *b) {
                best = Some((all, text));
            }
        }
        if let Some((all, text)) = best {
            println!("  best: {text} ({all:.3})");
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Fits the expected errors of all solvers, writes them, and prints how they do on objects they were not fitted to.
fn fit_expected(args: &Args, out: &Path) -> anyhow::Result<ExitCode> {
    let seconds = Instant::now();
    let models = args.models.load(&["coil".to_owned()])?;
    let pixels = expectation::pixels(args.objects, args.size, &models)?;
    let checks = expectation::checks(args.checks, args.size, &models)?;
    eprintln!("rendered after {:.0} s", seconds.elapsed().as_secs_f64());
    println!(
        "on {} validation objects seen by the rig, T = 10: mean error, mean expected, objects within 2°, median rank correlation",
        args.checks
    );
    let alone = in_parallel(|name| {
        Ok(expectation::fit(&expectation::samples(&*solve::by_name(name)?, pixels.of(name))?, args.seed))
    })?;
    drop(pixels);
    eprintln!("pixels by themselves fitted after {:.0} s", seconds.elapsed().as_secs_f64());
    let neighbours = neighbourhood::samples(args.objects.div_ceil(2), &alone, &models)?;
    eprintln!("their neighbours seen after {:.0} s", seconds.elapsed().as_secs_f64());
    let judges = in_parallel(|name| {
        let among = neighbourhood::network(&neighbours[name], args.seed);
        let judge = Judge { alone: alone[name].clone(), among };
        let mut line = format!("{name:8}");
        for (lights, c) in expectation::check(&*solve::by_name(name)?, &judge, &checks)? {
            let within = 100.0 * c.within;
            line += &format!("  {lights} {:5.2} {:5.2} {within:3.0} % {:.2}", c.mean, c.expected, c.rank);
        }
        println!("{line}");
        Ok(judge)
    })?;
    // A line a solver: readable differences, and no more bytes than needed in the page.
    let lines: Vec<String> = judges
        .iter()
        .map(|(name, judge)| Ok(format!("\"{name}\": {}", serde_json::to_string(judge)?)))
        .collect::<anyhow::Result<_>>()?;
    output::write(out, format!("{{\n{}\n}}\n", lines.join(",\n")).as_bytes())?;
    eprintln!("{:.0} s", seconds.elapsed().as_secs_f64());
    Ok(ExitCode::SUCCESS)
}

/// Something of every solver that treats pixels alone.
fn in_parallel<T: Send>(
    of: impl Fn(&'static str) -> anyhow::Result<T> + Sync,
) -> anyhow::Result<BTreeMap<&'static str, T>> {
    let alone: Vec<_> = solve::SOLVERS.iter().filter(|s| !s.of_whole).collect();
    alone.par_iter().map(|s| Ok((s.name, of(s.name)?))).collect()
}

/// Fits what makes the lamps' nearness of what is seen, writes it, and prints how far off it is on objects it was not fitted to.
fn fit_nearness(args: &Args, out: &Path) -> anyhow::Result<ExitCode> {
    let network = nearness::network(&nearness::samples(Split::Train, args.objects, args.size)?, args.seed);
    output::write(out, format!("{}\n", serde_json::to_string(&network)?).as_bytes())?;
    let checks = nearness::samples(Split::Validation, args.checks, args.size)?;
    println!(
        "nearness (half width over the lamps' distance), {} validation objects, root mean square:",
        args.checks
    );
    for (least, most) in [(5, 8), (9, 14), (15, 24), (25, 100)] {
        let some: Vec<_> = checks.iter().filter(|s| (least..=most).contains(&s.lights)).collect();
        let found = |s: &nearness::Sample| near::judged(&network, &s.signs);
        let root_mean_square = |of: &dyn Fn(&nearness::Sample) -> f32| {
            let squares: Vec<f64> = some.iter().map(|s| f64::from(of(s)).powi(2)).collect();
            mean(&squares).sqrt()
        };
        let distant: Vec<f64> = some.iter().filter(|s| s.truth == 0.0).map(|s| f64::from(found(s))).collect();
        println!(
            "  {least:2} to {most:3} lights ({:4} sets): {:.3} is {:.4} off; distant lamps are taken for {:.4} in the mean",
            some.len(),
            root_mean_square(&|s| s.truth),
            root_mean_square(&|s| found(s) - s.truth),
            mean(&distant)
        );
    }
    Ok(ExitCode::SUCCESS)
}

/// Fits what corrects normals by what is around them, writes it, and prints what it does to objects it was not fitted to.
fn fit_context(args: &Args, out: &Path) -> anyhow::Result<ExitCode> {
    let seconds = Instant::now();
    let models = args.models.load(&["coil".to_owned()])?;
    let read = |dir: &Option<PathBuf>| dir.as_deref().map_or_else(|| Ok(Vec::new()), read_meshes);
    let samples = context::samples(args.objects, &read(&args.meshes)?, &models)?;
    eprintln!("solved after {:.0} s", seconds.elapsed().as_secs_f64());
    let network = context::network(&samples, args.seed);
    output::write(out, format!("{}\n", serde_json::to_string(&network)?).as_bytes())?;
    eprintln!("fitted after {:.0} s", seconds.elapsed().as_secs_f64());
    println!(
        "validation objects, lights: mean error of `pixel`, in context, expected, objects within 2°, median rank correlation"
    );
    for line in context::check(&network, args.checks, &read(&args.validation_meshes)?, &models)? {
        println!("{line}");
    }
    eprintln!("{:.0} s", seconds.elapsed().as_secs_f64());
    Ok(ExitCode::SUCCESS)
}

type Candidates = Vec<(String, Box<dyn Solver>)>;

fn grid() -> Vec<(&'static str, Candidates)> {
    let thresholds = |shadow| Thresholds { shadow, ..Thresholds::default() };
    let mut trimmed: Candidates = Vec::new();
    for shadow in [0.0, 0.02, 0.05] {
        for dark in [0.0, 0.1, 0.2, 0.3, 0.4, 0.5] {
            for bright in [0.0, 0.1, 0.2] {
                let solver = Trimmed { dark, bright, thresholds: thresholds(shadow) };
                trimmed.push((format!("shadow {shadow} dark {dark} bright {bright}"), Box::new(solver)));
            }
        }
    }
    let mut out = vec![("trimmed", trimmed)];
    for (name, loss, scales) in [
        ("l1", Loss::L1, [1e-4, 1e-3, 3e-3, 0.01]),
        ("huber", Loss::Huber, [3e-3, 0.01, 0.02, 0.05]),
        ("cauchy", Loss::Cauchy, [0.01, 0.02, 0.05, 0.1]),
    ] {
        let mut candidates: Candidates = Vec::new();
        for shadow in [0.0, 0.02, 0.05, 0.1] {
            for scale in scales {
                for iterations in [6, 12, 24] {
                    let solver = Irls { loss, scale, iterations, thresholds: thresholds(shadow) };
                    candidates.push((
                        format!("shadow {shadow} scale {scale} iterations {iterations}"),
                        Box::new(solver),
                    ));
                }
            }
        }
        out.push((name, candidates));
    }
    let mut bayes: Candidates = Vec::new();
    for shadow in [0.0, 0.02, 0.05, 0.1] {
        for noise in [1e-3, 3e-3, 0.01, 0.03] {
            for iterations in [15, 40, 100] {
                let solver = SparseBayes { noise, iterations, thresholds: thresholds(shadow) };
                bayes.push((
                    format!("shadow {shadow} noise {noise} iterations {iterations}"),
                    Box::new(solver),
                ));
            }
        }
    }
    out.push(("sbr", bayes));
    let mut conditioning: Candidates = Vec::new();
    for c in [0.0, 1e-3, 0.01, 0.03, 0.1] {
        let bayes = SparseBayes::default();
        let thresholds = Thresholds { conditioning: c, ..bayes.thresholds };
        conditioning.push((format!("sbr, conditioning {c}"), Box::new(SparseBayes { thresholds, ..bayes })));
        let t = Trimmed::default();
        let thresholds = Thresholds { conditioning: c, ..t.thresholds };
        conditioning.push((format!("trimmed, conditioning {c}"), Box::new(Trimmed { thresholds, ..t })));
    }
    out.push(("conditioning (compare within a solver)", conditioning));
    out
}
