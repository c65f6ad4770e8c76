//! Lamps at a finite distance: how near they are is seen in the pictures, and its effect is taken out of them.
//!
//! A pixel off the object's middle sees a near lamp from elsewhere than the middle does, and one on its own side brighter:
//! `I = g·(l − κx) / |l − κx|³`, where `g` is albedo times normal, `x` the pixel's place in half widths of the object and `κ` the
//! *nearness*, the half width in units of the lamps' distance (Papadhimitri and Favaro 2014, with all depths taken for that of the middle). For a known κ this
//! is as linear in `g` as for distant lamps. How the values deviate from it is explained by a linear fit over all pixels: by more nearness, and
//! by functions of the angles alone (`angles`), which stand for reflectance that isn't Lambert's; what another
//! normal would explain as well is taken out. Nearness and reflectance look alike (on a sphere nearly the same), so κ is not just the
//! first coefficient: a small network that has seen many rendered objects knows which reflectances there are, and makes κ
//! of all coefficients, at two assumed nearnesses (`models/nearness.md`).

use super::perceptron::Perceptron;
use super::{Measurements, SolveError};
use crate::stack::Mask;
use glam::{Mat3, Vec2, Vec3};
use std::sync::LazyLock;

/// Fewer lights leave nothing of which the nearness could be seen.
pub const LEAST_LIGHTS: usize = 5;

/// Pixels that it is estimated on.
const PIXELS: usize = 1000;
/// Nearnesses that are assumed, to see what is left beside them.
const ASSUMED: [f32; 2] = [0.0, 0.06];
/// Between these the estimate stays.
const RANGE: [f32; 2] = [0.0, 0.12];
/// Iterations of a pixel's robust fit.
const ITERATIONS: usize = 12;
/// Residual at which a value counts half, in units of the albedo.
const SCALE: f32 = 0.03;
/// Values at most this fraction of a pixel's brightest are shadow, and what light of a smaller cosine gives says little.
const DARK: f32 = 0.05;
const GRAZING: f32 = 0.1;
/// Weight of shadows and of what the sensor cut off.
const UNTRUSTED: f32 = 1e-3;
/// How much the direction of light may change a value when its nearness is taken out.
const MOST_TURNED: f32 = 2.0;

/// Functions of the angles beside the nearness.
const ANGLES: usize = 8;
/// These, the nearness, and the values.
const COLUMNS: usize = ANGLES + 2;
type Row = [f32; COLUMNS];

/// What one fit says: its coefficients, the logarithms of the first one's standard error and of the noise.
const SAID: usize = COLUMNS - 1 + 2;
/// Number of values that the nearness is made of: what the fits say, and the logarithm of the number of lights.
pub const SIGNS: usize = ASSUMED.len() * SAID + 1;
/// The nearness that the network's output 1 stands for.
pub const UNIT: f32 = 0.05;

/// The weights that come with the crate.
static SHIPPED: LazyLock<Perceptron<SIGNS>> = LazyLock::new(|| {
    let network: Perceptron<SIGNS> = serde_json::from_str(include_str!("../../models/nearness.json"))
        .expect("the committed file is valid");
    assert!(network.is_whole(), "the committed file is whole");
    network
});

/// Where each mask pixel is: from the middle of the mask's bounding box, in halves of its longer side, x right and y up.
#[must_use]
pub fn places(mask: &Mask) -> Vec<Vec2> {
    let (left, top, width, height) = mask.bounds();
    let per_half = 2.0 / width.max(height) as f32;
    let (x0, y0) = (left as f32 + 0.5 * (width - 1) as f32, top as f32 + 0.5 * (height - 1) as f32);
    let place = |p| {
        let (x, y) = mask.position(p);
        Vec2::new(x as f32 - x0, y0 - y as f32) * per_half
    };
    (0..mask.len()).map(place).collect()
}

/// One pixel under near lamps: where it sees them, and its values made those of lamps at distance 1.
struct Pixel {
    lamps: Vec<Vec3>,
    values: Vec<f32>,
    /// 1, or [`UNTRUSTED`] for what is dark or cut off.
    trust: Vec<f32>,
    weights: Vec<f32>,
    /// Robust albedo times normal.
    g: Vec3,
}

impl Pixel {
    fn new(lights: usize) -> Self {
        Self {
            lamps: vec![Vec3::ZERO; lights],
            values: vec![0.0; lights],
            trust: vec![1.0; lights],
            weights: vec![0.0; lights],
            g: Vec3::ZERO,
        }
    }

    /// Looks at pixel `p`; `false` for a black one.
    fn look(&mut self, m: &Measurements, p: usize, place: Vec2, nearness: f32) -> bool {
        let mut brightest = 0.0f32;
        for (k, &l) in m.lights.iter().enumerate() {
            let lamp = l - nearness * place.extend(0.0);
            let length = lamp.length();
            let value = m.images[k][p];
            let usable = value > 0.0 && value <= f32::MAX;
            self.lamps[k] = lamp;
            self.values[k] = if usable { value * length * length * length } else { 0.0 };
            brightest = brightest.max(self.values[k]);
        }
        if brightest <= 1e-20 {
            return false;
        }
        let per_brightest = 1.0 / brightest;
        for (k, (v, trust)) in self.values.iter_mut().zip(&mut self.trust).enumerate() {
            *v *= per_brightest;
            let cut_off = m.saturated_in(k).get(p) == Some(&true);
            *trust = if *v > DARK && !cut_off { 1.0 } else { UNTRUSTED };
        }
        self.fit();
        self.g.length_squared() > 1e-12 && self.g.is_finite()
    }

    /// Iteratively reweighted least squares with Cauchy's loss.
    fn fit(&mut self) {
        self.weights.copy_from_slice(&self.trust);
        for _ in 0..ITERATIONS {
            let mut right = Vec3::ZERO;
            for ((&l, &v), &w) in self.lamps.iter().zip(&self.values).zip(&self.weights) {
                right += l * (v * w);
            }
            self.g = self.inverse() * right;
            let per_scale = 1.0 / (SCALE * self.g.length().max(1e-9));
            for (k, w) in self.weights.iter_mut().enumerate() {
                let r = (self.values[k] - self.g.dot(self.lamps[k])) * per_scale;
                *w = self.trust[k] / (1.0 + r * r);
            }
        }
    }

    /// `(ΛᵀWΛ)⁻¹`.
    fn inverse(&self) -> Mat3 {
        let mut gram = Mat3::from_diagonal(Vec3::splat(1e-6));
        for (&l, &w) in self.lamps.iter().zip(&self.weights) {
            let wl = l * w;
            gram += Mat3::from_cols(wl * l.x, wl * l.y, wl * l.z);
        }
        gram.inverse()
    }

    /// Appends a row for each light: what is left of its columns beside the best normal, and its weight.
    fn rows(&mut self, place: Vec2, rows: &mut Vec<(Row, f32)>) {
        let albedo = self.g.length();
        let n = self.g / albedo;
        let at = place.extend(0.0);
        let mut lit = 0;
        for ((w, &lamp), &trust) in self.weights.iter_mut().zip(&self.lamps).zip(&self.trust) {
            if n.dot(lamp) > GRAZING && trust == 1.0 {
                lit += 1;
            } else {
                *w = 0.0;
            }
        }
        // Some normal explains three values whatever the nearness, and four nearly.
        if lit < LEAST_LIGHTS {
            return;
        }
        let first = rows.len();
        for k in 0..self.lamps.len() {
            let lamp = self.lamps[k];
            let cos = n.dot(lamp);
            let half = (lamp.normalize() + Vec3::Z).normalize_or_zero().dot(n).max(0.0);
            let near = 3.0 * cos * lamp.dot(at) / lamp.length_squared() - n.dot(at);
            let mut row = [0.0; COLUMNS];
            row[0] = near;
            row[1..=ANGLES].copy_from_slice(&angles(cos, half, n.z));
            row[COLUMNS - 1] = self.values[k] / albedo - cos;
            rows.push((row, self.weights[k]));
        }
        let inverse = self.inverse();
        let new = &mut rows[first..];
        for column in 0..COLUMNS {
            let mut right = Vec3::ZERO;
            for ((row, w), &l) in new.iter().zip(&self.lamps) {
                right += l * (row[column] * w);
            }
            let explained = inverse * right;
            for ((row, _), &l) in new.iter_mut().zip(&self.lamps) {
                row[column] -= explained.dot(l);
            }
        }
    }
}

/// How reflectance may deviate from Lambert's: broad and narrow functions of the cosines of incidence and half angle.
fn angles(cos: f32, half: f32, height: f32) -> [f32; ANGLES] {
    let h2 = half * half;
    let h4 = h2 * h2;
    let h8 = h4 * h4;
    let h16 = h8 * h8;
    let h64 = h16 * h16 * h16 * h16;
    [cos * cos, cos * cos * cos, cos * cos * height, cos * h4, cos * h8, h16, h64, h64 * h64 * h64 * h64]
}

/// Least squares of the last column by the others, robust over the rows; `None` where they don't determine it.
fn fit(rows: &[(Row, f32)]) -> Option<[f32; SAID]> {
    let mut weights: Vec<f32> = rows.iter().map(|r| r.1).collect();
    let mut said = None;
    for _ in 0..4 {
        let mut gram = [[0.0f64; COLUMNS]; COLUMNS];
        for ((row, _), &w) in rows.iter().zip(&weights) {
            if w > 0.0 {
                for i in 0..COLUMNS {
                    let wi = w * row[i];
                    for j in i..COLUMNS {
                        gram[i][j] += f64::from(wi * row[j]);
                    }
                }
            }
        }
        let (beta, variance) = solve(gram)?;
        let residual = |row: &Row| {
            let explained: f64 = (0..COLUMNS - 1).map(|i| beta[i] * f64::from(row[i])).sum();
            f64::from(row[COLUMNS - 1]) - explained
        };
        let residuals: Vec<f64> = rows.iter().map(|(row, _)| residual(row)).collect();
        let mut sizes: Vec<f64> =
            residuals.iter().zip(rows).filter(|(_, row)| row.1 > 1e-3).map(|(r, _)| r.abs()).collect();
        if sizes.is_empty() {
            return None;
        }
        let middle = sizes.len() / 2;
        let scale = 1.5 * *sizes.select_nth_unstable_by(middle, f64::total_cmp).1 + 1e-4;
        let (mut squares, mut total) = (0.0, 0.0);
        for (((_, base), w), r) in rows.iter().zip(&mut weights).zip(&residuals) {
            *w = base / (1.0 + (r / scale).powi(2)) as f32;
            squares += f64::from(*w) * r * r;
            total += f64::from(*w);
        }
        let noise = squares / total.max(1e-12);
        let mut all = [0.0; SAID];
        all.iter_mut().zip(beta).for_each(|(to, b)| *to = b as f32);
        all[SAID - 2] = 0.5 * log(variance * noise);
        all[SAID - 1] = 0.5 * log(noise);
        said = Some(all);
    }
    said
}

/// Natural logarithm, of 1e−12 where `value` is below.
fn log(value: f64) -> f32 {
    libm::log(value.max(1e-12)) as f32
}

/// Solves the normal equations in the upper triangle of `gram` (the right side in the last column) by Cholesky's method; gives the coefficients and
/// the first entry of the inverse's diagonal.
fn solve(gram: [[f64; COLUMNS]; COLUMNS]) -> Option<([f64; COLUMNS - 1], f64)> {
    const N: usize = COLUMNS - 1;
    let mut lower = [[0.0f64; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let mut sum = gram[j][i] + if i == j { 1e-9 } else { 0.0 };
            for k in 0..j {
                sum -= lower[i][k] * lower[j][k];
            }
            if i == j {
                if sum.is_nan() || sum <= 0.0 {
                    return None;
                }
                lower[i][i] = libm::sqrt(sum);
            } else {
                lower[i][j] = sum / lower[j][j];
            }
        }
    }
    let substitute = |mut v: [f64; N]| {
        for i in 0..N {
            for k in 0..i {
                v[i] -= lower[i][k] * v[k];
            }
            v[i] /= lower[i][i];
        }
        for i in (0..N).rev() {
            for k in i + 1..N {
                v[i] -= lower[k][i] * v[k];
            }
            v[i] /= lower[i][i];
        }
        v
    };
    let beta = substitute(std::array::from_fn(|i| gram[i][N]));
    let unit = substitute(std::array::from_fn(|i| f64::from(u8::from(i == 0))));
    beta.iter().all(|b| b.is_finite()).then_some((beta, unit[0]))
}

/// What the pictures show of the nearness: what [`nearness`] is made of. `None` where they show nothing of it.
///
/// # Errors
/// As [`nearness`].
pub fn signs(m: &Measurements, places: &[Vec2]) -> Result<Option<[f32; SIGNS]>, SolveError> {
    let pixels = checked(m, places)?;
    let count = m.lights.len();
    if count < LEAST_LIGHTS {
        return Ok(None);
    }
    let step = pixels.div_ceil(PIXELS).max(1);
    let mut pixel = Pixel::new(count);
    let mut rows = Vec::with_capacity(pixels.div_ceil(step) * count);
    let mut signs = [0.0; SIGNS];
    for (said, assumed) in signs.chunks_exact_mut(SAID).zip(ASSUMED) {
        rows.clear();
        for p in (0..pixels).step_by(step) {
            if pixel.look(m, p, places[p], assumed) {
                pixel.rows(places[p], &mut rows);
            }
        }
        let Some(fit) = fit(&rows) else { return Ok(None) };
        said.copy_from_slice(&fit);
    }
    signs[SIGNS - 1] = log(count as f64);
    Ok(Some(signs))
}

/// The nearness κ of the lamps: half width of the object in units of their distance, 0 for distant lamps, and where the pictures don't show it.
///
/// # Errors
/// As [`Measurements::check`]; [`SolveError::Places`] where there is not one place for each pixel.
pub fn nearness(m: &Measurements, places: &[Vec2]) -> Result<f32, SolveError> {
    Ok(signs(m, places)?.map_or(0.0, |signs| judged(&SHIPPED, &signs)))
}

/// The nearness that a network makes of the signs.
#[must_use]
pub fn judged(network: &Perceptron<SIGNS>, signs: &[f32; SIGNS]) -> f32 {
    (UNIT * network.output(signs)).clamp(RANGE[0], RANGE[1])
}

/// The pictures that lamps of nearness 0 would have given.
///
/// # Errors
/// As [`nearness`].
pub fn distant(m: &Measurements, places: &[Vec2], nearness: f32) -> Result<Vec<Vec<f32>>, SolveError> {
    let pixels = checked(m, places)?;
    let mut out: Vec<Vec<f32>> = m.images.iter().map(|i| i.to_vec()).collect();
    let mut pixel = Pixel::new(m.lights.len());
    for p in 0..pixels {
        if !pixel.look(m, p, places[p], nearness) {
            continue;
        }
        let n = pixel.g.normalize();
        for (k, image) in out.iter_mut().enumerate() {
            let lamp = pixel.lamps[k];
            let (near, far) = (n.dot(lamp), n.dot(m.lights[k]));
            // Where light grazes, or the value is not of light from there, only its brightness changes.
            let turned = if near.min(far) > DARK { far / near } else { 1.0 };
            let length = lamp.length();
            image[p] *= length * length * length * turned.clamp(1.0 / MOST_TURNED, MOST_TURNED);
        }
    }
    Ok(out)
}

fn checked(m: &Measurements, places: &[Vec2]) -> Result<usize, SolveError> {
    let pixels = m.check()?;
    if places.len() != pixels {
        return Err(SolveError::Places { found: places.len(), expected: pixels });
    }
    Ok(pixels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::mae;
    use crate::light::fibonacci_cap;
    use crate::solve::{LeastSquares, Solver, prepare};

    const SIDE: u32 = 40;

    /// Places, normals, and pictures of a wavy relief with a broad sheen, under lamps of this nearness.
    fn relief(lights: &[Vec3], nearness: f32) -> (Vec<Vec2>, Vec<Vec3>, Vec<Vec<f32>>) {
        let places = places(&Mask::full(SIDE, SIDE).unwrap());
        let normal = |at: &Vec2| {
            let slope = |v: f32, w: f32| 0.6 * libm::cosf(7.0 * v + 2.0 * w);
            Vec3::new(slope(at.x, at.y), slope(at.y, -at.x), 1.0).normalize()
        };
        let normals: Vec<Vec3> = places.iter().map(normal).collect();
        let value = |l: Vec3, at: &Vec2, n: &Vec3| {
            let lamp = l - nearness * at.extend(0.0);
            let half = (lamp.normalize() + Vec3::Z).normalize();
            let sheen = 0.2 * n.dot(half).max(0.0).powi(20);
            (0.5 * n.dot(lamp.normalize()).max(0.0) + sheen) / lamp.length_squared()
        };
        let images =
            lights.iter().map(|&l| places.iter().zip(&normals).map(|(at, n)| value(l, at, n)).collect());
        let images = images.collect();
        (places, normals, images)
    }

    fn measurements<'a>(lights: &[Vec3], images: &'a [Vec<f32>]) -> Measurements<'a> {
        let images = images.iter().map(Vec::as_slice).collect();
        Measurements { lights: lights.to_vec(), images, saturated: Vec::new() }
    }

    #[test]
    fn the_nearness_is_found() {
        for count in [8, 12, 40] {
            let lights = fibonacci_cap(count, 0.8);
            for truth in [0.0, 0.03, 0.08] {
                let (places, _, images) = relief(&lights, truth);
                let found = nearness(&measurements(&lights, &images), &places).unwrap();
                println!("{count} lights: {found} for {truth}");
                assert!((found - truth).abs() < 0.015, "{count} lights: {found} for {truth}");
            }
        }
    }

    #[test]
    fn pictures_become_those_of_distant_lamps() {
        let lights = fibonacci_cap(12, 0.8);
        let (places, normals, images) = relief(&lights, 0.08);
        let m = measurements(&lights, &images);
        let error = |m: &Measurements| mae(&LeastSquares.solve(m).unwrap().normals, &normals);
        let (_, _, wanted) = relief(&lights, 0.0);
        let [given, perfect] = [error(&m), error(&measurements(&lights, &wanted))];
        let ready = prepare("pixel", m.clone(), &places).unwrap();
        let mended = error(&ready.measurements());
        assert!(
            mended < perfect + 0.2 * (given - perfect),
            "{given}° became {mended}°, {perfect}° is perfect"
        );
        let textbook = prepare("ls", m, &places).unwrap();
        assert_eq!(textbook.measurements().images, measurements(&lights, &images).images);
    }

    #[test]
    fn what_shows_no_nearness_has_none() {
        let lights = fibonacci_cap(LEAST_LIGHTS - 1, 0.8);
        let (places, _, images) = relief(&lights, 0.08);
        assert_eq!(nearness(&measurements(&lights, &images), &places).unwrap(), 0.0);
        let lights = fibonacci_cap(9, 0.8);
        for value in [0.0, 1.0, f32::NAN, f32::INFINITY] {
            let images = vec![vec![value; places.len()]; 9];
            let m = measurements(&lights, &images);
            assert!(nearness(&m, &places).unwrap() < 0.02, "{value}");
            let same = distant(&m, &places, 0.05).unwrap();
            assert!(value == 1.0 || same.iter().flatten().all(|v| v.to_bits() == value.to_bits()));
        }
        let images = vec![vec![0.5; places.len()]; 9];
        let wrong = nearness(&measurements(&lights, &images), &places[1..]);
        assert!(matches!(wrong, Err(SolveError::Places { .. })));
    }
}
