//! `coil export`: lights, normals and whole objects in other formats.

use crate::files;
use crate::objects::Names;
use anyhow::{Context, bail};
use clap::ValueEnum;
use coil_ps::dataset::diligent::object_name;
use coil_ps::dataset::{Files, Header, Limits, archive, csv, diligent102, lp, write_object};
use coil_ps::eval::{Protocol, plot};
use coil_ps::solve::{self, Measurements};
use coil_ps::stack::BitDepth;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Write lights, normals or whole objects in another format.
#[derive(clap::Args)]
pub struct Args {
    /// Objects, folders of objects, zip archives.
    #[arg(required = true)]
    paths: Vec<PathBuf>,
    /// What to write.
    #[arg(long, value_enum)]
    to: Format,
    /// Solver of the submission, from all lights.
    #[arg(long, default_value = "ls")]
    solver: String,
    /// Folder to write to; it is made where it is missing.
    #[arg(long)]
    out: PathBuf,
    /// Overwrite files that are already there.
    #[arg(long)]
    force: bool,
}

/// A format of `coil export`.
#[derive(Clone, Copy, ValueEnum)]
enum Format {
    /// OBJECT.lp: the light directions, as RTI software reads them.
    Lp,
    /// OBJECT_lights.csv, and OBJECT_normals.csv where true normals are known.
    Csv,
    /// A folder OBJECTPNG in DiLiGenT's layout, its ground truth as Normal_gt.mat.
    Diligent,
    /// OBJECT.zip: the same folder in an archive.
    Zip,
    /// OBJECT_normals.png: the true normals, 16 bits a channel.
    Normals,
    /// OBJECT.mat: normals solved from all lights, as DiLiGenT10²'s server takes them.
    Submission,
}

pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let limits = Limits::default();
    let mut failed = false;
    let mut names = Names::default();
    for path in &args.paths {
        let source = match files::open(path, &limits) {
            Ok(source) => source,
            Err(e) => {
                eprintln!("error: {e:#}");
                failed = true;
                continue;
            }
        };
        for dir in &source.objects {
            let name = names.distinct(&object_name(source.files.as_ref(), dir));
            match export(source.files.as_ref(), dir, name, &limits, &args) {
                Ok(written) => println!("{}: {written}", source.place(dir)),
                Err(e) => {
                    eprintln!("error: {e:#}");
                    failed = true;
                }
            }
        }
    }
    Ok(if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

fn export(
    files: &dyn Files,
    dir: &str,
    name: String,
    limits: &Limits,
    args: &Args,
) -> anyhow::Result<String> {
    let written = match args.to {
        Format::Lp | Format::Csv | Format::Normals => {
            of_header(&Header { name, ..Header::read(files, dir, limits)? }, args.to)?
        }
        Format::Diligent | Format::Zip => {
            let (stack, _) = files::read_object(files, dir, limits)?;
            let folder = format!("{name}PNG");
            let object: Vec<(String, Vec<u8>)> =
                write_object(&stack)?.into_iter().map(|(name, b)| (format!("{folder}/{name}"), b)).collect();
            match args.to {
                Format::Zip => vec![(format!("{name}.zip"), archive::write_zip(&object)?)],
                _ => object,
            }
        }
        Format::Submission => {
            let (raw, _) = files::read_object(files, dir, limits)?;
            let stack = Protocol::Official.apply(&raw)?;
            let solver = solve::by_name(&args.solver)?;
            let pictures = Measurements::of_stack(&stack);
            let normals = solve::whole(&*solver, pictures, &stack.mask, false)?.solution.normals;
            vec![(format!("{name}.mat"), diligent102::submission(&stack.mask, &normals))]
        }
    };
    for (name, bytes) in &written {
        write(&args.out.join(name), bytes, args.force)?;
    }
    let (first, _) = &written[0];
    Ok(match written.len() {
        1 => args.out.join(first).display().to_string(),
        n => format!("{n} files, {} …", args.out.join(first).display()),
    })
}

/// The formats that need no image.
fn of_header(header: &Header, format: Format) -> anyhow::Result<Vec<(String, Vec<u8>)>> {
    let name = &header.name;
    let truth = header.truth.as_deref();
    Ok(match format {
        Format::Lp => {
            let lights = header.images.iter().map(String::as_str).zip(header.lights.iter().copied());
            vec![(format!("{name}.lp"), lp::write_lp(lights).into_bytes())]
        }
        Format::Csv => {
            let lights = csv::lights_csv(&header.images, &header.lights, &header.intensities);
            let mut written = vec![(format!("{name}_lights.csv"), lights.into_bytes())];
            if let Some(truth) = truth {
                let normals = csv::normals_csv(&header.mask, truth);
                written.push((format!("{name}_normals.csv"), normals.into_bytes()));
            }
            written
        }
        _ => {
            let truth = truth.with_context(|| format!("{}: no true normals", header.dir))?;
            vec![(format!("{name}_normals.png"), plot::normal_map(&header.mask, truth, BitDepth::Sixteen)?)]
        }
    })
}

fn write(path: &Path, bytes: &[u8], force: bool) -> anyhow::Result<()> {
    if path.exists() && !force {
        bail!("{}: exists already (--force overwrites)", path.display());
    }
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    std::fs::write(path, bytes).with_context(|| path.display().to_string())
}
