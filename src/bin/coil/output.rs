//! What subcommands print and write: tables, JSON, pictures, progress.

use anyhow::{Context, bail};
use clap::builder::RangedU64ValueParser;
use coil_ps::error;
use coil_ps::eval::plot::{self, LightPlot};
use coil_ps::eval::settings::ALL_LIGHTS;
use coil_ps::eval::{Run, RunSpec, Settings, Subject};
use coil_ps::light;
use coil_ps::session::SessionError;
use coil_ps::solve::{self, Measurements};
use coil_ps::stack::BitDepth;
use glam::Vec3;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use serde_json::json;
use std::fmt::Arguments;
use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Write as _};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether standard output took less than all.
static LOST: AtomicBool = AtomicBool::new(false);

/// Prints; where nobody reads any more, nothing happens.
pub fn say(text: Arguments) {
    let said = std::io::stdout().write_fmt(text);
    if said.is_err_and(|e| e.kind() != ErrorKind::BrokenPipe) {
        LOST.store(true, Ordering::Relaxed);
    }
}

/// The same on standard error. There is no other place to say that it can't be written.
pub fn tell(text: Arguments) {
    let _ = std::io::stderr().write_fmt(text);
}

/// Looks whether everything that was to be printed has been.
///
/// # Errors
/// Where it could not be, for another reason than that nobody reads it.
pub fn all_said() -> anyhow::Result<()> {
    let flushed = std::io::stdout().flush().is_err_and(|e| e.kind() != ErrorKind::BrokenPipe);
    if flushed || LOST.load(Ordering::Relaxed) {
        bail!("standard output could not be written: is the disk full?");
    }
    Ok(())
}

/// Makes sure that a file can be written later, as [`write()`] will; `-` is standard output.
pub fn check_file(path: &Path) -> anyhow::Result<()> {
    if path.as_os_str() == "-" {
        return Ok(());
    }
    let there = path.exists();
    // A pipe's reader would take a look for the end.
    if there && !path.is_file() && !path.is_dir() {
        return Ok(());
    }
    if let Some(folder) = path.parent().filter(|f| !f.as_os_str().is_empty()) {
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    let tried = OpenOptions::new().append(true).create(true).open(path);
    tried.with_context(|| format!("{}: can't be written", path.display()))?;
    if !there {
        let _ = fs::remove_file(path);
    }
    Ok(())
}

/// Makes sure that files can be written into a folder later; it is made where it is missing.
pub fn check_folder(dir: &Path) -> anyhow::Result<()> {
    fs::create_dir_all(dir).with_context(|| dir.display().to_string())?;
    check_file(&dir.join(".coil-write-test"))
}

/// A bar on standard error, shown only where that is a terminal.
pub fn progress(length: usize, what: &str) -> ProgressBar {
    let bar = ProgressBar::new(length as u64).with_message(what.to_owned());
    if let Ok(style) = ProgressStyle::with_template("{msg:20} [{wide_bar}] {pos}/{len}, {eta} left") {
        bar.set_style(style);
    }
    bar
}

/// Reads a list of counts: `10`, `3,5,10`, `3..10` (both ends included) or a mixture.
pub fn counts(text: &str) -> anyhow::Result<Vec<usize>> {
    let mut list = Vec::new();
    for part in text.split(',') {
        let bad = || format!("'{part}': write a number, a list as 3,5,10, or a range as 3..10");
        match part.split_once("..") {
            Some((from, to)) => {
                let from: usize = from.trim().parse().with_context(bad)?;
                let to: usize = to.trim().trim_start_matches('=').parse().with_context(bad)?;
                if from > to || to > 100_000 {
                    bail!(bad());
                }
                list.extend(from..=to);
            }
            None => list.push(part.trim().parse().with_context(bad)?),
        }
    }
    Ok(list)
}

/// Reads a number of things of which there must be one.
pub fn at_least_one() -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(1..)
}

/// Columns padded to the same width, the first to the left, the others to the right.
pub fn align(lines: &[Vec<String>]) -> String {
    let columns = lines.iter().map(Vec::len).max().unwrap_or(0);
    let width =
        |c: usize| lines.iter().filter_map(|l| l.get(c)).map(|s| s.chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let mut text = String::new();
    for line in lines {
        for (c, (cell, &width)) in line.iter().zip(&widths).enumerate() {
            let pad = " ".repeat(width - cell.chars().count());
            text += &if c == 0 { format!("{cell}{pad}") } else { format!("  {pad}{cell}") };
        }
        text.truncate(text.trim_end().len());
        text.push('\n');
    }
    text
}

/// Writes `value` as JSON to a file, or to standard output for `-`.
pub fn write_json(path: &Path, value: &impl Serialize) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(value)? + "\n";
    if path.as_os_str() == "-" {
        print!("{text}");
        return Ok(());
    }
    write(path, text.as_bytes())
}

/// Writes a file, making its folder where it is missing.
pub fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    if let Some(folder) = path.parent().filter(|f| !f.as_os_str().is_empty()) {
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    fs::write(path, bytes).with_context(|| path.display().to_string())
}

/// Writes a file so that at every moment the old or the new one is there, whole: another file first, then its name.
pub fn replace(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    let write = || -> std::io::Result<()> {
        let mut file = std::fs::File::create(&part)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&part, path)
    };
    write().with_context(|| format!("{}: can't be written", path.display()))
}

/// Largest error that the colour scale of error maps reaches, degrees.
const ERROR_SCALE: f32 = 45.0;

/// Normal maps, error maps, light plots and directions of one object's runs, in `DIR/OBJECT/`.
pub fn write_runs(
    dir: &Path,
    subject: &Subject,
    runs: &[&(RunSpec, Result<Run, SessionError>)],
    settings: &Settings,
) -> anyhow::Result<()> {
    let folder = dir.join(safe(subject.name()));
    let mut directions = Vec::new();
    for (spec, run) in runs {
        let Ok(run) = run else { continue };
        let lights = if spec.planner == ALL_LIGHTS { run.seen.len() } else { spec.lights };
        let lookup = safe(&spec.lookup.to_string());
        let stem = format!("{}-T{lights}-{lookup}", safe(&spec.planner));
        let list = |f: &dyn Fn(&coil_ps::camera::Observation) -> Vec3| -> Vec<Vec3> {
            run.seen.iter().map(f).collect()
        };
        directions.push(json!({
            "planner": spec.planner, "lights": lights, "lookup": spec.lookup.to_string(), "seed": spec.seed, "draw": spec.draw,
            "requested": list(&|o| o.requested).iter().map(|l| l.to_array()).collect::<Vec<_>>(),
            "used": list(&|o| o.light).iter().map(|l| l.to_array()).collect::<Vec<_>>(),
            "images": run.seen.iter().map(|o| o.index).collect::<Vec<_>>(),
            "deviation_degrees": run.seen.iter().map(|o| o.deviation().to_degrees()).collect::<Vec<_>>(),
            "effective_images": run.seen.iter().map(|o| o.effective_images).collect::<Vec<_>>(),
            "azimuth_degrees": list(&|o| o.requested).iter().map(|&l| light::azimuth(l).to_degrees()).collect::<Vec<_>>(),
            "slant_degrees": list(&|o| o.requested).iter().map(|&l| light::slant(l).to_degrees()).collect::<Vec<_>>(),
        }));
        let candidates = match subject {
            Subject::Stack(stack) => &stack.lights[..],
            Subject::Scene { .. } => &[],
        };
        let plot = LightPlot {
            title: format!("{}: {}, T = {lights}", subject.name(), spec.planner),
            candidates,
            chosen: run.seen.iter().map(|o| (o.requested, o.light)).collect(),
        };
        write(&folder.join(format!("{stem}-lights.svg")), plot.svg().as_bytes())?;
        for name in &settings.solvers {
            let solver = solve::by_name(name)?;
            let pictures = Measurements::of(&run.seen);
            let solution = solve::whole(&*solver, pictures, subject.mask(), false)?.solution;
            let normals = plot::normal_map(subject.mask(), &solution.normals, BitDepth::Sixteen)?;
            write(&folder.join(format!("{stem}-{name}-normals.png")), &normals)?;
            if let Some(truth) = subject.truth() {
                let errors = error::error_map(&solution.normals, truth);
                let png = plot::error_map(subject.mask(), &errors, ERROR_SCALE)?;
                write(&folder.join(format!("{stem}-{name}-error.png")), &png)?;
            }
        }
    }
    write_json(&folder.join("directions.json"), &directions)
}

/// `name` as a file name: what is not a letter, digit, dot, dash or underscore becomes a dash.
pub fn safe(name: &str) -> String {
    let clean: String =
        name.chars().map(|c| if c.is_alphanumeric() || "._-".contains(c) { c } else { '-' }).collect();
    if clean.trim_matches('.').is_empty() { "object".into() } else { clean }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_lists_and_ranges() {
        assert_eq!(counts("10").unwrap(), [10]);
        assert_eq!(counts("3,5,8..10").unwrap(), [3, 5, 8, 9, 10]);
        for bad in ["", "3..", "10..3", "x", "3,,5"] {
            assert!(counts(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_file_is_replaced_and_nothing_stays_beside_it() {
        let dir = std::env::temp_dir().join(format!("coil-replace-{}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        let path = dir.join("log.jsonl");
        for text in ["first", "second"] {
            replace(&path, text.as_bytes()).unwrap();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
        assert_eq!(std::fs::read_dir(&dir).unwrap().count(), 1);
        let nowhere = replace(&dir.join("none").join("file"), b"").unwrap_err();
        assert!(nowhere.to_string().contains("can't be written"), "{nowhere}");
        std::fs::remove_dir_all(&dir).unwrap();
    }

    #[test]
    fn names_become_files() {
        assert_eq!(safe("../ring:40"), "..-ring-40");
        assert_eq!(safe(".."), "object");
    }
}
