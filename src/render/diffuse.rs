//! How the diffuse part of real paints, plasters and plastics departs from Lambert's.

use super::real::Real;
use crate::rng::Rng;

/// A diffuse reflection, as a factor on Lambert's: rough like plaster (Oren and Nayar 1994, the qualitative model), under a clear
/// coat like plastic or glaze (light that enters and leaves at grazing angles is reflected instead: Ashikhmin and Shirley 2000), or both.
/// Rough surfaces look flatter than they are, coated ones steeper.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Diffuse {
    /// Standard deviation of the facets' slopes, radians; 0 for Lambert.
    pub roughness: f32,
    /// Share of the surface under the coat, 0 to 1.
    pub coat: f32,
}

impl Diffuse {
    /// Lambert's.
    pub const LAMBERT: Self = Self { roughness: 0.0, coat: 0.0 };

    /// Lambert's, coated, rough, or something of both, a quarter each.
    #[must_use]
    pub fn any(rng: &mut Rng) -> Self {
        match rng.below(4) {
            0 => Self::LAMBERT,
            1 => Self { roughness: 0.0, coat: 1.0 },
            2 => Self { roughness: rng.range(0.1, 0.7), coat: 0.0 },
            _ => Self { roughness: rng.range(0.0, 0.5), coat: rng.uniform() },
        }
    }

    /// The factor where normal and light have the cosine `cos_i`, normal and viewer `cos_o`, light and viewer `cos_between`; all
    /// above 0, but for the last.
    #[must_use]
    pub fn factor<R: Real>(self, cos_i: R, cos_o: f32, cos_between: R) -> R {
        let square = self.roughness * self.roughness;
        let mut factor = R::of(1.0 - 0.5 * square / (square + 0.33));
        // sin α tan β cos Δφ = (l·v − cos θ_i cos θ_o) / max(cos θ_i, cos θ_o).
        let across = cos_between - cos_i * cos_o;
        if across.value() > 0.0 {
            factor = factor + across / cos_i.max(R::of(cos_o)) * (0.45 * square / (square + 0.09));
        }
        let fifth = |c: R| {
            let s = -c + 1.0;
            s * s * s * s * s
        };
        factor * (fifth(cos_i) * -self.coat + 1.0) * (fifth(R::of(cos_o)) * -self.coat + 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lambert_is_left_alone_and_the_others_depart_as_they_should() {
        let at = |d: Diffuse, tilt: f32| d.factor(tilt.cos(), tilt.cos(), 1.0);
        for tilt in [0.0f32, 0.5, 1.2] {
            assert_eq!(at(Diffuse::LAMBERT, tilt), 1.0);
        }
        let rough = Diffuse { roughness: 0.5, coat: 0.0 };
        let coated = Diffuse { roughness: 0.0, coat: 1.0 };
        // Light at the viewer: Oren and Nayar's A + B sin²θ/cosθ; the coat takes 1 − (1 − (1 − cosθ)⁵)².
        let tilt = 1.2f32;
        let expected = 1.0 - 0.125 / 0.58 + 0.45 * 0.25 / 0.34 * tilt.sin() * tilt.tan();
        assert!((at(rough, tilt) - expected).abs() < 1e-5);
        let expected = (1.0 - (1.0 - tilt.cos()).powi(5)).powi(2);
        assert!((at(coated, tilt) - expected).abs() < 1e-6);
        assert!(at(rough, tilt) / at(rough, 0.0) > 1.3 && at(coated, tilt) / at(coated, 0.0) < 0.8);
    }
}
