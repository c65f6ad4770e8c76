//! Trimmed least squares: each pixel leaves out its darkest values (shadows) and its brightest
//! (highlights) and solves from the rest.

use super::lanes::Lanes;
use super::robust::{self, Block, Thresholds, Weigh};
use super::{Measurements, Solution, SolveError, Solver};

/// Trimmed least squares. `Default` has the fractions that `coil tune` found on synthetic pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trimmed {
    /// Fraction of a pixel's values left out as the darkest.
    pub dark: f32,
    /// Fraction left out as the brightest.
    pub bright: f32,
    /// What counts as shadow.
    pub thresholds: Thresholds,
}

impl Default for Trimmed {
    fn default() -> Self {
        Self { dark: 0.1, bright: 0.1, thresholds: Thresholds::default() }
    }
}

/// Fewest values that are kept where there are as many. Those in shadow count: to keep five lit ones beside them keeps
/// highlights too, which on rendered objects is worse (docs/solvers.md).
const KEPT: usize = 5;

impl Trimmed {
    /// How many of `count` values are left out: (darkest, brightest). At least five stay where there
    /// are five.
    #[must_use]
    pub fn left_out(&self, count: usize) -> (usize, usize) {
        let most = count.saturating_sub(KEPT);
        let bright = ((self.bright * count as f32) as usize).min(most);
        let dark = ((self.dark * count as f32) as usize).min(most);
        // Too few to drop both: highlights mislead more than shadows, so they go first.
        (dark.min(most - bright), bright)
    }
}

impl Weigh for Trimmed {
    #[inline(always)]
    fn weigh(&self, block: &Block, weights: &mut [Lanes]) {
        let count = block.values.len();
        let (dark, bright) = self.left_out(count);
        let (lowest, highest) = (Lanes::splat(dark as f32), Lanes::splat((count - bright) as f32));
        for k in 0..count {
            // Rank by counting; equal values in the order of their lights.
            let v = block.values[k];
            let mut rank = Lanes::ZERO;
            for &other in &block.values[..k] {
                rank += other.at_most(v);
            }
            for &other in &block.values[k + 1..] {
                rank += other.below(v);
            }
            weights[k] = weights[k] * lowest.at_most(rank) * rank.below(highest);
        }
    }
}

impl Solver for Trimmed {
    fn name(&self) -> &'static str {
        "trimmed"
    }

    fn solve(&self, measurements: &Measurements) -> Result<Solution, SolveError> {
        robust::solve(measurements, &self.thresholds, self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn five_values_stay() {
        let t = Trimmed { dark: 0.3, bright: 0.2, ..Trimmed::default() };
        assert_eq!(t.left_out(10), (3, 2));
        assert_eq!(t.left_out(96), (28, 19));
        for count in 3..8 {
            let (dark, bright) = t.left_out(count);
            assert!(count - dark - bright >= count.min(KEPT));
        }
    }

    #[test]
    fn ranks_leave_out_the_ends() {
        let values: Vec<Lanes> =
            [5.0, 1.0, 9.0, 3.0, 3.0, 7.0, 2.0, 8.0, 4.0, 6.0].map(Lanes::splat).to_vec();
        let usable = vec![Lanes::ONE; 10];
        let mut weights = usable.clone();
        let block = Block { lights: &[], values: &values, usable: &usable };
        Trimmed { dark: 0.3, bright: 0.2, ..Trimmed::default() }.weigh(&block, &mut weights);
        let kept: Vec<usize> = (0..10).filter(|&k| weights[k].0[0] > 0.0).collect();
        assert_eq!(kept, [0, 4, 5, 8, 9]); // of the two 3s the later one stays
    }
}
