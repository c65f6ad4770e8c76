//! A simulated camera: any scene seen through exposure, noise and quantisation.

use super::hdr::Exposure;
use crate::camera::{Camera, CameraError, Observation, check_direction};
use crate::image::Image;
use crate::light;
use crate::rng::Rng;
use crate::stack::{BitDepth, Mask};
use glam::{Vec2, Vec3};

/// A linear sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Bits of its converter.
    pub bits: u32,
    /// Exposure at which a scene value of 1 just saturates, seconds.
    pub full_exposure: f64,
    /// Electrons at saturation: shot noise is their root; 0 for none.
    pub full_well: f32,
    /// Read noise, electrons.
    pub read_noise: f32,
    /// Code value of black.
    pub black: u16,
    /// Ambient light, in scene values.
    pub ambient: f32,
}

impl Default for Sensor {
    /// The paper's: 12 bits, 1 to 10 ms.
    fn default() -> Self {
        Self { bits: 12, full_exposure: 2e-3, full_well: 10_000.0, read_noise: 3.0, black: 16, ambient: 0.0 }
    }
}

impl Sensor {
    /// Code value at saturation.
    #[must_use]
    pub fn white(&self) -> u16 {
        ((1u32 << self.bits.min(16)) - 1) as u16
    }

    /// What the sensor makes of a scene (linear RGB, row-major) in `seconds`.
    #[must_use]
    pub fn expose(
        &self,
        width: u32,
        height: u32,
        scene: &[[f32; 3]],
        seconds: f64,
        rng: &mut Rng,
    ) -> Exposure {
        let (black, white) = (f32::from(self.black), f32::from(self.white()));
        let gain = (seconds / self.full_exposure) as f32;
        let mut code = |v: f32| {
            let mut z = (v + self.ambient).max(0.0) * gain;
            if self.full_well > 0.0 {
                let electrons = z.min(4.0) * self.full_well;
                let sigma = libm::sqrtf(electrons + self.read_noise * self.read_noise);
                z += sigma * rng.normal() / self.full_well;
            }
            (black + z * (white - black) + 0.5).clamp(0.0, white) as u16
        };
        let rgb = scene.iter().map(|c| c.map(&mut code)).collect();
        let image = Image { width, height, bits: BitDepth::Sixteen, rgb };
        Exposure { image, seconds, black: self.black, white: self.white() }
    }
}

/// A scene in front of a sensor.
pub struct SimulatedCamera<'a> {
    scene: &'a dyn Camera,
    sensor: Sensor,
    rng: Rng,
}

impl<'a> SimulatedCamera<'a> {
    /// `scene` seen by `sensor`, with the noise of `seed`.
    #[must_use]
    pub fn new(scene: &'a dyn Camera, sensor: Sensor, seed: u64) -> Self {
        Self { scene, sensor, rng: Rng::new(seed) }
    }

    /// The sensor.
    #[must_use]
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// One exposure with the light where it really is; `brightness` 0 (off) to 1.
    ///
    /// # Errors
    /// [`CameraError`] of the scene.
    pub fn expose(&mut self, light: Vec3, brightness: f32, seconds: f64) -> Result<Exposure, CameraError> {
        let mask = self.scene.mask();
        let (width, height) = (mask.width(), mask.height());
        let mut rgb = vec![[0.0; 3]; mask.len()];
        // A light behind the object, or off, lights nothing.
        if brightness > 0.0 && light.z > 0.0 {
            let picture = self.scene.capture(light.normalize(), &[])?;
            rgb = if picture.rgb.is_empty() {
                picture.grey.iter().map(|g| [*g; 3]).collect()
            } else {
                picture.rgb
            };
            rgb.iter_mut().flatten().for_each(|v| *v *= brightness);
        }
        Ok(self.sensor.expose(width, height, &mask.scatter(&rgb, [0.0; 3]), seconds, &mut self.rng))
    }
}

/// A white Lambertian sphere: the simplest scene with a known answer.
#[derive(Clone, Debug)]
pub struct Sphere {
    mask: Mask,
    normals: Vec<Vec3>,
}

impl Sphere {
    /// A sphere that fills a `size × size` image but for a margin of 5 %.
    ///
    /// # Errors
    /// [`crate::stack::StackError`] for an image without pixels.
    pub fn new(size: u32) -> Result<Self, crate::stack::StackError> {
        let radius = 0.475 * size as f32;
        let at = |i: u32| {
            let (x, y) = (i % size, i / size);
            Vec2::new(x as f32 + 0.5 - 0.5 * size as f32, 0.5 * size as f32 - y as f32 - 0.5) / radius
        };
        let inside: Vec<bool> = (0..size * size).map(|i| at(i).length_squared() < 0.98).collect();
        let mask = Mask::new(size, size, &inside)?;
        let normals = mask
            .indices()
            .iter()
            .map(|&i| {
                let p = at(i);
                p.extend((1.0 - p.length_squared()).sqrt())
            })
            .collect();
        Ok(Self { mask, normals })
    }

    /// True unit normals of the mask pixels.
    #[must_use]
    pub fn truth(&self) -> &[Vec3] {
        &self.normals
    }
}

impl Camera for Sphere {
    fn mask(&self) -> &Mask {
        &self.mask
    }

    fn capture(&self, direction: Vec3, _: &[Observation]) -> Result<Observation, CameraError> {
        check_direction(direction)?;
        let grey: Vec<f32> = self.normals.iter().map(|n| 0.8 * n.dot(direction).max(0.0)).collect();
        Ok(Observation {
            requested: direction,
            light: direction,
            rgb: grey.iter().map(|g| [*g; 3]).collect(),
            grey,
            effective_images: 1.0,
            index: None,
        })
    }
}

/// Angle between where the light is and where the record says, degrees; for tests of the simulated rig.
#[must_use]
pub fn misplacement(truth: Vec3, recorded: Vec3) -> f64 {
    f64::from(light::angle(truth, recorded)).to_degrees()
}
