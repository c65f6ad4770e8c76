//! `coil info`: what a dataset is and what is wrong with it.

use crate::files;
use coil_ps::dataset::{DatasetError, Files, Header, Limits, Warning, diligent102};
use coil_ps::light;
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;

/// Tell what datasets are and what is wrong with them. Every file is read. The exit status is 1 where
/// anything is wrong.
#[derive(clap::Args)]
pub struct Args {
    /// Objects, folders of objects, zip archives.
    #[arg(required = true)]
    paths: Vec<PathBuf>,
    /// Print JSON instead of text.
    #[arg(long)]
    json: bool,
}

/// The whole answer.
#[derive(Serialize)]
struct Report {
    schema: &'static str,
    objects: Vec<Object>,
}

/// One object, or a path without any.
#[derive(Serialize)]
struct Object {
    /// Its folder, or the path that was asked for.
    path: String,
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    facts: Option<Facts>,
    warnings: Vec<Message>,
    errors: Vec<String>,
}

#[derive(Serialize)]
struct Message {
    #[serde(flatten)]
    warning: Warning,
    message: String,
}

#[derive(Serialize)]
struct Facts {
    object: String,
    /// "diligent" or "diligent102".
    dataset: &'static str,
    images: usize,
    width: u32,
    height: u32,
    /// Bits a channel; absent where no image can be read.
    #[serde(skip_serializing_if = "Option::is_none")]
    bits: Option<u8>,
    mask_pixels: usize,
    /// Smallest and largest slant of the lights, degrees.
    slant: [f32; 2],
    truth: bool,
    /// Share of the mask's values at the largest code value, percent.
    #[serde(skip_serializing_if = "Option::is_none")]
    saturated: Option<f64>,
}

pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let limits = Limits::default();
    let mut report = Report { schema: "coil-ps/info/1", objects: Vec::new() };
    for path in &args.paths {
        match files::open(path, &limits) {
            Ok(source) => {
                for dir in &source.objects {
                    let mut object = inspect(source.files.as_ref(), dir, &limits);
                    object.path = source.place(dir);
                    if !args.json {
                        print(&object);
                    }
                    report.objects.push(object);
                }
            }
            Err(e) => {
                let path = path.display().to_string();
                let object =
                    Object { path, facts: None, warnings: Vec::new(), errors: vec![format!("{e:#}")] };
                if !args.json {
                    print(&object);
                }
                report.objects.push(object);
            }
        }
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    }
    let wrong = report.objects.iter().any(|o| !o.errors.is_empty());
    Ok(if wrong { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

fn inspect(files: &dyn Files, dir: &str, limits: &Limits) -> Object {
    let mut object = Object { path: dir.into(), facts: None, warnings: Vec::new(), errors: Vec::new() };
    let header = match Header::read(files, dir, limits) {
        Ok(header) => header,
        Err(e) => {
            object.errors.push(e.to_string());
            return object;
        }
    };
    let slants = || header.lights.iter().map(|&l| light::slant(l).to_degrees());
    let mut facts = Facts {
        object: header.name.clone(),
        dataset: match diligent102::shape_and_material(&header.name) {
            Some(_) => "diligent102",
            None => "diligent",
        },
        images: header.images.len(),
        width: header.mask.width(),
        height: header.mask.height(),
        bits: None,
        mask_pixels: header.mask.len(),
        slant: [slants().fold(f32::INFINITY, f32::min), slants().fold(0.0, f32::max)],
        truth: header.truth.is_some(),
        saturated: None,
    };
    let mut pixels = Vec::new();
    for (k, image) in files::decode_all(files, &header).into_iter().enumerate() {
        match image {
            Ok(image) => pixels.push((k, image)),
            Err(e) => object.errors.push(e.to_string()),
        }
    }
    let warnings = header.warnings.iter().cloned().chain(header.image_warnings(&pixels));
    object.warnings = warnings.map(|w| Message { message: w.to_string(), warning: w }).collect();
    let pixels: Vec<_> = pixels.into_iter().map(|p| p.1).collect();
    facts.bits = pixels.first().map(|p| p.bits.bits());
    let (mut saturated, mut values) = (0usize, 0usize);
    for image in &pixels {
        saturated += image.rgb.iter().flatten().filter(|&&v| v == image.bits.max()).count();
        values += 3 * image.rgb.len();
    }
    facts.saturated = (values > 0).then(|| 100.0 * saturated as f64 / values as f64);
    if object.errors.is_empty() {
        object.errors.extend(header.assemble(pixels).err().as_ref().map(DatasetError::to_string));
    }
    object.facts = Some(facts);
    object
}

fn print(object: &Object) {
    println!("{}", object.path);
    if let Some(f) = &object.facts {
        let bits = f.bits.map_or("depth unknown".into(), |b| format!("{b} bit"));
        let share = 100.0 * f.mask_pixels as f64 / (f64::from(f.width) * f64::from(f.height));
        println!("  object    {} ({})", f.object, f.dataset);
        println!("  images    {} of {}×{} pixels, {bits}", f.images, f.width, f.height);
        println!("  mask      {} pixels ({share:.1} %)", f.mask_pixels);
        println!("  lights    slant {:.1}° to {:.1}°", f.slant[0], f.slant[1]);
        println!("  truth     {}", if f.truth { "yes" } else { "no" });
        if let Some(s) = f.saturated {
            println!("  saturated {s:.3} % of the mask's values");
        }
    }
    for w in &object.warnings {
        println!("  warning: {}", w.message);
    }
    for e in &object.errors {
        println!("  ERROR: {e}");
    }
}
