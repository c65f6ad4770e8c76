//! The renderer's worlds as training and validation objects, seen by a camera with noise.

use super::fit::Pool;
use super::formation::Scene;
use super::formation::Shading;
use crate::policy::frame::white;
use crate::render::{self, Options, Pose, View, horizon::Horizon, worlds};
use crate::rng::Rng;
use crate::stack::Mask;
use glam::Vec3;
use std::collections::HashMap;
use std::sync::{Arc, Mutex};

/// Read noise of the camera: standard deviation as a share of white (the 99 % quantile of the frontal picture).
pub const READ_NOISE: f32 = 0.003;
/// Shot noise at white, as a share of white; it grows with the square root of the value.
pub const SHOT_NOISE: f32 = 0.01;
/// Seed of the training and validation objects.
const SEED: u64 = 1;

/// A scene seen by a camera with noise: the same picture under the same direction, other noise under any other. Without
/// noise, lights side by side would measure normals as well as lights far apart.
pub struct Noisy<S> {
    scene: S,
    seed: u64,
    white: f32,
}

impl<S: Scene> Noisy<S> {
    /// `scene` with noise drawn from `seed`.
    #[must_use]
    pub fn new(scene: S, seed: u64) -> Self {
        let white = white(&scene.image(Vec3::Z));
        Self { scene, seed, white }
    }

    fn disturb(&self, light: Vec3, rgb: &mut [[f32; 3]]) {
        let bits = light.to_array().map(|v| u64::from(v.to_bits()));
        let mut rng = Rng::stream(self.seed, bits[0] ^ (bits[1] << 21) ^ (bits[2] << 42));
        let read = READ_NOISE * self.white;
        let shot = SHOT_NOISE * SHOT_NOISE * self.white;
        for value in rgb.as_flattened_mut() {
            let deviation = (read * read + shot * *value).sqrt();
            *value = (*value + deviation * rng.normal()).max(0.0);
        }
    }
}

impl<S: Scene> Scene for Noisy<S> {
    fn mask(&self) -> &Mask {
        self.scene.mask()
    }
    fn truth(&self) -> &[Vec3] {
        self.scene.truth()
    }
    fn image(&self, light: Vec3) -> Vec<[f32; 3]> {
        let mut rgb = self.scene.image(light);
        self.disturb(light, &mut rgb);
        rgb
    }
    fn image_with_gradient(&self, light: Vec3) -> Shading {
        let (mut rgb, gradient) = self.scene.image_with_gradient(light);
        self.disturb(light, &mut rgb);
        (rgb, gradient)
    }
}

/// What of an object doesn't depend on its finish.
struct Bare {
    pose: Pose,
    view: View,
    horizon: Horizon,
}

/// The training objects of `worlds`, made when first drawn and kept; each draw gets a finish of its own.
pub struct Training {
    size: u32,
    softness: f32,
    made: Mutex<HashMap<usize, Arc<Bare>>>,
}

/// Azimuths of the training objects' horizon maps: what soft shadows need, in half the memory of the test's.
const AZIMUTHS: usize = 32;

impl Training {
    /// Objects in pictures of `size × size` pixels with shadow boundaries of this softness.
    #[must_use]
    pub fn new(size: u32, softness: f32) -> Self {
        Self { size, softness, made: Mutex::new(HashMap::new()) }
    }

    fn bare(&self, index: usize) -> Arc<Bare> {
        let made = |map: &HashMap<usize, Arc<Bare>>| map.get(&index).cloned();
        if let Some(bare) = made(&self.made.lock().expect("no thread panicked")) {
            return bare;
        }
        let object = worlds::training(SEED, index);
        let pose = Pose::fit(&object.shape, object.rotation).expect("a sculpture can be seen");
        let view = View::new(&object.shape, &pose, self.size).expect("a sculpture can be seen");
        let horizon = Horizon::new(&view, AZIMUTHS);
        let bare = Arc::new(Bare { pose, view, horizon });
        self.made.lock().expect("no thread panicked").insert(index, bare.clone());
        bare
    }
}

impl Pool for Training {
    fn draw(&self, index: usize, rng: &mut Rng) -> Box<dyn Scene> {
        let bare = self.bare(index);
        let finish = worlds::finish(worlds::Split::Train, rng);
        let skin = finish.skin(&bare.view, &bare.pose);
        let scene = render::Scene {
            name: index.to_string(),
            pose: bare.pose,
            view: bare.view.clone(),
            horizon: bare.horizon.clone(),
            exchange: None,
            skin,
            softness: self.softness,
            bounces: 0,
        };
        Box::new(Noisy::new(scene, rng.next_u64()))
    }
}

/// The first validation objects of `worlds`, with one bounce of light and hard shadows.
#[must_use]
pub fn validation(count: usize, size: u32) -> Vec<Box<dyn Scene>> {
    let options = Options { size, softness: 0.0, ..Options::default() };
    (0..count)
        .map(|i| {
            let scene = worlds::validation(SEED, i).scene(&options).expect("a sculpture can be seen");
            Box::new(Noisy::new(scene, i as u64)) as Box<dyn Scene>
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_repeats_for_a_direction_and_differs_between_directions() {
        let scenes = validation(1, 24);
        let (a, b) = (scenes[0].image(Vec3::Z), scenes[0].image(Vec3::Z));
        assert_eq!(a, b);
        let clean = worlds::validation(SEED, 0).scene(&Options { size: 24, ..Options::default() }).unwrap();
        let white = white(&clean.render(Vec3::Z));
        let noise = |l: Vec3| -> Vec<f32> {
            scenes[0].image(l).iter().zip(clean.render(l)).map(|(n, c)| (n[0] - c[0]) / white).collect()
        };
        let (first, other) = (noise(Vec3::Z), noise(crate::light::from_azimuth_slant(0.3, 0.01)));
        let deviation = |n: &[f32]| (n.iter().map(|v| v * v).sum::<f32>() / n.len() as f32).sqrt();
        assert!((0.002..0.02).contains(&deviation(&first)), "{}", deviation(&first));
        assert_ne!(first, other);
    }

    #[test]
    fn the_pool_repeats_itself() {
        let pool = Training::new(20, 0.05);
        let draw = |pool: &Training| pool.draw(3, &mut Rng::new(8)).image(Vec3::new(0.6, 0.0, 0.8));
        assert_eq!(draw(&pool), draw(&pool));
        assert_eq!(draw(&pool), draw(&Training::new(20, 0.05)));
    }
}
