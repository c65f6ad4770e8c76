//! Procedural sculptures: implicit surfaces grown from a seed, so that nothing has to be downloaded.
//!
//! A sculpture is a function of space, negative inside: forms joined by smooth unions and cuts, then twisted and
//! rippled. It need not be a distance, but never changes faster than `1/step`. Normals are its exact gradient.

use super::real::{Dual, Real, V3};
use crate::rng::Rng;
use glam::{Mat3, Vec3};
use std::f32::consts::{PI, TAU};

/// The families of sculptures, each with a line for people.
pub const FAMILIES: &[(&str, &str)] = &[
    ("sphere", "the unit sphere (no seed)"),
    ("bowl", "an open hemispherical bowl (no seed)"),
    ("blob", "smooth lumps with hollows and soft folds"),
    ("relief", "a carved plate: bumps, grooves, wavy ridges"),
    ("drape", "cloth falling over hidden things: long folds"),
    ("vase", "thin fluted vessels, open towards the viewer"),
    ("coral", "branches: thin parts that shade each other"),
    ("totem", "stacked blocks, rings and balls with sharp edges"),
    ("figure", "a standing figure with arms and a pleated robe"),
    ("knot", "a torus knot: a tube that crosses itself"),
    ("lattice", "a ball with a labyrinth carved into it (a cut gyroid)"),
    ("stone", "a broken stone: flat faces, ridges, chips"),
];

/// Why there is no such sculpture.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("no sculpture '{name}': {}", right(name))]
pub struct UnknownSculpture {
    name: String,
}

/// Families that are one object each, not one a seed.
const SEEDLESS: [&str; 2] = ["sphere", "bowl"];

/// What would be right instead of `name`.
fn right(name: &str) -> String {
    let family = name.split(':').next().unwrap_or_default();
    if SEEDLESS.contains(&family) {
        return format!("{family} takes no seed, write {family}");
    }
    let seeded: Vec<&str> = FAMILIES.iter().map(|f| f.0).filter(|f| !SEEDLESS.contains(f)).collect();
    format!(
        "write FAMILY:SEED (as blob:7), where FAMILY is one of {}; or {}, without a seed",
        seeded.join(", "),
        SEEDLESS.join(" or ")
    )
}

/// Which way up a sculpture can be shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Upright {
    /// Any rotation.
    Any,
    /// Standing: turned about y, tilted a little.
    Standing,
    /// Lying open: tilted towards the viewer.
    Open,
    /// A plate seen from the front.
    Front,
}

/// An implicit surface within about the unit ball; y up, z towards the front.
#[derive(Clone, Debug)]
pub struct Sculpture {
    name: String,
    parts: Vec<Part>,
    /// Turn about y per unit of y, radians.
    twist: f32,
    waves: Vec<Wave>,
    step: f32,
    upright: Upright,
}

#[derive(Clone, Debug)]
struct Part {
    form: Form,
    join: Join,
    /// Radius over which the joint is rounded.
    blend: f32,
    center: Vec3,
    /// Rows of the rotation from the sculpture's to the part's axes.
    axes: [Vec3; 3],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Join {
    Add,
    Cut,
    Keep,
}

#[derive(Clone, Debug)]
enum Form {
    Ellipsoid(Vec3),
    /// Along y from −half (radius `low`) to +half (radius `high`).
    Limb {
        half: f32,
        low: f32,
        high: f32,
    },
    /// Around y.
    Ring {
        major: f32,
        minor: f32,
    },
    Block {
        half: Vec3,
        round: f32,
    },
    /// `strands` tubes wound `turns/strands` times around a ring about z.
    Knot {
        ring: f32,
        winding: f32,
        tube: f32,
        turns: f32,
        strands: u32,
    },
    Vessel(Vessel),
    /// Solid below z = h(x, y).
    Field(Field),
    /// Walls of the gyroid of this wave number.
    Gyroid {
        wave: f32,
        wall: f32,
    },
}

/// A wall of revolution about y.
#[derive(Clone, Debug)]
struct Vessel {
    radius: f32,
    /// Amplitude, wave number, phase of the profile's waves.
    profile: Vec<[f32; 3]>,
    wall: f32,
    /// Amplitude of the flutes around the wall, 4 or 8 of them.
    flute: f32,
    eight: bool,
}

#[derive(Clone, Debug, Default)]
struct Field {
    bumps: Vec<Bump>,
    folds: Vec<Fold>,
}

/// A smooth hill `height (1 − r²/radius²)³`.
#[derive(Clone, Debug)]
struct Bump {
    x: f32,
    y: f32,
    radius: f32,
    height: f32,
}

/// Parallel folds: `height · crest(k·p + bend · sin(m·p))`.
#[derive(Clone, Debug)]
struct Fold {
    k: [f32; 2],
    phase: f32,
    m: [f32; 2],
    bend: f32,
    height: f32,
    /// Roundness of the crest; large: a sine, small: a sharp crease.
    round: f32,
}

/// `height · sin(k·p + phase)` added to the whole sculpture.
#[derive(Clone, Debug)]
struct Wave {
    k: Vec3,
    phase: f32,
    height: f32,
}

impl Form {
    fn at<R: Real>(&self, p: V3<R>) -> R {
        match self {
            Self::Ellipsoid(r) => {
                let inverse = r.recip();
                let near = p.scale(inverse);
                let far = near.scale(inverse);
                let k0 = near.length();
                k0 * (k0 - 1.0) / far.length().max(R::of(1e-4))
            }
            Self::Limb { half, low, high } => {
                let along = p.y.clamp(-half, *half);
                let t = (along + *half) * (0.5 / half);
                let dy = p.y - along;
                (p.x * p.x + dy * dy + p.z * p.z).sqrt() - (t * (high - low) + *low)
            }
            Self::Ring { major, minor } => {
                let q = (p.x * p.x + p.z * p.z).sqrt() - *major;
                (q * q + p.y * p.y).sqrt() - *minor
            }
            Self::Block { half, round } => {
                let q = [
                    p.x.abs() - (half.x - round),
                    p.y.abs() - (half.y - round),
                    p.z.abs() - (half.z - round),
                ];
                let zero = R::of(0.0);
                let out = q.map(|v| v.max(zero));
                let outside = (out[0] * out[0] + out[1] * out[1] + out[2] * out[2]).sqrt();
                outside + q[0].max(q[1]).max(q[2]).min(zero) - *round
            }
            Self::Knot { ring, winding, tube, turns, strands } => {
                let rho = (p.x * p.x + p.y * p.y).sqrt() - *ring;
                let theta = p.y.atan2(p.x) * (turns / *strands as f32);
                let mut best = R::of(1e3);
                for j in 0..*strands {
                    let (s, c) = (theta + TAU * j as f32 / *strands as f32).sin_cos();
                    let (dx, dz) = (rho - c * *winding, p.z - s * *winding);
                    best = best.min((dx * dx + dz * dz).sqrt());
                }
                best - *tube
            }
            Self::Vessel(v) => {
                let rho = (p.x * p.x + p.z * p.z + 1e-8).sqrt();
                let mut radius = R::of(v.radius);
                for &[height, k, phase] in &v.profile {
                    radius = radius + (p.y * k + phase).sin_cos().0 * height;
                }
                // cos 4θ or cos 8θ by doubling the angle.
                let mut c = p.x / rho;
                for _ in 0..if v.eight { 3 } else { 2 } {
                    c = c * c * 2.0 - 1.0;
                }
                (rho - radius * (c * v.flute + 1.0)).abs() - v.wall
            }
            Self::Field(f) => p.z - f.height(p.x, p.y),
            Self::Gyroid { wave, wall } => {
                let ((sx, cx), (sy, cy), (sz, cz)) =
                    ((p.x * *wave).sin_cos(), (p.y * *wave).sin_cos(), (p.z * *wave).sin_cos());
                (sx * cy + sy * cz + sz * cx).abs() * (1.0 / wave) - *wall
            }
        }
    }
}

impl Field {
    fn height<R: Real>(&self, x: R, y: R) -> R {
        let mut h = R::of(0.0);
        for b in &self.bumps {
            let (dx, dy) = (x - b.x, y - b.y);
            let t = -((dx * dx + dy * dy) * (1.0 / (b.radius * b.radius))) + 1.0;
            if t.value() > 0.0 {
                h = h + t * t * t * b.height;
            }
        }
        for f in &self.folds {
            let bend = (x * f.m[0] + y * f.m[1]).sin_cos().0 * f.bend;
            let s = (x * f.k[0] + y * f.k[1] + bend + f.phase).sin_cos().0;
            // √(s² + r²) is |s| with a rounded crease.
            h = h + (-(s * s + f.round * f.round).sqrt() + 1.0) * f.height;
        }
        h
    }
}

/// The smaller of two, rounded over `k` (cubic: second derivatives are continuous).
fn smooth_min<R: Real>(a: R, b: R, k: f32) -> R {
    let m = a.min(b);
    if k <= 0.0 {
        return m;
    }
    let h = (-(a - b).abs() + k).max(R::of(0.0));
    m - h * h * h * (1.0 / (6.0 * k * k))
}

impl Sculpture {
    /// The sculpture of a name: "sphere", "blob:7", …
    ///
    /// # Errors
    /// [`UnknownSculpture`] with the families there are.
    pub fn named(name: &str) -> Result<Self, UnknownSculpture> {
        let unknown = || UnknownSculpture { name: name.into() };
        let (family, seed) = match name.split_once(':') {
            Some((family, seed)) => (family, Some(seed.parse::<u64>().map_err(|_| unknown())?)),
            None => (name, None),
        };
        match (family, seed) {
            ("sphere", None) => {
                Ok(Self::solid(name, vec![Part::add(Form::Ellipsoid(Vec3::ONE), Vec3::ZERO)]))
            }
            ("bowl", None) => Ok(bowl()),
            (family, Some(seed)) => Self::grown(family, seed).ok_or_else(unknown),
            _ => Err(unknown()),
        }
    }

    /// The sculpture of a family and seed; `None` for a family without seeds or an unknown one.
    #[must_use]
    pub fn grown(family: &str, seed: u64) -> Option<Self> {
        let number = FAMILIES.iter().position(|f| f.0 == family)?;
        let rng = &mut Rng::stream(seed, number as u64);
        let mut s = match family {
            "blob" => blob(rng),
            "relief" => relief(rng),
            "drape" => drape(rng),
            "vase" => vase(rng),
            "coral" => coral(rng),
            "totem" => totem(rng),
            "figure" => figure(rng),
            "knot" => knot(rng),
            "lattice" => lattice(rng),
            "stone" => stone(rng),
            _ => return None,
        };
        s.name = format!("{family}:{seed}");
        Some(s)
    }

    fn solid(name: &str, parts: Vec<Part>) -> Self {
        Self { name: name.into(), parts, twist: 0.0, waves: Vec::new(), step: 0.8, upright: Upright::Any }
    }

    /// Its name, as [`Sculpture::named`] reads it.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Which way up it can be shown.
    #[must_use]
    pub fn upright(&self) -> Upright {
        self.upright
    }

    /// How far, as a share of the function's value, a ray can go without passing through the surface.
    #[must_use]
    pub fn step(&self) -> f32 {
        self.step
    }

    /// The function at `p`: negative inside.
    pub fn at<R: Real>(&self, p: V3<R>) -> R {
        let mut q = p;
        if self.twist != 0.0 {
            let (s, c) = (p.y * self.twist).sin_cos();
            q = V3 { x: c * p.x - s * p.z, y: p.y, z: s * p.x + c * p.z };
        }
        let mut f = R::of(10.0);
        for part in &self.parts {
            let d = part.form.at(q.plus(-part.center).turned(&part.axes));
            f = match part.join {
                Join::Add => smooth_min(f, d, part.blend),
                Join::Cut => -smooth_min(-f, d, part.blend),
                Join::Keep => -smooth_min(-f, -d, part.blend),
            };
        }
        for w in &self.waves {
            f = f + (p.dot(w.k) + w.phase).sin_cos().0 * w.height;
        }
        f
    }

    /// The unit outward normal at a surface point: the exact gradient.
    #[must_use]
    pub fn normal(&self, p: Vec3) -> Vec3 {
        self.at(Dual::inputs(p)).gradient.normalize_or(Vec3::Z)
    }
}

impl Part {
    fn add(form: Form, center: Vec3) -> Self {
        let axes = [Vec3::X, Vec3::Y, Vec3::Z];
        Self { form, join: Join::Add, blend: 0.0, center, axes }
    }

    fn cut(form: Form, center: Vec3) -> Self {
        Self { join: Join::Cut, ..Self::add(form, center) }
    }

    fn keep(form: Form, center: Vec3) -> Self {
        Self { join: Join::Keep, ..Self::add(form, center) }
    }

    fn blend(self, blend: f32) -> Self {
        Self { blend, ..self }
    }

    fn turned(self, rotation: Mat3) -> Self {
        let axes = [rotation.x_axis, rotation.y_axis, rotation.z_axis];
        Self { axes, ..self }
    }

    /// A limb from `a` to `b`.
    fn limb(a: Vec3, b: Vec3, low: f32, high: f32) -> Self {
        let y = (b - a).normalize_or(Vec3::Y);
        let x = y.any_orthonormal_vector();
        let half = (0.5 * (b - a).length()).max(1e-3);
        Self::add(Form::Limb { half, low, high }, 0.5 * (a + b)).turned(Mat3::from_cols(x, y, x.cross(y)))
    }
}

/// A rotation drawn evenly from all rotations.
pub(crate) fn any_rotation(rng: &mut Rng) -> Mat3 {
    let (u, a, b) = (rng.uniform(), TAU * rng.uniform(), TAU * rng.uniform());
    let ((sa, ca), (sb, cb)) = (libm::sincosf(a), libm::sincosf(b));
    let (p, q) = ((1.0 - u).sqrt(), u.sqrt());
    Mat3::from_quat(glam::Quat::from_xyzw(p * sa, p * ca, q * sb, q * cb))
}

fn somewhere(rng: &mut Rng, radius: f32) -> Vec3 {
    let r = radius * libm::cbrtf(rng.uniform());
    let side = if rng.uniform() < 0.5 { -1.0 } else { 1.0 };
    r * side * rng.direction(PI / 2.0)
}

/// `count` ripples with wave numbers in `low..high`, heights such that each has the slope `slope`.
fn ripples(rng: &mut Rng, count: usize, low: f32, high: f32, slope: f32) -> Vec<Wave> {
    (0..count)
        .map(|_| {
            let k = rng.range(low, high);
            let direction = somewhere(rng, 1.0).normalize_or(Vec3::Y);
            Wave { k: direction * k, phase: rng.range(0.0, TAU), height: slope / k }
        })
        .collect()
}

fn bowl() -> Sculpture {
    let parts = vec![
        Part::add(Form::Ellipsoid(Vec3::ONE), Vec3::ZERO),
        Part::cut(Form::Ellipsoid(Vec3::splat(0.88)), Vec3::ZERO).blend(0.02),
        Part::keep(Form::Block { half: Vec3::new(2.0, 2.0, 1.0), round: 0.0 }, Vec3::new(0.0, 0.0, -0.95))
            .blend(0.02),
    ];
    Sculpture { upright: Upright::Front, ..Sculpture::solid("bowl", parts) }
}

fn blob(rng: &mut Rng) -> Sculpture {
    let mut parts = Vec::new();
    for i in 0..5 + rng.below(4) {
        let size = if i == 0 { 0.6 } else { rng.range(0.22, 0.48) };
        let radii = Vec3::new(rng.range(0.6, 1.3), rng.range(0.6, 1.3), rng.range(0.6, 1.3)) * size;
        let center = if i == 0 { Vec3::ZERO } else { somewhere(rng, 0.75) };
        parts.push(
            Part::add(Form::Ellipsoid(radii), center).blend(rng.range(0.08, 0.35)).turned(any_rotation(rng)),
        );
    }
    for _ in 0..2 + rng.below(4) {
        let radii =
            Vec3::new(rng.range(0.7, 1.3), rng.range(0.7, 1.3), rng.range(0.7, 1.6)) * rng.range(0.15, 0.3);
        let center = somewhere(rng, 1.0).normalize_or(Vec3::Z) * rng.range(0.45, 0.8);
        parts.push(
            Part::cut(Form::Ellipsoid(radii), center).blend(rng.range(0.06, 0.2)).turned(any_rotation(rng)),
        );
    }
    let folds = 2 + rng.below(3);
    let mut waves = ripples(rng, folds, 4.0, 9.0, 0.16);
    waves.extend(ripples(rng, 2, 10.0, 20.0, 0.13));
    let twist = rng.range(-1.2, 1.2);
    Sculpture { waves, twist, step: 0.45, ..Sculpture::solid("", parts) }
}

fn bump(rng: &mut Rng, low: f32, high: f32, height: f32) -> Bump {
    let radius = rng.range(low, high);
    let steep = rng.range(-0.5, 1.0) * height;
    Bump { x: rng.range(-0.85, 0.85), y: rng.range(-0.85, 0.85), radius, height: steep * radius }
}

fn fold(rng: &mut Rng, wave: f32, slope: f32, round: f32) -> Fold {
    let (s, c) = libm::sincosf(rng.range(0.0, TAU));
    let (ms, mc) = libm::sincosf(rng.range(0.0, TAU));
    let m = rng.range(1.5, 4.0);
    Fold {
        k: [wave * c, wave * s],
        phase: rng.range(0.0, TAU),
        m: [m * mc, m * ms],
        bend: rng.range(0.3, 1.6),
        height: slope / wave,
        round,
    }
}

fn relief(rng: &mut Rng) -> Sculpture {
    let mut field = Field::default();
    for _ in 0..8 + rng.below(10) {
        field.bumps.push(bump(rng, 0.15, 0.6, 0.8));
    }
    for _ in 0..1 + rng.below(2) {
        let (wave, round) = (rng.range(4.0, 14.0), rng.range(0.1, 0.6));
        let slope = rng.range(0.1, 0.55);
        field.folds.push(fold(rng, wave, slope, round));
    }
    let plate = if rng.uniform() < 0.5 {
        Form::Ellipsoid(Vec3::new(1.0, rng.range(0.75, 1.0), 0.9))
    } else {
        Form::Block { half: Vec3::new(1.0, rng.range(0.75, 1.0), 0.8), round: 0.15 }
    };
    let parts = vec![
        Part::add(Form::Field(field), Vec3::new(0.0, 0.0, -0.1)),
        Part::keep(plate, Vec3::ZERO).blend(0.08),
    ];
    Sculpture { step: 0.4, upright: Upright::Front, ..Sculpture::solid("", parts) }
}

fn drape(rng: &mut Rng) -> Sculpture {
    let mut field = Field::default();
    for _ in 0..3 + rng.below(4) {
        let b = bump(rng, 0.35, 0.9, 0.9);
        field.bumps.push(Bump { height: b.height.abs(), ..b });
    }
    // Folds of one cloth run about the same way.
    let way = rng.range(0.0, TAU);
    for i in 0..3 {
        let wave = rng.range(3.0, 6.0) * (1.0 + 0.8 * i as f32);
        let round = rng.range(0.15, 0.5);
        let (s, c) = libm::sincosf(way + rng.range(-0.45, 0.45));
        let mut one = fold(rng, wave, 0.9 / (1.0 + 0.5 * i as f32), round);
        one.k = [wave * c, wave * s];
        one.bend = rng.range(0.8, 2.2);
        field.folds.push(one);
    }
    let parts = vec![
        Part::add(Form::Field(field), Vec3::new(0.0, 0.0, -0.3)),
        Part::keep(Form::Ellipsoid(Vec3::new(rng.range(0.8, 1.0), 1.0, 1.0)), Vec3::ZERO).blend(0.15),
    ];
    Sculpture { step: 0.3, upright: Upright::Front, ..Sculpture::solid("", parts) }
}

fn vase(rng: &mut Rng) -> Sculpture {
    let vessel = Vessel {
        radius: rng.range(0.42, 0.62),
        profile: vec![
            [rng.range(0.1, 0.22), rng.range(1.5, 3.2), rng.range(0.0, TAU)],
            [rng.range(0.0, 0.05), rng.range(6.0, 11.0), rng.range(0.0, TAU)],
        ],
        wall: rng.range(0.025, 0.05),
        flute: rng.range(0.0, 0.1),
        eight: rng.uniform() < 0.5,
    };
    let floor = rng.range(-0.75, -0.45);
    let parts = vec![
        Part::add(Form::Vessel(vessel), Vec3::ZERO),
        Part::keep(Form::Block { half: Vec3::new(2.0, 0.75, 2.0), round: 0.0 }, Vec3::ZERO).blend(0.04),
        Part::add(Form::Ellipsoid(Vec3::new(0.5, 0.12, 0.5)), Vec3::new(0.0, floor, 0.0)).blend(0.1),
    ];
    Sculpture {
        twist: rng.range(-1.5, 1.5),
        step: 0.4,
        upright: Upright::Open,
        ..Sculpture::solid("", parts)
    }
}

fn coral(rng: &mut Rng) -> Sculpture {
    let mut parts = vec![Part::add(Form::Ellipsoid(Vec3::new(0.4, 0.15, 0.4)), Vec3::new(0.0, -0.8, 0.0))];
    let mut tips = vec![(Vec3::new(0.0, -0.8, 0.0), Vec3::Y, 0.17f32)];
    while parts.len() < 20 && !tips.is_empty() {
        let (from, way, radius) = tips.remove(0);
        for _ in 0..2 + rng.below(2) {
            let spread = somewhere(rng, 1.0) * 1.1;
            let next = (way + spread).normalize_or(Vec3::Y);
            let to = from + next * rng.range(0.32, 0.6);
            if to.length() > 1.05 || parts.len() >= 20 {
                continue;
            }
            let thin = radius * rng.range(0.6, 0.9);
            parts.push(Part::limb(from, to, radius, thin).blend(0.08));
            tips.push((to, next, thin.max(0.06)));
        }
    }
    for &(tip, _, radius) in tips.iter().take(8) {
        parts.push(Part::add(Form::Ellipsoid(Vec3::splat(radius * rng.range(1.1, 1.9))), tip).blend(0.06));
    }
    let waves = ripples(rng, 3, 12.0, 24.0, 0.1);
    Sculpture { waves, step: 0.6, ..Sculpture::solid("", parts) }
}

fn totem(rng: &mut Rng) -> Sculpture {
    let mut parts = Vec::new();
    let mut y = -0.95;
    while y < 0.8 {
        let height = rng.range(0.12, 0.34);
        let wide = rng.range(0.25, 0.55);
        let center = Vec3::new(rng.range(-0.06, 0.06), y + height, rng.range(-0.06, 0.06));
        let form = match rng.below(4) {
            0 => Form::Block {
                half: Vec3::new(wide, height, wide * rng.range(0.5, 1.0)),
                round: rng.range(0.0, 0.06),
            },
            1 => Form::Ellipsoid(Vec3::new(wide, height * 1.15, wide * rng.range(0.7, 1.0))),
            2 => Form::Ring { major: wide, minor: height * 0.7 },
            _ => Form::Limb { half: height, low: wide * 0.9, high: wide * 0.45 },
        };
        let (s, c) = libm::sincosf(rng.range(0.0, PI));
        let turn = Mat3::from_cols(Vec3::new(c, 0.0, s), Vec3::Y, Vec3::new(-s, 0.0, c));
        parts.push(Part::add(form, center).blend(rng.range(0.0, 0.05)).turned(turn));
        y += 1.7 * height;
    }
    // A core, so that rings do not float, and bored holes.
    parts.push(Part::limb(Vec3::new(0.0, -0.9, 0.0), Vec3::new(0.0, 0.8, 0.0), 0.2, 0.14).blend(0.02));
    for _ in 0..1 + rng.below(3) {
        let center = Vec3::new(rng.range(-0.3, 0.3), rng.range(-0.8, 0.8), 0.0);
        let bore = Form::Limb { half: 1.0, low: rng.range(0.07, 0.16), high: 0.1 };
        let (s, c) = libm::sincosf(rng.range(0.0, PI));
        let axis = Vec3::new(c, 0.0, s);
        parts.push(Part::cut(bore, center).turned(Mat3::from_cols(Vec3::Y, axis, Vec3::Y.cross(axis))));
    }
    Sculpture { step: 0.7, upright: Upright::Standing, ..Sculpture::solid("", parts) }
}

fn figure(rng: &mut Rng) -> Sculpture {
    let lean = Vec3::new(rng.range(-0.12, 0.12), 0.0, rng.range(-0.08, 0.12));
    let hips = Vec3::new(0.0, -0.15, 0.0);
    let chest = hips + Vec3::new(0.0, 0.42, 0.0) + lean;
    let neck = chest + Vec3::new(0.0, 0.2, 0.02) + 0.3 * lean;
    let head = neck + Vec3::new(rng.range(-0.05, 0.05), 0.2, rng.range(0.0, 0.08));
    let wide = rng.range(0.2, 0.28);
    let mut parts = vec![
        Part::limb(Vec3::new(0.0, -0.85, 0.0), hips, rng.range(0.3, 0.42), 0.22),
        Part::limb(hips, chest, 0.21, rng.range(0.2, 0.25)).blend(0.12),
        Part::limb(chest - Vec3::X * wide, chest + Vec3::X * wide, 0.11, 0.11).blend(0.1),
        Part::limb(chest, neck, 0.1, 0.085).blend(0.06),
        Part::add(Form::Ellipsoid(Vec3::new(0.135, 0.175, 0.15)), head).blend(0.04),
        Part::add(Form::Ellipsoid(Vec3::new(0.035, 0.05, 0.06)), head + Vec3::new(0.0, -0.02, 0.14))
            .blend(0.04),
        Part::add(Form::Block { half: Vec3::new(0.5, 0.07, 0.45), round: 0.02 }, Vec3::new(0.0, -0.93, 0.0))
            .blend(0.02),
    ];
    for side in [-1.0f32, 1.0] {
        let eye = head + Vec3::new(side * 0.055, 0.03, 0.15);
        parts.push(Part::cut(Form::Ellipsoid(Vec3::new(0.04, 0.025, 0.045)), eye).blend(0.03));
        let shoulder = chest + Vec3::new(side * wide, 0.03, 0.0);
        let out = Vec3::new(side * rng.range(0.2, 1.0), rng.range(-1.0, 0.6), rng.range(0.0, 0.9));
        let elbow = shoulder + 0.33 * out.normalize_or(Vec3::X);
        let fore = Vec3::new(-side * rng.range(-0.3, 0.8), rng.range(-0.5, 0.8), rng.range(0.3, 1.0));
        let hand = elbow + 0.3 * fore.normalize_or(Vec3::Z);
        parts.push(Part::limb(shoulder, elbow, 0.1, 0.075).blend(0.06));
        parts.push(Part::limb(elbow, hand, 0.075, 0.055).blend(0.03));
        parts.push(Part::add(Form::Ellipsoid(Vec3::new(0.07, 0.08, 0.06)), hand).blend(0.03));
    }
    let pleats = rng.range(18.0, 26.0);
    let waves = vec![
        Wave {
            k: Vec3::new(pleats, rng.range(-4.0, 4.0), 0.0),
            phase: rng.range(0.0, TAU),
            height: 0.2 / pleats,
        },
        Wave {
            k: Vec3::new(0.0, rng.range(-4.0, 4.0), pleats),
            phase: rng.range(0.0, TAU),
            height: 0.2 / pleats,
        },
    ];
    Sculpture { waves, step: 0.6, upright: Upright::Standing, ..Sculpture::solid("", parts) }
}

fn knot(rng: &mut Rng) -> Sculpture {
    let (turns, strands) = [(3.0, 2), (5.0, 2), (2.0, 3), (4.0, 3), (7.0, 2)][rng.below(5)];
    let winding = rng.range(0.2, 0.28);
    let tube = winding * rng.range(0.5, 0.75);
    let parts = vec![Part::add(Form::Knot { ring: 0.62, winding, tube, turns, strands }, Vec3::ZERO)];
    let waves = ripples(rng, 3, 8.0, 20.0, 0.1);
    Sculpture { waves, step: 0.3, ..Sculpture::solid("", parts) }
}

fn lattice(rng: &mut Rng) -> Sculpture {
    let wave = rng.range(4.0, 7.0);
    let radii = Vec3::new(rng.range(0.8, 1.0), rng.range(0.8, 1.0), rng.range(0.8, 1.0));
    let parts = vec![
        Part::add(Form::Gyroid { wave, wall: rng.range(0.28, 0.5) / wave }, somewhere(rng, 0.5)),
        Part::keep(Form::Ellipsoid(radii), Vec3::ZERO).blend(0.06),
        Part::add(Form::Ellipsoid(radii * rng.range(0.62, 0.85)), Vec3::ZERO).blend(0.12),
    ];
    Sculpture { step: 0.45, ..Sculpture::solid("", parts) }
}

fn stone(rng: &mut Rng) -> Sculpture {
    let radii = Vec3::new(rng.range(0.7, 1.0), rng.range(0.7, 1.0), rng.range(0.7, 1.0));
    let mut parts = vec![Part::add(Form::Ellipsoid(radii), Vec3::ZERO)];
    for _ in 0..9 + rng.below(7) {
        // A half-space: a block so large that one face is all one sees of it.
        let rotation = any_rotation(rng);
        let half = Form::Block { half: Vec3::splat(3.0), round: 0.0 };
        let depth = rng.range(0.5, 0.8) - 3.0;
        parts.push(Part::keep(half, rotation.z_axis * depth).blend(rng.range(0.01, 0.12)).turned(rotation));
    }
    for _ in 0..2 + rng.below(4) {
        let chip = Form::Ellipsoid(Vec3::splat(rng.range(0.15, 0.4)));
        let place = somewhere(rng, 1.0).normalize_or(Vec3::Z) * rng.range(0.7, 0.95);
        parts.push(Part::cut(chip, place).blend(rng.range(0.01, 0.05)));
    }
    let mut waves = ripples(rng, 2, 3.0, 6.0, 0.08);
    waves.extend(ripples(rng, 3, 14.0, 28.0, 0.05));
    Sculpture { waves, step: 0.65, ..Sculpture::solid("", parts) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One of each family with seeds.
    fn some() -> Vec<Sculpture> {
        FAMILIES.iter().flat_map(|f| (0..2).filter_map(|seed| Sculpture::grown(f.0, seed))).collect()
    }

    #[test]
    fn names_are_read_and_refused() {
        assert_eq!(some().len(), 20);
        assert!(Sculpture::named("sphere").is_ok() && Sculpture::named("bowl").is_ok());
        for bad in ["", "blob", "blob:", "blob:x", "blob:-1", "sphere:1", "bust:3"] {
            assert!(Sculpture::named(bad).is_err(), "{bad}");
        }
        let said = |name| Sculpture::named(name).unwrap_err().to_string();
        assert!(said("sphere:1").ends_with("sphere takes no seed, write sphere"));
        assert!(said("bust:3").ends_with("lattice, stone; or sphere or bowl, without a seed"));
    }

    #[test]
    fn normals_are_the_gradient() {
        let mut rng = Rng::new(1);
        for s in some() {
            for _ in 0..50 {
                let p = somewhere(&mut rng, 1.0);
                let gradient = s.at(Dual::inputs(p)).gradient;
                let value = |q: Vec3| s.at(V3::<f32>::of(q));
                let h = 2e-3;
                let numeric = Vec3::new(
                    value(p + Vec3::X * h) - value(p - Vec3::X * h),
                    value(p + Vec3::Y * h) - value(p - Vec3::Y * h),
                    value(p + Vec3::Z * h) - value(p - Vec3::Z * h),
                ) / (2.0 * h);
                // Within h of a crease the difference quotient is a mean of both sides: allow a few.
                let close = (gradient - numeric).length() < 0.05 * (1.0 + gradient.length());
                assert!(
                    close || (gradient - numeric).length() < 2.5,
                    "{} {p} {gradient} {numeric}",
                    s.name()
                );
            }
        }
    }

    #[test]
    fn steps_never_jump_through_the_surface() {
        let mut rng = Rng::new(2);
        let mut worst = Vec::new();
        for s in some() {
            let mut steep = 0;
            for _ in 0..2000 {
                let p = somewhere(&mut rng, 1.1);
                let d = s.at(Dual::inputs(p));
                // Far inside nothing is traced, and far outside no step reaches the surface.
                if d.value > -0.02 && d.value < 0.2 && d.gradient.length() * s.step() > 1.0 {
                    steep += 1;
                }
            }
            if steep > 20 {
                worst.push(format!("{}: {steep} of 2000", s.name()));
            }
        }
        assert!(worst.is_empty(), "points steeper than the step allows: {worst:?}");
    }
}
