//! How far normals are from the truth: angular error per pixel and its mean (COIL-PS Eq. 2).

use glam::Vec3;
use std::f32::consts::{PI, SQRT_2};

/// Angle between two unit vectors, radians.
///
/// From the chord, 2·asin(|a−b|/2), because arccos(a·b) loses half of the digits near zero. The series for asin is the
/// same arithmetic on every platform, so native and WASM agree to the bit.
#[inline]
#[must_use]
pub fn unit_angle(a: Vec3, b: Vec3) -> f32 {
    let near = (a - b).length();
    let far = (a + b).length();
    let chord = near.min(far).min(SQRT_2);
    let half = 2.0 * asin_to_sqrt_half(0.5 * chord);
    if near <= far { half } else { PI - half }
}

/// asin(x) for 0 ≤ x ≤ √½; error below 2e-7.
#[inline]
fn asin_to_sqrt_half(x: f32) -> f32 {
    let t = x * x;
    // Chebyshev interpolant of asin(√t)/√t over t in [0, ½].
    ASIN.iter().rev().fold(0.0, |sum, &c| sum * t + c) * x
}

const ASIN: [f32; 9] = [
    1.0,
    0.166_666_14,
    0.075_027_57,
    0.044_091_62,
    0.035_814_24,
    -0.007_020_57,
    0.107_400_01,
    -0.135_916_26,
    0.123_913_49,
];

/// Angular error of every pixel in degrees, and its mean.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorMap {
    /// Degrees, one a mask pixel.
    pub degrees: Vec<f32>,
    /// Mean angular error over the mask, degrees.
    pub mae: f64,
    /// Pixels whose true normal is unknown (zero); they count as 90°, as in the official score.
    pub unknown: usize,
}

/// Angular error of `normals` against `truth` (unit vectors; a zero true normal counts as 90°).
#[must_use]
pub fn error_map(normals: &[Vec3], truth: &[Vec3]) -> ErrorMap {
    let mut unknown = 0;
    let degrees: Vec<f32> = normals
        .iter()
        .zip(truth)
        .map(|(&n, &t)| {
            if t == Vec3::ZERO {
                unknown += 1;
                90.0
            } else {
                unit_angle(n, t).to_degrees()
            }
        })
        .collect();
    ErrorMap { mae: mean(&degrees), degrees, unknown }
}

/// Mean angular error in degrees, without the map.
#[must_use]
pub fn mae(normals: &[Vec3], truth: &[Vec3]) -> f64 {
    error_map(normals, truth).mae
}

fn mean(values: &[f32]) -> f64 {
    values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_angle_is_the_angle() {
        for degrees in [0.0f32, 0.001, 0.1, 1.0, 30.0, 60.0, 89.9, 90.0, 90.1, 120.0, 179.0, 180.0] {
            let (s, c) = degrees.to_radians().sin_cos();
            let (a, b) = (Vec3::Z, Vec3::new(s * 0.6, s * 0.8, c));
            assert!((unit_angle(a, b).to_degrees() - degrees).abs() < 3e-5 * degrees.max(1.0), "{degrees}");
        }
    }

    #[test]
    fn unknown_truth_counts_as_ninety_degrees() {
        let e = error_map(&[Vec3::Z, Vec3::X], &[Vec3::ZERO, Vec3::X]);
        assert_eq!((e.unknown, e.mae), (1, 45.0));
    }
}
