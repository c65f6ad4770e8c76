//! `coil model`: what a trained model says of itself.

use anyhow::Context;
use clap::{Args as ClapArgs, Subcommand};
use coil_ps::policy::{ModelFiles, Policy, file};
use coil_ps::rng::Rng;
use coil_ps::stack::Mask;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// What to do with a model.
#[derive(ClapArgs)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Subcommand)]
enum Action {
    /// Check a policy's files and print their header.
    Info {
        /// Folder with encoder.onnx and step.onnx.
        #[arg(default_value = "models/compact")]
        folder: PathBuf,
    },
    /// Run a policy on made-up pictures and print inputs, directions and step times as JSON, for
    /// `benchmarks/onnx/check.py` to repeat in another runtime.
    Trace {
        /// Folder with encoder.onnx and step.onnx.
        #[arg(default_value = "models/compact")]
        folder: PathBuf,
        /// Sequences.
        #[arg(long, default_value_t = 8)]
        sequences: u64,
    },
}

/// Runs `coil model`.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.action {
        Action::Info { folder } => info(&folder)?,
        Action::Trace { folder, sequences } => trace(&folder, sequences)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn info(folder: &Path) -> anyhow::Result<()> {
    let files = read(folder)?;
    let (encoder, step) = file::headers(&files).with_context(|| folder.display().to_string())?;
    let c = &encoder.config;
    println!("network   {} (format {})", encoder.network, coil_ps::policy::config::FORMAT);
    println!("size      {}: input {1}x{1}, features {2}x{2}x{3}", c.size, c.input, c.grid(), c.channels[3]);
    let transformer = format!("{} layers of width {}, {} heads", c.layers, c.width, c.heads);
    println!("temporal  {}", if c.transformer { &transformer } else { "none (ablation)" });
    println!("gate      {}", if c.gating { "outlier-aware" } else { "none (ablation)" });
    let told = if c.horizon > 0 { format!("; told how many, up to {}", c.horizon) } else { String::new() };
    println!("pictures  {} at most{told}", c.max_frames);
    println!("encoder   {} constants, {} bytes", encoder.values, files.encoder.len());
    println!("step      {} constants, {} bytes", step.values, files.step.len());
    println!("trained   {}", encoder.note);
    Ok(())
}

/// Side of the made-up pictures, pixels.
const SIDE: u32 = 100;
/// Pictures a sequence.
const PICTURES: usize = 10;

fn trace(folder: &Path, sequences: u64) -> anyhow::Result<()> {
    let policy = Policy::load(&read(folder)?)?;
    let mask = Mask::full(SIDE, SIDE)?;
    let mut times = vec![Vec::new(); PICTURES];
    let mut runs = Vec::new();
    for s in 0..sequences {
        let mut rng = Rng::stream(4, s);
        let reach = rng.range(0.3, 1.0);
        let mut run = policy.start(&mask, reach * std::f32::consts::FRAC_PI_2, PICTURES);
        let mut light = glam::Vec3::Z;
        let mut pictures = Vec::new();
        for time in &mut times {
            // Smooth lumps under this light, with noise: something of an image's range.
            let (a, b) = (rng.range(2.0, 9.0), rng.range(2.0, 9.0));
            let rgb: Vec<[f32; 3]> = (0..mask.len())
                .map(|p| {
                    let (x, y) = mask.position(p);
                    let v = (a * x as f32 / SIDE as f32).sin() * light.x
                        + (b * y as f32 / SIDE as f32).cos() * light.y;
                    let v = (v + light.z).max(0.0) + 0.05 * rng.uniform();
                    [v, 0.8 * v, 0.6 * v]
                })
                .collect();
            let start = Instant::now();
            let next = run.observe(&rgb, light)?;
            time.push(start.elapsed().as_secs_f64() * 1e3);
            pictures.push(serde_json::json!({
                "frame": run.frame(), "light": light.to_array(), "next": next.to_array(),
            }));
            light = next;
        }
        runs.push(serde_json::json!({ "reach": reach, "pictures": pictures }));
    }
    let median = |t: &mut Vec<f64>| {
        t.sort_by(f64::total_cmp);
        t[t.len() / 2]
    };
    let milliseconds: Vec<f64> = times.iter_mut().map(median).collect();
    println!("{}", serde_json::json!({ "runs": runs, "milliseconds": milliseconds }));
    Ok(())
}

/// The two files of a policy's folder.
pub fn read(folder: &Path) -> anyhow::Result<ModelFiles> {
    let get = |name: &str| {
        let path = folder.join(name);
        fs::read(&path).with_context(|| format!("can't read the model file {}", path.display()))
    };
    Ok(ModelFiles { encoder: get("encoder.onnx")?, step: get("step.onnx")? })
}
