//! An object ready to be seen under any light: everything that does not depend on the light is computed once.

use super::RenderError;
use super::finish::{Finish, Skin};
use super::horizon::{Exchange, Horizon};
use super::material::{Directions, Lit, Material};
use super::real::{Dual, Real, V3};
use super::tolerance::{Errors, Tolerances};
use super::view::{Pose, Shape, View};
use crate::camera::{Camera, CameraError, Observation, check_direction};
use crate::stack::Mask;
use glam::Vec3;

/// How a scene is prepared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Width and height of the images.
    pub size: u32,
    /// Azimuths of the horizon map.
    pub azimuths: usize,
    /// Width of the shadow boundary in the sine of the elevation; 0 for hard shadows, 0.05 for useful gradients.
    pub softness: f32,
    /// Diffuse bounces of light between parts of the object.
    pub bounces: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self { size: 128, azimuths: 64, softness: 0.0, bounces: 1 }
    }
}

/// Azimuths and levels of the form factors.
const EXCHANGE: (usize, usize) = (24, 2);

/// An object, its finish and pose, as one camera sees it.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name of the object.
    pub name: String,
    /// How it stands.
    pub pose: Pose,
    /// The visible surface.
    pub view: View,
    /// Cast shadows.
    pub horizon: Horizon,
    /// Light between the pixels; `None` without bounces.
    pub exchange: Option<Exchange>,
    /// Materials of the pixels.
    pub skin: Skin,
    /// Width of the shadow boundary in the sine of the elevation.
    pub softness: f32,
    /// Diffuse bounces.
    pub bounces: u32,
}

impl Scene {
    /// Prepares an object.
    ///
    /// # Errors
    /// [`RenderError`] for an impossible size, or an object that the camera does not see.
    pub fn new(
        name: &str,
        shape: &Shape,
        pose: &Pose,
        finish: &Finish,
        options: &Options,
    ) -> Result<Self, RenderError> {
        let view = View::new(shape, pose, options.size)?;
        let horizon = Horizon::new(&view, options.azimuths);
        let exchange = (options.bounces > 0).then(|| Exchange::new(&view, EXCHANGE.0, EXCHANGE.1));
        let skin = finish.skin(&view, pose);
        let softness = options.softness.max(0.0);
        Ok(Self {
            name: name.into(),
            pose: *pose,
            view,
            horizon,
            exchange,
            skin,
            softness,
            bounces: options.bounces,
        })
    }

    /// True unit normals of the mask pixels.
    #[must_use]
    pub fn truth(&self) -> &[Vec3] {
        &self.view.normals
    }

    /// Linear RGB of every mask pixel under a unit direction; a white Lambertian patch facing the light is 1.
    #[must_use]
    pub fn render(&self, light: Vec3) -> Vec<[f32; 3]> {
        let shadow = Shadow::new(self, V3::<f32>::of(light));
        self.image(V3::<f32>::of(light), |p| shadow.visibility(p))
    }

    /// [`Scene::render`] with cast shadows from elsewhere, as the exact ones of [`super::Tracer::visibility`]: whether each
    /// mask pixel sees the light.
    ///
    /// # Panics
    /// If `visible` has fewer entries than the mask has pixels.
    #[must_use]
    pub fn render_with_shadows(&self, light: Vec3, visible: &[bool]) -> Vec<[f32; 3]> {
        self.image(V3::<f32>::of(light), |p| f32::from(u8::from(visible[p])))
    }

    /// [`Scene::render`] with the gradient of each value by the light direction's three components.
    ///
    /// At hard shadow boundaries (softness 0) the gradient of the shadow is left out.
    #[must_use]
    pub fn render_with_gradient(&self, light: Vec3) -> Vec<[Dual; 3]> {
        let light = Dual::inputs(light);
        let shadow = Shadow::new(self, light);
        self.image(light, |p| shadow.visibility(p))
    }

    /// Share of the light that reaches every mask pixel past the other parts of the object, 0..1. Attached
    /// shadows (n·l ≤ 0) are not in it.
    #[must_use]
    pub fn visibility(&self, light: Vec3) -> Vec<f32> {
        let shadow = Shadow::new(self, V3::<f32>::of(light));
        (0..self.view.mask.len()).map(|p| shadow.visibility(p)).collect()
    }

    /// The picture, where `visibility(p)` is the share of the light that cast shadows leave to pixel p.
    fn image<R: Real>(&self, light: V3<R>, visibility: impl Fn(usize) -> R) -> Vec<[R; 3]> {
        let direction = light.value();
        let directions = Directions::new(light, Vec3::Z);
        let lits: Vec<Lit<R>> = self.skin.materials.iter().map(|m| m.lit(&directions)).collect();
        let black = [R::of(0.0); 3];
        let mut irradiance = Vec::new();
        let mut image = Vec::with_capacity(self.view.mask.len());
        for (p, &n) in self.view.normals.iter().enumerate() {
            let seen = if n.dot(direction) > 0.0 { visibility(p) } else { R::of(0.0) };
            if self.exchange.is_some() {
                irradiance.push(light.dot(n).max(R::of(0.0)) * seen);
            }
            if seen.value() <= 0.0 {
                image.push(black);
                continue;
            }
            let tint = self.skin.tint.get(p).copied().unwrap_or([1.0; 3]);
            let mut value = lits[0].shade(n, tint);
            if let (Some(&w), Some(second)) = (self.skin.blend.get(p), lits.get(1)) {
                let other = second.shade(n, tint);
                value = std::array::from_fn(|c| value[c] * (1.0 - w) + other[c] * w);
            }
            image.push(value.map(|v| v * seen));
        }
        if let Some(exchange) = &self.exchange {
            let mut radiosity: Vec<[R; 3]> =
                (0..image.len()).map(|p| self.skin.albedo(p).map(|kd| irradiance[p] * kd)).collect();
            for _ in 0..self.bounces {
                radiosity = exchange.gather(&radiosity);
                for (p, (b, value)) in radiosity.iter_mut().zip(&mut image).enumerate() {
                    for ((b, v), kd) in b.iter_mut().zip(value).zip(self.skin.albedo(p)) {
                        *b = *b * kd;
                        *v = *v + *b;
                    }
                }
            }
        }
        image
    }

    /// All that the physics needs, as flat arrays, so that a trainer can repeat it in tensor form.
    ///
    /// # Errors
    /// [`RenderError::Export`] for GGX, which the arrays have no place for.
    pub fn buffers(&self) -> Result<Buffers, RenderError> {
        let row = |m: &Material| match m {
            Material::Lambert([r, g, b]) => Ok([*r, *g, *b, 0.0, 0.0, 0.0, 1.0, 1.0, 1.5]),
            Material::Abc(m) => {
                let ([r, g, b], [x, y, z]) = (m.kd, m.a);
                Ok([r, g, b, x, y, z, m.b, m.c, m.ior])
            }
            Material::Ggx(_) => Err(RenderError::Export(m.name())),
        };
        Ok(Buffers {
            size: self.view.mask.width(),
            pixels: self.view.mask.indices().to_vec(),
            normals: self.view.normals.iter().flat_map(|n| n.to_array()).collect(),
            azimuths: self.horizon.azimuths,
            horizon: self.horizon.sines.clone(),
            materials: self.skin.materials.iter().map(row).collect::<Result<_, _>>()?,
            blend: self.skin.blend.clone(),
            tint: self.skin.tint.iter().flatten().copied().collect(),
            exchange: self.exchange.clone().unwrap_or_default(),
            bounces: self.bounces,
        })
    }
}

/// A scene as flat arrays. P is the number of mask pixels, A that of azimuths.
///
/// The image: for light `l`, view `v` = (0,0,1) and `h` = normalize(l + v), pixel p with normal n has
/// `seen · Σ_m share_m · (kd·tint·(n·l) + F·a·(1 + b(1 − n·h))^−c · min(1, 2(n·h)(n·l)/(h·v), 2(n·h)(n·v)/(h·v)) / (n·v))`
/// where n·l > 0; `seen` = smoothstep((l.z − horizon)/softness + ½), with the horizon interpolated linearly between the
/// azimuths on either side of atan2(l.y, l.x).
#[derive(Clone, Debug)]
pub struct Buffers {
    /// Width and height of the image.
    pub size: u32,
    /// Row-major position of each mask pixel. P.
    pub pixels: Vec<u32>,
    /// Unit normals. P × 3.
    pub normals: Vec<f32>,
    /// A.
    pub azimuths: usize,
    /// Sine of the horizon's elevation. A × P: all pixels of azimuth 0 (+x) first, azimuths turn towards +y.
    pub horizon: Vec<f32>,
    /// One or two materials: kd RGB, a RGB, b, c, ior.
    pub materials: Vec<[f32; 9]>,
    /// Share of the second material. P, or empty.
    pub blend: Vec<f32>,
    /// Factor on kd. P × 3, or empty.
    pub tint: Vec<f32>,
    /// Form factors between pixels; empty without bounces.
    pub exchange: Exchange,
    /// Diffuse bounces.
    pub bounces: u32,
}

/// Cast shadows under one light.
struct Shadow<'a, R> {
    low: &'a [f32],
    high: &'a [f32],
    t: R,
    elevation: R,
    softness: f32,
}

impl<'a, R: Real> Shadow<'a, R> {
    fn new(scene: &'a Scene, light: V3<R>) -> Self {
        let sector = scene.horizon.sector(light.value());
        Self {
            low: scene.horizon.at(sector.low),
            high: scene.horizon.at(sector.high),
            t: R::with_gradient(sector.t, sector.t_gradient),
            elevation: light.z,
            softness: scene.softness,
        }
    }

    #[inline]
    fn visibility(&self, p: usize) -> R {
        let horizon = self.t * (self.high[p] - self.low[p]) + self.low[p];
        let above = self.elevation - horizon;
        if self.softness <= 0.0 {
            return R::of(if above.value() > 0.0 { 1.0 } else { 0.0 });
        }
        let s = (above * (1.0 / self.softness) + 0.5).clamp(0.0, 1.0);
        s * s * (s * -2.0 + 3.0)
    }
}

/// A scene as a camera: a picture under exactly the direction asked for. Grey is the mean of RGB.
#[derive(Clone, Copy, Debug)]
pub struct SceneCamera<'a> {
    scene: &'a Scene,
    errors: Option<Errors>,
}

impl<'a> SceneCamera<'a> {
    /// A camera without noise that sees `scene`, under a light that is exactly where it is said to be.
    #[must_use]
    pub fn new(scene: &'a Scene) -> Self {
        Self { scene, errors: None }
    }

    /// A real rig's camera: with errors within `tolerances`, drawn from `seed`.
    #[must_use]
    pub fn real(scene: &'a Scene, tolerances: Tolerances, seed: u64) -> Self {
        Self { scene, errors: Some(Errors::new(scene, tolerances, seed)) }
    }
}

impl Camera for SceneCamera<'_> {
    fn mask(&self) -> &Mask {
        &self.scene.view.mask
    }

    fn capture(&self, direction: Vec3, _: &[Observation]) -> Result<Observation, CameraError> {
        check_direction(direction)?;
        let mut rgb = self.scene.render(self.errors.map_or(direction, |e| e.light(direction)));
        if let Some(errors) = self.errors {
            errors.expose(self.scene, direction, &mut rgb);
        }
        let grey = rgb.iter().map(|[r, g, b]| (r + g + b) / 3.0).collect();
        Ok(Observation::new(direction, direction, grey, rgb))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::{fibonacci_cap, fibonacci_hemisphere};
    use crate::render::named;
    use crate::solve::{LeastSquares, Measurements, Solver};

    fn scene(name: &str, material: &str, options: &Options) -> Scene {
        let shape = named(name).unwrap();
        let pose = Pose::fit(&shape, shape.front()).unwrap();
        let material: Material = material.parse().unwrap();
        Scene::new(name, &shape, &pose, &material.into(), options).unwrap()
    }

    fn plain(size: u32) -> Options {
        Options { size, bounces: 0, ..Options::default() }
    }

    #[test]
    fn least_squares_recovers_a_lambertian_sphere() {
        // Lights so steep that only the border of the sphere turns away from one: solve what all of them see.
        let s = scene("sphere", "lambert:0.8", &plain(128));
        let lights = fibonacci_cap(20, 0.35);
        let images: Vec<Vec<f32>> =
            lights.iter().map(|&l| s.render(l).iter().map(|v| v[0]).collect()).collect();
        let m = Measurements {
            lights: lights.clone(),
            images: images.iter().map(Vec::as_slice).collect(),
            saturated: Vec::new(),
        };
        let solution = LeastSquares.solve(&m).unwrap();
        let lit = |p: &usize| lights.iter().all(|l| s.truth()[*p].dot(*l) > 0.0);
        let pixels: Vec<usize> = (0..s.view.mask.len()).filter(lit).collect();
        assert!(pixels.len() * 4 > s.view.mask.len() * 3);
        let sum: f32 =
            pixels.iter().map(|&p| crate::error::unit_angle(solution.normals[p], s.truth()[p])).sum();
        let mae = (sum / pixels.len() as f32).to_degrees();
        assert!(mae < 0.05, "{mae}");
    }

    #[test]
    fn a_convex_object_casts_no_shadow_on_itself() {
        let s = scene("sphere", "lambert", &plain(96));
        let (mut wrong, mut lit) = (0, 0);
        for l in fibonacci_hemisphere(60) {
            let seen = s.visibility(l);
            lit += s.truth().iter().filter(|n| n.dot(l) > 0.0).count();
            wrong += s.truth().iter().zip(&seen).filter(|(n, v)| n.dot(l) > 0.0 && **v < 1.0).count();
        }
        // A few pixels at the silhouette, where a neighbour's depth stands for half a pixel.
        assert!(wrong * 1000 < lit, "{wrong} of {lit}");
    }

    #[test]
    fn gradients_match_finite_differences() {
        let options = Options { size: 24, softness: 0.2, bounces: 1, azimuths: 32 };
        for (name, material) in [("blob:3", "red-plastic"), ("figure:1", "teflon"), ("lattice:2", "lambert")]
        {
            let s = scene(name, material, &options);
            let (mut sum, mut off) = (0.0f64, 0.0f64);
            for l in fibonacci_cap(30, 1.3) {
                let exact = s.render_with_gradient(l);
                let axis = l.any_orthonormal_vector();
                let h = 1e-3;
                let (a, b) = (s.render((l + axis * h).normalize()), s.render((l - axis * h).normalize()));
                for p in 0..exact.len() {
                    for c in 0..3 {
                        let numeric = (a[p][c] - b[p][c]) / (2.0 * h);
                        let analytic = exact[p][c].gradient.dot(axis);
                        sum += f64::from(analytic.abs());
                        off += f64::from((numeric - analytic).abs());
                    }
                }
            }
            // Kinks (azimuth bins, n·l = 0, the geometric term) fall between the two pictures for a few pixels.
            assert!(off < 0.02 * sum, "{name}: {off} of {sum}");
        }
    }

    #[test]
    fn a_light_bounces_inside_a_bowl() {
        let direct = scene("bowl", "lambert:0.8", &plain(64));
        let one = scene("bowl", "lambert:0.8", &Options { size: 64, bounces: 1, ..Options::default() });
        let many = scene("bowl", "lambert:0.8", &Options { size: 64, bounces: 40, ..Options::default() });
        let mean = |s: &Scene| {
            s.render(Vec3::Z).iter().map(|v| f64::from(v[0])).sum::<f64>() / s.view.mask.len() as f64
        };
        let (d, o, m) = (mean(&direct), mean(&one), mean(&many));
        assert!(d < o && o < m, "{d} {o} {m}");
        // A hemispherical cavity of radius 1 sends half of its light to itself.
        let factor = one.exchange.as_ref().unwrap();
        let centre = one.view.mask.indices().iter().position(|&i| i == 32 * 64 + 32).unwrap();
        let to_centre: f32 =
            factor.weight[factor.start[centre] as usize..factor.start[centre + 1] as usize].iter().sum();
        assert!((to_centre - 0.5).abs() < 0.1, "{to_centre}");
    }

    #[test]
    fn the_camera_gives_the_direction_asked_for() {
        let s = scene("relief:1", "gray-plastic", &plain(32));
        let camera = SceneCamera::new(&s);
        let o = camera.capture(Vec3::new(0.6, 0.0, 0.8), &[]).unwrap();
        assert_eq!((o.light, o.grey.len()), (o.requested, s.view.mask.len()));
        assert!(o.grey.iter().all(|v| v.is_finite()) && o.grey.iter().any(|&v| v > 0.0));
        assert!(camera.capture(-Vec3::Z, &[]).is_err());
        assert_eq!(s.buffers().unwrap().horizon.len(), 64 * s.view.mask.len());
    }
}
