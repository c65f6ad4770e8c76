//! `coil study k`: the brute-force study over the number of candidates.

use crate::objects::Selection;
use crate::output;
use anyhow::{Context, bail};
use clap::{Args, Subcommand};
use coil_ps::camera::Camera;
use coil_ps::eval::plot::{LinePlot, Point, Series};
use coil_ps::eval::statistics::{interval95, mean};
use coil_ps::eval::study::greedy;
use coil_ps::eval::{Protocol, Subject};
use coil_ps::light;
use coil_ps::relight::{Lookup, StackCamera};
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Studies that need the ground truth.
#[derive(Args)]
pub struct StudyArgs {
    #[command(subcommand)]
    study: Study,
}

#[derive(Subcommand)]
enum Study {
    /// What a finer choice of lights is worth: greedy search with ground truth over K Fibonacci directions.
    K(KArgs),
}

#[derive(Args)]
struct KArgs {
    #[command(flatten)]
    selection: Selection,
    /// Numbers of candidates, separated by commas.
    #[arg(long, value_delimiter = ',', default_value = "50,100,500,1000")]
    k: Vec<usize>,
    /// Numbers of lights: a list or a range as 3..10 (both ends included).
    #[arg(long, default_value = "3..10")]
    lights: String,
    /// From code values to linear values: official or 128.
    #[arg(long, default_value = "128")]
    protocol: Protocol,
    /// From a direction to a picture of a stored stack: nearest or soft:TAU.
    #[arg(long, default_value = "soft:0.02")]
    lookup: Lookup,
    /// Write the results as JSON to FILE (- or nothing: to standard output, instead of the table).
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-")]
    json: Option<PathBuf>,
    /// Where to write the plot (SVG).
    #[arg(long, value_name = "FILE", default_value = "study-k.svg")]
    plot: PathBuf,
}

#[derive(Serialize)]
struct StudyReport {
    schema: &'static str,
    k: Vec<usize>,
    lights: Vec<usize>,
    protocol: Protocol,
    lookup: String,
    results: Vec<Entry>,
    means: Vec<Mean>,
}

#[derive(Serialize)]
struct Entry {
    object: String,
    k: usize,
    /// MAE in degrees at each of `lights`; null where the candidates are, or lead to, less photos than lights.
    mae: Vec<Option<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
}

#[derive(Serialize)]
struct Mean {
    k: usize,
    lights: usize,
    objects: usize,
    mae: f64,
    ci95: Option<[f64; 2]>,
}

/// Runs the subcommand. The status is 1 where an object failed, after all others have run.
pub fn run(args: StudyArgs) -> anyhow::Result<ExitCode> {
    let Study::K(args) = args.study;
    let lights = output::counts(&args.lights)?;
    let most = lights.iter().copied().max().unwrap_or(0);
    anyhow::ensure!(args.k.iter().all(|k| (1..=100_000).contains(k)), "--k: numbers from 1 to 100000");
    anyhow::ensure!(lights.iter().all(|t| (3..=1000).contains(t)), "--lights: numbers from 3 to 1000");
    let least = lights.iter().copied().min().unwrap_or(0);
    if let Some(k) = args.k.iter().find(|&&k| k < least) {
        bail!("--k {k}: less candidates than the {least} lights that are to be chosen");
    }
    for path in args.json.iter().chain([&args.plot]) {
        output::check_file(path)?;
    }
    let mut results = Vec::new();
    let reach = args.selection.reach.to_radians();
    args.selection.for_each(args.protocol, |name, object| {
        let entries = object.and_then(|object| {
            object.with_subject(reach, |subject| search(subject, &args.k, &lights, most, args.lookup))
        });
        results.extend(entries.unwrap_or_else(|error| {
            eprintln!("{name}: {error:#}");
            let failed = |&k: &usize| Entry {
                object: name.into(),
                k,
                mae: vec![None; lights.len()],
                error: Some(format!("{error:#}")),
            };
            args.k.iter().map(failed).collect()
        }));
        Ok(())
    })?;
    let failed = results.iter().any(|e| e.error.is_some());
    let means = means(&results, &args.k, &lights);
    let table = text_table(&means, &args.k, &lights);
    let svg = plot(&means, &args.k).svg();
    let report = StudyReport {
        schema: "coil-ps/study-k/1",
        k: args.k,
        lights,
        protocol: args.protocol,
        lookup: args.lookup.to_string(),
        results,
        means,
    };
    if args.json.as_deref() != Some(Path::new("-")) {
        print!("{table}");
    }
    if let Some(path) = &args.json {
        output::write_json(path, &report)?;
    }
    output::write(&args.plot, svg.as_bytes())?;
    eprintln!("plot: {}", args.plot.display());
    Ok(ExitCode::from(u8::from(failed)))
}

fn search(
    subject: &Subject,
    ks: &[usize],
    lights: &[usize],
    most: usize,
    lookup: Lookup,
) -> anyhow::Result<Vec<Entry>> {
    let truth = subject.truth().context("no ground truth, which the study needs")?;
    if let Subject::Stack(stack) = subject
        && stack.len() < most
    {
        bail!("{} photos for up to {most} lights: ask for at most {0} (--lights)", stack.len());
    }
    let bar = output::progress(ks.len(), subject.name());
    let entries = ks
        .par_iter()
        .map(|&k| {
            let found = match *subject {
                Subject::Stack(stack) => {
                    let camera = StackCamera::new(stack, lookup);
                    greedy(&camera as &dyn Camera, truth, k, light::reach(&stack.lights), most, || false)
                }
                Subject::Scene { camera, reach, .. } => greedy(camera, truth, k, reach, most, || false),
            };
            bar.inc(1);
            let mae = found.map(|g| lights.iter().map(|&t| g.mae.get(t - 1).copied()).collect())?;
            Ok(Entry { object: subject.name().into(), k, mae, error: None })
        })
        .collect();
    bar.finish_and_clear();
    entries
}

fn means(results: &[Entry], ks: &[usize], lights: &[usize]) -> Vec<Mean> {
    let mut means = Vec::new();
    for &k in ks {
        for (i, &t) in lights.iter().enumerate() {
            let of: Vec<f64> = results.iter().filter(|e| e.k == k).filter_map(|e| e.mae[i]).collect();
            if !of.is_empty() {
                means.push(Mean { k, lights: t, objects: of.len(), mae: mean(&of), ci95: interval95(&of) });
            }
        }
    }
    means
}

fn text_table(means: &[Mean], ks: &[usize], lights: &[usize]) -> String {
    let mut lines = vec![vec!["lights T".to_owned()]];
    lines[0].extend(ks.iter().map(|k| format!("K = {k}")));
    for &t in lights {
        let mut line = vec![t.to_string()];
        for &k in ks {
            let cell = means.iter().find(|m| (m.k, m.lights) == (k, t));
            line.push(cell.map_or("—".into(), |m| format!("{:.2}", m.mae)));
        }
        lines.push(line);
    }
    let objects = means.iter().map(|m| m.objects).max().unwrap_or(0);
    format!(
        "Greedy with ground truth, least squares: MAE in degrees, mean of {objects} object(s)\n{}",
        output::align(&lines)
    )
}

fn plot(means: &[Mean], ks: &[usize]) -> LinePlot {
    let series = |&k: &usize| Series {
        name: format!("K = {k}"),
        points: means
            .iter()
            .filter(|m| m.k == k)
            .map(|m| Point { x: m.lights as f64, y: m.mae, interval: None })
            .collect(),
    };
    LinePlot {
        title: "Greedy oracle over K candidate directions".into(),
        x_label: "lights T".into(),
        y_label: "MAE (degrees)".into(),
        series: ks.iter().map(series).collect(),
    }
}
