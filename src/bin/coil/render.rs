//! `coil render`: stacks of synthetic objects in DiLiGenT's layout.

mod bench;
mod lights;
mod shards;

use crate::objects::{Names, rendered};
use crate::output;
use anyhow::{Context, bail};
use clap::ValueEnum;
use coil_ps::dataset::write_object;
use coil_ps::fingerprint::Fingerprint;
use coil_ps::image::encode_rgb;
use coil_ps::render::worlds::{self, Object, Split};
use coil_ps::render::{Finish, Material, Options, Pose, Scene, Sensor, Tracer, sensor};
use coil_ps::rng::Rng;
use coil_ps::stack::BitDepth;
use glam::Vec3;
use rayon::prelude::*;
use shards::{Manifest, Rendered};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Render objects under many lights, as folders in DiLiGenT's layout.
///
/// OBJECT is a mesh (.obj, .ply, .stl), a sculpture (blob:7, relief:3, …: also drape, vase, coral, totem, figure, knot,
/// lattice, stone; and sphere, bowl), the test objects (worlds-v1, worlds-v1:0..9), or drawn ones (worlds-train:0..999,
/// worlds-validate:0..49).
#[derive(clap::Args)]
pub struct Args {
    /// What to render; with --merge, the folders of the shards.
    objects: Vec<String>,
    /// Lights: fibonacci:K, ring:K:SLANT (degrees), a .lp file, a text file with x y z a line, the folder of a DiLiGenT object, or
    /// x,y,z (repeatable).
    #[arg(long, default_value = "fibonacci:100", allow_hyphen_values = true)]
    lights: Vec<String>,
    /// Material: a name of models/materials/abc.json, lambert:ALBEDO, ggx:ALPHA:F0, or random (a training material, perhaps
    /// with patches and texture). Not for worlds-…, which have their own.
    #[arg(long)]
    material: Option<String>,
    /// Pose of meshes and sculptures: front, random, or a JSON file with "rotation" (rows), "scale", "translation".
    #[arg(long, default_value = "front")]
    pose: String,
    /// Width and height of the images.
    #[arg(long, default_value_t = 128)]
    size: u32,
    /// Diffuse bounces of light between parts of the object.
    #[arg(long, default_value_t = 1)]
    bounces: u32,
    /// Noise and bits: ideal (none, 16 bits) or camera (10 000 electrons, 5 of read noise, 12 bits).
    #[arg(long, value_enum, default_value = "ideal")]
    sensor: SensorName,
    /// Cast shadows: by rays, exact; or by the horizon map, several times faster, which takes light from below an overhang for
    /// shadow. Without it: rays, but the map for worlds-…, whose definition it is part of.
    #[arg(long, value_enum)]
    shadows: Option<Shadows>,
    /// Linear value that just saturates; without it all but 0.2 % of the values lie below.
    #[arg(long)]
    white: Option<f32>,
    /// Seed of random poses and materials, and of the noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Render every N-th object from the I-th (1..=N): one of N jobs. Join the folders with --merge.
    #[arg(long, value_name = "I/N")]
    shard: Option<String>,
    /// Join the folders of shards, given as OBJECT, into --out.
    #[arg(long)]
    merge: bool,
    /// Folder to write to; it is made where it is missing.
    #[arg(long, required_unless_present_any = ["bench", "sheet"])]
    out: Option<PathBuf>,
    /// Write one picture that shows every object under the first light to FILE (.png), instead of stacks.
    #[arg(long, value_name = "FILE")]
    sheet: Option<PathBuf>,
    /// Objects a row of --sheet.
    #[arg(long, default_value_t = 10)]
    columns: usize,
    /// Write a summary as JSON to standard output.
    #[arg(long)]
    json: bool,
    /// Measure images a second against triangles, size and number of images; writes nothing.
    #[arg(long)]
    bench: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum SensorName {
    Ideal,
    Camera,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Shadows {
    Rays,
    Map,
}

pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    if args.bench {
        return bench::bench(args.material.as_deref(), args.json);
    }
    if args.objects.is_empty() {
        bail!("what to render? a mesh file, blob:7, worlds-v1; see coil render --help");
    }
    if let Some(file) = &args.sheet {
        return sheet(&args, file);
    }
    let out = args.out.clone().context("--out DIR says where to write")?;
    if args.merge {
        return shards::merge(&args.objects, &out, args.json);
    }
    if args.white.is_some_and(|w| !(w > 0.0 && w.is_finite())) {
        bail!("--white must be a number above 0");
    }
    let shard = args.shard.as_deref().map(shards::shard).transpose()?;
    let lights = lights::lights(&args.lights)?;
    let sensor = match args.sensor {
        SensorName::Ideal => Sensor::IDEAL,
        SensorName::Camera => Sensor::CAMERA,
    };
    let options = Options { size: args.size, bounces: args.bounces, ..Options::default() };
    let mut jobs = Vec::new();
    for name in &args.objects {
        jobs.extend(
            objects(name, &args)?.into_iter().map(|(object, pose)| (object, pose, worlds::is_set(name))),
        );
    }
    // Two objects of one name would overwrite each other.
    let mut names = Names::default();
    for (object, ..) in &mut jobs {
        object.name = names.distinct(&object.name);
    }
    let total = jobs.len();
    let mine: Vec<_> = jobs
        .into_iter()
        .enumerate()
        .filter(|(i, _)| shard.is_none_or(|[part, of]| i % of == part - 1))
        .collect();
    let bar = output::progress(mine.len() * lights.len(), "images");
    let mut rendered = Vec::new();
    for (number, (object, pose, of_a_set)) in &mine {
        let scene = match pose {
            Some(pose) => Scene::new(&object.name, &object.shape, pose, &object.finish, &options),
            None => object.scene(&options),
        }
        .with_context(|| object.name.clone())?;
        let white = args.white.unwrap_or_else(|| sensor::white_level(&scene, sensor::SATURATED));
        let seed = Rng::stream(args.seed, *number as u64).next_u64();
        let shadows = args.shadows.unwrap_or(if *of_a_set { Shadows::Map } else { Shadows::Rays });
        let tracer = (shadows == Shadows::Rays).then(|| Tracer::new(&object.shape, &scene.pose));
        let images = lights
            .par_iter()
            .enumerate()
            .map(|(k, &light)| {
                let linear = match &tracer {
                    Some(tracer) => scene.render_with_shadows(light, &tracer.visibility(&scene.view, light)),
                    None => scene.render(light),
                };
                bar.inc(1);
                sensor::photo(&linear, white, &sensor, seed, k)
            })
            .collect();
        let raw = sensor::assemble(&scene, &lights, white, images);
        let folder = out.join(&object.name);
        let mut files = write_object(&raw)?;
        files.push(("pose.json".into(), scene.pose.to_json(&object.shape).into_bytes()));
        let mut print = Fingerprint::default();
        for (file, bytes) in &files {
            print.add(file.bytes());
            print.add(bytes.iter().copied());
        }
        files.par_iter().try_for_each(|(file, bytes)| output::write(&folder.join(file), bytes))?;
        rendered.push(Rendered {
            name: object.name.clone(),
            images: lights.len(),
            pixels: raw.mask.len(),
            checksum: print.to_string(),
        });
    }
    bar.finish_and_clear();
    let request = vec![
        args.objects.join(" "),
        format!("material {}", args.material.as_deref().unwrap_or("default")),
        format!("pose {}", args.pose),
        format!("white {:?}", args.white),
        format!("shadows {:?}", args.shadows),
    ];
    let manifest = Manifest {
        version: env!("CARGO_PKG_VERSION").into(),
        objects: args.objects.clone(),
        lights: lights.iter().map(Vec3::to_array).collect(),
        size: args.size,
        bounces: args.bounces,
        seed: args.seed,
        sensor,
        shard,
        request,
        rendered,
    };
    let file = match shard {
        Some([part, of]) => format!("render-{part}-of-{of}.json"),
        None => "render.json".into(),
    };
    output::write_json(&out.join(file), &manifest)?;
    shards::report(&manifest, &out, total, args.json)
}

/// Every object under the first light, side by side, each at its own exposure, gamma 2.2.
fn sheet(args: &Args, file: &Path) -> anyhow::Result<ExitCode> {
    let light = lights::lights(&args.lights)?[0];
    let options = Options { size: args.size, bounces: args.bounces, ..Options::default() };
    let mut jobs = Vec::new();
    for name in &args.objects {
        jobs.extend(objects(name, args)?);
    }
    let scenes: Vec<Scene> = jobs
        .par_iter()
        .map(|(object, pose)| match pose {
            Some(pose) => Scene::new(&object.name, &object.shape, pose, &object.finish, &options),
            None => object.scene(&options),
        })
        .collect::<Result<_, _>>()?;
    let size = args.size as usize;
    let columns = args.columns.clamp(1, scenes.len());
    let (width, height) = (columns * size, scenes.len().div_ceil(columns) * size);
    let mut picture = vec![[0u16; 3]; width * height];
    for (i, scene) in scenes.iter().enumerate() {
        let image = scene.render(light);
        let mut values: Vec<f32> = image.iter().map(|c| c[0].max(c[1]).max(c[2])).collect();
        values.sort_by(f32::total_cmp);
        // Highlights may burn out: the rest is what there is to see.
        let white = (values[values.len() * 95 / 100] * 1.3).max(1e-4);
        for (p, rgb) in image.iter().enumerate() {
            let (x, y) = scene.view.mask.position(p);
            let at = (i / columns * size + y as usize) * width + i % columns * size + x as usize;
            picture[at] = rgb.map(|v| ((v / white).clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0 + 0.5) as u16);
        }
    }
    output::write(file, &encode_rgb(width as u32, height as u32, BitDepth::Eight, &picture)?)?;
    Ok(ExitCode::SUCCESS)
}

/// The objects of a name, with the pose where it does not follow from the object's rotation.
fn objects(name: &str, args: &Args) -> anyhow::Result<Vec<(Object, Option<Pose>)>> {
    if worlds::is_set(name) {
        if args.material.is_some() || args.pose != "front" {
            bail!("{name}: its materials and poses are part of it; leave --material and --pose out");
        }
        return Ok(worlds::objects(name)?.into_iter().map(|o| (o, None)).collect());
    }
    let mut object = rendered(name)?.remove(0);
    // Each object draws for itself, whatever else is rendered.
    let rng =
        &mut Rng::stream(args.seed, name.bytes().fold(0, |h: u64, b| h.wrapping_mul(31) + u64::from(b)));
    let drawn = Object::dressed(&object.name, object.shape.clone(), Split::Train, rng);
    match args.material.as_deref() {
        None => {}
        Some("random") => object.finish = drawn.finish,
        Some(text) => object.finish = Finish::from(text.parse::<Material>()?),
    }
    let mut pose = None;
    match args.pose.as_str() {
        "front" => {}
        "random" => object.rotation = drawn.rotation,
        file => {
            let text = std::fs::read_to_string(file)
                .with_context(|| format!("{file}: --pose takes front, random or a JSON file"))?;
            pose = Some(Pose::from_json(&object.shape, &text).with_context(|| file.to_owned())?);
        }
    }
    Ok(vec![(object, pose)])
}
