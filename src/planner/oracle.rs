//! The greedy oracle: each step takes the light that lowers the true error of least squares most. It sees the
//! ground truth, so it is no planner but the line that none should be able to cross.

use super::{PlanError, Planner, View, ascend};
use crate::camera::{Camera, Domain};
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
    /// Candidates with their images, taken once.
    images: Option<Vec<(Vec3, Vec<f32>, Vec3)>>,
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

    fn take_images(&self, candidates: &[Vec3]) -> Result<Vec<(Vec3, Vec<f32>, Vec3)>, PlanError> {
        candidates
            .iter()
            .map(|&c| match self.camera.capture(c, &[]) {
                Ok(o) => Ok((c, o.grey, o.light)),
                Err(e) => {
                    Err(PlanError::Needs { planner: "oracle", what: format!("every candidate's image: {e}") })
                }
            })
            .collect()
    }
}

impl Planner for Oracle<'_> {
    fn next(&mut self, view: &View) -> Result<Vec3, PlanError> {
        let Some(last) = view.seen.last() else {
            self.equations = NormalEquations::new(self.truth.len());
            return super::first(view, self.start);
        };
        self.equations.add(last.light, &last.grey);
        let images = match self.images.take() {
            Some(images) => images,
            None => match view.domain {
                Domain::Candidates(all) => self.take_images(all)?,
                Domain::Hemisphere { reach } => {
                    self.take_images(&light::fibonacci_cap(ORACLE_CANDIDATES, *reach))?
                }
            },
        };
        let best = images
            .iter()
            .filter(|(c, ..)| !view.seen.iter().any(|o| o.requested == *c))
            .map(|(c, image, l)| (*c, self.error_with(*l, image)))
            .reduce(|best, next| if next.1 < best.1 { next } else { best })
            .map(|(c, _)| c);
        let count = images.len();
        self.images = Some(images);
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
