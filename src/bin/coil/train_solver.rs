//! `coil train solver`: the pixel network, from synthetic pixels made on the fly.

use crate::output::{at_least_one, replace};
use anyhow::Context;
use coil_ps::pixels::fit::{Recipe, Report, Training};
use coil_ps::pixels::tune::{bench, score};
use coil_ps::pixels::{Generator, Pixels};
use coil_ps::render::worlds::Split;
use coil_ps::solve::pixel::onnx;
use coil_ps::solve::{self, PixelNetwork};
use std::fs;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Trains the pixel network; stops and goes on at any time.
#[derive(clap::Args)]
pub struct Args {
    /// Folder of the run: checkpoint, log.jsonl and the network as pixel.onnx. A run that is there is resumed.
    #[arg(long)]
    out: PathBuf,
    /// Network (pixel.onnx) whose weights a new run begins with.
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,
    /// Steps of the whole run (the learning rate falls to 0 at the last).
    #[arg(long, default_value_t = Recipe::default().steps)]
    steps: u64,
    /// Seed of weights and pixels.
    #[arg(long, default_value_t = Recipe::default().seed)]
    seed: u64,
    /// Light sets of a step, with 16 pixels under each.
    #[arg(long, default_value_t = Recipe::default().groups, value_parser = at_least_one())]
    groups: usize,
    /// Largest learning rate.
    #[arg(long, default_value_t = Recipe::default().rate, value_parser = rate)]
    rate: f32,
    /// Steps between validations.
    #[arg(long, default_value_t = 500, value_parser = clap::value_parser!(u64).range(1..))]
    validate_every: u64,
    /// Threads (at most 4 are used); their number doesn't change the result.
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// Stop after this many seconds; the same command goes on later.
    #[arg(long)]
    seconds: Option<u64>,
}

fn rate(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|r| *r > 0.0 && *r < 1.0).ok_or_else(|| "a number between 0 and 1".into())
}

/// Numbers of lights that are validated.
const LIGHTS: [usize; 3] = [3, 10, 30];
/// Seed of the validation pixels: no training run uses its streams with the held-out materials.
const VALIDATION_SEED: u64 = 0x5eed_0002;

pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    rayon::ThreadPoolBuilder::new().num_threads(args.threads).build_global()?;
    let recipe = Recipe {
        seed: args.seed,
        steps: args.steps,
        groups: args.groups,
        rate: args.rate,
        ..Recipe::default()
    };
    fs::create_dir_all(&args.out).with_context(|| format!("can't make {}", args.out.display()))?;
    let checkpoint = args.out.join("checkpoint");
    let mut training = if checkpoint.exists() {
        let bytes = fs::read(&checkpoint).with_context(|| format!("can't read {}", checkpoint.display()))?;
        Training::resume(recipe, &bytes).with_context(|| checkpoint.display().to_string())?
    } else if let Some(from) = &args.from {
        let bytes = fs::read(from).with_context(|| format!("can't read {}", from.display()))?;
        let model = onnx::read(&bytes).with_context(|| from.display().to_string())?;
        Training::from(model.network, recipe)
    } else {
        Training::new(recipe)
    };
    let mut log = fs::OpenOptions::new().create(true).append(true).open(args.out.join("log.jsonl"))?;
    let generator = Generator::new(Split::Train).with_distant_lamps();
    let unseen = Generator::new(Split::Validation).with_distant_lamps();
    let benches: Vec<_> = LIGHTS.iter().map(|&t| bench(&unseen, VALIDATION_SEED, t, 60, 32)).collect();
    let untrained = |s: &&solve::Info| s.name != solve::pixel::NAME && !s.of_whole;
    for name in solve::SOLVERS.iter().filter(untrained).map(|s| s.name) {
        println!("validation {name:8} {}", validate(&*solve::by_name(name)?, &benches)?);
    }
    let begun = Instant::now();
    let first = training.step();
    let mut saved = Instant::now();
    let mut recent = Report::default();
    let mut count = 0.0;
    while training.step() < recipe.steps {
        let report = training.advance(&generator)?;
        recent.error += report.error;
        recent.start_error += report.start_error;
        count += 1.0;
        let step = training.step();
        let due = step % args.validate_every == 0 || step == recipe.steps;
        if due {
            let solver = PixelNetwork::new(Arc::new(training.network().clone()));
            let elapsed = begun.elapsed().as_secs_f64();
            let done = (step - first) as f64;
            println!(
                "step {step}: training {:.2}° (start {:.2}°), validation {}; {:.0} pixels/s, {:.0} min left",
                recent.error / count,
                recent.start_error / count,
                validate(&solver, &benches)?,
                done * report.pixels as f64 / elapsed,
                elapsed / done * (recipe.steps - step) as f64 / 60.0,
            );
            let means = means(&solver, &benches)?;
            let line = serde_json::json!({
                "step": step, "training": recent.error / count, "start": recent.start_error / count,
                "lights": LIGHTS, "validation": means, "seconds": elapsed,
            });
            writeln!(log, "{line}")?;
            let about = [
                ("recipe".to_string(), format!("{recipe:?}")),
                ("steps done".into(), step.to_string()),
                ("validation lights".into(), format!("{LIGHTS:?}")),
                ("validation degrees".into(), format!("{means:.2?}")),
            ];
            replace(&args.out.join("pixel.onnx"), &onnx::write(training.network(), &about))?;
            (recent, count) = (Report::default(), 0.0);
        }
        let stop = args.seconds.is_some_and(|s| begun.elapsed() >= Duration::from_secs(s));
        if due || stop || saved.elapsed() > Duration::from_secs(30) {
            replace(&checkpoint, &training.checkpoint())?;
            saved = Instant::now();
        }
        if stop {
            println!("stopped at step {step} of {}: the same command goes on", recipe.steps);
            break;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn means(solver: &dyn solve::Solver, benches: &[Vec<Pixels>]) -> anyhow::Result<Vec<f64>> {
    benches.iter().map(|b| Ok(score(solver, b)?.mean())).collect()
}

fn validate(solver: &dyn solve::Solver, benches: &[Vec<Pixels>]) -> anyhow::Result<String> {
    let mut text = String::new();
    for (t, b) in LIGHTS.iter().zip(benches) {
        let s = score(solver, b)?;
        text += &format!(
            "T={t} {:.2}° (rank correlation with the expected error {:.2})  ",
            s.mean(),
            s.rank_correlation()
        );
    }
    Ok(text)
}
