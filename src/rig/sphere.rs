//! Light direction from a mirror sphere: circle fit to its outline, highlight → normal → `l = 2(n·v)n − v`.
//!
//! The outline is taken from a picture with room light on (or clicked), the highlight from one under the LED. Every
//! pixel of the highlight gives a direction, and their mean is the light's: for a mirror sphere under an orthographic
//! camera each pixel stands for the same solid angle (4/r²), so nothing has to be weighed but the brightness.

use super::hdr::Exposure;
use crate::image::Image;
use crate::light;
use crate::rng::Rng;
use glam::{DVec2, DVec3, Vec3};

/// A grey image: row-major values.
#[derive(Clone, Copy, Debug)]
pub struct Grey<'a> {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `width · height` values.
    pub values: &'a [f32],
}

/// The grey values of a picture.
#[derive(Clone, Debug)]
pub struct Values {
    width: usize,
    values: Vec<f32>,
}

impl Values {
    /// To look at.
    #[must_use]
    pub fn view(&self) -> Grey<'_> {
        Grey { width: self.width, height: self.values.len() / self.width.max(1), values: &self.values }
    }
}

/// The mean of a picture's channels, 1 at full scale.
#[must_use]
pub fn values(image: &Image) -> Values {
    let scale = 1.0 / (3.0 * f32::from(image.bits.max()));
    let grey = |c: &[u16; 3]| (f32::from(c[0]) + f32::from(c[1]) + f32::from(c[2])) * scale;
    Values { width: image.width as usize, values: image.rgb.iter().map(grey).collect() }
}

/// The light's direction from an exposure of the sphere, less the same exposure with the light off.
///
/// # Errors
/// [`SphereError`].
pub fn measure(lit: &Exposure, dark: Option<&Exposure>, circle: &Circle) -> Result<Reflection, SphereError> {
    let mut grey = values(&lit.image);
    if let Some(dark) = dark.filter(|d| d.image.rgb.len() == lit.image.rgb.len()) {
        for (v, d) in grey.values.iter_mut().zip(values(&dark.image).values) {
            *v -= d;
        }
    }
    light_direction(&grey.view(), circle)
}

/// A circle in pixels; the centre of the first pixel is (0.5, 0.5).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Circle {
    /// Column of the centre.
    pub x: f64,
    /// Row of the centre.
    pub y: f64,
    /// Radius.
    pub radius: f64,
}

/// A measured light direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reflection {
    /// Unit direction towards the light.
    pub direction: Vec3,
    /// Standard uncertainty, degrees: from the spot's size and a tenth of a pixel of the circle.
    pub uncertainty: f64,
    /// Centre of the highlight, pixels.
    pub at: (f64, f64),
    /// Radius of a disc of the highlight's area, pixels.
    pub spot: f64,
}

/// Why there is no direction.
#[derive(Clone, Debug, thiserror::Error, PartialEq)]
pub enum SphereError {
    /// Values don't fill the image.
    #[error("{found} values for a {width}×{height} image")]
    Length {
        /// Number of values.
        found: usize,
        /// Width in pixels.
        width: usize,
        /// Height in pixels.
        height: usize,
    },
    /// Fewer than three points, or on a line.
    #[error("no circle goes through these {0} points: click at least three, well apart on the outline")]
    Points(usize),
    /// No circle stands out.
    #[error("no outline of a sphere found: light the room for this picture, or click on the outline")]
    NoOutline,
    /// No highlight stands out.
    #[error("no highlight on the sphere: is the LED on, and its reflection not hidden?")]
    NoHighlight,
}

impl Grey<'_> {
    fn check(&self) -> Result<(), SphereError> {
        if self.width < 5 || self.height < 5 || self.values.len() != self.width * self.height {
            let (found, width, height) = (self.values.len(), self.width, self.height);
            return Err(SphereError::Length { found, width, height });
        }
        Ok(())
    }

    fn at(&self, x: usize, y: usize) -> f64 {
        f64::from(self.values[y * self.width + x])
    }
}

/// The circle through points, least squares of the distances (Kåsa's as a start, then Gauss-Newton).
///
/// # Errors
/// [`SphereError::Points`].
pub fn fit_circle(points: &[DVec2]) -> Result<Circle, SphereError> {
    let fail = SphereError::Points(points.len());
    if points.len() < 3 {
        return Err(fail);
    }
    let n = points.len() as f64;
    let mean = points.iter().sum::<DVec2>() / n;
    let (mut m, mut right) = ([[0.0; 2]; 2], [0.0; 2]);
    for p in points {
        let d = *p - mean;
        let q = d.length_squared();
        m[0][0] += d.x * d.x;
        m[0][1] += d.x * d.y;
        m[1][1] += d.y * d.y;
        right[0] += 0.5 * q * d.x;
        right[1] += 0.5 * q * d.y;
    }
    let det = m[0][0] * m[1][1] - m[0][1] * m[0][1];
    let trace = m[0][0] + m[1][1];
    if det.is_nan() || det <= 1e-9 * trace * trace {
        return Err(fail);
    }
    let centre = DVec2::new(
        (right[0] * m[1][1] - right[1] * m[0][1]) / det,
        (right[1] * m[0][0] - right[0] * m[0][1]) / det,
    );
    let mut centre = mean + centre;
    let mut radius = points.iter().map(|p| (*p - centre).length()).sum::<f64>() / n;
    for _ in 0..20 {
        let (mut a, mut b) = (glam::DMat3::ZERO, DVec3::ZERO);
        for p in points {
            let d = *p - centre;
            let r = d.length().max(1e-9);
            let row = DVec3::new(-d.x / r, -d.y / r, -1.0);
            a += glam::DMat3::from_cols(row * row.x, row * row.y, row * row.z);
            b -= row * (r - radius);
        }
        if a.determinant().abs() < 1e-12 {
            break;
        }
        let step = a.inverse() * b;
        centre += step.truncate();
        radius += step.z;
        if step.length() < 1e-9 {
            break;
        }
    }
    let circle = Circle { x: centre.x, y: centre.y, radius };
    (radius > 0.0 && radius.is_finite() && centre.is_finite()).then_some(circle).ok_or(fail)
}

/// Points on edges, to a fraction of a pixel.
fn edges(image: &Grey) -> Vec<DVec2> {
    let (w, h) = (image.width, image.height);
    let mut size = vec![0.0f64; w * h];
    let mut slope = vec![DVec2::ZERO; w * h];
    for y in 1..h - 1 {
        for x in 1..w - 1 {
            let p = |dx: usize, dy: usize| image.at(x + dx - 1, y + dy - 1);
            let gx = p(2, 0) + 2.0 * p(2, 1) + p(2, 2) - p(0, 0) - 2.0 * p(0, 1) - p(0, 2);
            let gy = p(0, 2) + 2.0 * p(1, 2) + p(2, 2) - p(0, 0) - 2.0 * p(1, 0) - p(2, 0);
            slope[y * w + x] = DVec2::new(gx, gy);
            size[y * w + x] = libm::sqrt(gx * gx + gy * gy);
        }
    }
    let mut sorted: Vec<f64> = size.clone();
    let rank = (sorted.len() as f64 * 0.995) as usize;
    let strong = *sorted.select_nth_unstable_by(rank.min(w * h - 1), f64::total_cmp).1;
    let mut points = Vec::new();
    for y in 2..h - 2 {
        for x in 2..w - 2 {
            let i = y * w + x;
            if size[i] < 0.4 * strong || size[i] <= 0.0 {
                continue;
            }
            // Along the steeper axis: a ridge of the slope, its top by a parabola.
            let horizontal = slope[i].x.abs() >= slope[i].y.abs();
            let step = if horizontal { 1 } else { w };
            let (a, b, c) = (size[i - step], size[i], size[i + step]);
            if b >= a && b > c && a + c < 2.0 * b {
                let offset = 0.5 * (a - c) / (a - 2.0 * b + c);
                let at = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                points.push(at + if horizontal { DVec2::X } else { DVec2::Y } * offset);
            }
        }
    }
    points
}

/// The outline of the sphere: the circle with the most edge points on it (RANSAC), fitted to those. Up to half of the
/// outline may be hidden. Points (in pixels) for which `skip` says so are not looked at: the object may be round too.
///
/// # Errors
/// [`SphereError::NoOutline`] where no circle has edge points on 40 % of its length.
pub fn find_outline(image: &Grey, skip: impl Fn(f64, f64) -> bool) -> Result<Circle, SphereError> {
    image.check()?;
    let mut points = edges(image);
    points.retain(|p| !skip(p.x, p.y));
    let pixels = (0..image.width * image.height)
        .filter(|i| !skip((i % image.width) as f64 + 0.5, (i / image.width) as f64 + 0.5))
        .count();
    if points.len() < 20 {
        return Err(SphereError::NoOutline);
    }
    let mut rng = Rng::new(1);
    let largest = 0.5 * image.width.max(image.height) as f64;
    let on = |c: &Circle, tolerance: f64| -> Vec<DVec2> {
        points
            .iter()
            .copied()
            .filter(|p| ((*p - DVec2::new(c.x, c.y)).length() - c.radius).abs() < tolerance)
            .collect()
    };
    // Share of the outline that has points: bins of angle, so that a thick edge counts once.
    let covered = |c: &Circle, on: &[DVec2]| -> f64 {
        let mut bins = [false; 72];
        for p in on {
            let turn = libm::atan2(p.y - c.y, p.x - c.x) / std::f64::consts::TAU + 0.5;
            bins[((turn * 72.0) as usize).min(71)] = true;
        }
        bins.iter().filter(|b| **b).count() as f64 / 72.0
    };
    let mut best: Option<(f64, Circle)> = None;
    for _ in 0..1500 {
        let pick: Vec<DVec2> = (0..3).map(|_| points[rng.below(points.len())]).collect();
        let Ok(circle) = fit_circle(&pick) else { continue };
        if circle.radius < 4.0 || circle.radius > largest {
            continue;
        }
        let near = on(&circle, 1.2);
        let score = covered(&circle, &near) + 1e-4 * (near.len() as f64 / points.len() as f64);
        if best.is_none_or(|(s, _)| score > s) {
            best = Some((score, circle));
        }
    }
    let (_, mut circle) = best.ok_or(SphereError::NoOutline)?;
    for tolerance in [2.0, 1.2, 1.0, 1.0] {
        circle = fit_circle(&on(&circle, tolerance)).map_err(|_| SphereError::NoOutline)?;
    }
    // In mere noise any ring has points: an outline has far more of them than the picture elsewhere.
    let near = on(&circle, 1.2);
    let ring = std::f64::consts::TAU * circle.radius * 2.4;
    let by_chance = points.len() as f64 * ring / pixels.max(1) as f64;
    if covered(&circle, &near) < 0.4 || (near.len() as f64) < 3.0 * by_chance {
        return Err(SphereError::NoOutline);
    }
    Ok(circle)
}

impl Circle {
    /// Direction of a light whose reflection is seen at a point of the image; `None` outside the circle.
    #[must_use]
    pub fn reflect(&self, x: f64, y: f64) -> Option<DVec3> {
        let (nx, ny) = ((x - self.x) / self.radius, (self.y - y) / self.radius);
        let rest = 1.0 - nx * nx - ny * ny;
        let n = (rest > 0.0).then(|| DVec3::new(nx, ny, libm::sqrt(rest)))?;
        // l = 2(n·v)n − v with v = (0, 0, 1).
        Some(2.0 * n.z * n - DVec3::Z)
    }
}

/// The light's direction from the highlight within `circle`.
///
/// # Errors
/// [`SphereError::NoHighlight`] where nothing stands out of the noise.
pub fn light_direction(image: &Grey, circle: &Circle) -> Result<Reflection, SphereError> {
    image.check()?;
    let (w, h) = (image.width, image.height);
    let inside = |i: usize| {
        let (x, y) = ((i % w) as f64 + 0.5 - circle.x, (i / w) as f64 + 0.5 - circle.y);
        // The rim shows grazing reflections of the whole room.
        x * x + y * y < 0.96 * circle.radius * circle.radius
    };
    let pixels: Vec<usize> = (0..w * h).filter(|&i| inside(i)).collect();
    if pixels.len() < 20 {
        return Err(SphereError::NoHighlight);
    }
    let mut values: Vec<f32> = pixels.iter().map(|&i| image.values[i]).collect();
    let middle = values.len() / 2;
    let base = *values.select_nth_unstable_by(middle, f32::total_cmp).1;
    let mut spread: Vec<f32> = values.iter().map(|v| (v - base).abs()).collect();
    let sigma = 1.4826 * *spread.select_nth_unstable_by(middle, f32::total_cmp).1;
    // The peak of a 3×3 mean: one hot pixel is no highlight.
    let mean = |i: usize| -> f32 {
        let (x, y) = (i % w, i / w);
        if x == 0 || y == 0 || x + 1 == w || y + 1 == h {
            return base;
        }
        (0..9).map(|k| image.values[(y + k / 3 - 1) * w + x + k % 3 - 1]).sum::<f32>() / 9.0
    };
    let (mut peak, mut top) = (0, base);
    for &i in &pixels {
        let m = mean(i);
        if m > top {
            (peak, top) = (i, m);
        }
    }
    if top - base <= (4.0 * sigma).max(1e-3 * base.abs()).max(1e-6) {
        return Err(SphereError::NoHighlight);
    }
    // The connected spot above a quarter of the peak, around the peak.
    let cut = base + 0.25 * (top - base);
    let member: Vec<bool> = (0..w * h).map(|i| inside(i) && mean(i) > cut).collect();
    let mut spot = vec![peak];
    let mut taken = vec![false; w * h];
    taken[peak] = true;
    let mut next = 0;
    while let Some(&i) = spot.get(next) {
        next += 1;
        for j in [i.wrapping_sub(1), i + 1, i.wrapping_sub(w), i + w] {
            if j < w * h && member[j] && !taken[j] {
                taken[j] = true;
                spot.push(j);
            }
        }
    }
    let (mut sum, mut at, mut weight) = (DVec3::ZERO, DVec2::ZERO, 0.0);
    for &i in &spot {
        let (x, y) = ((i % w) as f64 + 0.5, (i / w) as f64 + 0.5);
        let v = f64::from(image.values[i] - base).max(0.0);
        if let Some(l) = circle.reflect(x, y) {
            sum += l * v;
            at += DVec2::new(x, y) * v;
            weight += v;
        }
    }
    if weight <= 0.0 || sum.length() <= 0.0 {
        return Err(SphereError::NoHighlight);
    }
    let direction = sum.normalize().as_vec3();
    let at = at / weight;
    let radius = libm::sqrt(spot.len() as f64 / std::f64::consts::PI);
    // A twentieth of the spot, a tenth of a pixel for its centre, the same for the circle's.
    let error = libm::sqrt(0.0025 * radius * radius + 0.02);
    // dl = 2 dn, dn = dx / (r·n_z), and n_z = cos(σ/2) of the light's slant σ.
    let nz = f64::from(libm::cosf(0.5 * light::slant(direction))).max(0.1);
    let uncertainty = (2.0 * error / (circle.radius * nz)).to_degrees();
    Ok(Reflection { direction, uncertainty, at: (at.x, at.y), spot: radius })
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Bench {
        size: usize,
        circle: Circle,
        blur: f64,
        noise: f32,
        occluded: bool,
    }

    impl Bench {
        /// A picture by `value` of a position, 3×3 samples a pixel, defocused, noisy, clipped at 1.
        fn render(&self, rng: &mut Rng, value: impl Fn(f64, f64) -> f64) -> Vec<f32> {
            let n = self.size;
            let mut image: Vec<f64> = (0..n * n)
                .map(|i| {
                    (0..9)
                        .map(|k| {
                            let at = |c: usize, k: usize| c as f64 + (k as f64 + 0.5) / 3.0;
                            value(at(i % n, k % 3), at(i / n, k / 3))
                        })
                        .sum::<f64>()
                        / 9.0
                })
                .collect();
            if self.blur > 0.0 {
                let reach = (3.0 * self.blur).ceil() as isize;
                let kernel: Vec<f64> =
                    (-reach..=reach).map(|d| libm::exp(-0.5 * (d as f64 / self.blur).powi(2))).collect();
                let total: f64 = kernel.iter().sum();
                for along in [1isize, n as isize] {
                    let old = image.clone();
                    for (i, out) in image.iter_mut().enumerate() {
                        let c = if along == 1 { i % n } else { i / n } as isize;
                        *out = (-reach..=reach)
                            .zip(&kernel)
                            .map(|(d, k)| {
                                let d = d.clamp(-c, n as isize - 1 - c);
                                k * old[(i as isize + d * along) as usize]
                            })
                            .sum::<f64>()
                            / total;
                    }
                }
            }
            image.iter().map(|v| (*v as f32 + self.noise * rng.normal()).clamp(0.0, 1.0)).collect()
        }

        fn hidden(&self, x: f64, y: f64) -> bool {
            // A stand covers the lower left of the outline.
            self.occluded
                && y - self.circle.y > 0.55 * self.circle.radius
                && x < self.circle.x + 0.5 * self.circle.radius
        }

        fn room(&self, rng: &mut Rng) -> Vec<f32> {
            let c = self.circle;
            self.render(rng, |x, y| {
                if self.hidden(x, y) {
                    return 0.35;
                }
                // A dark ball before a lighter wall, its rim mirroring the wall.
                let q = ((x - c.x).powi(2) + (y - c.y).powi(2)) / (c.radius * c.radius);
                if q < 1.0 { 0.12 + 0.1 * q * q } else { 0.6 }
            })
        }

        fn lit(&self, light: DVec3, rng: &mut Rng) -> Vec<f32> {
            self.render(rng, |x, y| {
                if self.hidden(x, y) {
                    return 0.02;
                }
                let Some(l) = self.circle.reflect(x, y) else { return 0.01 };
                // A collimated LED of 1.5° radius, and the gloss around it.
                let angle = libm::acos(l.dot(light).clamp(-1.0, 1.0)).to_degrees();
                0.03 + if angle < 1.5 { 3.0 } else { 0.3 * libm::exp(-(angle - 1.5) / 1.5) }
            })
        }
    }

    #[test]
    fn half_a_degree_in_the_median_one_and_a_half_at_worst() {
        let mut rng = Rng::new(11);
        let (mut errors, mut ratios) = (Vec::new(), Vec::new());
        for k in 0..60 {
            let circle = Circle {
                x: 130.0 + f64::from(rng.range(-12.0, 12.0)),
                y: 128.0 + f64::from(rng.range(-12.0, 12.0)),
                radius: f64::from(rng.range(60.0, 100.0)),
            };
            let bench = Bench {
                size: 256,
                circle,
                blur: f64::from(rng.range(0.0, 2.5)),
                noise: rng.range(0.0, 0.02),
                occluded: k % 2 == 0,
            };
            let room = bench.room(&mut rng);
            let found = find_outline(&Grey { width: 256, height: 256, values: &room }, |_, _| false).unwrap();
            for _ in 0..3 {
                let truth = rng.direction(1.25);
                let at = truth.as_dvec3() + DVec3::Z;
                let n = at.normalize();
                let (x, y) = (circle.x + n.x * circle.radius, circle.y - n.y * circle.radius);
                if bench.hidden(x, y) || bench.hidden(x, y + 6.0) {
                    continue;
                }
                let lit = bench.lit(truth.as_dvec3(), &mut rng);
                let got = light_direction(&Grey { width: 256, height: 256, values: &lit }, &found).unwrap();
                let error = f64::from(light::angle(got.direction, truth)).to_degrees();
                errors.push(error);
                ratios.push(error / got.uncertainty);
            }
        }
        errors.sort_by(f64::total_cmp);
        let (median, worst) = (errors[errors.len() / 2], errors[errors.len() - 1]);
        let rms = libm::sqrt(ratios.iter().map(|r| r * r).sum::<f64>() / ratios.len() as f64);
        println!(
            "{} directions: median {median:.3}°, worst {worst:.3}°, error over uncertainty {rms:.2}",
            errors.len()
        );
        assert!(errors.len() > 120 && median < 0.5 && worst < 1.5, "{median} {worst}");
        assert!(rms < 3.0, "the uncertainty is too small: {rms}");
    }

    #[test]
    fn clicked_points_and_what_is_missing() {
        let on = |a: f64| DVec2::new(50.0 + 20.0 * libm::cos(a), 40.0 + 20.0 * libm::sin(a));
        let c = fit_circle(&[on(0.1), on(2.0), on(4.0), on(5.0)]).unwrap();
        assert!((c.x - 50.0).abs() < 1e-6 && (c.y - 40.0).abs() < 1e-6 && (c.radius - 20.0).abs() < 1e-6);
        assert_eq!(fit_circle(&[on(0.0), on(1.0)]), Err(SphereError::Points(2)));
        assert_eq!(fit_circle(&[DVec2::ZERO, DVec2::X, DVec2::X * 2.0]), Err(SphereError::Points(3)));
        let mut rng = Rng::new(1);
        let noise: Vec<f32> = (0..128 * 128).map(|_| 0.2 + 0.02 * rng.normal()).collect();
        let image = Grey { width: 128, height: 128, values: &noise };
        assert_eq!(find_outline(&image, |_, _| false), Err(SphereError::NoOutline));
        assert_eq!(
            light_direction(&image, &Circle { x: 64.0, y: 64.0, radius: 40.0 }),
            Err(SphereError::NoHighlight)
        );
    }
}
