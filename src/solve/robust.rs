//! What the robust solvers share: which values of a pixel can be used, weighted least squares on
//! blocks of pixels, and what happens where too little is left.
//!
//! A solver of this family only says how much weight each value gets ([`Weigh`]). Then `g = (LᵀWL)⁻¹LᵀW I`.

use super::lanes::{LANES, Lanes};
use super::{Measurements, Solution, SolveError, Validity, least_squares};
use glam::Vec3;

/// Which values of a pixel a robust solver looks at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thresholds {
    /// Values at or below this fraction of the pixel's brightest are taken for shadow.
    pub shadow: f32,
    /// Weighted light sets whose mean Gram matrix has less than this fraction of the determinant of
    /// the whole set's are refused: they would turn small errors into large angles.
    pub conditioning: f32,
}

impl Default for Thresholds {
    /// As `coil tune` found them on synthetic pixels.
    fn default() -> Self {
        Self { shadow: 0.05, conditioning: 0.1 }
    }
}

/// The values of [`LANES`] pixels under all lights.
pub struct Block<'a> {
    /// Light of each value.
    pub lights: &'a [Vec3],
    /// One entry a light.
    pub values: &'a [Lanes],
    /// 1 for values that are neither shadowed nor saturated, else 0; all 1 where too few would be left.
    pub usable: &'a [Lanes],
}

/// Decides the weight of each value.
pub trait Weigh {
    /// Writes one weight ≥ 0 a light into `weights`, which starts as `block.usable`.
    fn weigh(&self, block: &Block, weights: &mut [Lanes]);
}

/// Symmetric 3×3 matrices (xx, xy, xz, yy, yz, zz) of the pixels of a block.
#[derive(Clone, Copy)]
pub struct Gram(pub [Lanes; 6]);

impl Gram {
    /// `Σ_k w_k l_k l_kᵀ`.
    #[inline(always)]
    pub fn weighted(lights: &[Vec3], weights: &[Lanes]) -> Self {
        let mut m = [Lanes::ZERO; 6];
        for (l, &w) in lights.iter().zip(weights) {
            m[0] += w * (l.x * l.x);
            m[1] += w * (l.x * l.y);
            m[2] += w * (l.x * l.z);
            m[3] += w * (l.y * l.y);
            m[4] += w * (l.y * l.z);
            m[5] += w * (l.z * l.z);
        }
        Self(m)
    }

    /// Adjugate (inverse times determinant) and determinant.
    #[inline(always)]
    pub fn adjugate(&self) -> (Self, Lanes) {
        let [xx, xy, xz, yy, yz, zz] = self.0;
        let a = Self([
            yy * zz - yz * yz,
            xz * yz - xy * zz,
            xy * yz - xz * yy,
            xx * zz - xz * xz,
            xy * xz - xx * yz,
            xx * yy - xy * xy,
        ]);
        let det = xx * a.0[0] + xy * a.0[1] + xz * a.0[2];
        (a, det)
    }

    /// Product with a vector of each pixel.
    #[inline(always)]
    pub fn times(&self, v: [Lanes; 3]) -> [Lanes; 3] {
        let [xx, xy, xz, yy, yz, zz] = self.0;
        [
            xx * v[0] + xy * v[1] + xz * v[2],
            xy * v[0] + yy * v[1] + yz * v[2],
            xz * v[0] + yz * v[1] + zz * v[2],
        ]
    }

    /// Product with one vector.
    #[inline(always)]
    pub fn times_light(&self, l: Vec3) -> [Lanes; 3] {
        let [xx, xy, xz, yy, yz, zz] = self.0;
        [xx * l.x + xy * l.y + xz * l.z, xy * l.x + yy * l.y + yz * l.z, xz * l.x + yz * l.y + zz * l.z]
    }
}

/// `v·l` of each pixel.
#[inline(always)]
pub fn dot(v: [Lanes; 3], l: Vec3) -> Lanes {
    v[0] * l.x + v[1] * l.y + v[2] * l.z
}

/// Length of each pixel's vector.
#[inline(always)]
pub fn length(v: [Lanes; 3]) -> Lanes {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

/// Weighted least squares of a block.
pub struct Fit {
    /// Albedo times normal.
    pub g: [Lanes; 3],
    /// `(LᵀWL)⁻¹`.
    pub inverse: Gram,
    /// Determinant of `LᵀWL / Σw`: how well the weighted lights are spread.
    pub spread: Lanes,
}

/// `g = (LᵀWL)⁻¹LᵀW I`.
#[inline(always)]
pub fn fit(lights: &[Vec3], values: &[Lanes], weights: &[Lanes]) -> Fit {
    let mut rhs = [Lanes::ZERO; 3];
    let mut total = Lanes::ZERO;
    for ((l, &v), &w) in lights.iter().zip(values).zip(weights) {
        let wv = w * v;
        rhs[0] += wv * l.x;
        rhs[1] += wv * l.y;
        rhs[2] += wv * l.z;
        total += w;
    }
    // Weights that sum to 1 keep the determinant away from the ends of f32, whatever their unit.
    let scale = Lanes::ONE / total.max(Lanes::splat(1e-30));
    let gram = Gram(Gram::weighted(lights, weights).0.map(|m| m * scale));
    let (adjugate, det) = gram.adjugate();
    let reciprocal = scale / det.max(Lanes::splat(1e-12));
    let inverse = Gram(adjugate.0.map(|m| m * reciprocal));
    Fit { g: inverse.times(rhs), inverse, spread: det }
}

/// `inner` wherever its lights are spread well enough, else `outer`.
#[inline(always)]
fn prefer(good: Lanes, inner: &[Lanes], outer: &mut [Lanes]) {
    for (o, &i) in outer.iter_mut().zip(inner) {
        *o = good.select(i, *o);
    }
}

/// Solves all pixels with the weights of `method`.
///
/// # Errors
/// [`SolveError`] where the counts disagree or the lights lie in one plane.
pub fn solve<W: Weigh>(
    measurements: &Measurements,
    thresholds: &Thresholds,
    method: &W,
) -> Result<Solution, SolveError> {
    let pixels = measurements.check()?;
    least_squares::pseudo_inverse(&measurements.lights)?;
    let lights = measurements.lights.as_slice();
    let count = lights.len();
    let ones = vec![Lanes::ONE; count];
    let whole_spread = Gram::weighted(lights, &ones).adjugate().1 * (1.0 / (count as f32).powi(3));
    let enough = whole_spread * thresholds.conditioning;

    let mut values = vec![Lanes::ZERO; count];
    let mut usable = vec![Lanes::ONE; count];
    let mut weights = vec![Lanes::ONE; count];
    let mut bright = vec![Lanes::ONE; count];
    let mut out = Solution {
        normals: Vec::with_capacity(pixels),
        albedo: Vec::with_capacity(pixels),
        validity: Vec::with_capacity(pixels),
        uncertainty: None,
        own: Vec::new(),
    };
    for start in (0..pixels).step_by(LANES) {
        let end = pixels.min(start + LANES);
        let mut brightest = Lanes::ZERO;
        for (v, image) in values.iter_mut().zip(&measurements.images) {
            *v = Lanes::load(&image[start..end]);
            brightest = brightest.max(*v);
        }
        let dark = brightest * thresholds.shadow;
        let mut unsaturated = Lanes::ZERO;
        for k in 0..count {
            let whole = Lanes::unflagged(measurements.saturated_in(k).get(start..end).unwrap_or_default());
            unsaturated += whole;
            bright[k] = dark.below(values[k]);
            weights[k] = bright[k] * whole;
        }
        let solvable = |w: &[Lanes]| enough.at_most(fit(lights, &values, w).spread) * counted(w);
        // Where shadow and saturation leave too little, all values are better than none.
        usable.fill(Lanes::ONE);
        let good = solvable(&weights);
        prefer(good, &weights, &mut usable);
        let without_saturation = if good == Lanes::ONE { good } else { solvable(&bright) };

        weights.copy_from_slice(&usable);
        method.weigh(&Block { lights, values: &values, usable: &usable }, &mut weights);
        let mut fitted = fit(lights, &values, &weights);
        let refused = fitted.spread.below(enough);
        if refused != Lanes::ZERO {
            for (w, &u) in weights.iter_mut().zip(&usable) {
                *w = refused.select(u, *w);
            }
            fitted = fit(lights, &values, &weights);
        }
        let albedo = length(fitted.g);
        for i in 0..end - start {
            let g = Vec3::new(fitted.g[0].0[i], fitted.g[1].0[i], fitted.g[2].0[i]);
            let a = albedo.0[i];
            let dead = !(a > 1e-20 && a.is_finite());
            out.normals.push(if dead { Vec3::Z } else { g / a });
            out.albedo.push(if dead { 0.0 } else { a });
            let missing =
                if without_saturation.0[i] > 0.0 { Validity::Saturated } else { Validity::Shadowed };
            out.validity.push(if unsaturated.0[i] < 3.0 {
                Validity::Saturated
            } else if dead {
                Validity::Shadowed
            } else if good.0[i] > 0.0 {
                Validity::Valid
            } else {
                missing
            });
        }
    }
    Ok(out)
}

/// 1 where at least three weights are above 0.
#[inline(always)]
fn counted(weights: &[Lanes]) -> Lanes {
    let mut n = Lanes::ZERO;
    for &w in weights {
        n += Lanes::ZERO.below(w);
    }
    Lanes::splat(3.0).at_most(n)
}

#[cfg(test)]
mod tests {
    use super::super::*;
    use crate::error::unit_angle;
    use crate::light::{fibonacci_cap, ring};
    use crate::rng::Rng;

    /// Every solver there is, for what must hold for all.
    fn all() -> Vec<Box<dyn Solver>> {
        SOLVERS.iter().map(|s| by_name(s.name).unwrap()).collect()
    }

    fn solve(solver: &dyn Solver, lights: &[Vec3], images: &[Vec<f32>], saturation: Option<f32>) -> Solution {
        let limit = saturation.unwrap_or(f32::INFINITY);
        let flags: Vec<Vec<bool>> =
            images.iter().map(|i| i.iter().map(|v| v.is_finite() && *v >= limit).collect()).collect();
        let images = images.iter().map(Vec::as_slice).collect();
        let saturated = flags.iter().map(Vec::as_slice).collect();
        let measurements = Measurements { lights: lights.to_vec(), images, saturated };
        let mut solution = solver.solve(&measurements).unwrap();
        uncertainty::complete(solver.name(), &measurements, &mut solution).unwrap();
        solution
    }

    fn lambert(normals: &[Vec3], lights: &[Vec3]) -> Vec<Vec<f32>> {
        lights.iter().map(|l| normals.iter().map(|n| 0.6 * n.dot(*l).max(0.0)).collect()).collect()
    }

    #[test]
    fn lambertian_pixels_are_exact() {
        let normals = fibonacci_cap(501, 0.5);
        for count in [3, 4, 5, 8, 10, 40] {
            let lights = fibonacci_cap(count, 0.9);
            let images = lambert(&normals, &lights);
            for solver in all() {
                let s = solve(&*solver, &lights, &images, Some(1.0));
                // Three lights fit any values, so the network can't know that they are Lambertian.
                let learned = matches!(solver.name(), "pixel" | "context");
                let limit = if learned && count == 3 { 8.0 } else { 0.2 };
                for (n, t) in s.normals.iter().zip(&normals) {
                    let off = unit_angle(*n, *t).to_degrees();
                    assert!(off < limit, "{} at T = {count}: {off}°", solver.name());
                }
            }
        }
    }

    #[test]
    fn shadows_and_highlights_are_seen_through() {
        let mut rng = Rng::new(4);
        let normals = fibonacci_cap(400, 0.6);
        let lights = fibonacci_cap(12, 0.9);
        let mut images = lambert(&normals, &lights);
        for p in 0..normals.len() {
            let hit = rng.sample(12, 3);
            images[hit[0]][p] *= 0.02;
            images[hit[1]][p] *= 0.02;
            images[hit[2]][p] += 0.7;
        }
        let error = |name: &str| {
            let s = solve(&*by_name(name).unwrap(), &lights, &images, None);
            crate::error::mae(&s.normals, &normals)
        };
        let ls = error("ls");
        for name in ["trimmed", "l1", "huber", "cauchy", "sbr"] {
            assert!(error(name) < 0.25 * ls, "{name}: {} of {ls}", error(name));
        }
    }

    #[test]
    fn saturated_values_are_left_out_and_pixels_without_others_are_marked() {
        let (normals, lights) = (fibonacci_cap(300, 0.3), fibonacci_cap(12, 1.0));
        // So bright that the sensor cuts off all but so many of the lights.
        for (left, validity) in [(8, Validity::Valid), (2, Validity::Saturated)] {
            let mut images = lambert(&normals, &lights);
            for p in 0..normals.len() {
                let mut values: Vec<f32> = images.iter().map(|i| i[p]).collect();
                values.sort_by(f32::total_cmp);
                let gain = 1.001 / values[left];
                images.iter_mut().for_each(|i| i[p] = (gain * i[p]).min(1.0));
            }
            for solver in all() {
                let s = solve(&*solver, &lights, &images, Some(1.0));
                assert!(s.validity.iter().all(|v| *v == validity), "{}", solver.name());
                // Least squares takes all values; the network saw few pixels of which a third is saturated.
                let limit = match (validity, solver.name()) {
                    (Validity::Saturated, _) | (_, "ls") => 90.0,
                    (_, "pixel" | "context") => 3.0,
                    _ => 0.2,
                };
                let off = crate::error::mae(&s.normals, &normals);
                assert!(off < limit, "{}: {off}°", solver.name());
            }
        }
    }

    #[test]
    fn pixels_whose_lit_lights_lie_close_together_are_marked() {
        let mut lights = ring(4, 0.05, 0.3);
        lights.extend(ring(6, 0.9, 0.0));
        let normals = [Vec3::Z];
        let mut images = lambert(&normals, &lights);
        images[4..].iter_mut().for_each(|image| image.fill(0.0));
        let (shadowed, saturated) = (images.clone(), images);
        for solver in all().iter().filter(|s| s.name() != "ls") {
            let s = solve(&**solver, &lights, &shadowed, Some(1.0));
            assert_eq!(s.validity, [Validity::Shadowed], "{}", solver.name());
        }
        let mut burnt = saturated;
        burnt[4..].iter_mut().for_each(|image| image.fill(1.0));
        for solver in all().iter().filter(|s| s.name() != "ls") {
            let s = solve(&**solver, &lights, &burnt, Some(1.0));
            assert_eq!(s.validity, [Validity::Saturated], "{}", solver.name());
        }
    }

    #[test]
    fn hopeless_pixels_are_marked_and_never_nan() {
        let lights = ring(6, 0.8, 0.2);
        // black; saturated everywhere; NaN; infinite; one light only; ordinary
        let pixel = |k: usize| {
            [0.0, 1.0, f32::NAN, f32::INFINITY, if k == 2 { 0.5 } else { 0.0 }, 0.1 + 0.1 * k as f32]
        };
        let images: Vec<Vec<f32>> = (0..6).map(|k| pixel(k).to_vec()).collect();
        for solver in all() {
            if solver.name() == "ls" {
                continue; // its own tests; the session refuses NaN before it
            }
            let s = solve(&*solver, &lights, &images, Some(1.0));
            let expected = [
                Validity::Shadowed,
                Validity::Saturated,
                Validity::Shadowed,
                Validity::Shadowed,
                Validity::Shadowed,
                Validity::Valid,
            ];
            assert_eq!(s.validity, expected, "{}", solver.name());
            assert_eq!(s.normals[0], Vec3::Z);
            for (n, u) in s.normals.iter().zip(s.uncertainty.as_ref().unwrap()) {
                assert!((n.length() - 1.0).abs() < 1e-5 && (0.0..=90.0).contains(u), "{}", solver.name());
            }
        }
    }

    #[test]
    fn three_lights_are_least_squares() {
        let mut rng = Rng::new(8);
        let lights = ring(3, 0.6, 0.0);
        let images: Vec<Vec<f32>> = (0..3).map(|_| (0..100).map(|_| rng.range(0.1, 1.0)).collect()).collect();
        let reference = solve(&LeastSquares, &lights, &images, None);
        for name in ["trimmed", "l1", "huber", "cauchy", "sbr"] {
            let s = solve(&*by_name(name).unwrap(), &lights, &images, None);
            for (a, b) in s.normals.iter().zip(&reference.normals) {
                assert!((*a - *b).length() < 1e-3, "{name}");
            }
        }
    }

    #[test]
    fn a_pixel_does_not_depend_on_its_neighbours() {
        let mut rng = Rng::new(2);
        let lights = fibonacci_cap(9, 0.8);
        let images: Vec<Vec<f32>> = (0..9).map(|_| (0..21).map(|_| rng.uniform()).collect()).collect();
        for solver in all() {
            let whole = solve(&*solver, &lights, &images, Some(1.0));
            let part: Vec<Vec<f32>> = images.iter().map(|i| i[13..].to_vec()).collect();
            let part = solve(&*solver, &lights, &part, Some(1.0));
            assert_eq!(whole.normals[13..], part.normals, "{}", solver.name());
        }
    }

    #[test]
    fn names_lead_to_solvers() {
        for solver in all() {
            assert!(SOLVERS.iter().any(|s| s.name == solver.name()));
        }
        assert!(by_name("least").err().unwrap().to_string().contains("ls, trimmed"));
    }
}
