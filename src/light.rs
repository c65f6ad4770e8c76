//! Light directions: unit vectors with z ≥ 0, azimuth and slant, sets of candidates.

use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, TAU};

/// Angle between the optical axis (0,0,1) and `direction`, radians.
#[must_use]
pub fn slant(direction: Vec3) -> f32 {
    libm::atan2f(direction.truncate().length(), direction.z)
}

/// Angle of the projection on the image plane from +x towards +y, radians in (−π, π]; 0 on the axis.
#[must_use]
pub fn azimuth(direction: Vec3) -> f32 {
    libm::atan2f(direction.y, direction.x)
}

/// The unit direction of an azimuth and a slant in [0, π/2], radians.
#[must_use]
pub fn from_azimuth_slant(azimuth: f32, slant: f32) -> Vec3 {
    let s = libm::sinf(slant);
    // The nearest f32 to π/2 has a cosine just below zero.
    Vec3::new(s * libm::cosf(azimuth), s * libm::sinf(azimuth), libm::cosf(slant).max(0.0))
}

/// Angle between two unit vectors, radians; exact also where they nearly coincide.
#[must_use]
pub fn angle(a: Vec3, b: Vec3) -> f32 {
    libm::atan2f(a.cross(b).length(), a.dot(b))
}

/// `count` directions spread evenly by area over the hemisphere z ≥ 0 (Fibonacci lattice: heights at
/// the middle of equal-area bands, azimuth advancing by the golden angle), from the pole outwards.
#[must_use]
pub fn fibonacci_hemisphere(count: usize) -> Vec<Vec3> {
    fibonacci_cap(count, FRAC_PI_2)
}

/// [`fibonacci_hemisphere`] on the cap of slants up to `reach` radians.
#[must_use]
pub fn fibonacci_cap(count: usize, reach: f32) -> Vec<Vec3> {
    let golden = std::f64::consts::PI * (3.0 - libm::sqrt(5.0));
    let depth = 1.0 - libm::cos(f64::from(reach));
    (0..count)
        .map(|i| {
            let z = 1.0 - depth * (i as f64 + 0.5) / count as f64;
            let r = libm::sqrt((1.0 - z * z).max(0.0));
            let phi = golden * i as f64;
            Vec3::new((r * libm::cos(phi)) as f32, (r * libm::sin(phi)) as f32, z as f32)
        })
        .collect()
}

/// `count` directions at one slant, evenly spaced in azimuth from `start` (radians).
#[must_use]
pub fn ring(count: usize, slant: f32, start: f32) -> Vec<Vec3> {
    (0..count).map(|k| from_azimuth_slant(start + TAU * k as f32 / count as f32, slant)).collect()
}

/// `direction`, or where its slant is above `reach` (radians), the nearest direction at that slant.
#[must_use]
pub fn within(direction: Vec3, reach: f32) -> Vec3 {
    if slant(direction) <= reach { direction } else { from_azimuth_slant(azimuth(direction), reach) }
}

/// `v` turned about the optical axis by `angle` radians.
#[must_use]
pub fn rotate_about_axis(v: Vec3, angle: f32) -> Vec3 {
    let (s, c) = (libm::sinf(angle), libm::cosf(angle));
    Vec3::new(c * v.x - s * v.y, s * v.x + c * v.y, v.z)
}

/// Index of the candidate nearest in angle to `direction` among those for which `free` holds.
/// Ties go to the lower index. `None` where no candidate is free.
#[must_use]
pub fn nearest(direction: Vec3, candidates: &[Vec3], mut free: impl FnMut(usize) -> bool) -> Option<usize> {
    let mut best: Option<(usize, f32)> = None;
    for (i, c) in candidates.iter().enumerate() {
        let dot = c.dot(direction);
        if best.is_none_or(|(_, d)| dot > d) && free(i) {
            best = Some((i, dot));
        }
    }
    best.map(|(i, _)| i)
}

/// Assigns to each direction, in order, the nearest candidate not yet assigned (greedy, as in DC05 on
/// a light stage). Directions beyond the number of candidates get none: the result is then shorter.
#[must_use]
pub fn assign_unique(directions: &[Vec3], candidates: &[Vec3]) -> Vec<usize> {
    let mut taken = vec![false; candidates.len()];
    directions
        .iter()
        .map_while(|&d| {
            let i = nearest(d, candidates, |i| !taken[i])?;
            taken[i] = true;
            Some(i)
        })
        .collect()
}

/// Largest slant among `lights`, radians; 0 for an empty set.
#[must_use]
pub fn reach(lights: &[Vec3]) -> f32 {
    lights.iter().map(|&l| slant(l)).fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn azimuth_and_slant_round_trip() {
        for d in fibonacci_hemisphere(200) {
            assert!((from_azimuth_slant(azimuth(d), slant(d)) - d).length() < 1e-6);
        }
        assert_eq!(azimuth(Vec3::Z), 0.0);
    }

    #[test]
    fn fibonacci_is_unit_even_and_in_the_hemisphere() {
        for k in [1, 50, 1000] {
            let dirs = fibonacci_hemisphere(k);
            assert_eq!(dirs.len(), k);
            assert!(dirs.iter().all(|d| (d.length() - 1.0).abs() < 1e-6 && d.z > 0.0));
        }
        // Even: the mean of a full-hemisphere set is (0, 0, 1/2).
        let mean = fibonacci_hemisphere(1000).iter().sum::<Vec3>() / 1000.0;
        assert!((mean - Vec3::new(0.0, 0.0, 0.5)).length() < 2e-3);
    }

    #[test]
    fn assignment_is_unique_and_nearest_first() {
        let candidates = fibonacci_hemisphere(20);
        let wanted = vec![candidates[7]; 5];
        let got = assign_unique(&wanted, &candidates);
        assert_eq!(got[0], 7);
        let mut sorted = got.clone();
        sorted.sort_unstable();
        sorted.dedup();
        assert_eq!(sorted.len(), 5);
        assert_eq!(assign_unique(&vec![Vec3::Z; 30], &candidates).len(), 20);
    }

    #[test]
    fn small_angles_are_exact() {
        let a = Vec3::Z;
        let b = from_azimuth_slant(1.0, 1e-4);
        assert!((angle(a, b) - 1e-4).abs() < 1e-9);
    }
}
