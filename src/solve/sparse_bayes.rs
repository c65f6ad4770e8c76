//! Sparse Bayesian regression (Ikehata, Wipf, Matsushita & Aizawa, CVPR 2012).
//!
//! `I = L g + e + noise`, where e is sparse: each e_k is Gaussian with a variance γ_k of its own, learned
//! by maximising the evidence. With a flat prior on g the posterior has a closed form of 3×3 matrices:
//! with w = 1/(γ + λ), g is weighted least squares, e_k has mean γ_k w_k r_k and variance
//! γ_k − γ_k²(w_k − w_k² l_kᵀ(LᵀWL)⁻¹l_k), and expectation maximisation sets γ_k to mean² + variance.

use super::lanes::Lanes;
use super::robust::{self, Block, Thresholds, Weigh, dot, fit};
use super::{Measurements, Solution, SolveError, Solver};

/// Sparse Bayesian regression. `Default` has the parameters that `coil tune` found on synthetic pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SparseBayes {
    /// Standard deviation of the dense noise, √λ, in units of the pixel's brightest value.
    pub noise: f32,
    /// Steps of expectation maximisation.
    pub iterations: usize,
    /// What counts as shadow.
    pub thresholds: Thresholds,
}

impl Default for SparseBayes {
    fn default() -> Self {
        Self { noise: 0.03, iterations: 40, thresholds: Thresholds::default() }
    }
}

impl Weigh for SparseBayes {
    #[inline(always)]
    fn weigh(&self, block: &Block, weights: &mut [Lanes]) {
        let mut brightest = Lanes::splat(1e-20);
        for &v in block.values {
            brightest = brightest.max(v);
        }
        // In units of the brightest value squared; γ starts at 1: anything may be an outlier.
        let per_square = Lanes::ONE / (brightest * brightest);
        let lambda = Lanes::splat(self.noise * self.noise);
        for (w, &u) in weights.iter_mut().zip(block.usable) {
            *w = u / (lambda + 1.0);
        }
        for _ in 0..self.iterations {
            let f = fit(block.lights, block.values, weights);
            for (((&l, &v), &u), w) in
                block.lights.iter().zip(block.values).zip(block.usable).zip(&mut *weights)
            {
                let r = v - dot(f.g, l);
                let leverage = dot(f.inverse.times_light(l), l);
                // An unusable value has weight 0, not γ = ∞: give its γ any finite value.
                let gamma =
                    u.select(Lanes::ONE / w.max(Lanes::splat(1e-30)) - lambda, Lanes::ONE).max(Lanes::ZERO);
                let shrunk = gamma * *w;
                let mean_square = shrunk * shrunk * r * r * per_square;
                let variance = gamma - gamma * (shrunk - shrunk * *w * leverage);
                *w = u / (mean_square + variance.max(Lanes::ZERO) + lambda);
            }
        }
    }
}

impl Solver for SparseBayes {
    fn name(&self) -> &'static str {
        "sbr"
    }

    fn solve(&self, measurements: &Measurements) -> Result<Solution, SolveError> {
        robust::solve(measurements, &self.thresholds, self)
    }
}
