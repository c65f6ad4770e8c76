//! Reflectance: the 100 measured ABC materials, Lambert, GGX.
//!
//! Values are `π f(l, v) max(n·l, 0)`: the radiance under a distant light whose irradiance is π, so that a
//! white Lambertian patch facing the light has the value 1.

use super::real::{Real, V3};
use crate::rng::Rng;
use glam::Vec3;
use std::sync::LazyLock;

/// A measured material: the ABC microfacet fit of Löw et al. 2012.
///
/// `f = kd/π + F(θ_d) D G / (π cosθ_i cosθ_o)` with `D = a/(1 + b(1−cosθ_h))^c`,
/// `G = min(1, 2cosθ_h cosθ_i/cosθ_d, 2cosθ_h cosθ_o/cosθ_d)` and unpolarised Fresnel F of `ior`.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Abc {
    /// Name in the MERL database, as "alum-bronze".
    pub name: String,
    /// Diffuse albedo, RGB.
    pub kd: [f32; 3],
    /// Height of the lobe, RGB.
    pub a: [f32; 3],
    /// Inverse width of the lobe.
    pub b: f32,
    /// Fall-off of the lobe.
    pub c: f32,
    /// Index of refraction.
    pub ior: f32,
}

/// A conductor-like microfacet material: GGX distribution, separable Smith shadowing (Walter et al. 2007),
/// Schlick's Fresnel term.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ggx {
    /// Diffuse albedo, RGB.
    pub kd: [f32; 3],
    /// Reflectance at normal incidence, RGB; 0 for no lobe.
    pub f0: [f32; 3],
    /// Width α of the distribution, in (0, 1].
    pub alpha: f32,
}

/// What a surface is made of.
#[derive(Clone, Debug, PartialEq)]
pub enum Material {
    /// Ideal diffuse of this RGB albedo.
    Lambert([f32; 3]),
    /// A measured material.
    Abc(Abc),
    /// GGX.
    Ggx(Ggx),
}

/// Why a material can't be found or read.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum MaterialError {
    /// No such name.
    #[error(
        "no material '{0}': write a name of models/materials/abc.json (as {1}), lambert, lambert:ALBEDO, \
             ggx:ALPHA or ggx:ALPHA:F0"
    )]
    Unknown(String, String),
    /// A number is out of range.
    #[error("material '{text}': {what} must lie in ({low}, {high}]")]
    Range {
        /// The whole text.
        text: String,
        /// Which number.
        what: &'static str,
        /// Above this.
        low: f32,
        /// Up to this.
        high: f32,
    },
}

static ABC: LazyLock<Vec<Abc>> = LazyLock::new(|| {
    let mut rows: Vec<Abc> = serde_json::from_str(include_str!("../../models/materials/abc.json"))
        .expect("the committed file is valid");
    for row in &mut rows {
        if let Some((_, scale)) = ENERGY_SCALE.iter().find(|(name, _)| *name == row.name) {
            row.a = row.a.map(|a| a * scale);
            row.kd = row.kd.map(|kd| kd * scale);
        }
    }
    rows
});

/// Fits that reflect more light than they receive at some angle (up to 89° from the normal), and the factor
/// on `kd` and `a` that brings the worst angle and channel to 1. All others are used as published.
pub const ENERGY_SCALE: &[(&str, f32)] = &[];

impl Abc {
    /// The 100 measured materials in the order of the file, with [`ENERGY_SCALE`] applied.
    #[must_use]
    pub fn all() -> &'static [Self] {
        &ABC
    }

    /// The material of a name.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        ABC.iter().find(|m| m.name == name)
    }
}

/// A light and viewing direction, with what depends on nothing else: computed once an image.
#[derive(Clone, Copy, Debug)]
pub struct Directions<R> {
    light: V3<R>,
    view: Vec3,
    half: V3<R>,
    cos_d: R,
}

impl<R: Real> Directions<R> {
    /// Of unit vectors towards the light and towards the viewer.
    #[must_use]
    pub fn new(light: V3<R>, view: Vec3) -> Self {
        let sum = light.plus(view);
        let length = sum.length().max(R::of(1e-6));
        let half = V3 { x: sum.x / length, y: sum.y / length, z: sum.z / length };
        let cos_d = half.dot(view).clamp(1e-4, 1.0);
        Self { light, view, half, cos_d }
    }
}

/// A material under one light direction: [`Lit::shade`] is what remains to be done for every normal.
#[derive(Clone, Copy, Debug)]
pub struct Lit<R> {
    directions: Directions<R>,
    kd: [f32; 3],
    lobe: Lobe<R>,
}

#[derive(Clone, Copy, Debug)]
enum Lobe<R> {
    None,
    /// F·a (RGB), b, −c.
    Abc([R; 3], f32, f32),
    /// F (RGB), α².
    Ggx([R; 3], f32),
}

impl Material {
    /// Some material: half of the time one of the `measured` ones, else Lambert, plastic, paint, glaze, metallic paint or metal.
    #[must_use]
    pub fn any(rng: &mut Rng, measured: &[Self]) -> Self {
        let kind = rng.uniform();
        if kind < 0.5 && !measured.is_empty() {
            return measured[rng.below(measured.len())].clone();
        }
        if kind < 0.55 {
            return Self::Lambert([rng.range(0.05, 1.0); 3]);
        }
        let (kd, f0, alpha) = if kind < 0.8 {
            // Plastic, paint, glaze.
            (rng.range(0.02, 0.9), rng.range(0.02, 0.15), rng.range(0.04, 0.7))
        } else if kind < 0.9 {
            // Metallic paint: a broad lobe over little that is diffuse.
            (rng.range(0.02, 0.3), rng.range(0.1, 0.7), rng.range(0.25, 0.8))
        } else {
            (rng.range(0.0, 0.05), rng.range(0.4, 1.0), rng.range(0.1, 0.6))
        };
        Self::Ggx(Ggx { kd: [kd; 3], f0: [f0; 3], alpha })
    }

    /// The material under a light.
    #[must_use]
    pub fn lit<R: Real>(&self, directions: &Directions<R>) -> Lit<R> {
        let (kd, lobe) = match self {
            Self::Lambert(kd) => (*kd, Lobe::None),
            Self::Abc(m) => {
                let fresnel = fresnel(directions.cos_d, m.ior);
                let lobe = Lobe::Abc(m.a.map(|a| fresnel * a), m.b, -m.c);
                (m.kd, if m.a == [0.0; 3] { Lobe::None } else { lobe })
            }
            Self::Ggx(m) => {
                let s = -directions.cos_d + 1.0;
                let s5 = s * s * s * s * s;
                let lobe = Lobe::Ggx(m.f0.map(|f0| s5 * (1.0 - f0) + f0), m.alpha * m.alpha);
                (m.kd, if m.f0 == [0.0; 3] { Lobe::None } else { lobe })
            }
        };
        Lit { directions: *directions, kd, lobe }
    }

    /// `π f max(n·l, 0)` for unit vectors: normal, light, viewer. RGB; 0 where light or viewer are behind.
    #[must_use]
    pub fn shade(&self, normal: Vec3, light: Vec3, view: Vec3) -> [f32; 3] {
        self.lit(&Directions::new(V3::of(light), view)).shade(normal, [1.0; 3])
    }

    /// Diffuse albedo, RGB.
    #[must_use]
    pub fn diffuse(&self) -> [f32; 3] {
        match self {
            Self::Lambert(kd) => *kd,
            Self::Abc(m) => m.kd,
            Self::Ggx(m) => m.kd,
        }
    }

    /// Name, as `from_str` reads it.
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            Self::Lambert([r, g, b]) if r == g && g == b => format!("lambert:{r}"),
            Self::Lambert([r, g, b]) => format!("lambert:{r},{g},{b}"),
            Self::Abc(m) => m.name.clone(),
            Self::Ggx(m) => format!("ggx:{}:{}", m.alpha, m.f0[1]),
        }
    }
}

impl<R: Real> Lit<R> {
    /// `π f max(n·l, 0)` at a unit normal; `tint` multiplies the diffuse albedo.
    #[inline]
    #[must_use]
    pub fn shade(&self, normal: Vec3, tint: [f32; 3]) -> [R; 3] {
        let d = &self.directions;
        let cos_i = d.light.dot(normal);
        let cos_o = d.view.dot(normal);
        if cos_i.value() <= 0.0 || cos_o <= 0.0 {
            return [R::of(0.0); 3];
        }
        let kd = &self.kd;
        let diffuse = [cos_i * (kd[0] * tint[0]), cos_i * (kd[1] * tint[1]), cos_i * (kd[2] * tint[2])];
        let (colour, shape) = match self.lobe {
            Lobe::None => return diffuse,
            Lobe::Abc(colour, b, minus_c) => {
                // 1 − cosθ_h as |h − n|²/2: the lobes are so narrow that the difference would lose them.
                let one_minus_cos = d.half.plus(-normal).length_squared() * 0.5;
                let cos_h = (-one_minus_cos + 1.0).max(R::of(0.0));
                let distribution = (one_minus_cos * b + 1.0).powf(minus_c);
                let twice = cos_h * 2.0 / d.cos_d;
                let shadowing = R::of(1.0).min(twice * cos_i).min(twice * cos_o);
                (colour, distribution * shadowing * (1.0 / cos_o))
            }
            Lobe::Ggx(colour, alpha2) => {
                let cos_h = d.half.dot(normal).clamp(0.0, 1.0);
                let t = cos_h * cos_h * (alpha2 - 1.0) + 1.0;
                // π D G1(l) G1(v) / (4 cos_o), G1 = 2cos/(cos + √(α² + (1−α²)cos²)).
                let distribution = R::of(alpha2) / (t * t);
                let root = |c: R| (c * c * (1.0 - alpha2) + alpha2).sqrt() + c;
                let towards_view = cos_o + (cos_o * cos_o * (1.0 - alpha2) + alpha2).sqrt();
                (colour, distribution * cos_i / root(cos_i) * (1.0 / towards_view))
            }
        };
        let [r, g, b] = diffuse;
        [r + colour[0] * shape, g + colour[1] * shape, b + colour[2] * shape]
    }
}

/// Unpolarised Fresnel reflectance of a dielectric, at the angle whose cosine is given.
fn fresnel<R: Real>(cos: R, ior: f32) -> R {
    let g = (cos * cos + (ior * ior - 1.0)).max(R::of(0.0)).sqrt();
    let near = (g - cos) / (g + cos);
    let other = (cos * (g + cos) - 1.0) / (cos * (g - cos) + 1.0);
    near * near * (other * other + 1.0) * 0.5
}

impl std::str::FromStr for Material {
    type Err = MaterialError;

    fn from_str(text: &str) -> Result<Self, MaterialError> {
        if let Some(m) = Abc::named(text) {
            return Ok(Self::Abc(m.clone()));
        }
        let unknown = || MaterialError::Unknown(text.into(), "green-plastic".into());
        let number = |part: &str, what, low, high| {
            let value: f32 = part.parse().map_err(|_| unknown())?;
            if value > low && value <= high {
                Ok(value)
            } else {
                Err(MaterialError::Range { text: text.into(), what, low, high })
            }
        };
        let parts: Vec<&str> = text.split(':').collect();
        match parts[..] {
            ["lambert"] => Ok(Self::Lambert([1.0; 3])),
            ["lambert", albedo] => Ok(Self::Lambert([number(albedo, "the albedo", 0.0, 1.0)?; 3])),
            ["ggx", alpha] | ["ggx", alpha, _] => {
                let f0 = parts.get(2).map_or(Ok(1.0), |f0| number(f0, "F0", 0.0, 1.0))?;
                let alpha = number(alpha, "alpha", 0.0, 1.0)?;
                Ok(Self::Ggx(Ggx { kd: [0.0; 3], f0: [f0; 3], alpha }))
            }
            _ => Err(unknown()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::from_azimuth_slant;
    use crate::render::real::Dual;

    /// Largest share of light that leaves again, over channels, for a viewer at `slant` from the normal.
    fn albedo(m: &Material, slant: f32) -> f64 {
        let (view, b) = match m {
            Material::Abc(m) => (from_azimuth_slant(0.0, slant), m.b),
            Material::Ggx(m) => (from_azimuth_slant(0.0, slant), 1.0 / (m.alpha * m.alpha)),
            Material::Lambert(_) => (from_azimuth_slant(0.0, slant), 1.0),
        };
        // Over half vectors, dense where the lobe is: u = ln(1 + b(1−cosθ_h)), dω_l = 4 (v·h) dω_h.
        let (rings, spokes) = (400, 64);
        let top = (1.0 + f64::from(b)).ln();
        let mut sum = [0.0f64; 3];
        for i in 0..rings {
            let x = (((i as f64 + 0.5) / rings as f64 * top).exp() - 1.0) / f64::from(b);
            let dx = (x + 1.0 / f64::from(b)) * top / rings as f64;
            for j in 0..spokes {
                let phi = std::f32::consts::TAU * (j as f32 + 0.5) / spokes as f32;
                let h = from_azimuth_slant(phi, ((2.0 * x - x * x).max(0.0).sqrt()).atan2(1.0 - x) as f32);
                let cos_d = view.dot(h);
                let light = 2.0 * cos_d * h - view;
                if cos_d <= 0.0 || light.z <= 0.0 {
                    continue;
                }
                let weight = 4.0 * f64::from(cos_d) * dx * std::f64::consts::TAU / spokes as f64;
                let value = m.shade(Vec3::Z, light, view);
                for (s, v) in sum.iter_mut().zip(value) {
                    *s += f64::from(v) * weight / std::f64::consts::PI;
                }
            }
        }
        sum.into_iter().fold(0.0, f64::max)
    }

    const SLANTS: [f32; 9] = [0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 80.0, 85.0, 89.0];

    #[test]
    fn no_material_reflects_more_than_it_receives() {
        let mut all: Vec<Material> = Abc::all().iter().cloned().map(Material::Abc).collect();
        all.push(Material::Lambert([1.0; 3]));
        for alpha in [0.05, 0.2, 0.5, 1.0] {
            all.push(Material::Ggx(Ggx { kd: [0.0; 3], f0: [1.0; 3], alpha }));
        }
        let mut over = Vec::new();
        for m in &all {
            let worst = SLANTS.iter().map(|s| albedo(m, s.to_radians())).fold(0.0, f64::max);
            println!("{} {worst:.3}", m.name());
            if worst > 1.0 + 5e-3 {
                over.push(format!("(\"{}\", {:.3})", m.name(), 1.0 / worst));
            }
        }
        assert!(over.is_empty(), "over: {}", over.join(",\n"));
    }

    #[test]
    fn lambert_is_the_cosine() {
        let l = from_azimuth_slant(0.3, 1.0);
        let m = Material::Lambert([0.25, 0.5, 1.0]);
        let [r, g, b] = m.shade(Vec3::Z, l, Vec3::Z);
        assert!((r - 0.25 * l.z).abs() < 1e-6 && (g - 0.5 * l.z).abs() < 1e-6 && (b - l.z).abs() < 1e-6);
        assert_eq!(m.shade(Vec3::Z, -Vec3::Z, Vec3::Z), [0.0; 3]);
    }

    #[test]
    fn abc_is_the_formula() {
        // By hand from the printed formula, f64, for one row and one pair of directions.
        let m = Abc::named("red-plastic").unwrap();
        let (n, l) = (from_azimuth_slant(0.5, 0.4), from_azimuth_slant(-0.7, 0.9));
        let h = (l + Vec3::Z).normalize();
        let (ci, co, ch, cd) = (n.dot(l) as f64, n.z as f64, n.dot(h) as f64, h.z as f64);
        let g = (f64::from(m.ior).powi(2) - 1.0 + cd * cd).sqrt();
        let f = 0.5
            * ((g - cd) / (g + cd)).powi(2)
            * (1.0 + ((cd * (g + cd) - 1.0) / (cd * (g - cd) + 1.0)).powi(2));
        let d = f64::from(m.a[0]) / (1.0 + f64::from(m.b) * (1.0 - ch)).powf(f64::from(m.c));
        let shadowing = 1f64.min(2.0 * ch * ci / cd).min(2.0 * ch * co / cd);
        let pi = std::f64::consts::PI;
        let expected = pi * (f64::from(m.kd[0]) / pi + f * d * shadowing / (pi * ci * co)) * ci;
        let got = Material::Abc(m.clone()).shade(n, l, Vec3::Z)[0];
        assert!((f64::from(got) - expected).abs() < 1e-4 * expected, "{got} {expected}");
    }

    #[test]
    fn lobes_are_reciprocal() {
        // f(l, v) = f(v, l): shade divides by the cosine that changes roles.
        let (l, v) = (from_azimuth_slant(0.2, 0.5), from_azimuth_slant(2.0, 1.0));
        for m in ["brass", "red-plastic", "white-fabric", "ggx:0.3"] {
            let m: Material = m.parse().unwrap();
            let (a, b) = (m.shade(Vec3::Z, l, v)[0] / l.z, m.shade(Vec3::Z, v, l)[0] / v.z);
            assert!((a - b).abs() < 1e-4 * a.abs(), "{} {a} {b}", m.name());
        }
    }

    #[test]
    fn gradients_match_finite_differences() {
        let n = from_azimuth_slant(0.9, 0.5);
        let step = 1e-3f32;
        for m in ["red-plastic", "teflon", "nickel", "ggx:0.4:0.6", "lambert:0.7"] {
            let m: Material = m.parse().unwrap();
            for l in crate::light::fibonacci_cap(40, 1.2) {
                if n.dot(l) < 0.05 {
                    continue;
                }
                let dual = m.lit(&Directions::new(Dual::inputs(l), Vec3::Z)).shade(n, [1.0; 3])[1];
                for axis in [l.any_orthonormal_vector(), l.cross(l.any_orthonormal_vector())] {
                    let at = |s: f32| m.shade(n, (l + axis * s).normalize(), Vec3::Z)[1];
                    let numeric = (at(step) - at(-step)) / (2.0 * step);
                    let analytic = dual.gradient.dot(axis);
                    let tolerance = 0.02 * analytic.abs() + 0.02 * dual.value.max(0.05);
                    assert!((numeric - analytic).abs() < tolerance, "{} {numeric} {analytic}", m.name());
                }
            }
        }
    }

    #[test]
    fn names_are_read_and_refused() {
        assert_eq!(Abc::all().len(), 100);
        for good in ["lambert", "lambert:0.5", "ggx:0.2", "ggx:0.2:0.9", "brass"] {
            assert!(good.parse::<Material>().is_ok(), "{good}");
        }
        for bad in ["", "brass ", "lambert:2", "lambert:nan", "ggx", "ggx:0", "ggx:0.1:7", "ggx:0.1:1:1"] {
            assert!(bad.parse::<Material>().is_err(), "{bad}");
        }
    }
}
