//! A simulated camera: any scene seen through exposure, noise and quantisation.

use super::hdr::{Crop, Exposure};
use super::sphere::Circle;
use crate::arm::kinematics::Mount;
use crate::camera::{Camera, CameraError, Observation, check_direction};
use crate::image::Image;
use crate::light;
use crate::rng::Rng;
use crate::stack::{BitDepth, Mask};
use glam::{Vec2, Vec3};
use std::fmt;

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

/// What a simulated camera sees, as `session.json` says it ("sim OBJECT+MATERIAL SIZE AZIMUTH SLANT TILT TILT"): enough to
/// go on with the session anywhere.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedView {
    /// Sculpture.
    pub object: String,
    /// Its material.
    pub material: String,
    /// Side of the picture, pixels.
    pub size: u32,
    /// How the arm really stands.
    pub mount: Mount,
}

impl fmt::Display for SimulatedView {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Mount { azimuth, slant, tilt: [x, y] } = self.mount;
        write!(f, "sim {}+{} {} {azimuth} {slant} {x} {y}", self.object, self.material, self.size)
    }
}

impl SimulatedView {
    /// Of a record's camera; none if that is no simulated one.
    #[must_use]
    pub fn parse(camera: &str) -> Option<Self> {
        let mut words = camera.strip_prefix("sim ")?.split(' ');
        let (object, material) = words.next()?.split_once('+')?;
        let size = words.next()?.parse().ok()?;
        let angles: Option<Vec<f64>> =
            words.map(|w| w.parse().ok().filter(|a: &f64| a.is_finite())).collect();
        let [azimuth, slant, x, y] = angles?.try_into().ok()?;
        let mount = Mount { azimuth, slant, tilt: [x, y] };
        Some(Self { object: object.into(), material: material.into(), size, mount })
    }
}

/// A sensor that looks at a scene, and at a mirror sphere beside it where there is one.
pub struct SimulatedCamera {
    sensor: Sensor,
    rng: Rng,
    ball: bool,
}

/// Angular radius of the simulated LED in the mirror sphere, degrees.
const LED: f64 = 1.5;

impl SimulatedCamera {
    /// `sensor` with the noise of `seed`. With `ball`, a mirror sphere stands to the right of the scene.
    #[must_use]
    pub fn new(sensor: Sensor, seed: u64, ball: bool) -> Self {
        Self { sensor, rng: Rng::new(seed), ball }
    }

    /// The part of the picture that shows the scene; `None` where it is the whole.
    #[must_use]
    pub fn crop(&self, scene: &dyn Camera) -> Option<Crop> {
        let (width, height) = (scene.mask().width(), scene.mask().height());
        self.ball.then_some(Crop { left: 0, top: 0, width, height })
    }

    /// Outline of the mirror sphere in the whole picture.
    #[must_use]
    pub fn ball(&self, scene: &dyn Camera) -> Option<Circle> {
        let (w, h) = (f64::from(scene.mask().width()), f64::from(scene.mask().height()));
        self.ball.then_some(Circle { x: w + 0.5 * h, y: 0.5 * h, radius: 0.42 * h })
    }

    /// One exposure of `scene` with the light where it really is; `brightness` 0 (off) to 1.
    ///
    /// # Errors
    /// [`CameraError`] of the scene.
    pub fn expose(
        &mut self,
        scene: &dyn Camera,
        light: Vec3,
        brightness: f32,
        seconds: f64,
    ) -> Result<Exposure, CameraError> {
        let mask = scene.mask();
        let mut rgb = vec![[0.0; 3]; mask.len()];
        // A light behind the object, or off, lights nothing.
        let lit = brightness > 0.0 && light.z > 0.0;
        if lit {
            let picture = scene.capture(light.normalize(), &[])?;
            rgb = if picture.rgb.is_empty() {
                picture.grey.iter().map(|g| [*g; 3]).collect()
            } else {
                picture.rgb
            };
            rgb.iter_mut().flatten().for_each(|v| *v *= brightness);
        }
        let towards = light.normalize_or_zero().as_dvec3();
        Ok(self.take(scene, &mask.scatter(&rgb, [0.0; 3]), seconds, |circle, x, y| {
            let Some(seen) = circle.reflect(x, y).filter(|_| lit) else { return 0.0 };
            let angle = libm::acos(seen.dot(towards).clamp(-1.0, 1.0)).to_degrees();
            // The LED, and the gloss around it on a sphere that is not perfectly clean.
            let spot = if angle < LED { 4.0 } else { 0.3 * libm::exp(-(angle - LED) / LED) };
            f64::from(brightness) * (0.01 + spot)
        }))
    }

    /// One exposure in room light: what shows the outline of the mirror sphere.
    pub fn room(&mut self, scene: &dyn Camera, seconds: f64) -> Exposure {
        let mask = scene.mask();
        let flat = mask.scatter(&vec![[0.25; 3]; mask.len()], [0.5; 3]);
        self.take(scene, &flat, seconds, |circle, x, y| {
            // A dark ball before a lighter wall, which its rim mirrors.
            let q = ((x - circle.x) * (x - circle.x) + (y - circle.y) * (y - circle.y))
                / (circle.radius * circle.radius);
            if q < 1.0 { 0.1 + 0.08 * q * q } else { 0.5 }
        })
    }

    /// The scene's picture with the sphere to its right, whose brightness at a point is `mirror`.
    fn take(
        &mut self,
        scene: &dyn Camera,
        picture: &[[f32; 3]],
        seconds: f64,
        mirror: impl Fn(&Circle, f64, f64) -> f64,
    ) -> Exposure {
        let (w, h) = (scene.mask().width(), scene.mask().height());
        let Some(circle) = self.ball(scene) else {
            return self.sensor.expose(w, h, picture, seconds, &mut self.rng);
        };
        let mut whole = Vec::with_capacity(((w + h) * h) as usize);
        for (y, row) in picture.chunks_exact(w as usize).enumerate() {
            whole.extend_from_slice(row);
            for x in w..w + h {
                // 3 × 3 samples a pixel.
                let sum: f64 = (0..9)
                    .map(|k| {
                        let part = |k: u32| (f64::from(k) + 0.5) / 3.0;
                        mirror(&circle, f64::from(x) + part(k % 3), y as f64 + part(k / 3))
                    })
                    .sum();
                whole.push([(sum / 9.0) as f32; 3]);
            }
        }
        self.sensor.expose(w + h, h, &whole, seconds, &mut self.rng)
    }
}

/// The mean of several pictures of a webcam: 8-bit sRGB made linear, with less noise than one of them.
pub struct Average {
    width: u32,
    height: u32,
    sum: Vec<[f32; 3]>,
    burnt: Vec<bool>,
    count: u32,
}

/// A picture does not have the size of the first.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{found} bytes of RGBA are not a {width}×{height} picture")]
pub struct AverageError {
    /// Bytes given.
    pub found: usize,
    /// Width of the pictures.
    pub width: u32,
    /// Height of the pictures.
    pub height: u32,
}

impl Average {
    /// No picture yet.
    #[must_use]
    pub fn new(width: u32, height: u32) -> Self {
        let pixels = width as usize * height as usize;
        Self { width, height, sum: vec![[0.0; 3]; pixels], burnt: vec![false; pixels], count: 0 }
    }

    /// Adds a picture: RGBA, 8 bits, row by row. A pixel that is saturated in one of them is so in the mean.
    ///
    /// # Errors
    /// [`AverageError`] for another size.
    pub fn add(&mut self, rgba: &[u8]) -> Result<(), AverageError> {
        if rgba.len() != 4 * self.sum.len() {
            return Err(AverageError { found: rgba.len(), width: self.width, height: self.height });
        }
        let linear: [f32; 256] = std::array::from_fn(|i| srgb_to_linear(i as f32 / 255.0));
        for ((sum, burnt), c) in self.sum.iter_mut().zip(&mut self.burnt).zip(rgba.chunks_exact(4)) {
            for (s, v) in sum.iter_mut().zip(c) {
                *s += linear[usize::from(*v)];
            }
            *burnt |= c[..3].contains(&255);
        }
        self.count += 1;
        Ok(())
    }

    /// The mean as an exposure of so many seconds.
    #[must_use]
    pub fn exposure(&self, seconds: f64) -> Exposure {
        let scale = 65534.0 / self.count.max(1) as f32;
        let code = |v: f32| (v * scale + 0.5) as u16;
        let rgb = self
            .sum
            .iter()
            .zip(&self.burnt)
            .map(|(c, burnt)| if *burnt { [u16::MAX; 3] } else { c.map(code) })
            .collect();
        let image = Image { width: self.width, height: self.height, bits: BitDepth::Sixteen, rgb };
        Exposure { image, seconds, black: 0, white: u16::MAX }
    }
}

/// The linear value of an sRGB one, both 0..=1 (IEC 61966-2-1).
fn srgb_to_linear(v: f32) -> f32 {
    if v <= 0.04045 { v / 12.92 } else { libm::powf((v + 0.055) / 1.055, 2.4) }
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
        let rgb = grey.iter().map(|g| [*g; 3]).collect();
        Ok(Observation::new(direction, direction, grey, rgb))
    }
}

/// Angle between where the light is and where the record says, degrees; for tests of the simulated rig.
#[must_use]
pub fn misplacement(truth: Vec3, recorded: Vec3) -> f64 {
    f64::from(light::angle(truth, recorded)).to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::sphere::{find_outline, measure, values};

    #[test]
    fn what_a_simulated_camera_sees_is_read_back_as_written() {
        let mount = Mount { azimuth: 4.0, slant: -2.0, tilt: [1.5, -1.0] };
        let view = SimulatedView { object: "blob:7".into(), material: "lambert:0.8".into(), size: 96, mount };
        assert_eq!(SimulatedView::parse(&view.to_string()), Some(view));
        for other in [
            "sim",
            "folder:/cam",
            "frames of the page",
            "sim blob:7 96",
            "sim a+b 96 1 2 3",
            "sim a+b 9 1 2 3 NaN",
        ] {
            assert_eq!(SimulatedView::parse(other), None, "{other}");
        }
    }

    #[test]
    fn the_simulated_mirror_sphere_shows_the_light() {
        let scene = Sphere::new(96).unwrap();
        let mut camera = SimulatedCamera::new(Sensor::default(), 1, true);
        let room = camera.room(&scene, 1e-3);
        let grey = values(&room.image);
        let crop = camera.crop(&scene).unwrap();
        let found = find_outline(&grey.view(), |x, y| crop.contains(x, y)).unwrap();
        let truth = camera.ball(&scene).unwrap();
        assert!((found.x - truth.x).abs() < 0.3 && (found.radius - truth.radius).abs() < 0.3, "{found:?}");
        let mut rng = Rng::new(5);
        for _ in 0..20 {
            let light = rng.direction(1.2);
            let picture = camera.expose(&scene, light, 0.8, 1e-3).unwrap();
            let got = measure(&picture, None, &found).unwrap();
            let error = f64::from(light::angle(got.direction, light)).to_degrees();
            assert!(error < 1.5 && error < 4.0 * got.uncertainty, "{error} {got:?}");
        }
    }

    #[test]
    fn webcam_pictures_become_linear() {
        let mut mean = Average::new(2, 1);
        mean.add(&[188, 0, 0, 255, 255, 10, 10, 255]).unwrap();
        mean.add(&[188, 0, 0, 255, 250, 10, 10, 255]).unwrap();
        assert!(mean.add(&[0; 4]).is_err());
        let e = mean.exposure(0.01);
        // sRGB 188 is half the light.
        assert!((f32::from(e.image.rgb[0][0]) / 65535.0 - 0.503).abs() < 0.003);
        assert_eq!((e.image.rgb[0][1], e.image.rgb[1]), (0, [u16::MAX; 3]));
    }
}
