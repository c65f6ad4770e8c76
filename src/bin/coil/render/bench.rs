//! `coil render --bench`: images a second against triangles, size and number of images.

use crate::output;
use coil_ps::light::fibonacci_hemisphere;
use coil_ps::render::{Finish, Material, Mesh, Options, Pose, Scene, Sensor, Shape, Tracer, sensor, worlds};
use glam::Vec3;
use rayon::prelude::*;
use serde::Serialize;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

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

/// Measures, and prints a table or JSON.
pub fn bench(material: Option<&str>, json: bool) -> anyhow::Result<ExitCode> {
    let material: Material = material.unwrap_or(worlds::MATERIAL).parse()?;
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
    if json {
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
