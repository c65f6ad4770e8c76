//! `coil train policy`: COIL-PS's network, in resumable pieces.

use crate::model;
use crate::objects::read_meshes;
use crate::output::{at_least_one, replace};
use anyhow::{Context, bail};
use clap::ValueEnum;
use coil_ps::light::{azimuth, fibonacci_cap, from_azimuth_slant, ring, slant};
use coil_ps::policy::Config;
use coil_ps::train::compute::{Compute, Processor};
use coil_ps::train::fit::{Recipe, Report, Trainer};
use coil_ps::train::formation::Scene;
use coil_ps::train::loss::Measure;
use coil_ps::train::{checkpoint, export, import, objects, plot, validate};
use glam::Vec3;
use indicatif::{ProgressBar, ProgressStyle};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Preset {
    /// For two CPU cores.
    Compact,
    /// The paper's recipe (AdamW 1e-5, batch 8, 500 epochs of 1000 objects, soft interpolation).
    Paper,
}

#[derive(Clone, Copy, ValueEnum)]
enum Device {
    Cpu,
    Cuda,
    Wgpu,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Without {
    /// No outlier-aware gate.
    Gate,
    /// No transformer and no positional encoding.
    Transformer,
}

/// Options of `coil train policy`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    choices: Choices,
    /// What the network is trained on: cpu, cuda (feature train-cuda) or wgpu (feature train-wgpu).
    #[arg(long, value_enum, default_value = "cpu")]
    device: Device,
    /// Threads; their number doesn't change the result.
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// Updates between validations.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    validate_every: u64,
    /// Objects to validate on.
    #[arg(long, default_value_t = 32, value_parser = at_least_one())]
    validation_objects: usize,
    /// Folder of meshes (.obj, .ply, .stl) to validate on, in turn; without it sculptures that are not trained on.
    #[arg(long, value_name = "DIR")]
    validation_meshes: Option<PathBuf>,
    /// Seconds after which to stop; go on later with --resume.
    #[arg(long)]
    seconds: Option<u64>,
    /// Folder of a new run: recipe, log, plot, checkpoint, exported best model.
    #[arg(long, required_unless_present = "resume")]
    out: Option<PathBuf>,
    /// Folder of a run whose best weights a new run begins with, or of a model (encoder.onnx, step.onnx).
    #[arg(long, conflicts_with = "resume")]
    from: Option<PathBuf>,
    /// Folder of a run to go on with, by its own recipe, or to begin with the options given where there is none yet. Of one that
    /// has ended, its best and its last weights are compared again.
    #[arg(long, value_name = "DIR", conflicts_with = "out")]
    resume: Option<PathBuf>,
}

/// What makes the recipe of a new run. What is not given comes from the preset.
#[derive(clap::Args, Default, PartialEq)]
struct Choices {
    /// Recipe to start from; compact without it.
    #[arg(long, value_enum)]
    preset: Option<Preset>,
    /// Recipe of an earlier run (its recipe.json, perhaps changed) to start from instead of a preset.
    #[arg(long, value_name = "FILE", conflicts_with = "preset")]
    recipe: Option<PathBuf>,
    /// Size of the network: compact or paper.
    #[arg(long)]
    size: Option<String>,
    /// Ablation: leave a part out.
    #[arg(long, value_enum)]
    without: Option<Without>,
    /// Show the policy black frames: it then learns one fixed light set.
    #[arg(long)]
    blank: bool,
    /// Folder of meshes (.obj, .ply, .stl) for a quarter of the training objects; the rest are sculptures.
    #[arg(long, value_name = "DIR")]
    meshes: Option<PathBuf>,
    /// Side of the network's frames, pixels: a power of two times its feature map.
    #[arg(long)]
    input: Option<usize>,
    /// Objects in the training pool.
    #[arg(long)]
    objects: Option<usize>,
    /// Side of the training pictures, pixels.
    #[arg(long)]
    resolution: Option<u32>,
    /// How a direction becomes a picture: exact, or soft:TAU (radians).
    #[arg(long)]
    lookup: Option<String>,
    /// What the loss measures: angle, or cosine (the paper's).
    #[arg(long, value_parser = |text: &str| serde_json::from_value::<Measure>(text.into()).map_err(|_| "angle or cosine"))]
    measure: Option<Measure>,
    /// Picture after which the loss is measured first: 3 or later (4 in the paper).
    #[arg(long)]
    first_loss: Option<usize>,
    /// Tell the policy how many pictures there will be, 3 to T, and count the error after the last one alone.
    #[arg(long, conflicts_with = "first_loss")]
    horizon: bool,
    /// Show real life's variety in sequences of limited reach: objects turned about the optical axis, rigs good and bad
    #[arg(long)]
    varied: bool,
    /// Objects of varied sequences are of any material, not measured ones alone
    #[arg(long)]
    any_material: bool,
    /// Share of the sequences over the whole hemisphere
    #[arg(long)]
    whole_dome: Option<f32>,
    /// Share of the sequences with a finite light set; the rest has a random reach
    #[arg(long)]
    finite: Option<f32>,
    /// Solver to train through.
    #[arg(long)]
    solver: Option<String>,
    /// Updates.
    #[arg(long)]
    steps: Option<u64>,
    /// Sequences an update.
    #[arg(long)]
    batch: Option<usize>,
    /// Sequences differentiated together.
    #[arg(long)]
    micro_batch: Option<usize>,
    /// Learning rate.
    #[arg(long)]
    rate: Option<f32>,
    /// Share of the old in the running average of the weights that is validated and shipped; 0 for none.
    #[arg(long)]
    averaging: Option<f32>,
    /// Pictures a sequence, T.
    #[arg(long)]
    lights: Option<usize>,
    /// Share of the gradient that flows back through what the policy sees, 0 to 1.
    #[arg(long)]
    feedback: Option<f32>,
    /// Seed of weights and draws.
    #[arg(long)]
    seed: Option<u64>,
}

/// A line of the log.
#[derive(Serialize, Deserialize)]
struct Line {
    #[serde(flatten)]
    report: Option<Report>,
    /// Seconds of this update.
    #[serde(skip_serializing_if = "Option::is_none")]
    seconds: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    validation: Option<Validation>,
    #[serde(skip_serializing_if = "Option::is_none")]
    baselines: Option<Vec<(String, validate::Errors)>>,
}

#[derive(Serialize, Deserialize)]
struct Validation {
    /// Updates made.
    after: u64,
    #[serde(flatten)]
    found: validate::Validation,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let dir = args.resume.as_ref().or(args.out.as_ref()).context("name a folder with --out")?.clone();
    let there = dir.join("checkpoint").exists();
    if there && args.resume.is_none() {
        bail!("{} holds a run already: go on with --resume, or name another folder", dir.display());
    }
    let mut trainer = if there || args.resume.is_some() && args.choices == Choices::default() {
        let trainer = resume(&dir)?;
        same_recipe(&trainer.recipe, &args.choices, &dir)?;
        trainer
    } else {
        let recipe = recipe(&args.choices)?;
        match &args.from {
            None => Trainer::new(recipe)?,
            Some(from) => begin_from(from, recipe)?,
        }
    };
    fs::create_dir_all(&dir).with_context(|| format!("can't make the folder {}", dir.display()))?;
    replace(&dir.join("recipe.json"), serde_json::to_string_pretty(&trainer.recipe)?.as_bytes())?;
    let mut log = Log::open(&dir.join("log.jsonl"), trainer.step)?;

    let threads = args.threads.max(1);
    let processor = match args.device {
        Device::Cpu => Processor::Cpu,
        Device::Cuda => Processor::Cuda,
        Device::Wgpu => Processor::Wgpu,
    };
    let compute = Compute::new(processor, threads)?;
    let meshes = trainer.recipe.meshes.as_deref().map(|dir| read_meshes(Path::new(dir))).transpose()?;
    let reach = trainer.recipe.validated_reach();
    let (size, softness) = (trainer.recipe.resolution, trainer.recipe.softness);
    let pool = objects::Training::new(size, softness, meshes.unwrap_or_default())?
        .of_any_material(trainer.recipe.any_material);
    let meshes = args.validation_meshes.as_deref().map(read_meshes).transpose()?.unwrap_or_default();
    let varied = trainer.recipe.varied && trainer.recipe.limited();
    let scenes = objects::validation(&meshes, args.validation_objects, size, varied)?;
    eprintln!(
        "{} weights, {} validation objects, {} of {} updates made",
        trainer.weights.count(),
        scenes.len(),
        trainer.step,
        trainer.recipe.steps
    );
    if trainer.step == 0 {
        let baselines = baselines(&scenes, reach, threads);
        for (name, e) in &baselines {
            eprintln!("  {name:24} {:6.2} {:6.2} {:6.2}", e.0[0], e.0[1], e.0[2]);
        }
        log.write(&Line { report: None, seconds: None, validation: None, baselines: Some(baselines) })?;
        replace(&dir.join("checkpoint"), &checkpoint::write(&trainer))?;
    }

    if trainer.done() {
        return choose(&dir, &mut trainer, &scenes, &compute);
    }
    let started = Instant::now();
    let bar = ProgressBar::new(trainer.recipe.steps).with_position(trainer.step);
    bar.set_style(ProgressStyle::with_template("{pos}/{len} {elapsed}, {eta} left  {msg}")?);
    bar.reset_eta();
    while !trainer.done() {
        let before = Instant::now();
        let report = trainer.update(&pool, &compute)?;
        let seconds = Some((before.elapsed().as_secs_f64() * 1e3).round() / 1e3);
        log.write(&Line { report: Some(report), seconds, validation: None, baselines: None })?;
        bar.inc(1);
        let due = trainer.step.is_multiple_of(args.validate_every) || trainer.done();
        if due {
            let found = validate::policy(trainer.judged(), &scenes, reach, trainer.recipe.blank, &compute);
            let better = trainer.validated(found.degrees.last());
            let after = trainer.step;
            let [a, b, c] = found.degrees.0;
            bar.suspend(|| {
                eprintln!(
                    "after {after}: T=3 {a:.2}, T=5 {b:.2}, T=10 {c:.2} degrees, spread {:.1}{}",
                    found.spread,
                    if better { ", best so far" } else { "" }
                )
            });
            log.write(&Line {
                report: None,
                seconds: None,
                validation: Some(Validation { after, found }),
                baselines: None,
            })?;
        }
        bar.set_message(format!("loss {:.4}", report.loss));
        let stop = args.seconds.is_some_and(|s| started.elapsed().as_secs() >= s);
        if due || stop {
            log.flush()?;
            replace(&dir.join("checkpoint"), &checkpoint::write(&trainer))?;
            save_best(&dir, &trainer)?;
            replace(
                &dir.join("loss.svg"),
                plot::training(&fs::read_to_string(dir.join("log.jsonl"))?).as_bytes(),
            )?;
        }
        if stop && !trainer.done() {
            bar.abandon();
            eprintln!(
                "stopped after {} updates; go on with: coil train policy --resume {}",
                trainer.step,
                dir.display()
            );
            break;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Of a run that has ended, compares its best weights and its last ones again, perhaps on more objects than before, and keeps
/// the better: the best of many validations on few objects is partly luck.
fn choose(
    dir: &Path,
    trainer: &mut Trainer,
    scenes: &[Box<dyn Scene>],
    compute: &Compute,
) -> anyhow::Result<ExitCode> {
    let best = trainer.best.take().map(|best| best.0);
    for (name, weights) in [("best", best), ("last", Some(trainer.judged().clone()))] {
        let Some(weights) = weights else { continue };
        let found = validate::policy(
            &weights,
            scenes,
            trainer.recipe.validated_reach(),
            trainer.recipe.blank,
            compute,
        );
        let [a, b, c] = found.degrees.0;
        eprintln!("{name}: T=3 {a:.2}, T=5 {b:.2}, T=10 {c:.2} degrees on {} objects", scenes.len());
        if trainer.best.as_ref().is_none_or(|(_, other)| found.degrees.last() < *other) {
            trainer.best = Some((weights, found.degrees.last()));
        }
    }
    replace(&dir.join("checkpoint"), &checkpoint::write(trainer))?;
    save_best(dir, trainer)?;
    Ok(ExitCode::SUCCESS)
}

/// The recipe of a new run.
fn recipe(args: &Choices) -> anyhow::Result<Recipe> {
    let start = match (&args.recipe, args.preset) {
        (Some(file), _) => read_recipe(file)?,
        (None, None | Some(Preset::Compact)) => Recipe::compact(),
        (None, Some(Preset::Paper)) => Recipe::paper(),
    };
    changed(start, args)
}

/// Refuses options that are not those of the run in `dir`: it goes on by its own recipe.
fn same_recipe(of_run: &Recipe, args: &Choices, dir: &Path) -> anyhow::Result<()> {
    let asked = if args.recipe.is_some() || args.preset.is_some() {
        Recipe { from: of_run.from.clone(), ..recipe(args)? }
    } else {
        changed(of_run.clone(), args)?
    };
    let (asked, of_run) = (serde_json::to_value(&asked)?, serde_json::to_value(of_run)?);
    let fields = of_run.as_object().into_iter().flatten();
    let other: Vec<String> = fields
        .filter(|&(name, value)| asked.get(name) != Some(value))
        .map(|(name, value)| format!("{name} {value}"))
        .collect();
    if !other.is_empty() {
        bail!(
            "the run in {} goes on by its own recipe, with {}: leave that option out, or begin another run with --out",
            dir.display(),
            other.join(", ")
        );
    }
    Ok(())
}

/// A recipe with what the options say otherwise.
fn changed(mut r: Recipe, args: &Choices) -> anyhow::Result<Recipe> {
    if let Some(size) = &args.size {
        let named = Config::by_name(size)?;
        if named.size != r.config.size {
            r.config = named;
        }
    }
    if let Some(input) = args.input {
        r.config = r.config.seeing(input)?;
    }
    r.config.gating &= args.without != Some(Without::Gate);
    r.config.transformer &= args.without != Some(Without::Transformer);
    r.blank |= args.blank;
    if let Some(dir) = &args.meshes {
        r.meshes = Some(dir.display().to_string());
    }
    set(&mut r.objects, args.objects);
    set(&mut r.resolution, args.resolution);
    set(&mut r.steps, args.steps);
    set(&mut r.batch, args.batch);
    set(&mut r.micro_batch, args.micro_batch);
    set(&mut r.rate, args.rate);
    set(&mut r.averaging, args.averaging);
    set(&mut r.lights, args.lights);
    set(&mut r.seed, args.seed);
    set(&mut r.feedback, args.feedback);
    set(&mut r.measure, args.measure);
    set(&mut r.first_loss, args.first_loss);
    r.varied |= args.varied;
    r.any_material |= args.any_material;
    set(&mut r.whole_dome, args.whole_dome);
    set(&mut r.finite, args.finite);
    if args.horizon {
        r.config.horizon = r.lights;
    }
    set(&mut r.solver, args.solver.clone());
    match args.lookup.as_deref() {
        None => {}
        Some("exact") => r.tau = None,
        Some(other) => {
            let tau = other.strip_prefix("soft:").and_then(|t| t.parse().ok());
            r.tau =
                Some(tau.with_context(|| {
                    format!("look-up '{other}': write exact or soft:TAU, TAU in radians")
                })?);
        }
    }
    Ok(r)
}

fn read_recipe(file: &Path) -> anyhow::Result<Recipe> {
    let text = fs::read_to_string(file).with_context(|| file.display().to_string())?;
    let recipe: Recipe = serde_json::from_str(&text).with_context(|| file.display().to_string())?;
    // A new run begins with fresh weights unless --from says otherwise.
    Ok(Recipe { from: None, ..recipe })
}

fn set<T>(field: &mut T, value: Option<T>) {
    if let Some(value) = value {
        *field = value;
    }
}

fn resume(dir: &Path) -> anyhow::Result<Trainer> {
    let path = dir.join("checkpoint");
    let bytes = fs::read(&path).with_context(|| format!("no run in {}", dir.display()))?;
    checkpoint::read(&bytes).with_context(|| path.display().to_string())
}

/// A new run of the network, and with the best weights, of the run or the model in `from`.
fn begin_from(from: &Path, recipe: Recipe) -> anyhow::Result<Trainer> {
    let weights = if from.join("checkpoint").exists() {
        let other = resume(from)?;
        other.best.as_ref().map_or_else(|| other.judged().clone(), |best| best.0.clone())
    } else {
        let neither = || format!("{}: neither a run (checkpoint) nor a model", from.display());
        import::import(&model::read(from).with_context(neither)?)
            .with_context(|| from.display().to_string())?
    };
    // The folder's name, not where it lies: a recipe is passed on.
    let name = fs::canonicalize(from)?.file_name().map(|name| name.to_string_lossy().into_owned());
    let recipe = Recipe { from: name, ..recipe };
    Ok(Trainer::begin_with(weights, recipe)?)
}

fn baselines(scenes: &[Box<dyn Scene>], reach: f32, threads: usize) -> Vec<(String, validate::Errors)> {
    let ring_and_vertical: Vec<Vec3> =
        validate::ring_and_vertical(10).into_iter().map(|l| within(l, reach)).collect();
    let mut out = vec![
        ("random".into(), validate::random(scenes, reach, 8, 1, threads)),
        ("dc05 ring + vertical".into(), validate::fixed(&ring_and_vertical, scenes, threads)),
    ];
    for degrees in [5, 10, 15, 20, 25, 30, 35, 40, 45, 55] {
        let slant = (degrees as f32).to_radians();
        if slant <= reach {
            out.push((format!("ring {degrees}"), validate::fixed(&ring(10, slant, 0.0), scenes, threads)));
        }
    }
    let candidates = fibonacci_cap(100, reach);
    out.push(("oracle (100 candidates)".into(), validate::oracle(scenes, &candidates, threads)));
    out
}

/// The light, not farther from the axis than `reach`.
fn within(light: Vec3, reach: f32) -> Vec3 {
    from_azimuth_slant(azimuth(light), slant(light).min(reach))
}

fn save_best(dir: &Path, trainer: &Trainer) -> anyhow::Result<()> {
    let Some((best, degrees)) = &trainer.best else { return Ok(()) };
    let r = &trainer.recipe;
    let note = format!(
        "step {} of {}, validation {degrees:.2} degrees at T = 10, seed {}, {} objects",
        trainer.step, r.steps, r.seed, r.objects
    );
    let files = export::export(best, &note);
    replace(&dir.join("encoder.onnx"), &files.encoder)?;
    replace(&dir.join("step.onnx"), &files.step)
}

/// The log, appended to; lines of updates that a killed run made after its last checkpoint are dropped, they are made again.
struct Log {
    file: std::io::BufWriter<fs::File>,
}

impl Log {
    fn open(path: &Path, step: u64) -> anyhow::Result<Self> {
        let old = fs::read_to_string(path).unwrap_or_default();
        let kept: String = old
            .lines()
            .filter(|l| {
                serde_json::from_str::<Line>(l).is_ok_and(|l| {
                    l.report.is_none_or(|r| r.step <= step) && l.validation.is_none_or(|v| v.after <= step)
                })
            })
            .flat_map(|l| [l, "\n"])
            .collect();
        if step > 0 {
            replace(path, kept.as_bytes())?;
        } else {
            replace(path, b"")?;
        }
        let file = fs::OpenOptions::new().append(true).open(path)?;
        Ok(Self { file: std::io::BufWriter::new(file) })
    }

    fn write(&mut self, line: &Line) -> anyhow::Result<()> {
        serde_json::to_writer(&mut self.file, line)?;
        self.file.write_all(b"\n")?;
        Ok(())
    }

    fn flush(&mut self) -> anyhow::Result<()> {
        self.file.flush()?;
        Ok(())
    }
}
