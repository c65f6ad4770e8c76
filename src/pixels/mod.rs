//! Synthetic pixels: what single pixels of real objects measure under a set of lights, made on the fly.
//!
//! No shapes and no images: a pixel is a normal, a material, a horizon that hides some lights, the
//! surroundings that reflect light into it, and a sensor. Robust solvers are tuned on such pixels and the
//! pixel network is trained on them, so that real benchmarks stay untouched.

pub mod context;
pub mod expectation;
pub mod fit;
pub mod nearness;
pub mod neighbourhood;
pub mod perceptron;
pub mod tune;

use crate::camera::{Camera, CameraError};
use crate::image::luma;
use crate::light;
use crate::render::worlds::{self, Split};
use crate::render::{Material, Options, RenderError, Scene};
use crate::rng::Rng;
use crate::session::SessionError;
use crate::solve::{SolveError, UnknownSolver, near};
use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// Most of a patch's or lobe's brightness that one sample may carry: a sample stands for a solid angle.
const SAMPLE_LIMIT: f32 = 4.0;

/// Makes synthetic pixels.
#[derive(Clone, Debug)]
pub struct Generator {
    measured: Vec<Material>,
    nearness: Nearness,
}

/// What pixels show of the lamps' nearness.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Nearness {
    /// All of it.
    Whole,
    /// What [`near`] leaves, which may be too much or too little.
    Rest,
}

/// Pixels that share one set of lights.
#[derive(Clone, Debug)]
pub struct Pixels {
    /// The lights as a solver is told them (the true ones differ by calibration errors).
    pub lights: Vec<Vec3>,
    /// For each light the value of every pixel.
    pub images: Vec<Vec<f32>>,
    /// True normals.
    pub normals: Vec<Vec3>,
    /// For each light which pixels are saturated; empty where the sensor has no limit.
    pub saturated: Vec<Vec<bool>>,
}

/// Why pixels of rendered objects can't be made.
#[derive(Debug, thiserror::Error)]
pub enum PixelsError {
    /// An object can't be rendered.
    #[error("{object}: {error}")]
    Object {
        /// Its name.
        object: String,
        /// Why not.
        error: RenderError,
    },
    /// A planner fails on it.
    #[error("{planner}: {error}")]
    Plan {
        /// Its name.
        planner: String,
        /// Why.
        error: SessionError,
    },
    /// A picture can't be taken.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// Its pictures can't be solved.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// There is no such solver.
    #[error(transparent)]
    Solver(#[from] UnknownSolver),
}

/// An object as cameras see it.
fn seen(object: &worlds::Object, size: u32) -> Result<Scene, PixelsError> {
    let scene = object.scene(&Options { size, ..Options::default() });
    scene.map_err(|error| PixelsError::Object { object: object.name.clone(), error })
}

/// Grey values of the pictures under these lights.
fn pictures(camera: &dyn Camera, lights: &[Vec3]) -> Result<Vec<Vec<f32>>, PixelsError> {
    lights.iter().map(|&l| Ok(camera.capture(l, &[])?.grey)).collect()
}

/// One patch of surface of up to two materials.
struct Surface {
    normal: Vec3,
    /// Normals of the facets inside the patch, where it is rough at a scale that the material does not know or
    /// scatters light below its surface; else just the normal.
    facets: Vec<Vec3>,
    materials: [(Material, f32); 2],
}

/// Something beside the pixel that rises above it: it hides lights and reflects them.
struct Wall {
    azimuth: f32,
    half_width: f32,
    elevation: f32,
    patches: Vec<Patch>,
}

/// A piece of a wall as seen from the pixel.
struct Patch {
    direction: Vec3,
    solid_angle: f32,
    surface: Surface,
}

/// What the sensor does, and how wrong the calibration is.
struct Rig {
    full_scale: f32,
    read_noise: f32,
    shot_noise: f32,
    step: f32,
    gain_error: f32,
    direction_error: f32,
    /// The pixel's place on the object in units of the lamps' distance from its centre: it sees lamps elsewhere than the
    /// centre does, those on its own side nearer.
    place: Vec3,
    ambient: f32,
}

impl Surface {
    /// `π f max(n·l, 0)`, grey.
    fn shade(&self, light: Vec3, view: Vec3) -> f32 {
        let mut sum = 0.0;
        for (material, weight) in self.materials.iter().filter(|(_, weight)| *weight > 0.0) {
            for &facet in &self.facets {
                let rgb = material.shade(facet, light, view);
                sum += weight * luma(rgb);
            }
        }
        sum / self.facets.len() as f32
    }
}

impl Wall {
    /// Share of the light from `direction` that passes over the wall; the edge is a few degrees soft, as
    /// lamps and pixels have a size.
    fn visible(&self, direction: Vec3, softness: f32) -> f32 {
        let mut off = (light::azimuth(direction) - self.azimuth).abs() % TAU;
        if off > PI {
            off = TAU - off;
        }
        let t = off / self.half_width;
        let top = self.elevation * (1.0 - t * t).max(0.0);
        let elevation = FRAC_PI_2 - light::slant(direction);
        if top <= 0.0 { 1.0 } else { ((elevation - top) / softness + 0.5).clamp(0.0, 1.0) }
    }
}

impl Generator {
    /// A generator with the measured materials of a split of `worlds-v1` (and GGX, Lambert and mixtures).
    #[must_use]
    pub fn new(split: Split) -> Self {
        Self { measured: split.measured(), nearness: Nearness::Whole }
    }

    /// The same for a solver whose pictures [`near`] has made those of distant lamps.
    #[must_use]
    pub fn with_distant_lamps(self) -> Self {
        Self { nearness: Nearness::Rest, ..self }
    }

    /// A light set of `count` directions: random on a cap, a ring with or without its vertical, a spiral or a
    /// jittered mixture, reaching to a slant of 35° to 88°.
    #[must_use]
    pub fn lights(&self, rng: &mut Rng, count: usize) -> Vec<Vec3> {
        let reach = rng.range(35.0, 88.0).to_radians();
        loop {
            let kind = rng.uniform();
            let mut set: Vec<Vec3> = if kind < 0.5 {
                (0..count).map(|_| rng.direction(reach)).collect()
            } else if kind < 0.62 {
                let mut ring = light::ring(count - 1, rng.range(0.35, 1.0) * reach, rng.range(0.0, TAU));
                ring.push(Vec3::Z);
                ring
            } else if kind < 0.72 {
                light::ring(count, rng.range(0.35, 1.0) * reach, rng.range(0.0, TAU))
            } else if kind < 0.9 {
                let turn = rng.range(0.0, TAU);
                light::fibonacci_cap(count, reach)
                    .into_iter()
                    .map(|l| light::rotate_about_axis(l, turn))
                    .collect()
            } else {
                // Lopsided: all in the cap around some direction within reach.
                let middle = rng.direction(0.7 * reach);
                let spread = rng.range(0.35, 0.9);
                (0..count)
                    .map(|_| {
                        let wanted = rng.direction(1.2) - Vec3::Z * 0.4;
                        (middle + spread * wanted).normalize()
                    })
                    .collect()
            };
            let jitter = if rng.uniform() < 0.5 { 0.0 } else { rng.range(0.0, 0.12) };
            for l in &mut set {
                let moved = *l + jitter * Vec3::new(rng.normal(), rng.normal(), 0.0);
                *l = Vec3::new(moved.x, moved.y, moved.z.max(0.02)).normalize();
            }
            if crate::solve::least_squares::pseudo_inverse(&set).is_ok() {
                return set;
            }
        }
    }

    /// `count` pixels under `lights`.
    #[must_use]
    pub fn pixels(&self, rng: &mut Rng, lights: Vec<Vec3>, count: usize) -> Pixels {
        let mut images = vec![vec![0.0; count]; lights.len()];
        let mut normals = Vec::with_capacity(count);
        for p in 0..count {
            let (normal, values) = self.pixel(rng, &lights);
            normals.push(normal);
            for (image, v) in images.iter_mut().zip(values) {
                image[p] = v;
            }
        }
        let saturated = images.iter().map(|i| i.iter().map(|&v| v >= 1.0).collect()).collect();
        Pixels { lights, images, normals, saturated }
    }

    /// One pixel's true normal, and its value under each light.
    fn pixel(&self, rng: &mut Rng, lights: &[Vec3]) -> (Vec3, Vec<f32>) {
        let normal = facing_camera(rng);
        let surface = self.surface(rng, normal);
        let walls = self.walls(rng, &surface);
        let softness = rng.range(0.5, 6.0).to_radians();
        // At an edge a pixel sees two surfaces.
        let second = (rng.uniform() < 0.08).then(|| {
            let share = rng.range(0.05, 0.45);
            let normal = facing_camera(rng);
            (self.surface(rng, normal), share)
        });
        // Too few lights show none of it.
        let nearness = if lights.len() < near::LEAST_LIGHTS { Nearness::Whole } else { self.nearness };
        let rig = Rig::random(rng, normal, nearness);
        let mut values: Vec<f32> = lights
            .iter()
            .map(|&l| {
                let lamp = l - rig.place;
                let turned = lamp + rig.direction_error * unit_normal(rng);
                let true_light = turned.normalize();
                let passed = walls.iter().map(|w| w.visible(true_light, softness)).fold(1.0, f32::min);
                let mut v = surface.shade(true_light, Vec3::Z) * passed;
                if let Some((other, share)) = &second {
                    v = v * (1.0 - share) + share * other.shade(true_light, Vec3::Z);
                }
                for patch in walls.iter().flat_map(|w| &w.patches) {
                    let lit = patch.surface.shade(true_light, -patch.direction).min(SAMPLE_LIMIT);
                    let reflected = surface.shade(patch.direction, Vec3::Z).min(SAMPLE_LIMIT);
                    v += reflected * lit * patch.solid_angle / PI;
                }
                v / lamp.length_squared() * (1.0 + rig.gain_error * rng.normal()).max(0.1)
            })
            .collect();
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        values.iter_mut().for_each(|v| *v += rig.ambient * mean);
        rig.expose(rng, &mut values);
        (surface.normal, values)
    }

    fn surface(&self, rng: &mut Rng, normal: Vec3) -> Surface {
        let first = Material::any(rng, &self.measured);
        let (second, share) = if rng.uniform() < 0.2 {
            (Material::any(rng, &self.measured), rng.uniform())
        } else {
            (first.clone(), 0.0)
        };
        let facets = if rng.uniform() < 0.15 {
            let spread = rng.range(0.02, 0.25);
            (0..4).map(|_| (normal + spread * unit_normal(rng)).normalize()).collect()
        } else {
            vec![normal]
        };
        Surface { normal, facets, materials: [(first, 1.0 - share), (second, share)] }
    }

    /// What stands around the pixel: nothing for more than half of them.
    fn walls(&self, rng: &mut Rng, surface: &Surface) -> Vec<Wall> {
        let count = match rng.uniform() {
            u if u < 0.5 => 0,
            u if u < 0.78 => 1,
            u if u < 0.93 => 2,
            _ => 3,
        };
        (0..count)
            .map(|_| {
                // A slope faces the opposite wall of its valley more often than not.
                let ahead = light::azimuth(surface.normal);
                let azimuth =
                    if rng.uniform() < 0.6 { ahead + 0.6 * rng.normal() } else { rng.range(-PI, PI) };
                let half_width = rng.range(20.0, 110.0).to_radians();
                let elevation = rng.range(5.0, 80.0).to_radians();
                let pieces = 1 + rng.below(2);
                let solid_angle =
                    2.0 * half_width * libm::sinf(elevation) * rng.range(0.3, 0.9) / pieces as f32;
                let patches = (0..pieces).map(|_| self.patch(rng, surface, azimuth, half_width, elevation));
                let patches = patches.map(|p| Patch { solid_angle, ..p }).collect();
                Wall { azimuth, half_width, elevation, patches }
            })
            .collect()
    }

    fn patch(&self, rng: &mut Rng, near: &Surface, azimuth: f32, half_width: f32, top: f32) -> Patch {
        let azimuth = azimuth + 0.5 * half_width * rng.range(-1.0, 1.0);
        let direction = light::from_azimuth_slant(azimuth, FRAC_PI_2 - top * rng.uniform());
        // It looks back at the pixel and more or less up.
        let normal = loop {
            let back = azimuth + PI + rng.range(-0.9, 0.9);
            let n = light::from_azimuth_slant(back, rng.range(10.0, 95.0).to_radians());
            if n.dot(direction) < -0.05 {
                break n;
            }
        };
        // Mostly of the same material as the pixel.
        let surface = if rng.uniform() < 0.75 {
            Surface { normal, facets: vec![normal], materials: near.materials.clone() }
        } else {
            self.surface(rng, normal)
        };
        Patch { direction, solid_angle: 0.0, surface }
    }
}

impl Rig {
    fn random(rng: &mut Rng, normal: Vec3, nearness: Nearness) -> Self {
        let eight_bit = rng.uniform() < 0.3;
        let brightest = if rng.uniform() < 0.15 { 1.2 } else { 0.0 };
        Self {
            // How bright the pixel's brightest value is in units of the sensor's full scale: above 1 it saturates.
            full_scale: libm::expf(rng.range(-3.0, brightest)),
            read_noise: libm::expf(rng.range(-9.2, -5.5)),
            shot_noise: libm::expf(rng.range(-12.0, -7.5)),
            step: if eight_bit { 1.0 / 255.0 } else { 1.0 / 65535.0 },
            gain_error: rng.uniform() * 0.04,
            direction_error: rng.uniform() * 0.025,
            place: place(rng, normal, nearness),
            ambient: if rng.uniform() < 0.5 { 0.0 } else { rng.uniform() * 0.04 },
        }
    }

    /// Exposure, noise, saturation and quantisation.
    fn expose(&self, rng: &mut Rng, values: &mut [f32]) {
        let brightest = values.iter().copied().fold(1e-12, f32::max);
        for v in values {
            let exposed = *v / brightest * self.full_scale;
            let noise =
                libm::sqrtf(self.read_noise * self.read_noise + self.shot_noise * exposed) * rng.normal();
            let clipped = (exposed + noise).clamp(0.0, 1.0);
            *v = libm::roundf(clipped / self.step) * self.step;
        }
    }
}

/// How far off the estimate of [`near`] may be.
const LEFT: f32 = 0.035;

/// Where a pixel with this normal is, in units of the lamps' distance: lamps stand seven half widths of the object away or
/// farther, and what faces right is more often on the right.
fn place(rng: &mut Rng, normal: Vec3, nearness: Nearness) -> Vec3 {
    let kind = rng.uniform();
    let half_width = match nearness {
        _ if kind < 0.3 => 0.0,
        // Some surfaces hide it.
        Nearness::Rest if kind > 0.45 => rng.range(-LEFT, LEFT),
        _ => rng.range(0.0, 0.15),
    };
    let bulge = if rng.uniform() < 0.7 { rng.uniform() } else { 0.0 };
    let at = bulge * normal + (1.0 - bulge) * 0.5 * unit_normal(rng);
    half_width * Vec3::new(at.x, at.y, 0.7 * (at.z - 0.5 * bulge)).clamp_length_max(1.0)
}

/// A normal as cameras see them: mostly uniform over the disc of a sphere's picture, some nearer the rim.
fn facing_camera(rng: &mut Rng) -> Vec3 {
    if rng.uniform() < 0.25 {
        return rng.direction(85f32.to_radians());
    }
    let radius = libm::sqrtf(rng.uniform()) * 0.998;
    let phi = rng.range(0.0, TAU);
    Vec3::new(radius * libm::cosf(phi), radius * libm::sinf(phi), libm::sqrtf(1.0 - radius * radius))
}

fn unit_normal(rng: &mut Rng) -> Vec3 {
    Vec3::new(rng.normal(), rng.normal(), rng.normal())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_are_finite_and_repeat() {
        let generator = Generator::new(Split::Train);
        let make = |seed| {
            let mut rng = Rng::new(seed);
            let lights = generator.lights(&mut rng, 10);
            generator.pixels(&mut rng, lights, 300)
        };
        let (a, b) = (make(5), make(5));
        assert_eq!(a.images, b.images);
        assert!(a.images.iter().flatten().all(|v| v.is_finite() && (0.0..=1.0).contains(v)));
        assert!(a.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-5 && n.z > 0.0));
    }

    #[test]
    fn a_wall_hides_low_lights_on_its_side() {
        let wall = Wall { azimuth: 3.0, half_width: 0.7, elevation: 0.8, patches: Vec::new() };
        let at = |azimuth, elevation| {
            wall.visible(light::from_azimuth_slant(azimuth, FRAC_PI_2 - elevation), 0.02)
        };
        assert_eq!(at(3.0, 0.5), 0.0);
        assert_eq!(at(3.0 - TAU, 0.5), 0.0); // the same azimuth
        assert_eq!(at(3.0, 1.0), 1.0);
        assert_eq!(at(0.0, 0.1), 1.0);
    }
}
