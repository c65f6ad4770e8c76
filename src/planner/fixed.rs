//! Light sets fixed before the first picture: DC05's optimal rings, LIPIDS's published sets, a ring of any slant.

use super::{PlanError, Planner, View};
use crate::camera::Domain;
use crate::light::{self, ring, rotate_about_axis};
use crate::rng::Rng;
use glam::Vec3;
use std::f32::consts::TAU;

/// Gives the directions of a set one after the other. On candidates each direction becomes the nearest one
/// not used yet; on a cone of slants those beyond it are moved to its rim.
#[derive(Clone, Debug)]
pub struct FixedSet {
    directions: Vec<Vec3>,
    assigned: Option<Vec<Vec3>>,
}

impl FixedSet {
    /// For a set of unit directions.
    #[must_use]
    pub fn new(directions: Vec<Vec3>) -> Self {
        Self { directions, assigned: None }
    }

    fn assign(&self, view: &View) -> Result<Vec<Vec3>, PlanError> {
        match view.domain {
            Domain::Candidates(all) => {
                let chosen = light::assign_unique(&self.directions, all);
                if chosen.len() < self.directions.len() {
                    return Err(PlanError::TooFewCandidates { candidates: all.len(), lights: view.lights });
                }
                Ok(chosen.into_iter().map(|i| all[i]).collect())
            }
            Domain::Hemisphere { reach } => {
                Ok(self.directions.iter().map(|&d| light::within(d, *reach)).collect())
            }
        }
    }
}

impl Planner for FixedSet {
    fn next(&mut self, view: &View) -> Result<Vec3, PlanError> {
        let set = match self.assigned.take() {
            Some(set) => set,
            None => self.assign(view)?,
        };
        let next = set.get(view.seen.len()).copied();
        let count = set.len();
        self.assigned = Some(set);
        next.ok_or(PlanError::TooFewCandidates { candidates: count, lights: view.lights })
    }
}

/// DC05 ring (Drbohlav & Chantler, ICCV 2005): `lights` directions evenly spaced in azimuth at z = 1/√3, which
/// makes LᵀL = (n/3)·I and so tr((LᵀL)⁻¹) smallest. `start` is the azimuth of the first, radians.
#[must_use]
pub fn dc05_ring(lights: usize, start: f32) -> Vec<Vec3> {
    ring(lights, libm::acosf(1.0 / libm::sqrtf(3.0)), start)
}

/// DC05 ring plus vertical: the vertical light (0,0,1) and n−1 directions at z = √((n−3)/(3(n−1))).
///
/// # Errors
/// [`PlanError::Lights`] below 4: with three the ring would be two opposite lights at the horizon.
pub fn dc05_ring_and_vertical(lights: usize, start: f32) -> Result<Vec<Vec3>, PlanError> {
    if lights < 4 {
        return Err(PlanError::Lights {
            planner: "dc05v",
            lights,
            hint: "ring plus vertical needs at least 4; the ring alone is dc05".into(),
        });
    }
    let n = lights as f32;
    let z = libm::sqrtf((n - 3.0) / (3.0 * (n - 1.0)));
    let mut set = vec![Vec3::Z];
    set.extend(ring(lights - 1, libm::acosf(z), start));
    Ok(set)
}

/// LIPIDS's published sets (Tiwari et al., WACV 2025) for 3, 5 and 10 lights.
///
/// # Errors
/// [`PlanError::Lights`] for other counts: no other set was published.
pub fn lipids(lights: usize) -> Result<Vec<Vec3>, PlanError> {
    let set: &[[f32; 3]] = match lights {
        3 => &[[0.2837, -0.6017, 0.7466], [-0.3403, -0.2728, 0.8999], [0.5087, 0.4462, 0.7362]],
        5 => &[
            [0.1207, 0.0930, 0.9883],
            [-0.5080, -0.4448, 0.7376],
            [0.5087, 0.4462, 0.7362],
            [0.2837, -0.6017, 0.7466],
            [-0.4524, 0.6030, 0.6570],
        ],
        10 => &[
            [0.1208, -0.0914, 0.9885],
            [-0.1151, 0.2743, 0.9547],
            [0.5469, -0.2728, 0.7915],
            [-0.1151, -0.2728, 0.9552],
            [0.5660, 0.0930, 0.8191],
            [-0.5647, 0.0930, 0.8200],
            [-0.4530, -0.6017, 0.6578],
            [-0.4524, 0.6030, 0.6570],
            [0.4540, -0.6017, 0.6571],
            [0.4535, 0.6030, 0.6563],
        ],
        _ => {
            return Err(PlanError::Lights {
                planner: "lipids",
                lights,
                hint: "its published sets have 3, 5 and 10".into(),
            });
        }
    };
    Ok(set.iter().map(|&l| Vec3::from(l).normalize()).collect())
}

/// The same set for another draw: turned about the optical axis by a random angle, as an object may stand in any way before
/// it, so that a deterministic planner gets an interval too. Draw 0 is the set as published.
#[must_use]
pub(super) fn turned(set: Vec<Vec3>, draw: usize, rng: &mut Rng) -> Vec<Vec3> {
    if draw == 0 {
        return set;
    }
    let angle = rng.range(0.0, TAU);
    set.into_iter().map(|d| rotate_about_axis(d, angle)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    fn gram(set: &[Vec3]) -> DMat3 {
        set.iter()
            .map(|l| l.as_dvec3())
            .fold(DMat3::ZERO, |m, l| m + DMat3::from_cols(l * l.x, l * l.y, l * l.z))
    }

    #[test]
    fn dc05_sets_are_optimal() {
        // Drbohlav & Chantler: optimal if and only if LᵀL = (n/3) I.
        for n in [4, 5, 10, 20] {
            for set in [dc05_ring(n, 0.3), dc05_ring_and_vertical(n, 0.3).unwrap()] {
                assert_eq!(set.len(), n);
                let difference = gram(&set) - DMat3::IDENTITY * (n as f64 / 3.0);
                assert!(difference.to_cols_array().iter().all(|v| v.abs() < 1e-5), "{n}");
            }
        }
        let slant = light::slant(dc05_ring_and_vertical(10, 0.0).unwrap()[1]).to_degrees();
        assert!((slant - 59.39).abs() < 0.01, "{slant}");
        assert!(dc05_ring_and_vertical(3, 0.0).is_err());
    }

    #[test]
    fn lipids_sets_are_distinct_unit_directions() {
        for n in [3, 5, 10] {
            let set = lipids(n).unwrap();
            assert_eq!(set.len(), n);
            assert!(set.iter().all(|d| (d.length() - 1.0).abs() < 1e-6));
        }
        assert!(lipids(4).unwrap_err().to_string().contains("3, 5 and 10"));
    }
}
