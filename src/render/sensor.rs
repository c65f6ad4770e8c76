//! From linear light to code values: exposure, noise, saturation, quantisation. And from a scene to a stack.

use super::scene::Scene;
use crate::rng::Rng;
use crate::stack::{BitDepth, RawStack};
use glam::Vec3;

/// A linear camera sensor.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Sensor {
    /// Electrons at full scale: sets the shot noise. Infinite for none (`null` in JSON, which has no infinity).
    #[serde(deserialize_with = "null_is_infinite")]
    pub full_well: f32,
    /// Standard deviation of the read noise, electrons.
    pub read_noise: f32,
    /// Bits of the converter, 1..=16. Codes are stored scaled to 16 bits.
    pub bits: u32,
}

fn null_is_infinite<'de, D: serde::Deserializer<'de>>(value: D) -> Result<f32, D::Error> {
    Ok(<Option<f32> as serde::Deserialize>::deserialize(value)?.unwrap_or(f32::INFINITY))
}

impl Sensor {
    /// No noise, 16 bits.
    pub const IDEAL: Self = Self { full_well: f32::INFINITY, read_noise: 0.0, bits: 16 };

    /// An industrial camera: 10 000 electrons, 5 electrons of read noise, 12 bits.
    pub const CAMERA: Self = Self { full_well: 10_000.0, read_noise: 5.0, bits: 12 };

    /// The 16-bit codes of linear values, of which `white` just saturates. Values above it are cut off.
    #[must_use]
    pub fn expose(&self, linear: &[[f32; 3]], white: f32, rng: &mut Rng) -> Vec<[u16; 3]> {
        let top = ((1u32 << self.bits.clamp(1, 16)) - 1) as f32;
        let noisy = self.full_well.is_finite();
        linear
            .iter()
            .map(|rgb| {
                rgb.map(|v| {
                    let mut share = v / white;
                    if noisy {
                        share += rng.normal() * self.deviation(share);
                    }
                    let code = (share.clamp(0.0, 1.0) * top + 0.5).floor();
                    (code * (65535.0 / top) + 0.5).floor() as u16
                })
            })
            .collect()
    }

    /// A linear value as it comes out of merged exposures (HDR), of which the longest saturates at `white`: with the sensor's
    /// noise, neither cut off nor rounded.
    #[must_use]
    pub fn merged(&self, linear: f32, white: f32, rng: &mut Rng) -> f32 {
        let deviation = self.deviation(linear / white);
        (linear + deviation * white * rng.normal()).max(0.0)
    }

    /// Standard deviation of a value, both as shares of full scale. Shot noise is Poisson; from ten electrons on a normal
    /// distribution is as good.
    fn deviation(&self, share: f32) -> f32 {
        let electrons = share.max(0.0) * self.full_well;
        (electrons + self.read_noise * self.read_noise).sqrt() / self.full_well
    }

    /// One exposure for each value of `whites` (from short to long: from large to small): an HDR bracket.
    #[must_use]
    pub fn bracket(&self, linear: &[[f32; 3]], whites: &[f32], rng: &mut Rng) -> Vec<Vec<[u16; 3]>> {
        whites.iter().map(|&white| self.expose(linear, white, rng)).collect()
    }
}

/// The value below which lie all but `share` of a scene's values under lights all over the hemisphere: what an exposure
/// is set by.
#[must_use]
pub fn white_level(scene: &Scene, share: f32) -> f32 {
    level(scene, &crate::light::fibonacci_hemisphere(24), share)
}

/// The value below which lie 99 % of a scene's values under frontal light.
#[must_use]
pub fn frontal_white(scene: &Scene) -> f32 {
    level(scene, &[Vec3::Z], 0.01)
}

fn level(scene: &Scene, lights: &[Vec3], share: f32) -> f32 {
    let mut values: Vec<f32> =
        lights.iter().flat_map(|&l| scene.render(l)).map(|[r, g, b]| r.max(g).max(b)).collect();
    let rank = ((values.len() as f32 * (1.0 - share)) as usize).min(values.len() - 1);
    let (_, value, _) = values.select_nth_unstable_by(rank, f32::total_cmp);
    value.max(1e-6)
}

/// Share of the values that a stack's exposure lets saturate: highlights are hundreds of times as bright as the rest.
pub const SATURATED: f32 = 0.002;

/// Image `k` of a stack, from its linear values. Depends on nothing but its arguments, so that the caller can make images in
/// parallel.
#[must_use]
pub fn photo(linear: &[[f32; 3]], white: f32, sensor: &Sensor, seed: u64, k: usize) -> Vec<[u16; 3]> {
    sensor.expose(linear, white, &mut Rng::stream(seed, k as u64))
}

/// The stack of a scene under `lights`, as a rig would store it: 16-bit code values, all at one exposure.
///
/// Code value / 65535 / light intensity is the scene's linear value, over that of the exposure's white where it is above 1.
#[must_use]
pub fn stack(scene: &Scene, lights: &[Vec3], sensor: &Sensor, seed: u64) -> RawStack {
    let white = white_level(scene, SATURATED);
    let images =
        lights.iter().enumerate().map(|(k, &l)| photo(&scene.render(l), white, sensor, seed, k)).collect();
    assemble(scene, lights, white, images)
}

/// A stack of images that [`photo`] made.
#[must_use]
pub fn assemble(scene: &Scene, lights: &[Vec3], white: f32, images: Vec<Vec<[u16; 3]>>) -> RawStack {
    RawStack {
        name: scene.name.clone(),
        mask: scene.view.mask.clone(),
        bits: BitDepth::Sixteen,
        images,
        names: (1..=lights.len()).map(|k| format!("{k:03}.png")).collect(),
        lights: lights.to_vec(),
        // An intensity below 1 would lift values above 1, where protocol `official` clips.
        intensities: vec![[1.0 / white.min(1.0); 3]; lights.len()],
        truth: Some(scene.truth().to_vec()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::fibonacci_cap;
    use crate::render::{Options, worlds};

    #[test]
    fn codes_mean_what_was_rendered() {
        let scene = worlds::objects("blob:7+red-plastic").unwrap()[0]
            .scene(&Options { size: 32, ..Options::default() })
            .unwrap();
        let lights = fibonacci_cap(5, 0.8);
        let raw = stack(&scene, &lights, &Sensor::IDEAL, 1);
        for ((&l, image), gain) in lights.iter().zip(&raw.images).zip(&raw.intensities) {
            for (linear, code) in scene.render(l).iter().zip(image) {
                for c in 0..3 {
                    let back = f32::from(code[c]) / 65535.0 / gain[c];
                    assert!(code[c] == 65535 || (back - linear[c]).abs() < 1e-4, "{back} {}", linear[c]);
                }
            }
        }
    }

    #[test]
    fn a_glossy_stack_keeps_its_codes_in_the_official_protocol() {
        let scene = worlds::objects("blob:7+ggx:0.3").unwrap()[0]
            .scene(&Options { size: 32, bounces: 0, ..Options::default() })
            .unwrap();
        assert!(white_level(&scene, SATURATED) > 1.5);
        let raw = stack(&scene, &fibonacci_cap(24, 1.2), &Sensor::IDEAL, 1);
        let seen = crate::eval::Protocol::Official.apply(&raw).unwrap();
        let saturated = raw.images.iter().flatten().filter(|px| **px == [65535; 3]).count();
        let clipped = seen.grey.iter().flatten().filter(|v| **v > 0.9998).count();
        assert_eq!(clipped, saturated);
    }

    #[test]
    fn noise_is_that_of_the_sensor() {
        let grey = vec![[0.25; 3]; 20_000];
        let codes = Sensor::CAMERA.expose(&grey, 1.0, &mut Rng::new(3));
        let values: Vec<f64> = codes.iter().flatten().map(|&v| f64::from(v) / 65535.0).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let deviation = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt();
        // √(2500 + 25) electrons of 10 000.
        assert!((mean - 0.25).abs() < 1e-4 && (deviation - 0.005025).abs() < 1e-4, "{mean} {deviation}");
        assert_eq!(Sensor::IDEAL.expose(&[[2.0, -1.0, f32::NAN]], 1.0, &mut Rng::new(1)), [[65535, 0, 0]]);
        let steps = Sensor { bits: 1, ..Sensor::IDEAL }.expose(&[[0.4, 0.6, 1.0]], 1.0, &mut Rng::new(1));
        assert_eq!(steps, [[0, 65535, 65535]]);
        let bracket = Sensor::IDEAL.bracket(&[[0.1; 3]], &[1.0, 0.05], &mut Rng::new(1));
        assert_eq!(bracket, [[[6554; 3]], [[65535; 3]]]);
    }
}
