//! What a real rig gets wrong: sensor noise, a light that is not quite where, or as bright as, it is said to be, and
//! that is not infinitely far away.
//!
//! Without this, lights side by side would measure normals as well as lights far apart.

use super::scene::Scene;
use super::sensor::{Sensor, frontal_white};
use crate::rng::Rng;
use glam::Vec3;

/// How well a rig is built and calibrated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerances {
    /// Sets the noise. Exposures are merged (HDR): nothing is cut off or rounded.
    pub sensor: Sensor,
    /// Root mean square of the angle between the light and the direction that the solver is told, radians.
    pub direction: f32,
    /// Standard deviation of a picture's brightness, as a share of it.
    pub intensity: f32,
    /// Distance of the light from the frame's centre, in frame units (half the image); infinite for a collimated one.
    pub distance: f32,
}

impl Tolerances {
    /// A careful amateur's rig: shot noise of 1 % and read noise of 0.3 % at white, 0.5° (a mirror sphere's accuracy), 1 %.
    pub const RIG: Self = Self {
        sensor: Sensor { full_well: 10_000.0, read_noise: 30.0, bits: 16 },
        direction: 0.5 / 180.0 * std::f32::consts::PI,
        intensity: 0.01,
        distance: f32::INFINITY,
    };

    /// Some rig: its directions up to 1.2° wrong, its brightness up to 2.5 %; a share `collimated` of them with a collimated
    /// light, the others with one at 1/`nearest` half widths of the object or farther.
    #[must_use]
    pub fn any(rng: &mut Rng, collimated: f32, nearest: f32) -> Self {
        let collimated = rng.uniform() < collimated;
        Self {
            direction: rng.range(0.0, 1.2f32).to_radians(),
            intensity: rng.range(0.0, 0.025),
            distance: if collimated { f32::INFINITY } else { 1.0 / rng.range(1e-3, nearest) },
            ..Self::RIG
        }
    }
}

/// Cosines of grazing light are taken for this, and no cosine grows more than [`MOST_TURNED`] times.
const LOWEST_COSINE: f32 = 0.05;
const MOST_TURNED: f32 = 2.0;

/// The errors of one capture: drawn from the direction asked for, so that the same direction gives the same picture.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    tolerances: Tolerances,
    seed: u64,
    /// The value that the exposure is set by: the 99 % quantile under frontal light.
    white: f32,
}

impl Errors {
    /// Errors within `tolerances` for captures of `scene`.
    #[must_use]
    pub fn new(scene: &Scene, tolerances: Tolerances, seed: u64) -> Self {
        Self { tolerances, seed, white: frontal_white(scene) }
    }

    /// Where the light really is when it is said to be at the unit direction `said`.
    #[must_use]
    pub fn light(&self, said: Vec3) -> Vec3 {
        let mut rng = self.rng(said, 0);
        let turned = |azimuth: Vec3| azimuth * (rng.normal() * self.tolerances.direction);
        // Two tangents of equal deviation.
        let (a, b) = said.any_orthonormal_pair();
        let [a, b] = [a, b].map(turned);
        let there = said + (a + b) * std::f32::consts::FRAC_1_SQRT_2;
        Vec3::new(there.x, there.y, there.z.max(0.0)).normalize()
    }

    /// What the light's finite distance makes of the value of every mask pixel of `scene`, as a factor; empty for a distant
    /// light. That of diffuse light: highlights stay where a distant light puts them, and so do shadows.
    #[must_use]
    pub fn nearness(&self, scene: &Scene, light: Vec3) -> Vec<f32> {
        if self.tolerances.distance.is_infinite() {
            return Vec::new();
        }
        let place = 1.0 / self.tolerances.distance;
        let pixels = scene.view.positions.iter().zip(&scene.view.normals);
        let factor = |(&p, n): (&Vec3, &Vec3)| {
            let lamp = light - place * p;
            let turned = lamp.dot(*n) / n.dot(light).max(LOWEST_COSINE);
            turned.clamp(0.0, MOST_TURNED) / lamp.length().powi(3)
        };
        pixels.map(factor).collect()
    }

    /// Gives linear values of `scene`, taken with the light said to be at `said`, their brightness and noise.
    pub fn expose(&self, scene: &Scene, said: Vec3, rgb: &mut [[f32; 3]]) {
        for (value, factor) in rgb.iter_mut().zip(self.nearness(scene, self.light(said))) {
            *value = value.map(|v| v * factor);
        }
        let mut rng = self.rng(said, 1);
        let gain = 1.0 + self.tolerances.intensity * rng.normal();
        for value in rgb.as_flattened_mut() {
            *value = self.tolerances.sensor.merged(gain * *value, self.white, &mut rng);
        }
    }

    fn rng(&self, said: Vec3, part: u64) -> Rng {
        let [x, y, z] = said.to_array().map(|v| u64::from(v.to_bits()));
        Rng::stream(self.seed, (x ^ (y << 21) ^ (z << 42)).wrapping_mul(2).wrapping_add(part))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::{angle, fibonacci_cap};
    use crate::render::{Options, worlds};

    #[test]
    fn errors_repeat_and_are_as_large_as_said() {
        let scene = worlds::validation(1, 0).scene(&Options { size: 24, ..Options::default() }).unwrap();
        let errors = Errors::new(&scene, Tolerances::RIG, 7);
        let lights = fibonacci_cap(2000, 1.2);
        let squares: f32 = lights.iter().map(|&l| angle(l, errors.light(l)).powi(2)).sum();
        let rms = (squares / 2000.0).sqrt().to_degrees();
        assert!((rms - 0.5).abs() < 0.02, "{rms}");
        assert_eq!(errors.light(lights[3]), errors.light(lights[3]));

        let picture = |l: Vec3, value: f32| {
            let mut rgb = vec![[value; 3]; 4000];
            errors.expose(&scene, l, &mut rgb);
            rgb.into_flattened()
        };
        assert_eq!(picture(lights[0], 1.0), picture(lights[0], 1.0));
        assert_ne!(picture(lights[0], 1.0), picture(lights[1], 1.0));
        let values = picture(lights[0], errors.white);
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        let deviation = (values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / values.len() as f32).sqrt();
        assert!((deviation / errors.white - 0.01044).abs() < 4e-4, "{}", deviation / errors.white);
        assert!((mean / errors.white - 1.0).abs() < 0.05);
    }

    #[test]
    fn a_near_light_is_brighter_on_its_own_side() {
        let options = Options { size: 32, bounces: 0, ..Options::default() };
        let scene = worlds::objects("sphere+lambert").unwrap()[0].scene(&options).unwrap();
        let at = |distance| Errors::new(&scene, Tolerances { distance, ..Tolerances::RIG }, 1);
        assert!(at(f32::INFINITY).nearness(&scene, Vec3::Z).is_empty());
        let light = Vec3::new(0.6, 0.0, 0.8);
        for ((factor, p), n) in
            at(8.0).nearness(&scene, light).iter().zip(&scene.view.positions).zip(scene.truth())
        {
            let lamp = 8.0 * light - *p;
            let exact = 64.0 * lamp.normalize().dot(*n) / lamp.length_squared();
            if n.dot(light) > 0.1 {
                assert!((factor * n.dot(light) - exact).abs() < 1e-4, "{factor} {exact}");
            }
        }
    }
}
