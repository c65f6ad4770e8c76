//! Horizon maps: for each pixel and azimuth the elevation up to which other parts of the object stand in the way.
//!
//! Along a ray from a visible point towards a light with z ≥ 0, whatever blocks the *highest* elevation is itself
//! seen by the camera (it is the top of its column), so the map follows from the visible depths alone. It is not exact where
//! light passes *below* an overhang: there the map says shadow (see docs/rendering.md for how often).
//!
//! The march that finds a horizon meets the visible surface elements one after the other; the share of the hemisphere that each
//! takes up is its form factor, so the light exchanged between pixels ([`Exchange`]) comes with it.

use super::real::Real;
use super::view::View;
use glam::Vec3;
use std::f32::consts::{PI, TAU};

/// Sine of the elevation stored where nothing stands in the way. Below any light, and not by more than soft
/// shadows need, because neighbouring azimuths are interpolated.
pub const OPEN: f32 = -0.2;

/// Elevations of the horizon, by azimuth and pixel.
#[derive(Clone, Debug)]
pub struct Horizon {
    /// Number of azimuths A; number i stands at 2π i / A from +x towards +y.
    pub azimuths: usize,
    /// Number of mask pixels P.
    pub pixels: usize,
    /// Sine of the horizon's elevation, in [[`OPEN`], 1]: entry `azimuth · P + pixel`.
    pub sines: Vec<f32>,
}

/// Where the horizon is looked up for one light: between two azimuths.
#[derive(Clone, Copy, Debug)]
pub struct Sector {
    /// The azimuth below.
    pub low: usize,
    /// The azimuth above.
    pub high: usize,
    /// Position between them, 0..1.
    pub t: f32,
    /// Gradient of `t` with respect to the light direction.
    pub t_gradient: Vec3,
}

impl Horizon {
    /// The two azimuths around that of `light`.
    #[must_use]
    pub fn sector(&self, light: Vec3) -> Sector {
        let a = self.azimuths as f32;
        let turn = libm::atan2f(light.y, light.x) / TAU * a;
        let position = if turn < 0.0 { turn + a } else { turn };
        let low = (position as usize).min(self.azimuths - 1);
        let r2 = light.x * light.x + light.y * light.y;
        let t_gradient =
            if r2 > 1e-12 { Vec3::new(-light.y, light.x, 0.0) * (a / TAU / r2) } else { Vec3::ZERO };
        Sector {
            low,
            high: (low + 1) % self.azimuths,
            t: (position - low as f32).clamp(0.0, 1.0),
            t_gradient,
        }
    }

    /// Sines of all pixels at an azimuth number.
    #[must_use]
    pub fn at(&self, azimuth: usize) -> &[f32] {
        &self.sines[azimuth * self.pixels..][..self.pixels]
    }
}

/// Diffuse light between pixels: irradiance at `p` = Σ `weight` · (radiosity of `source`) over its entries.
#[derive(Clone, Debug, Default)]
pub struct Exchange {
    /// Entries of pixel p are `start[p]..start[p + 1]`.
    pub start: Vec<u32>,
    /// Pixel that light comes from.
    pub source: Vec<u32>,
    /// Form factor: share of the cosine-weighted hemisphere.
    pub weight: Vec<f32>,
}

/// Depths of the visible surface on the pixel grid; −∞ where there is none.
struct Depths {
    width: i32,
    height: i32,
    z: Vec<f32>,
    /// Mask pixel number of a grid pixel.
    number: Vec<u32>,
    /// Rise of the surface a pixel to the right and a pixel downwards.
    rise: Vec<[f32; 2]>,
    top: f32,
    pixel: f32,
}

impl Depths {
    fn new(view: &View) -> Self {
        let z: Vec<f32> = view.positions.iter().map(|p| p.z).collect();
        let numbers: Vec<u32> = (0..z.len() as u32).collect();
        let pixel = 2.0 / view.mask.width() as f32;
        let rise: Vec<[f32; 2]> =
            view.normals.iter().map(|n| [-n.x / n.z * pixel, n.y / n.z * pixel]).collect();
        Self {
            rise: view.mask.scatter(&rise, [0.0; 2]),
            width: view.mask.width() as i32,
            height: view.mask.height() as i32,
            top: z.iter().copied().fold(f32::MIN, f32::max),
            z: view.mask.scatter(&z, f32::NEG_INFINITY),
            number: view.mask.scatter(&numbers, u32::MAX),
            pixel,
        }
    }

    /// Walks from pixel (x, y) at azimuth `phi` and calls `raise(slope, pixel)` each time a higher horizon is met;
    /// `slope` is the tangent of its elevation. Starts from the slope `from`.
    #[inline]
    fn march(&self, x: i32, y: i32, ray: &Ray, from: f32, mut raise: impl FnMut(f32, u32)) {
        let here = self.z[(y * self.width + x) as usize];
        let clearance = self.top - here;
        let mut best = from;
        let (mut fx, mut fy, mut distance) = (x as f32, y as f32, 0.0f32);
        loop {
            fx += ray.dx;
            fy += ray.dy;
            distance += ray.length;
            // Nothing is higher than the top: further away the slope can only be less.
            if clearance <= best * distance {
                return;
            }
            // One coordinate is whole, the other lies between two pixels.
            let (x0, y0) = (fx as i32, fy as i32);
            let t = if ray.along_x { fy - y0 as f32 } else { fx - x0 as f32 };
            let (x1, y1) =
                if ray.along_x { (x0, y0 + i32::from(t > 0.0)) } else { (x0 + i32::from(t > 0.0), y0) };
            if fx < 0.0 || fy < 0.0 || x1 >= self.width || y1 >= self.height {
                return;
            }
            let (i, j) = ((y0 * self.width + x0) as usize, (y1 * self.width + x1) as usize);
            let (a, b) = (self.z[i], self.z[j]);
            let (nearest, offset) = if t < 0.5 { (i, t) } else { (j, t - 1.0) };
            // Across a silhouette the depths belong to different surfaces: extend the nearer pixel's.
            let z = if (a - b).abs() <= 4.0 * self.pixel {
                a + (b - a) * t
            } else {
                self.z[nearest] + self.rise[nearest][usize::from(ray.along_x)] * offset
            };
            let slope = (z - here) / distance;
            if slope > best {
                best = slope;
                raise(slope, self.number[nearest]);
            }
        }
    }
}

/// One pixel's step along an azimuth.
struct Ray {
    dx: f32,
    dy: f32,
    /// Length of the step in frame units.
    length: f32,
    along_x: bool,
}

impl Ray {
    fn new(azimuth: usize, azimuths: usize, pixel: f32) -> Self {
        let (s, c) = libm::sincosf(TAU * azimuth as f32 / azimuths as f32);
        // Image rows run against y.
        let (dx, dy) = (c, -s);
        let along_x = dx.abs() >= dy.abs();
        let major = if along_x { dx.abs() } else { dy.abs() };
        let snap = |v: f32, whole: bool| if whole { v.signum() } else { v / major };
        Self { dx: snap(dx, along_x), dy: snap(dy, !along_x), length: pixel / major, along_x }
    }
}

fn sine(slope: f32) -> f32 {
    slope / (1.0 + slope * slope).sqrt()
}

impl Horizon {
    /// The horizon map of a view at `azimuths` directions (at least 4).
    #[must_use]
    pub fn new(view: &View, azimuths: usize) -> Self {
        let azimuths = azimuths.max(4);
        let depths = Depths::new(view);
        let pixels = view.mask.len();
        let mut sines = Vec::with_capacity(azimuths * pixels);
        let open = OPEN / (1.0 - OPEN * OPEN).sqrt();
        for a in 0..azimuths {
            let ray = Ray::new(a, azimuths, depths.pixel);
            for p in 0..pixels {
                let (x, y) = view.mask.position(p);
                let mut best = open;
                depths.march(x as i32, y as i32, &ray, open, |slope, _| best = slope);
                sines.push(sine(best));
            }
        }
        Self { azimuths, pixels, sines }
    }
}

impl Exchange {
    /// Form factors between the pixels of a view, from `azimuths` directions with `levels` elevations each.
    #[must_use]
    pub fn new(view: &View, azimuths: usize, levels: usize) -> Self {
        let depths = Depths::new(view);
        let rays: Vec<(Ray, f32, f32)> = (0..azimuths)
            .map(|a| {
                let (s, c) = libm::sincosf(TAU * a as f32 / azimuths as f32);
                (Ray::new(a, azimuths, depths.pixel), c, s)
            })
            .collect();
        let mut exchange = Self { start: vec![0], ..Self::default() };
        let mut seen: Vec<(f32, u32)> = Vec::new();
        for (p, n) in view.normals.iter().enumerate() {
            let (x, y) = view.mask.position(p);
            for (ray, c, s) in &rays {
                let along = n.x * c + n.y * s;
                // Cosine-weighted share of the sector below an elevation; it is least at the tangent plane.
                let share = |slope: f32| {
                    let cos2 = 1.0 / (1.0 + slope * slope);
                    let angle = libm::atanf(slope);
                    (along * 0.5 * (angle + slope * cos2) + n.z * 0.5 * slope * slope * cos2) * (TAU / PI)
                        / azimuths as f32
                };
                let tangent = -along / n.z;
                let ground = share(tangent);
                seen.clear();
                depths.march(x as i32, y as i32, ray, tangent, |slope, q| {
                    seen.push((share(slope) - ground, q))
                });
                let Some(&(blocked, _)) = seen.last() else { continue };
                if blocked < 1e-5 {
                    continue;
                }
                // The middle of each of `levels` equal shares stands for it.
                for level in 0..levels {
                    let middle = blocked * (level as f32 + 0.5) / levels as f32;
                    if let Some(&(_, q)) = seen.iter().find(|e| e.0 >= middle).filter(|e| e.1 != u32::MAX) {
                        exchange.source.push(q);
                        exchange.weight.push(blocked / levels as f32);
                    }
                }
            }
            exchange.start.push(exchange.source.len() as u32);
        }
        exchange
    }

    /// Adds up what `radiosity` of all pixels sends to each.
    #[must_use]
    pub fn gather<R: Real>(&self, radiosity: &[[R; 3]]) -> Vec<[R; 3]> {
        self.start
            .windows(2)
            .map(|range| {
                let entries = range[0] as usize..range[1] as usize;
                let mut sum = [R::of(0.0); 3];
                for (&q, &w) in self.source[entries.clone()].iter().zip(&self.weight[entries]) {
                    for (s, b) in sum.iter_mut().zip(radiosity[q as usize]) {
                        *s = *s + b * w;
                    }
                }
                sum
            })
            .collect()
    }
}
