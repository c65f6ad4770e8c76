//! `coil render`: stacks of synthetic objects in DiLiGenT's layout.

use crate::output;
use anyhow::{Context, bail};
use clap::ValueEnum;
use coil_ps::dataset::{lp, write_object};
use coil_ps::image::encode_rgb;
use coil_ps::light::{fibonacci_hemisphere, ring};
use coil_ps::render::worlds::{self, Object, Split};
use coil_ps::render::{Finish, Material, Mesh, Options, Pose, Scene, Sensor, Shape, Tracer, sensor};
use coil_ps::rng::Rng;
use coil_ps::stack::BitDepth;
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// Render objects under many lights, as folders in DiLiGenT's layout.
///
/// OBJECT is a mesh (.obj, .ply, .stl), a sculpture (blob:7, relief:3, …: also drape, vase, coral, totem, figure, knot,
/// lattice, stone; and sphere, bowl), the test objects (worlds-v1, worlds-v1:0..9), or drawn ones (worlds-train:0..999,
/// worlds-validate:0..49).
#[derive(clap::Args)]
pub struct Args {
    /// What to render; with --merge, the folders of the shards.
    objects: Vec<String>,
    /// Lights: fibonacci:K, ring:K:SLANT (degrees), a .lp file, a text file with x y z a line, or x,y,z (repeatable).
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

/// What a run wrote, kept beside the objects (`render.json`, of a shard `render-I-of-N.json`).
#[derive(Debug, Serialize, Deserialize)]
struct Manifest {
    version: String,
    objects: Vec<String>,
    lights: Vec<[f32; 3]>,
    size: u32,
    bounces: u32,
    seed: u64,
    sensor: Sensor,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    shard: Option<[usize; 2]>,
    /// All that the command was asked for: equal in the shards of one set.
    request: Vec<String>,
    rendered: Vec<Rendered>,
}

#[derive(Debug, Serialize, Deserialize)]
struct Rendered {
    name: String,
    images: usize,
    pixels: usize,
    /// FNV-1a of all files, in hexadecimal.
    checksum: String,
}

pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    if args.bench {
        return bench(&args);
    }
    if args.objects.is_empty() {
        bail!("what to render? a mesh file, blob:7, worlds-v1; see coil render --help");
    }
    if let Some(file) = &args.sheet {
        return sheet(&args, file);
    }
    let out = args.out.clone().context("--out DIR says where to write")?;
    if args.merge {
        return merge(&args.objects, &out, args.json);
    }
    if args.white.is_some_and(|w| !(w > 0.0 && w.is_finite())) {
        bail!("--white must be a number above 0");
    }
    let shard = args.shard.as_deref().map(shard).transpose()?;
    let lights = lights(&args.lights)?;
    let sensor = match args.sensor {
        SensorName::Ideal => Sensor::IDEAL,
        SensorName::Camera => Sensor::CAMERA,
    };
    let options = Options { size: args.size, bounces: args.bounces, ..Options::default() };
    let mut jobs = Vec::new();
    for name in &args.objects {
        jobs.extend(objects(name, &args)?.into_iter().map(|(object, pose)| (object, pose, is_set(name))));
    }
    // Two objects of one name would overwrite each other.
    for i in 0..jobs.len() {
        let same = jobs[..i].iter().filter(|j| j.0.name == jobs[i].0.name).count();
        if same > 0 {
            jobs[i].0.name += &format!("-{}", same + 1);
        }
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
        files.push(("pose.json".into(), scene.pose.to_json().into_bytes()));
        let mut hash = Fnv::new();
        for (file, bytes) in &files {
            hash.add(file.as_bytes());
            hash.add(bytes);
        }
        files.par_iter().try_for_each(|(file, bytes)| output::write(&folder.join(file), bytes))?;
        rendered.push(Rendered {
            name: object.name.clone(),
            images: lights.len(),
            pixels: raw.mask.len(),
            checksum: format!("{:016x}", hash.0),
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
    report(&manifest, &out, total, args.json)
}

fn report(manifest: &Manifest, out: &Path, total: usize, json: bool) -> anyhow::Result<ExitCode> {
    if json {
        output::write_json(Path::new("-"), manifest)?;
    } else {
        let images: usize = manifest.rendered.iter().map(|r| r.images).sum();
        println!("{} of {total} objects, {images} images: {}", manifest.rendered.len(), out.display());
    }
    Ok(ExitCode::SUCCESS)
}

/// Every object under the first light, side by side, each at its own exposure, gamma 2.2.
fn sheet(args: &Args, file: &Path) -> anyhow::Result<ExitCode> {
    let light = lights(&args.lights)?[0];
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
    let mesh = [".obj", ".ply", ".stl"].iter().any(|end| name.to_ascii_lowercase().ends_with(end));
    if is_set(name) {
        if args.material.is_some() || args.pose != "front" {
            bail!("{name}: its materials and poses are part of it; leave --material and --pose out");
        }
        return Ok(worlds::objects(name)?.into_iter().map(|o| (o, None)).collect());
    }
    let mut object = if mesh {
        let data = std::fs::read(name).with_context(|| name.to_owned())?;
        let shape = Shape::Mesh(Mesh::from_bytes(name, &data).with_context(|| name.to_owned())?);
        let stem = Path::new(name).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let material: Material = worlds::MATERIAL.parse()?;
        Object { name: stem, rotation: shape.front(), shape, finish: material.into() }
    } else {
        worlds::objects(name)?.remove(0)
    };
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

/// Whether a name stands for objects that have their own materials and poses.
fn is_set(name: &str) -> bool {
    [worlds::NAME, "worlds-train", "worlds-validate"].contains(&name.split(':').next().unwrap_or_default())
}

/// Light directions of all `--lights` together.
fn lights(texts: &[String]) -> anyhow::Result<Vec<Vec3>> {
    let mut all = Vec::new();
    for text in texts {
        all.extend(light_set(text)?);
    }
    if all.is_empty() {
        bail!("--lights names no light");
    }
    Ok(all)
}

fn light_set(text: &str) -> anyhow::Result<Vec<Vec3>> {
    let vector = |line: &str, split: fn(char) -> bool, place: &str| -> anyhow::Result<Vec3> {
        let numbers: Vec<f32> = line
            .split(split)
            .filter(|w| !w.is_empty())
            .map(|w| w.trim().parse())
            .collect::<Result<_, _>>()
            .with_context(|| format!("{place}: '{line}'"))?;
        let [x, y, z] = numbers[..] else { bail!("{place}: '{line}': a direction is three numbers") };
        let v = Vec3::new(x, y, z);
        if !(v.is_finite() && v.length() > 1e-6 && z >= 0.0) {
            bail!("{place}: '{line}': a direction towards a light has z ≥ 0 and is not zero");
        }
        Ok(v.normalize())
    };
    let parts: Vec<&str> = text.split(':').collect();
    match parts[..] {
        ["fibonacci", k] => {
            let k: usize = k.parse().with_context(|| format!("--lights {text}"))?;
            return Ok(fibonacci_hemisphere(k));
        }
        ["ring", k, slant] => {
            let (k, slant): (usize, f32) = (k.parse()?, slant.parse()?);
            if !(slant > 0.0 && slant <= 90.0) {
                bail!("--lights {text}: the slant lies in (0, 90] degrees");
            }
            return Ok(ring(k, slant.to_radians(), 0.0));
        }
        _ => {}
    }
    if text.matches(',').count() == 2 && !Path::new(text).exists() {
        return Ok(vec![vector(text, |c| c == ',', "--lights")?]);
    }
    let bytes = std::fs::read(text).with_context(|| {
        format!("--lights {text}: write fibonacci:K, ring:K:SLANT, x,y,z or the name of a .lp or text file")
    })?;
    if text.to_ascii_lowercase().ends_with(".lp") {
        return Ok(lp::read_lp(&bytes, text)?.into_iter().map(|l| l.1).collect());
    }
    let content = String::from_utf8_lossy(&bytes);
    let lines = content.lines().enumerate().filter(|(_, l)| !l.trim().is_empty());
    lines.map(|(i, l)| vector(l, char::is_whitespace, &format!("{text}:{}", i + 1))).collect()
}

fn shard(text: &str) -> anyhow::Result<[usize; 2]> {
    let parsed = text.split_once('/').and_then(|(i, n)| Some([i.parse().ok()?, n.parse().ok()?]));
    match parsed {
        Some([i, n]) if i >= 1 && i <= n => Ok([i, n]),
        _ => bail!("--shard {text}: write I/N with 1 ≤ I ≤ N, as 3/8"),
    }
}

/// Joins the folders of all shards of one set.
fn merge(folders: &[String], out: &Path, json: bool) -> anyhow::Result<ExitCode> {
    let mut shards: Vec<(PathBuf, Manifest)> = Vec::new();
    for folder in folders {
        for entry in std::fs::read_dir(folder).with_context(|| folder.clone())? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if name.starts_with("render-") && name.ends_with(".json") {
                let text = std::fs::read_to_string(&path)?;
                let manifest = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
                shards.push((PathBuf::from(folder), manifest));
            }
        }
    }
    shards.sort_by_key(|s| s.1.shard);
    let Some((_, first)) = shards.first() else {
        bail!("no render-I-of-N.json in {}: are these folders of --shard runs?", folders.join(", "))
    };
    let of = first.shard.map_or(1, |s| s[1]);
    let same = |m: &Manifest| {
        (m.request == first.request, m.size, m.bounces, m.seed, m.sensor, &m.lights, m.shard.map(|s| s[1]))
            == (true, first.size, first.bounces, first.seed, first.sensor, &first.lights, Some(of))
    };
    if let Some((folder, _)) = shards.iter().find(|s| !same(&s.1)) {
        bail!("{}: rendered with other settings than {}", folder.display(), shards[0].0.display());
    }
    let parts: Vec<usize> = shards.iter().filter_map(|s| Some(s.1.shard?[0])).collect();
    if let Some(missing) = (1..=of).find(|part| !parts.contains(part)) {
        bail!("shard {missing}/{of} is missing");
    }
    if let Some(twice) = (1..=of).find(|part| parts.iter().filter(|p| *p == part).count() > 1) {
        bail!("shard {twice}/{of} is there twice");
    }
    let mut rendered = Vec::new();
    for (folder, manifest) in &mut shards {
        for object in std::mem::take(&mut manifest.rendered) {
            let (from, to) = (folder.join(&object.name), out.join(&object.name));
            if from != to {
                std::fs::create_dir_all(&to).with_context(|| to.display().to_string())?;
                for file in std::fs::read_dir(&from).with_context(|| from.display().to_string())? {
                    let file = file?;
                    std::fs::copy(file.path(), to.join(file.file_name()))?;
                }
            }
            rendered.push(object);
        }
    }
    rendered.sort_by(|a, b| a.name.cmp(&b.name));
    let total = rendered.len();
    let manifest = Manifest { shard: None, rendered, ..shards.swap_remove(0).1 };
    output::write_json(&out.join("render.json"), &manifest)?;
    report(&manifest, out, total, json)
}

/// FNV-1a.
struct Fnv(u64);

impl Fnv {
    fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    fn add(&mut self, bytes: &[u8]) {
        for &b in bytes {
            self.0 = (self.0 ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}

/// One line of the speed table.
#[derive(Serialize)]
struct Speed {
    object: String,
    triangles: usize,
    size: u32,
    pixels: usize,
    /// Once an object: G-buffer and horizon map, seconds.
    prepare_seconds: f64,
    /// With form factors too.
    prepare_bounce_seconds: f64,
    /// Direct light with cast shadows, images a second, one thread.
    direct_images_per_second: f64,
    /// With one bounce.
    bounce_images_per_second: f64,
    /// Shadows by rays instead, images a second, one thread.
    traced_images_per_second: f64,
    /// A stack of 96 images with a bounce, from shape to code values, seconds; images on all threads.
    stack_of_96_seconds: f64,
}

/// A sphere of about `triangles` triangles with ripples, so that it shades itself.
fn rippled_sphere(triangles: usize) -> anyhow::Result<Shape> {
    let rings = ((triangles as f64 / 4.0).sqrt() as u32).max(4);
    let spokes = 2 * rings;
    let mut positions = Vec::new();
    let mut faces = Vec::new();
    for i in 0..=rings {
        for j in 0..spokes {
            let (s, c) = (std::f32::consts::PI * i as f32 / rings as f32).sin_cos();
            let (sa, ca) = (std::f32::consts::TAU * j as f32 / spokes as f32).sin_cos();
            let d = Vec3::new(s * ca, s * sa, c);
            positions.push(d * (1.0 + 0.06 * (12.0 * d.x).sin() * (12.0 * d.y).sin() * (12.0 * d.z).cos()));
            if i < rings {
                let at = |i: u32, j: u32| i * spokes + j % spokes;
                faces.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                faces.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
    }
    Ok(Shape::Mesh(Mesh::new(positions, &faces)?))
}

fn bench(args: &Args) -> anyhow::Result<ExitCode> {
    let material: Material = args.material.as_deref().unwrap_or(worlds::MATERIAL).parse()?;
    let mut cases: Vec<(String, usize, u32)> = vec![("blob:7".into(), 0, 128)];
    cases.extend([1_000, 10_000, 100_000, 1_000_000].map(|n| ("rippled sphere".to_string(), n, 128)));
    cases.extend([64, 256].map(|size| ("rippled sphere".to_string(), 100_000, size)));
    let mut rows = Vec::new();
    let bar = output::progress(cases.len(), "cases");
    for (object, triangles, size) in cases {
        let shape = if triangles == 0 {
            worlds::objects(&object)?.remove(0).shape
        } else {
            rippled_sphere(triangles)?
        };
        let pose = Pose::fit(&shape, shape.front())?;
        let finish = Finish::from(material.clone());
        let prepare = |bounces| {
            let start = Instant::now();
            let options = Options { size, bounces, ..Options::default() };
            let scene = Scene::new(&object, &shape, &pose, &finish, &options);
            scene.map(|s| (s, start.elapsed().as_secs_f64()))
        };
        let (direct, prepare_seconds) = prepare(0)?;
        let (bounce, prepare_bounce_seconds) = prepare(1)?;
        // The best of five: other work on the machine only ever makes it slower.
        let rate = |images: usize, f: &mut dyn FnMut(Vec3)| {
            let lights = fibonacci_hemisphere(images);
            let best = (0..5)
                .map(|_| {
                    let start = Instant::now();
                    lights.iter().for_each(|&l| f(l));
                    start.elapsed().as_secs_f64()
                })
                .fold(f64::INFINITY, f64::min);
            images as f64 / best
        };
        let mut kept = 0.0;
        let mut keep = |image: Vec<[f32; 3]>| kept += image[0][0];
        let direct_images_per_second = rate(40, &mut |l| keep(direct.render(l)));
        let bounce_images_per_second = rate(40, &mut |l| keep(bounce.render(l)));
        let tracer = Tracer::new(&shape, &pose);
        let traced_images_per_second = rate(2, &mut |l| {
            std::hint::black_box(tracer.visibility(&direct.view, l));
        });
        std::hint::black_box(kept);
        let start = Instant::now();
        let white = sensor::white_level(&bounce, sensor::SATURATED);
        let photo = |&l: &Vec3| sensor::photo(&bounce.render(l), white, &Sensor::IDEAL, 1, 0).len();
        let done: usize = fibonacci_hemisphere(96).par_iter().map(photo).sum();
        std::hint::black_box(done);
        let stack_of_96_seconds = prepare_bounce_seconds + start.elapsed().as_secs_f64();
        let triangles = match &shape {
            Shape::Mesh(mesh) => mesh.triangles.len(),
            Shape::Sculpture(_) => 0,
        };
        rows.push(Speed {
            object,
            triangles,
            size,
            pixels: direct.view.mask.len(),
            prepare_seconds,
            prepare_bounce_seconds,
            direct_images_per_second,
            bounce_images_per_second,
            traced_images_per_second,
            stack_of_96_seconds,
        });
        bar.inc(1);
    }
    bar.finish_and_clear();
    if args.json {
        output::write_json(Path::new("-"), &rows)?;
        return Ok(ExitCode::SUCCESS);
    }
    let head =
        "object|triangles|size|pixels|prepare s|with bounce s|direct/s|with bounce/s|traced/s|96 images s";
    let mut lines = vec![head.split('|').map(str::to_string).collect::<Vec<_>>()];
    for r in &rows {
        lines.push(vec![
            r.object.clone(),
            r.triangles.to_string(),
            r.size.to_string(),
            r.pixels.to_string(),
            format!("{:.2}", r.prepare_seconds),
            format!("{:.2}", r.prepare_bounce_seconds),
            format!("{:.0}", r.direct_images_per_second),
            format!("{:.0}", r.bounce_images_per_second),
            format!("{:.1}", r.traced_images_per_second),
            format!("{:.2}", r.stack_of_96_seconds),
        ]);
    }
    print!("{}", output::align(&lines));
    Ok(ExitCode::SUCCESS)
}
