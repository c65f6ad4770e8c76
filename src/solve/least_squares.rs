//! Least squares (Woodham 1980): `g = (LᵀL)⁻¹ Lᵀ I` per pixel, normal g/|g|, albedo |g|.
//!
//! `LᵀL` is shared by all pixels, so a further light costs one pass over them: see [`NormalEquations`].

use super::{Measurements, Solution, SolveError, Solver, Validity};
use glam::{DMat3, DVec3, Vec3};

/// Least squares over all images.
#[derive(Clone, Copy, Debug, Default)]
pub struct LeastSquares;

impl Solver for LeastSquares {
    fn name(&self) -> &'static str {
        "ls"
    }

    fn solve(&self, measurements: &Measurements) -> Result<Solution, SolveError> {
        let pixels = measurements.check()?;
        let rows = pseudo_inverse(&measurements.lights)?;
        let mut normals = vec![Vec3::Z; pixels];
        let mut albedo = vec![0.0; pixels];
        const BLOCK: usize = 512; // accumulators stay in the first-level cache
        let mut g = [[0.0f32; BLOCK]; 3];
        for start in (0..pixels).step_by(BLOCK) {
            let n = BLOCK.min(pixels - start);
            g.iter_mut().for_each(|axis| axis[..n].fill(0.0));
            for (row, image) in rows.iter().zip(&measurements.images) {
                let values = &image[start..start + n];
                let [gx, gy, gz] = &mut g;
                for (((x, y), z), &v) in gx[..n].iter_mut().zip(&mut gy[..n]).zip(&mut gz[..n]).zip(values) {
                    *x += row.x * v;
                    *y += row.y * v;
                    *z += row.z * v;
                }
            }
            let out = normals[start..start + n].iter_mut().zip(&mut albedo[start..start + n]);
            for (p, (normal, albedo)) in out.enumerate() {
                (*normal, *albedo) = split(Vec3::new(g[0][p], g[1][p], g[2][p]));
            }
        }
        let mut solution = finish(normals, albedo);
        mark_saturated(measurements, &mut solution.validity);
        Ok(solution)
    }
}

/// Marks pixels with less than three values that are not saturated.
fn mark_saturated(measurements: &Measurements, validity: &mut [Validity]) {
    if measurements.saturated.iter().all(|flags| flags.is_empty()) {
        return;
    }
    for (p, validity) in validity.iter_mut().enumerate() {
        let whole =
            (0..measurements.images.len()).filter(|&k| measurements.saturated_in(k).get(p) != Some(&true));
        if whole.take(3).count() < 3 {
            *validity = Validity::Saturated;
        }
    }
}

/// Columns of the pseudo-inverse (LᵀL)⁻¹Lᵀ: `g = Σ_k I_k · column_k`.
///
/// # Errors
/// [`SolveError::Coplanar`] where LᵀL is not safely invertible.
pub fn pseudo_inverse(lights: &[Vec3]) -> Result<Vec<Vec3>, SolveError> {
    let gram = lights.iter().fold(DMat3::ZERO, |m, l| m + outer(l.as_dvec3()));
    let inverse = invert(gram, lights.len())?;
    Ok(lights.iter().map(|l| (inverse * l.as_dvec3()).as_vec3()).collect())
}

fn outer(l: DVec3) -> DMat3 {
    DMat3::from_cols(l * l.x, l * l.y, l * l.z)
}

fn invert(gram: DMat3, lights: usize) -> Result<DMat3, SolveError> {
    // det is the product of the eigenvalues, which sum to the trace; relative to (trace/3)³ it is 1 for
    // evenly spread lights and 0 for coplanar ones.
    let scale = (gram.x_axis.x + gram.y_axis.y + gram.z_axis.z) / 3.0;
    let det = gram.determinant();
    if lights < 3 {
        Err(SolveError::TooFew(lights))
    } else if det > 1e-9 * scale * scale * scale {
        Ok(gram.inverse())
    } else {
        Err(SolveError::Coplanar(lights))
    }
}

#[inline]
fn split(g: Vec3) -> (Vec3, f32) {
    let length = g.length();
    if length > 1e-20 { (g / length, length) } else { (Vec3::Z, 0.0) }
}

fn finish(normals: Vec<Vec3>, albedo: Vec<f32>) -> Solution {
    let validity =
        albedo.iter().map(|&a| if a > 0.0 { Validity::Valid } else { Validity::Shadowed }).collect();
    Solution { normals, albedo, validity, uncertainty: None, own: Vec::new() }
}

/// Running normal equations of all pixels: a light is added in one pass, normals are solved in one.
#[derive(Clone, Debug)]
pub struct NormalEquations {
    gram: DMat3,
    rhs: Vec<Vec3>,
    lights: usize,
}

impl NormalEquations {
    /// No light yet, `pixels` pixels.
    #[must_use]
    pub fn new(pixels: usize) -> Self {
        Self { gram: DMat3::ZERO, rhs: vec![Vec3::ZERO; pixels], lights: 0 }
    }

    /// Adds one image (`image.len()` = number of pixels).
    pub fn add(&mut self, light: Vec3, image: &[f32]) {
        assert_eq!(image.len(), self.rhs.len(), "one value a pixel");
        self.gram += outer(light.as_dvec3());
        self.lights += 1;
        for (r, &v) in self.rhs.iter_mut().zip(image) {
            *r += light * v;
        }
    }

    /// Number of lights added.
    #[must_use]
    pub fn lights(&self) -> usize {
        self.lights
    }

    /// Normals and albedo from the lights so far.
    ///
    /// # Errors
    /// [`SolveError`] for fewer than three lights, or lights in one plane.
    pub fn solve(&self) -> Result<Solution, SolveError> {
        let inverse = invert(self.gram, self.lights)?.as_mat3();
        let (normals, albedo) = self.rhs.iter().map(|&r| split(inverse * r)).unzip();
        Ok(finish(normals, albedo))
    }

    /// Unit normals that one further image would give, without adding it, handed pixel by pixel to
    /// `each(pixel, normal)`. What the greedy oracle and the brute-force study call for each candidate.
    /// Before three lights in general position a ridge of 1e-6 (as in TK22) stands in for the missing ones.
    pub fn preview(&self, light: Vec3, image: &[f32], mut each: impl FnMut(usize, Vec3)) {
        let gram = self.gram + outer(light.as_dvec3());
        let inverse = invert(gram, self.lights + 1)
            .unwrap_or_else(|_| (gram + DMat3::from_diagonal(DVec3::splat(1e-6))).inverse())
            .as_mat3();
        for (p, (&r, &v)) in self.rhs.iter().zip(image).enumerate() {
            each(p, split(inverse * (r + light * v)).0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::{fibonacci_cap, ring};

    fn shaded(normals: &[Vec3], lights: &[Vec3], albedo: f32) -> Vec<Vec<f32>> {
        lights.iter().map(|l| normals.iter().map(|n| albedo * n.dot(*l)).collect()).collect()
    }

    #[test]
    fn lambertian_normals_are_exact() {
        let normals = fibonacci_cap(1500, 0.5);
        let lights = fibonacci_cap(10, 0.9);
        let images = shaded(&normals, &lights, 0.7);
        let m = Measurements {
            lights,
            images: images.iter().map(Vec::as_slice).collect(),
            saturated: Vec::new(),
        };
        let s = LeastSquares.solve(&m).unwrap();
        for (a, b) in s.normals.iter().zip(&normals) {
            assert!((*a - *b).length() < 1e-5);
        }
        assert!(s.albedo.iter().all(|a| (a - 0.7).abs() < 1e-5));
    }

    #[test]
    fn one_light_at_a_time_gives_the_same() {
        let normals = fibonacci_cap(300, 0.5);
        let lights = fibonacci_cap(7, 0.9);
        let mut images = shaded(&normals, &lights, 1.0);
        images[3].iter_mut().for_each(|v| *v *= 0.3); // not Lambertian: a true least-squares fit
        let mut running = NormalEquations::new(300);
        for (l, i) in lights.iter().zip(&images).take(6) {
            running.add(*l, i);
        }
        let mut previewed = vec![Vec3::ZERO; 300];
        running.preview(lights[6], &images[6], |p, n| previewed[p] = n);
        running.add(lights[6], &images[6]);
        let m = Measurements {
            lights,
            images: images.iter().map(Vec::as_slice).collect(),
            saturated: Vec::new(),
        };
        let whole = LeastSquares.solve(&m).unwrap();
        for ((a, b), c) in whole.normals.iter().zip(running.solve().unwrap().normals).zip(previewed) {
            assert!((*a - b).length() < 1e-5 && (b - c).length() < 1e-6);
        }
    }

    #[test]
    fn what_cannot_be_solved_is_named() {
        let black = vec![0.0; 4];
        let solve = |lights: Vec<Vec3>| {
            let images = vec![black.as_slice(); lights.len()];
            LeastSquares.solve(&Measurements { lights, images, saturated: Vec::new() })
        };
        assert_eq!(solve(vec![Vec3::Z; 2]).unwrap_err(), SolveError::TooFew(2));
        assert_eq!(solve(vec![Vec3::Z; 5]).unwrap_err(), SolveError::Coplanar(5));
        let s = solve(ring(4, 0.9, 0.0)).unwrap();
        assert!(s.validity.iter().all(|&v| v == Validity::Shadowed));
        assert!(s.normals.iter().all(|&n| n == Vec3::Z));
    }
}
