//! Pictures under any direction from a finite stack: the nearest photo, or soft interpolation
//! (COIL-PS Eq. 7-8).

use crate::camera::{Camera, CameraError, Observation, check_direction};
use crate::light;
use crate::stack::{Mask, Stack};
use glam::Vec3;

/// How a requested direction becomes a picture.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum Lookup {
    /// The stored photo whose light is nearest and that was not used yet.
    Nearest,
    /// A blend of all photos with weights softmax(−angle/τ), τ in radians.
    Soft {
        /// Temperature τ, radians.
        tau: f32,
    },
}

/// Why a look-up can't be read.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("look-up '{0}': write nearest or soft:TAU with TAU in radians in (0, 10], for example soft:0.02")]
pub struct LookupError(String);

impl std::str::FromStr for Lookup {
    type Err = LookupError;

    fn from_str(s: &str) -> Result<Self, LookupError> {
        if s == "nearest" {
            return Ok(Self::Nearest);
        }
        s.strip_prefix("soft:")
            .and_then(|t| t.parse::<f32>().ok())
            .filter(|&tau| tau > 0.0 && tau <= 10.0)
            .map(|tau| Self::Soft { tau })
            .ok_or_else(|| LookupError(s.into()))
    }
}

impl std::fmt::Display for Lookup {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Nearest => write!(f, "nearest"),
            Self::Soft { tau } => write!(f, "soft:{tau}"),
        }
    }
}

/// Blend weights of a set of lights for one direction.
#[derive(Clone, Debug)]
pub struct Weights {
    /// (index of the light, weight), weights sum to 1; those below 1e-6 of the largest are left out.
    pub terms: Vec<(usize, f32)>,
    /// exp(entropy of the weights): how many photos are really blended.
    pub effective_images: f32,
}

/// Soft interpolation weights `w_p = softmax_p(−arccos(l·l_p)/τ)` (COIL-PS Eq. 7).
#[must_use]
pub fn soft_weights(direction: Vec3, lights: &[Vec3], tau: f32) -> Weights {
    let angles: Vec<f32> = lights.iter().map(|&l| light::angle(direction, l)).collect();
    let smallest = angles.iter().copied().fold(f32::INFINITY, f32::min);
    let mut terms: Vec<(usize, f32)> = angles
        .iter()
        .map(|&a| libm::expf((smallest - a) / tau))
        .enumerate()
        .filter(|&(_, w)| w > 1e-6)
        .collect();
    let total: f32 = terms.iter().map(|&(_, w)| w).sum();
    let mut entropy = 0.0;
    for (_, w) in &mut terms {
        *w /= total;
        entropy -= *w * libm::logf(*w);
    }
    Weights { terms, effective_images: libm::expf(entropy) }
}

/// Part of a blended value that may come from saturated photos before it counts as saturated.
const SATURATED_SHARE: f32 = 0.01;

/// A stack of photos as a camera.
#[derive(Clone, Copy, Debug)]
pub struct StackCamera<'a> {
    stack: &'a Stack,
    lookup: Lookup,
}

impl<'a> StackCamera<'a> {
    /// A camera that answers from `stack` by `lookup`.
    #[must_use]
    pub fn new(stack: &'a Stack, lookup: Lookup) -> Self {
        Self { stack, lookup }
    }

    fn photo(&self, requested: Vec3, k: usize) -> Observation {
        let (grey, rgb) = (self.stack.grey[k].clone(), self.stack.rgb[k].clone());
        let saturated = self.stack.saturated[k].clone();
        Observation {
            saturated,
            index: Some(k),
            ..Observation::new(requested, self.stack.lights[k], grey, rgb)
        }
    }

    fn blend(&self, requested: Vec3, tau: f32) -> Observation {
        let weights = soft_weights(requested, &self.stack.lights, tau);
        let pixels = self.stack.mask.len();
        let (mut grey, mut rgb, mut l) = (vec![0.0; pixels], vec![[0.0; 3]; pixels], Vec3::ZERO);
        for &(k, w) in &weights.terms {
            l += w * self.stack.lights[k];
            for (g, &v) in grey.iter_mut().zip(&self.stack.grey[k]) {
                *g += w * v;
            }
            for (c, v) in rgb.iter_mut().zip(&self.stack.rgb[k]) {
                for (c, v) in c.iter_mut().zip(v) {
                    *c += w * v;
                }
            }
        }
        let index = match weights.terms[..] {
            [(k, _)] => Some(k),
            _ => None,
        };
        let saturated = self.saturated(&weights.terms);
        let effective_images = weights.effective_images;
        Observation { requested, light: l, grey, rgb, saturated, effective_images, index }
    }

    /// Which pixels are saturated in more than [`SATURATED_SHARE`] of a blend.
    fn saturated(&self, terms: &[(usize, f32)]) -> Vec<bool> {
        if terms.iter().all(|&(k, _)| self.stack.saturated[k].is_empty()) {
            return Vec::new();
        }
        let mut share = vec![0.0; self.stack.mask.len()];
        for &(k, w) in terms {
            for (s, &flag) in share.iter_mut().zip(&self.stack.saturated[k]) {
                *s += w * f32::from(flag);
            }
        }
        share.into_iter().map(|s| s > SATURATED_SHARE).collect()
    }
}

impl Camera for StackCamera<'_> {
    fn mask(&self) -> &Mask {
        &self.stack.mask
    }

    fn capture(&self, direction: Vec3, seen: &[Observation]) -> Result<Observation, CameraError> {
        check_direction(direction)?;
        if self.stack.is_empty() {
            return Err(CameraError::Exhausted(0));
        }
        match self.lookup {
            Lookup::Nearest => {
                let free = |k| !seen.iter().any(|o| o.index == Some(k));
                let k = light::nearest(direction, &self.stack.lights, free)
                    .ok_or(CameraError::Exhausted(self.stack.len()))?;
                Ok(self.photo(direction, k))
            }
            Lookup::Soft { tau } => Ok(self.blend(direction, tau)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::fibonacci_hemisphere;
    use crate::stack::BitDepth;

    fn lambert(count: usize) -> (Stack, Vec<Vec3>) {
        let normals = crate::light::fibonacci_cap(16, 0.4);
        let lights = crate::light::fibonacci_cap(count, 0.6);
        let shade = |l: Vec3| normals.iter().map(|n| n.dot(l)).collect::<Vec<f32>>();
        let stack = Stack {
            name: "lambert".into(),
            mask: Mask::full(4, 4).unwrap(),
            bits: BitDepth::Sixteen,
            grey: lights.iter().map(|&l| shade(l)).collect(),
            rgb: lights.iter().map(|&l| shade(l).into_iter().map(|v| [v; 3]).collect()).collect(),
            saturated: vec![Vec::new(); count],
            names: (0..count).map(|k| k.to_string()).collect(),
            lights,
            truth: Some(normals.clone()),
        };
        (stack, normals)
    }

    #[test]
    fn a_blend_of_saturated_photos_is_saturated() {
        let (mut stack, _) = lambert(20);
        stack.saturated[7] = (0..16).map(|p| p == 3).collect();
        let soft = StackCamera::new(&stack, Lookup::Soft { tau: 0.05 });
        let near = soft.capture(stack.lights[7], &[]).unwrap();
        assert_eq!(near.saturated, stack.saturated[7]);
        let far = soft.capture(stack.lights[19], &[]).unwrap();
        assert!(!far.saturated.contains(&true));
    }

    #[test]
    fn soft_weights_sharpen_with_tau() {
        let lights = fibonacci_hemisphere(96);
        let sharp = soft_weights(lights[40], &lights, 1e-4);
        assert_eq!(sharp.terms, [(40, 1.0)]);
        assert!((sharp.effective_images - 1.0).abs() < 1e-6);
        let mut last = 1.0;
        for tau in [0.02, 0.05, 0.1, 0.2] {
            let w = soft_weights(lights[40], &lights, tau);
            assert!((w.terms.iter().map(|t| t.1).sum::<f32>() - 1.0).abs() < 1e-5);
            assert!(w.effective_images > last);
            last = w.effective_images;
        }
        assert!((soft_weights(Vec3::Z, &lights, 1e6).effective_images - 96.0).abs() < 0.01);
    }

    #[test]
    fn soft_interpolation_is_exact_for_linear_shading() {
        let (stack, normals) = lambert(30);
        let o = StackCamera::new(&stack, Lookup::Soft { tau: 0.1 })
            .capture(light::from_azimuth_slant(0.3, 0.2), &[])
            .unwrap();
        assert!(o.effective_images > 3.0 && o.index.is_none());
        for (n, g) in normals.iter().zip(&o.grey) {
            assert!((n.dot(o.light) - g).abs() < 1e-5);
        }
    }

    #[test]
    fn nearest_gives_no_photo_twice_and_then_says_so() {
        let (stack, _) = lambert(5);
        let camera = StackCamera::new(&stack, Lookup::Nearest);
        let mut seen = Vec::new();
        for _ in 0..5 {
            let o = camera.capture(Vec3::Z, &seen).unwrap();
            seen.push(o);
        }
        let mut used: Vec<_> = seen.iter().filter_map(|o| o.index).collect();
        used.sort_unstable();
        assert_eq!(used, [0, 1, 2, 3, 4]);
        assert_eq!(camera.capture(Vec3::Z, &seen).unwrap_err(), CameraError::Exhausted(5));
        assert!(camera.capture(Vec3::new(f32::NAN, 0.0, 1.0), &[]).is_err());
        assert!(camera.capture(-Vec3::Z, &[]).is_err());
    }

    #[test]
    fn lookup_names_round_trip() {
        for s in ["nearest", "soft:0.02"] {
            assert_eq!(s.parse::<Lookup>().unwrap().to_string(), s);
        }
        for s in ["soft", "soft:", "soft:0", "soft:-1", "soft:NaN", "near"] {
            assert!(s.parse::<Lookup>().is_err(), "{s}");
        }
    }
}
