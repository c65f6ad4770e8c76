//! The greedy oracle: each step takes the light that lowers the true error of least squares most. It sees the
//! ground truth, so it is no planner but the line that none should be able to cross.

use super::{PlanError, Planner, View, ascend};
use crate::camera::{Camera, Domain, Observation};
use crate::error::unit_angle;
use crate::light;
use crate::solve::least_squares::NormalEquations;
use glam::Vec3;

/// Candidates on a continuous domain, as the published discrete planners have.
pub const ORACLE_CANDIDATES: usize = 100;

/// Greedy with ground truth.
pub struct Oracle<'a> {
    camera: &'a dyn Camera,
    truth: &'a [Vec3],
    start: Vec3,
    continuous: bool,
    equations: NormalEquations,
    /// Candidates, and their pictures, taken once.
    images: Option<(Vec<Vec3>, Vec<Observation>)>,
}

impl<'a> Oracle<'a> {
    /// Over the candidates of the domain ([`ORACLE_CANDIDATES`] Fibonacci directions on a continuous one), beginning
    /// at `start`. With `continuous` the best of them is then moved until no nearby direction is better.
    #[must_use]
    pub fn new(camera: &'a dyn Camera, truth: &'a [Vec3], start: Vec3, continuous: bool) -> Self {
        let equations = NormalEquations::new(truth.len());
        Self { camera, truth, start, continuous, equations, images: None }
    }

    fn error_with(&self, light: Vec3, image: &[f32]) -> f64 {
        let mut sum = 0.0;
        self.equations.preview(light, image, |p, n| sum += f64::from(unit_angle(n, self.truth[p])));
        sum
    }

    fn take_images(&self, candidates: Vec<Vec3>) -> Result<(Vec<Vec3>, Vec<Observation>), PlanError> {
        let mut images: Vec<Observation> = Vec::with_capacity(candidates.len());
        for &c in &candidates {
            // The second time that a direction is there, it stands for its second photo.
            let before: Vec<Observation> = images.iter().filter(|o| o.requested == c).cloned().collect();
            let failed =
                |e| PlanError::Needs { planner: "oracle", what: format!("every candidate's image: {e}") };
            let image = self.camera.capture(c, &before).map_err(failed)?;
            images.push(Observation { requested: c, rgb: Vec::new(), ..image });
        }
        Ok((candidates, images))
    }
}

impl Planner for Oracle<'_> {
    fn next(&mut self, view: &View) -> Result<Vec3, PlanError> {
        let Some(last) = view.seen.last() else {
            self.equations = NormalEquations::new(self.truth.len());
            return super::first(view, self.start);
        };
        self.equations.add(last.light, &last.grey);
        let (candidates, images) = match self.images.take() {
            Some(images) => images,
            None => self.take_images(match view.domain {
                Domain::Candidates(all) => all.clone(),
                Domain::Hemisphere { reach } => light::fibonacci_cap(ORACLE_CANDIDATES, *reach),
            })?,
        };
        let best = images
            .iter()
            .enumerate()
            .filter(|&(i, _)| view.is_free(&candidates, i))
            .map(|(_, o)| (o.requested, self.error_with(o.light, &o.grey)))
            .reduce(|best, next| if next.1 < best.1 { next } else { best })
            .map(|(c, _)| c);
        let count = images.len();
        self.images = Some((candidates, images));
        let best = best.ok_or(PlanError::TooFewCandidates { candidates: count, lights: view.lights })?;
        match view.domain {
            Domain::Hemisphere { reach } if self.continuous => Ok(ascend(&[best], *reach, view.seen, |c| {
                // A direction whose picture can't be taken is never the best.
                self.camera
                    .capture(c, &[])
                    .map_or(f32::NEG_INFINITY, |o| -self.error_with(o.light, &o.grey) as f32)
            })),
            _ => Ok(best),
        }
    }
}
