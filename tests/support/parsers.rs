//! What must hold for every parser on any bytes: it never panics, takes no more than its limits, and
//! what it accepts is valid. The fuzz targets (`fuzz/`) and the property tests (`tests/fuzz.rs`) run the same bodies.
#![allow(dead_code)] // each fuzz target uses one

use coil_ps::dataset::{
    Files, Limits, Memory, Zip, check_name, find_objects, lp, mat, read_object, write_object,
};
use coil_ps::image::{decode_png, encode_rgb};
use coil_ps::light::fibonacci_cap;
use coil_ps::rig::tiff::decode_frame;
use coil_ps::solve::pixel::onnx;
use coil_ps::stack::{BitDepth, Mask, RawStack};
use glam::Vec3;
use std::sync::OnceLock;

/// A body with the name of its fuzz target. It returns whether the bytes were accepted.
pub type Body = (&'static str, fn(&[u8]) -> bool);

/// Every fuzz target.
pub const BODIES: &[Body] = &[
    ("png", png),
    ("tiff", tiff),
    ("mat", mat),
    ("zip", zip),
    ("lp", lp),
    ("object", object),
    ("model", model),
    ("grbl", grbl),
    #[cfg(feature = "render")]
    ("mesh", mesh),
];

/// Limits under which a test machine stays calm.
fn limits() -> Limits {
    Limits {
        images: 100,
        pixels: 1 << 16,
        object_bytes: 1 << 24,
        file_bytes: 1 << 20,
        archive_bytes: 1 << 22,
    }
}

pub fn png(bytes: &[u8]) -> bool {
    // With wrong checksums nothing behind them would ever be reached.
    check_png(&with_checksums(bytes));
    check_png(bytes)
}

fn check_png(bytes: &[u8]) -> bool {
    let Ok(image) = decode_png(bytes, 1 << 16) else { return false };
    assert_eq!(image.rgb.len() as u64, u64::from(image.width) * u64::from(image.height));
    assert!(image.rgb.iter().flatten().all(|&v| v <= image.bits.max()));
    if !image.rgb.is_empty() {
        let again = encode_rgb(image.width, image.height, image.bits, &image.rgb).unwrap();
        assert_eq!(decode_png(&again, 1 << 16).unwrap(), image);
    }
    true
}

/// A camera's file.
pub fn tiff(bytes: &[u8]) -> bool {
    let Ok(image) = decode_frame(bytes, 1 << 16) else { return false };
    assert!(image.rgb.len() <= 1 << 16);
    assert_eq!(image.rgb.len() as u64, u64::from(image.width) * u64::from(image.height));
    assert!(image.rgb.iter().flatten().all(|&v| v <= image.bits.max()));
    true
}

/// The same PNG with the checksum of every whole chunk put right.
pub fn with_checksums(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let mut at = 8;
    while let Some(length) = bytes.get(at..at + 4) {
        let length = u32::from_be_bytes([length[0], length[1], length[2], length[3]]) as usize;
        let Some(chunk) = bytes.get(at + 4..at.saturating_add(8).saturating_add(length)) else { break };
        let sum = crc32(chunk).to_be_bytes();
        at += 8 + length;
        let Some(place) = bytes.get_mut(at..at + 4) else { break };
        place.copy_from_slice(&sum);
        at += 4;
    }
    bytes
}

fn crc32(data: &[u8]) -> u32 {
    !data.iter().fold(!0, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| (c >> 1) ^ (0xedb8_8320 & (c & 1).wrapping_neg()))
    })
}

pub fn mat(bytes: &[u8]) -> bool {
    let Ok(array) = mat::read_array(bytes, "Normal_gt", 1 << 16) else { return false };
    assert_eq!(array.values.len(), array.dims.iter().product::<usize>());
    let again = mat::read_array(&mat::write_array("Normal_gt", &array), "Normal_gt", 1 << 16).unwrap();
    assert_eq!(again.dims, array.dims);
    let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&again.values), bits(&array.values));
    true
}

pub fn zip(bytes: &[u8]) -> bool {
    let limits = limits();
    let Ok(zip) = Zip::new(bytes.to_vec(), "fuzz.zip", &limits) else { return false };
    assert!(zip.names().is_sorted());
    for name in zip.names().iter().take(20) {
        check_name("fuzz", name).unwrap();
        if let Ok(file) = zip.read(name) {
            assert!(file.len() as u64 <= limits.file_bytes);
        }
    }
    for dir in find_objects(&zip).iter().take(3) {
        if let Ok((stack, _)) = read_object(&zip, dir, &limits) {
            assert_valid(&stack);
        }
    }
    true
}

pub fn lp(bytes: &[u8]) -> bool {
    let Ok(lights) = lp::read_lp(bytes, "fuzz.lp") else { return false };
    assert!(lights.iter().all(|(_, l)| (l.length() - 1.0).abs() < 1e-5 && l.z >= 0.0));
    let text = lp::write_lp(lights.iter().map(|(name, l)| (name.as_str(), *l)));
    assert_eq!(lp::read_lp(text.as_bytes(), "fuzz.lp").unwrap(), lights);
    true
}

/// The first byte names the file of a valid object that is replaced by the rest.
pub fn object(bytes: &[u8]) -> bool {
    let Some((&which, content)) = bytes.split_first() else { return false };
    static OBJECT: OnceLock<Vec<(String, Vec<u8>)>> = OnceLock::new();
    let mut object = OBJECT.get_or_init(|| write_object(&sphere(9, 7, 4, BitDepth::Eight)).unwrap()).clone();
    object.push(("normal.txt".into(), Vec::new()));
    let which = usize::from(which) % object.len();
    if object[which].0 == "normal.txt" {
        object.retain(|(name, _)| name != "Normal_gt.mat"); // which would be preferred
        object.last_mut().unwrap().1 = content.to_vec();
    } else {
        object.pop();
        object[which].1 = content.to_vec();
    }
    let mut files = Memory::new();
    for (name, bytes) in object {
        files.insert(&format!("spherePNG/{name}"), bytes).unwrap();
    }
    let read = read_object(&files, "spherePNG", &limits());
    if let Ok((stack, _)) = &read {
        assert_valid(stack);
    }
    read.is_ok()
}

/// A solver's network as an ONNX file.
pub fn model(bytes: &[u8]) -> bool {
    let Ok(model) = onnx::read(bytes) else { return false };
    assert!(model.network.weights().iter().all(|w| w.is_finite()));
    let again = onnx::read(&onnx::write(&model.network, &model.metadata)).unwrap();
    assert_eq!(again.network.weights(), model.network.weights());
    assert_eq!(again.metadata, model.metadata);
    true
}

/// Bytes from a serial line into the host's side of the link: any line, cut anywhere.
pub fn grbl(bytes: &[u8]) -> bool {
    use coil_ps::arm::grbl::{Command, Link, Phase};
    use coil_ps::arm::{Joints, line};
    use std::time::Duration;
    let mut link = Link::new();
    let mut now = Duration::ZERO;
    link.opened(now);
    let mut accepted = false;
    for (k, piece) in bytes.chunks(7).enumerate() {
        now += Duration::from_millis(u64::from(piece[0]) * 9);
        link.receive(now, piece);
        link.tick(now);
        if k % 3 == 0 {
            // Refused or taken, as the phase asks; never a panic.
            let to = Joints { azimuth: f64::from(piece[0]), slant: 10.0 };
            accepted |= link.send(now, Command::Goto { to, feed: 1000.0 }).is_ok();
        }
        if let Some(wake) = link.next_wake(now) {
            assert!(wake > now);
        }
    }
    link.stop(now);
    let out = link.take_output();
    assert!(matches!(link.phase(), Phase::Closed(_)) || out == b"!\x18");
    link.receive(now, bytes);
    link.tick(now);
    let after = link.take_output();
    assert!(after.iter().all(|b| b"!?\x18".contains(b)), "sent after Stop: {after:?}");
    if let line::Line::Status(s) = line::parse(bytes) {
        assert!(s.machine.into_iter().chain(s.work).flatten().all(f64::is_finite));
        accepted = true;
    }
    accepted
}

/// The first byte names the format of the rest.
#[cfg(feature = "render")]
pub fn mesh(bytes: &[u8]) -> bool {
    let Some((&format, content)) = bytes.split_first() else { return false };
    let name = ["mesh.obj", "mesh.ply", "mesh.stl"][usize::from(format) % 3];
    let Ok(mesh) = coil_ps::render::Mesh::from_bytes(name, content) else { return false };
    assert!(!mesh.triangles.is_empty() && mesh.normals.len() == mesh.triangles.len());
    assert!(mesh.triangles.iter().flatten().all(|&v| (v as usize) < mesh.positions.len()));
    assert!(mesh.positions.iter().all(|p| p.is_finite()));
    assert!(mesh.normals.iter().flatten().all(|n| (n.length() - 1.0).abs() < 1e-3), "{:?}", mesh.normals);
    true
}

/// What every reader promises of a stack.
pub fn assert_valid(stack: &RawStack) {
    let (images, pixels) = (stack.images.len(), stack.mask.len());
    assert!(images > 0 && pixels > 0);
    assert_eq!((stack.names.len(), stack.lights.len(), stack.intensities.len()), (images, images, images));
    assert!(stack.images.iter().all(|i| i.len() == pixels));
    assert!(stack.images.iter().flatten().flatten().all(|&v| v <= stack.bits.max()));
    assert!(stack.lights.iter().all(|l| (l.length() - 1.0).abs() < 1e-5 && l.z >= 0.0));
    assert!(stack.intensities.iter().flatten().all(|&v| v > 0.0 && v.is_finite()));
    if let Some(truth) = &stack.truth {
        assert_eq!(truth.len(), pixels);
        assert!(truth.iter().all(|n| *n == Vec3::ZERO || (n.length() - 1.0).abs() < 1e-5));
    }
}

/// A matt sphere of unit albedo that fills a `width`×`height` frame, under lights of different colour.
pub fn sphere(width: u32, height: u32, lights: usize, bits: BitDepth) -> RawStack {
    let radius = 0.5 * width.min(height) as f32;
    let normal = |x: u32, y: u32| {
        let u = (x as f32 + 0.5 - 0.5 * width as f32) / radius;
        let v = (0.5 * height as f32 - y as f32 - 0.5) / radius;
        let z = 1.0 - u * u - v * v;
        (z > 0.0).then(|| Vec3::new(u, v, z.sqrt()).normalize())
    };
    let grid: Vec<Option<Vec3>> =
        (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| normal(x, y)).collect();
    let inside: Vec<bool> = grid.iter().map(Option::is_some).collect();
    let truth: Vec<Vec3> = grid.into_iter().flatten().collect();
    let lights = fibonacci_cap(lights, 0.7);
    let intensities: Vec<[f32; 3]> =
        (0..lights.len()).map(|k| [0.5 + 0.01 * k as f32, 0.7, 0.9 - 0.003 * k as f32]).collect();
    let code = |shade: f32, gain: f32| (shade.max(0.0) * gain * f32::from(bits.max())).round() as u16;
    RawStack {
        name: "sphere".into(),
        mask: Mask::new(width, height, &inside).unwrap(),
        bits,
        images: lights
            .iter()
            .zip(&intensities)
            .map(|(l, gains)| truth.iter().map(|n| gains.map(|g| code(n.dot(*l), g))).collect())
            .collect(),
        names: (1..=lights.len()).map(|k| format!("{k:03}.png")).collect(),
        lights,
        intensities,
        truth: Some(truth),
    }
}
