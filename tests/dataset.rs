//! Datasets: the shared DiLiGenT objects as published.

mod support;

use coil_ps::image::decode_png;
use coil_ps::stack::BitDepth;
use glam::Vec3;

#[test]
fn shared_objects_are_read_as_published() {
    for (name, bits, pixels) in [
        ("ball", BitDepth::Sixteen, 15_791),
        ("bear", BitDepth::Sixteen, 41_512),
        ("cat", BitDepth::Sixteen, 45_200),
        ("reading", BitDepth::Sixteen, 27_654),
        ("cow", BitDepth::Eight, 26_421),
        ("pot1", BitDepth::Eight, 57_721),
    ] {
        let Some(stack) = support::diligent(name) else { return };
        assert_eq!((stack.name.as_str(), stack.bits), (name, bits));
        assert_eq!(stack.mask.len(), pixels, "{name}");
        assert_eq!((stack.images.len(), stack.lights.len(), stack.intensities.len()), (96, 96, 96));
        assert!(stack.lights.iter().all(|l| (l.length() - 1.0).abs() < 1e-6 && l.z > 0.7));
        let truth = stack.truth.unwrap();
        assert!(truth.iter().all(|n| (n.length() - 1.0).abs() < 1e-5));
    }
}

#[test]
fn the_frame_is_x_right_y_up_z_to_the_camera() {
    let Some(ball) = support::diligent("ball") else { return };
    let truth = ball.truth.unwrap();
    // On a sphere the normal follows the position: n = ((x − cx)/r, (cy − y)/r, z).
    let (x0, y0, w, h) = ball.mask.bounds();
    let (cx, cy) = (x0 as f32 + 0.5 * (w as f32 - 1.0), y0 as f32 + 0.5 * (h as f32 - 1.0));
    let r = 0.25 * (w + h) as f32;
    for (p, n) in truth.iter().enumerate() {
        let (x, y) = ball.mask.position(p);
        let (u, v) = ((x as f32 - cx) / r, (cy - y as f32) / r);
        assert!((n.x - u).abs() < 0.05 && (n.y - v).abs() < 0.05 && n.z >= 0.0, "{n} at {x}, {y}");
    }
    // The picture of the normals that comes with it says the same: rgb = (n + 1)/2.
    let data = support::shared_data().unwrap();
    let png = std::fs::read(support::diligent_folder(&data, "ball").join("Normal_gt.png")).unwrap();
    let picture = ball.mask.gather(&decode_png(&png, 1 << 20).unwrap().rgb);
    let worst = picture
        .iter()
        .zip(&truth)
        .map(|(rgb, n)| (Vec3::from(rgb.map(|v| f32::from(v) / 127.5 - 1.0)) - *n).abs().max_element());
    assert!(worst.fold(0.0, f32::max) < 0.02);
}
