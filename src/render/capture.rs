//! A scene photographed under many lights: what a light stage would deliver of it.

use super::Scene;
use crate::light::fibonacci_cap;
use crate::stack::{BitDepth, RawStack};
use glam::Vec3;

/// Number of lights of [`Capture::stage`].
pub const STAGE_LIGHTS: usize = 100;
/// Largest slant of the lights of [`Capture::stage`], degrees.
pub const STAGE_REACH: f32 = 80.0;
/// The 99.9 % quantile of all values is exposed to this share of the full scale: only highlights saturate.
const EXPOSURE: f32 = 0.9;

/// Photos of a scene, taken one by one.
#[derive(Clone, Debug)]
pub struct Capture {
    scene: Scene,
    lights: Vec<Vec3>,
    images: Vec<Vec<[f32; 3]>>,
}

impl Capture {
    /// Of `scene` under these unit directions.
    #[must_use]
    pub fn new(scene: Scene, lights: Vec<Vec3>) -> Self {
        Self { scene, images: Vec::with_capacity(lights.len()), lights }
    }

    /// Of `scene` under [`STAGE_LIGHTS`] lights, spread evenly up to [`STAGE_REACH`].
    #[must_use]
    pub fn stage(scene: Scene) -> Self {
        Self::new(scene, fibonacci_cap(STAGE_LIGHTS, STAGE_REACH.to_radians()))
    }

    /// Number of lights.
    #[must_use]
    pub fn total(&self) -> usize {
        self.lights.len()
    }

    /// Number of photos taken.
    #[must_use]
    pub fn done(&self) -> usize {
        self.images.len()
    }

    /// Takes the next photo; nothing when all are taken.
    pub fn take_next(&mut self) {
        if let Some(&light) = self.lights.get(self.images.len()) {
            self.images.push(self.scene.render(light));
        }
    }

    /// The stack of 16-bit photos, those still missing taken first.
    #[must_use]
    pub fn finish(mut self) -> RawStack {
        while self.done() < self.total() {
            self.take_next();
        }
        let full = f32::from(u16::MAX);
        let gain = EXPOSURE * full / quantile999(&self.images).max(1e-6);
        let code = |v: f32| (v * gain + 0.5).clamp(0.0, full) as u16;
        let count = self.images.len();
        RawStack {
            name: self.scene.name,
            mask: self.scene.view.mask,
            bits: BitDepth::Sixteen,
            images: self.images.iter().map(|i| i.iter().map(|px| px.map(code)).collect()).collect(),
            names: (1..=count).map(|k| format!("{k:03}.png")).collect(),
            lights: self.lights,
            intensities: vec![[1.0; 3]; count],
            truth: Some(self.scene.view.normals),
        }
    }
}

fn quantile999(images: &[Vec<[f32; 3]>]) -> f32 {
    let mut values: Vec<f32> = images.iter().flatten().flatten().copied().collect();
    if values.is_empty() {
        return 0.0;
    }
    let at = (values.len() - 1) - (values.len() - 1) / 1000; // × 999 would overflow 32 bits
    *values.select_nth_unstable_by(at, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::{Material, Options, Pose, named};

    #[test]
    fn a_captured_sphere_is_a_stack_that_least_squares_solves() {
        let shape = named("sphere").unwrap();
        let pose = Pose::fit(&shape, shape.front()).unwrap();
        let material: Material = "lambert:0.8".parse().unwrap();
        let options = Options { size: 48, bounces: 0, ..Options::default() };
        let scene = Scene::new("sphere", &shape, &pose, &material.into(), &options).unwrap();
        let raw = Capture::new(scene, fibonacci_cap(12, 0.3)).finish();
        assert_eq!((raw.images.len(), raw.names[11].as_str()), (12, "012.png"));
        let brightest = raw.images.iter().flatten().flatten().max().unwrap();
        assert!(*brightest > 55_000);
        let stack = crate::eval::Protocol::Official.apply(&raw).unwrap();
        let seen = crate::solve::Measurements {
            lights: stack.lights.clone(),
            images: stack.grey.iter().map(Vec::as_slice).collect(),
            saturated: Vec::new(),
        };
        let solution = crate::solve::by_name("ls").unwrap().solve(&seen).unwrap();
        assert!(crate::error::mae(&solution.normals, stack.truth.as_deref().unwrap()) < 2.0);
    }
}
