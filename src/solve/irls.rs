//! Iteratively reweighted least squares: values that the fit explains badly count less in the next.

use super::lanes::Lanes;
use super::robust::{self, Block, Thresholds, Weigh, dot, fit, length};
use super::{Measurements, Solution, SolveError, Solver};

/// How the weight of a value falls with its residual r (in units of the pixel's albedo).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loss {
    /// Sum of |r|: weight 1/|r|.
    L1,
    /// Huber (1964): squares up to the scale c, linear beyond: weight min(1, c/|r|).
    Huber,
    /// Cauchy: log(1 + (r/c)²): weight 1/(1 + (r/c)²).
    Cauchy,
}

/// Iteratively reweighted least squares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Irls {
    /// The loss.
    pub loss: Loss,
    /// Scale c of Huber and Cauchy; for L1 the residual below which weights stop growing. In units of
    /// the pixel's albedo.
    pub scale: f32,
    /// Number of fits.
    pub iterations: usize,
    /// What counts as shadow.
    pub thresholds: Thresholds,
}

impl Irls {
    /// The loss with the parameters that `coil tune` found on synthetic pixels.
    #[must_use]
    pub fn new(loss: Loss) -> Self {
        let scale = match loss {
            Loss::L1 => 0.01,
            Loss::Huber => 0.05,
            Loss::Cauchy => 0.05,
        };
        Self { loss, scale, iterations: 12, thresholds: Thresholds::default() }
    }
}

impl Weigh for Irls {
    #[inline(always)]
    fn weigh(&self, block: &Block, weights: &mut [Lanes]) {
        for _ in 0..self.iterations {
            let g = fit(block.lights, block.values, weights).g;
            // In units of the scale: 1 is where the loss begins to be forgiving.
            let unit = Lanes::ONE / (length(g) * self.scale).max(Lanes::splat(1e-20));
            for (((&l, &v), &u), w) in
                block.lights.iter().zip(block.values).zip(block.usable).zip(&mut *weights)
            {
                let r = (v - dot(g, l)).abs() * unit;
                *w = u * match self.loss {
                    Loss::L1 | Loss::Huber => Lanes::ONE / r.max(Lanes::ONE),
                    Loss::Cauchy => Lanes::ONE / (r * r + 1.0),
                };
            }
        }
    }
}

impl Solver for Irls {
    fn name(&self) -> &'static str {
        match self.loss {
            Loss::L1 => "l1",
            Loss::Huber => "huber",
            Loss::Cauchy => "cauchy",
        }
    }

    fn solve(&self, measurements: &Measurements) -> Result<Solution, SolveError> {
        robust::solve(measurements, &self.thresholds, self)
    }
}
