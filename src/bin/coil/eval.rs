//! `coil eval`: the table of planners and solvers on every object.

use crate::models;
use crate::objects::Selection;
use crate::output;
use anyhow::Context;
use clap::Args;
use coil_ps::eval::settings::ALL_LIGHTS;
use coil_ps::eval::{Protocol, Report, Row, Run, RunSpec, Settings, Subject};
use coil_ps::eval::{run, table};
use coil_ps::planner::{self, Learned};
use coil_ps::session::SessionError;
use coil_ps::solve::uncertainty::StopAt;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Compare planners and solvers on every object under PATH.
#[derive(Args)]
pub struct EvalArgs {
    #[command(flatten)]
    selection: Selection,
    /// Planners, separated by commas, none twice; `all` takes every light of the stack.
    #[arg(long, value_delimiter = ',', default_value = "all,random,dc05,dc05v,tk22,lipids,oracle")]
    planner: Vec<String>,
    /// Solvers, separated by commas, none twice.
    #[arg(long, value_delimiter = ',', default_value = "ls")]
    solver: Vec<String>,
    /// Numbers of lights: 10, or 3,5,10, or 3..10 (both ends included).
    #[arg(long, default_value = "10")]
    lights: String,
    /// From code values to linear values: official (DiLiGenT's) or 128 (the planning papers').
    #[arg(long, default_value = "official")]
    protocol: Protocol,
    /// From a direction to a picture: nearest or soft:TAU (radians), separated by commas.
    #[arg(long, value_delimiter = ',', default_value = "nearest")]
    lookup: Vec<String>,
    /// Repetitions; deterministic planners start turned, or begin a little off, in all but the first.
    #[arg(long, default_value_t = 30)]
    draws: usize,
    /// End a run before all lights once the first solver predicts a mean error of at most this: 8deg.
    #[arg(long, value_name = "DEGREES")]
    stop_at: Option<StopAt>,
    /// Seed of all repetitions.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    models: models::Folder,
    /// Write the results as JSON to FILE (- or nothing: to standard output, instead of the table).
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-")]
    json: Option<PathBuf>,
    /// Write normal maps, error maps, light plots and chosen directions of the first draw to DIR.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Runs the subcommand. The status is 1 where an object or combination failed, after all others have run.
pub fn run(args: EvalArgs) -> anyhow::Result<ExitCode> {
    let settings = Settings {
        planners: args.planner,
        solvers: args.solver,
        lights: output::counts(&args.lights)?,
        protocol: args.protocol,
        lookups: args.lookup,
        draws: args.draws,
        seed: args.seed,
        stop_at: args.stop_at.map(|stop| stop.degrees),
    };
    settings.check()?;
    let models = args.models.load(&settings.planners)?;
    for planner in &settings.planners {
        let most = settings.lights.iter().copied().max().unwrap_or(0);
        planner::check_lights(planner, most, Some(&models))?;
    }
    // Hours of runs are not for nothing.
    args.json.as_deref().map(output::check_file).transpose()?;
    args.out.as_deref().map(output::check_folder).transpose()?;
    let mut unwritten = Ok(());
    let mut results = Vec::new();
    args.selection.for_each(settings.protocol, |name, object| {
        let object = match object {
            Ok(object) => object,
            Err(error) => {
                eprintln!("{name}: {error:#}");
                results.extend(table::failed_rows(name, &settings, &format!("{error:#}"))?);
                return Ok(());
            }
        };
        let reach = args.selection.reach.to_radians();
        let (rows, written) = object.with_subject(reach, |subject| {
            let runs = settings.runs_on(subject)?;
            anyhow::Ok(evaluate(subject, &runs, &settings, &models, args.out.as_deref()))
        })?;
        results.extend(rows);
        if unwritten.is_ok() {
            unwritten = written;
        }
        Ok(())
    })?;
    let report = Report::new(settings, results);
    if args.json.as_deref() != Some(Path::new("-")) {
        print!("{}", text_table(&report));
    }
    if let Some(path) = &args.json {
        output::write_json(path, &report)?;
    }
    unwritten?;
    Ok(ExitCode::from(u8::from(report.has_errors())))
}

/// All runs on one object, in threads; its pictures where `out` names a folder, or why they can't be written.
fn evaluate(
    subject: &Subject,
    runs: &[RunSpec],
    settings: &Settings,
    learned: &dyn Learned,
    out: Option<&Path>,
) -> (Vec<Row>, anyhow::Result<()>) {
    let bar = output::progress(runs.len(), subject.name());
    let done: Vec<(RunSpec, Result<Run, SessionError>)> = runs
        .par_iter()
        .map(|spec| {
            let mut run = run::run(subject, spec, &settings.solvers, Some(learned));
            if let (Ok(run), true) = (&mut run, spec.draw > 0 || out.is_none()) {
                run.forget_pixels();
            }
            bar.inc(1);
            (spec.clone(), run)
        })
        .collect();
    bar.finish_and_clear();
    let rows = table::rows(subject, settings, &done);
    for row in rows.iter().filter(|r| r.error.is_some()) {
        eprintln!("{}: {}: {}", row.object, row.planner, row.error.as_deref().unwrap_or_default());
    }
    let first: Vec<_> = done.iter().filter(|(spec, _)| spec.draw == 0).collect();
    let written = out.map_or(Ok(()), |dir| {
        output::write_runs(dir, subject, &first, settings).with_context(|| dir.display().to_string())
    });
    (rows, written)
}

/// One block for each look-up, solver and number of lights: planners down, objects across.
fn text_table(report: &Report) -> String {
    let mut blocks: BTreeMap<(String, String, usize), Vec<&Row>> = BTreeMap::new();
    for row in report.results.iter().chain(&report.means) {
        // All lights of the stack are a line of every block.
        let counts = if row.planner == ALL_LIGHTS { &report.settings.lights[..] } else { &[row.lights][..] };
        for &t in counts {
            blocks.entry((row.lookup.clone(), row.solver.clone(), t)).or_default().push(row);
        }
    }
    let mut text = String::new();
    for ((lookup, solver, lights), rows) in blocks {
        let mut objects: Vec<&str> = Vec::new();
        for row in &rows {
            if !objects.contains(&row.object.as_str()) {
                objects.push(&row.object);
            }
        }
        let bits: Vec<String> = objects.iter().map(|o| bits_of(&rows, o)).collect();
        text += &format!(
            "T = {lights}, solver {solver}, protocol {}, look-up {lookup}, {} draws, seed {}: MAE in degrees ± half of the 95 % interval\n",
            rows.iter().find_map(|r| r.protocol).map_or("none (rendered)".into(), |p| p.to_string()),
            report.settings.draws,
            report.settings.seed
        );
        let mut lines = vec![header(&objects, &bits)];
        if report.settings.stop_at.is_some() {
            lines[0].push("lights taken".into());
        }
        for planner in &report.settings.planners {
            let of = |object: &str| rows.iter().find(|r| r.planner == *planner && r.object == object);
            let oracle = rows.iter().any(|r| r.planner == *planner && r.oracle);
            let mut line = vec![format!("{planner}{}", if oracle { " *" } else { "" })];
            line.extend(objects.iter().map(|o| of(o).map_or(String::new(), |r| cell(r))));
            let shown = of("mean").or_else(|| of(objects[0]));
            line.push(shown.and_then(|r| r.effective_images).map_or(String::new(), |v| format!("{v:.1}")));
            line.push(shown.and_then(|r| r.deviation).map_or(String::new(), |v| format!("{v:.1}°")));
            if report.settings.stop_at.is_some() {
                line.push(shown.and_then(|r| r.lights_taken).map_or(String::new(), |v| format!("{v:.1}")));
            }
            lines.push(line);
        }
        text += &output::align(&lines);
        if rows.iter().any(|r| r.oracle) {
            text += "* sees the ground truth: an upper bound, not a planner\n";
        }
        if rows.iter().any(|r| r.predicted_mae.is_some()) {
            text += "† no true normals: the error that the solver expects\n";
        }
        text.push('\n');
    }
    text
}

fn header(objects: &[&str], bits: &[String]) -> Vec<String> {
    let mut line = vec!["planner".to_owned()];
    line.extend(objects.iter().zip(bits).map(|(o, b)| format!("{o}{b}")));
    line.extend(["images blended".to_owned(), "asked ↔ used".to_owned()]);
    line
}

fn bits_of(rows: &[&Row], object: &str) -> String {
    let bits = rows.iter().find(|r| r.object == object).and_then(|r| r.bits);
    bits.filter(|&b| b == 8).map_or(String::new(), |b| format!(" ({b} bit)"))
}

fn cell(row: &Row) -> String {
    match (row.mae, row.ci95) {
        _ if row.error.is_some() => "error".into(),
        (None, _) => row.predicted_mae.map_or("no truth".into(), |m| format!("≈ {m:.1} †")),
        (Some(m), Some([lo, hi])) if hi > lo => format!("{m:.2} ±{:.2}", (hi - lo) / 2.0),
        (Some(m), _) => format!("{m:.2}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arguments_of_the_issue_are_understood() {
        use clap::Parser;
        #[derive(Parser)]
        struct Cli {
            #[command(flatten)]
            eval: EvalArgs,
        }
        let line = "eval a b.zip --planner all,random,oracle --solver ls --lights 10 --protocol 128 --lookup soft:0.02 \
                    --draws 30 --seed 1 --json out.json --out dir";
        let args = Cli::try_parse_from(line.split_whitespace()).unwrap().eval;
        assert_eq!(args.selection.paths, ["a", "b.zip"]);
        assert_eq!((args.planner.len(), args.protocol, args.draws), (3, Protocol::P128, 30));
        assert!(Cli::try_parse_from(["eval"]).is_err());
    }

    #[test]
    fn subjects_without_truth_are_shown_as_such() {
        let settings = Settings {
            planners: vec!["random".into()],
            solvers: vec!["ls".into()],
            lights: vec![10],
            protocol: Protocol::Official,
            lookups: vec!["nearest".into()],
            draws: 2,
            seed: 1,
            stop_at: None,
        };
        let rows = table::failed_rows("thing", &settings, "no such file").unwrap();
        let text = text_table(&Report::new(settings, rows));
        assert!(text.contains("thing") && text.contains("error"), "{text}");
    }
}
