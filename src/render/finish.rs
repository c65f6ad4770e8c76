//! What covers a shape: one material or a mixture of two in patches, and a coloured albedo texture.

use super::material::Material;
use super::view::{Pose, View};
use crate::rng::Rng;
use glam::Vec3;
use std::f32::consts::TAU;

/// The finish of an object, before it is laid onto pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Finish {
    /// The main material.
    pub material: Material,
    /// A second material, in patches grown from this seed.
    pub patches: Option<(Material, u64)>,
    /// Seed of an albedo texture: multiplies the diffuse albedo by 0.25..1, by place and channel.
    pub texture: Option<u64>,
}

impl From<Material> for Finish {
    fn from(material: Material) -> Self {
        Self { material, patches: None, texture: None }
    }
}

/// The finish of every pixel.
#[derive(Clone, Debug)]
pub struct Skin {
    /// One material, or two.
    pub materials: Vec<Material>,
    /// Share of the second material at each pixel; empty where there is one.
    pub blend: Vec<f32>,
    /// Factor on the diffuse albedo at each pixel; empty for 1.
    pub tint: Vec<[f32; 3]>,
}

/// Smooth noise: a sum of sines, about −1..1, varying over `1/wave` frame units.
struct Noise(Vec<(Vec3, f32)>);

impl Noise {
    fn new(rng: &mut Rng, wave: f32) -> Self {
        let term = |rng: &mut Rng| {
            let k = Vec3::new(rng.range(-1.0, 1.0), rng.range(-1.0, 1.0), rng.range(-1.0, 1.0));
            (k.normalize_or(Vec3::X) * wave * rng.range(0.6, 1.6), rng.range(0.0, TAU))
        };
        Self((0..5).map(|_| term(rng)).collect())
    }

    fn at(&self, p: Vec3) -> f32 {
        self.0.iter().map(|&(k, phase)| libm::sinf(k.dot(p) + phase)).sum::<f32>() * 0.4
    }
}

fn smoothstep(low: f32, high: f32, v: f32) -> f32 {
    let t = ((v - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl Finish {
    /// Lays the finish onto a view. Patterns turn with the object.
    #[must_use]
    pub fn skin(&self, view: &View, pose: &Pose) -> Skin {
        let back = pose.rotation.transpose();
        let places: Vec<Vec3> = view.positions.iter().map(|&p| back * (p - pose.translation)).collect();
        let mut skin = Skin { materials: vec![self.material.clone()], blend: Vec::new(), tint: Vec::new() };
        if let Some((second, seed)) = &self.patches {
            let noise = Noise::new(&mut Rng::stream(*seed, 1), 4.5);
            skin.materials.push(second.clone());
            skin.blend = places.iter().map(|&p| smoothstep(-0.1, 0.1, noise.at(p))).collect();
        }
        if let Some(seed) = self.texture {
            let rng = &mut Rng::stream(seed, 2);
            let (light, hue) = (Noise::new(rng, 6.0), [0; 3].map(|_| Noise::new(rng, 3.0)));
            let channel =
                |p, noise: &Noise| 0.25 + 0.75 * smoothstep(-1.2, 1.2, 0.8 * light.at(p) + 0.5 * noise.at(p));
            skin.tint = places.iter().map(|&p| std::array::from_fn(|c| channel(p, &hue[c]))).collect();
        }
        skin
    }
}

impl Skin {
    /// Diffuse albedo of pixel `p`, RGB.
    #[must_use]
    pub fn albedo(&self, p: usize) -> [f32; 3] {
        let mut kd = self.materials[0].diffuse();
        if let (Some(&w), Some(second)) = (self.blend.get(p), self.materials.get(1)) {
            for (a, b) in kd.iter_mut().zip(second.diffuse()) {
                *a += w * (b - *a);
            }
        }
        if let Some(tint) = self.tint.get(p) {
            for (a, t) in kd.iter_mut().zip(tint) {
                *a *= t;
            }
        }
        kd
    }
}
