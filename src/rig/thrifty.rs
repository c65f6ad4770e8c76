//! A planner's lights with less travel: of equally good lights, the nearer one first.
//!
//! A planner that does not look at the pictures gives a set whose order does not matter: it is walked along a short
//! path. One that does is allowed to move each light by a small angle, under which a picture hardly changes.

use crate::arm::Joints;
use crate::arm::kinematics::Arm;
use crate::camera::{Domain, Observation};
use crate::light;
use crate::planner::{PlanError, Planner, View};
use glam::Vec3;
use std::f32::consts::TAU;

/// A planner that saves travel.
pub struct Thrifty<'a> {
    inner: Box<dyn Planner + 'a>,
    arm: Arm,
    /// Largest change of a direction, radians.
    tolerance: f32,
    /// The whole set, in the order of the path, where the planner does not look at pictures.
    path: Option<Vec<Vec3>>,
    online: bool,
}

impl<'a> Thrifty<'a> {
    /// `online` says whether `inner` looks at the pictures; `tolerance` (radians) counts only then.
    #[must_use]
    pub fn new(inner: Box<dyn Planner + 'a>, online: bool, arm: Arm, tolerance: f32) -> Self {
        Self { inner, arm, tolerance, path: None, online }
    }

    /// Where the arm stands after the pictures so far.
    fn pose(&self, seen: &[Observation]) -> Joints {
        seen.iter().fold(home(&self.arm), |from, o| self.arm.plan(o.requested, from).joints)
    }

    fn cheapest(&self, wanted: Vec3, view: &View) -> Vec3 {
        let from = self.pose(view.seen);
        let mut options = vec![wanted];
        match view.domain {
            Domain::Candidates(_) => options.extend(
                view.free_candidates().map(|(_, c)| c).filter(|c| light::angle(*c, wanted) <= self.tolerance),
            ),
            Domain::Hemisphere { reach } => {
                let (u, v) = wanted.any_orthonormal_pair();
                let tangent = libm::tanf(self.tolerance);
                for k in 0..16 {
                    let phi = TAU * k as f32 / 16.0;
                    let d = wanted + (u * libm::cosf(phi) + v * libm::sinf(phi)) * tangent;
                    options.push(d.normalize());
                }
                options.retain(|d| light::slant(*d) <= *reach || *d == wanted);
            }
        }
        let cost = |d: &Vec3| self.arm.cost(from, *d);
        options.into_iter().min_by(|a, b| cost(a).total_cmp(&cost(b))).unwrap_or(wanted)
    }
}

/// Where the arm stands before the first light: at the middle of its ranges, outside the cone.
fn home(arm: &Arm) -> Joints {
    arm.plan(light::from_azimuth_slant(0.0, 0.5), Joints { azimuth: 0.0, slant: 30.0 }).joints
}

impl Planner for Thrifty<'_> {
    fn next(&mut self, view: &View) -> Result<Vec3, PlanError> {
        if self.online {
            let wanted = self.inner.next(view)?;
            return Ok(self.cheapest(wanted, view));
        }
        if self.path.is_none() {
            let mut seen: Vec<Observation> = Vec::new();
            for _ in 0..view.lights {
                let d = self.inner.next(&View { seen: &seen, ..*view })?;
                seen.push(Observation::new(d, d, Vec::new(), Vec::new()));
            }
            let set: Vec<Vec3> = seen.into_iter().map(|o| o.requested).collect();
            self.path = Some(short_path(&self.arm, home(&self.arm), set));
        }
        let path = self.path.as_deref().unwrap_or_default();
        path.get(view.seen.len())
            .copied()
            .ok_or(PlanError::TooFewCandidates { candidates: path.len(), lights: view.lights })
    }
}

/// Seconds to visit `lights` in order.
#[must_use]
pub fn travel(arm: &Arm, from: Joints, lights: &[Vec3]) -> f64 {
    let mut at = from;
    lights
        .iter()
        .map(|l| {
            let plan = arm.plan(*l, at);
            at = plan.joints;
            plan.seconds
        })
        .sum()
}

/// `lights` in an order with little travel from `from`: nearest first, then pieces turned round as long as it helps.
#[must_use]
pub fn short_path(arm: &Arm, from: Joints, mut lights: Vec<Vec3>) -> Vec<Vec3> {
    let mut at = from;
    for k in 0..lights.len() {
        let cost = |d: &Vec3| arm.cost(at, *d);
        let rest = &lights[k..];
        let best = (0..rest.len()).min_by(|&a, &b| cost(&rest[a]).total_cmp(&cost(&rest[b]))).unwrap_or(0);
        lights.swap(k, k + best);
        at = arm.plan(lights[k], at).joints;
    }
    let mut whole = travel(arm, from, &lights);
    // Each round must save something, so this ends; sixty lights are the most a session is made for.
    for _ in 0..40 {
        let before = whole;
        for i in 0..lights.len().min(60) {
            for j in i + 1..lights.len().min(60) {
                lights[i..=j].reverse();
                let turned = travel(arm, from, &lights);
                if turned < whole - 1e-9 {
                    whole = turned;
                } else {
                    lights[i..=j].reverse();
                }
            }
        }
        if whole >= before {
            break;
        }
    }
    lights
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planner::{self, Setup};
    use crate::stack::Mask;

    fn run(planner: &mut dyn Planner, domain: &Domain, lights: usize) -> Vec<Vec3> {
        let mask = Mask::full(2, 2).unwrap();
        let mut seen: Vec<Observation> = Vec::new();
        for _ in 0..lights {
            let d = planner.next(&View { mask: &mask, domain, seen: &seen, lights }).unwrap();
            let grey = vec![0.5; 4];
            seen.push(Observation::new(d, d, grey, Vec::new()));
        }
        seen.into_iter().map(|o| o.requested).collect()
    }

    /// Travel with and without, for the numbers in the guide.
    #[test]
    fn the_same_lights_with_less_travel() {
        let arm = Arm::default();
        let domain = Domain::Hemisphere { reach: 1.4 };
        let setup = |seed| Setup { lights: 10, seed, draw: 0, camera: None, truth: None, learned: None };
        let (mut plain, mut short) = (0.0, 0.0);
        for seed in 0..20 {
            let before = run(&mut *planner::build("random", &setup(seed)).unwrap(), &domain, 10);
            let mut thrifty =
                Thrifty::new(planner::build("random", &setup(seed)).unwrap(), false, arm.clone(), 0.0);
            let after = run(&mut thrifty, &domain, 10);
            let key = |d: &Vec3| d.to_array().map(f32::to_bits);
            let (mut a, mut b): (Vec<_>, Vec<_>) =
                (before.iter().map(key).collect(), after.iter().map(key).collect());
            a.sort_unstable();
            b.sort_unstable();
            assert_eq!(a, b, "the set must not change");
            plain += travel(&arm, home(&arm), &before);
            short += travel(&arm, home(&arm), &after);
        }
        println!(
            "ten random lights: {:.1} s of travel, {:.1} s on the short path",
            plain / 20.0,
            short / 20.0
        );
        assert!(short < 0.7 * plain, "{plain} {short}");
    }

    #[test]
    fn an_online_planner_moves_each_light_a_little() {
        let arm = Arm::default();
        let domain = Domain::Hemisphere { reach: 1.2 };
        let setup = Setup { lights: 10, seed: 1, draw: 0, camera: None, truth: None, learned: None };
        let before = run(&mut *planner::build("random", &setup).unwrap(), &domain, 10);
        let mut thrifty =
            Thrifty::new(planner::build("random", &setup).unwrap(), true, arm.clone(), 5f32.to_radians());
        let after = run(&mut thrifty, &domain, 10);
        assert!(before.iter().zip(&after).all(|(a, b)| light::angle(*a, *b) < 5.1f32.to_radians()));
        let (plain, short) = (travel(&arm, home(&arm), &before), travel(&arm, home(&arm), &after));
        println!("ten online lights within 5°: {plain:.1} s, {short:.1} s");
        assert!(short < plain);
    }
}
