//! AdamW (Loshchilov & Hutter 2019), with plain numbers as its state.

use super::weights::Weights;

/// What the optimiser remembers of each parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct AdamW {
    /// Updates made.
    pub updates: u64,
    /// Running means of the gradients.
    pub first: Vec<Vec<f32>>,
    /// Running means of their squares.
    pub second: Vec<Vec<f32>>,
}

const BETA1: f32 = 0.9;
const BETA2: f32 = 0.999;
const EPSILON: f32 = 1e-8;
/// The gate's window may become sharp, but not infinitely so, nor turn around.
const SHARPEST_GATE: f32 = 0.01;

impl AdamW {
    /// Nothing remembered yet.
    #[must_use]
    pub fn new(weights: &Weights) -> Self {
        let zero: Vec<Vec<f32>> = weights.params.iter().map(|p| vec![0.0; p.values.len()]).collect();
        Self { updates: 0, first: zero.clone(), second: zero }
    }

    /// One update. `gradients` are in the order of [`Weights::params`].
    pub fn update(&mut self, weights: &mut Weights, gradients: &[Vec<f32>], rate: f32, decay: f32) {
        self.updates += 1;
        let correct1 = 1.0 - libm::powf(BETA1, self.updates as f32);
        let correct2 = 1.0 - libm::powf(BETA2, self.updates as f32);
        for (i, p) in weights.params.iter_mut().enumerate() {
            let state = self.first[i].iter_mut().zip(&mut self.second[i]);
            for ((value, &g), (m, v)) in p.values.iter_mut().zip(&gradients[i]).zip(state) {
                *m = BETA1 * *m + (1.0 - BETA1) * g;
                *v = BETA2 * *v + (1.0 - BETA2) * g * g;
                let step = (*m / correct1) / ((*v / correct2).sqrt() + EPSILON);
                *value -= rate * (step + decay * *value);
            }
            if p.name == "gate.softness" {
                p.values[0] = p.values[0].max(SHARPEST_GATE);
            }
        }
    }
}

/// Scales `gradients` so that their common length is at most `limit`; gives the length before.
pub fn clip(gradients: &mut [Vec<f32>], limit: f32) -> f32 {
    let squares: f64 = gradients.iter().flatten().map(|&g| f64::from(g) * f64::from(g)).sum();
    let length = squares.sqrt() as f32;
    if length > limit {
        gradients.iter_mut().flatten().for_each(|g| *g *= limit / length);
    }
    length
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::Config;

    #[test]
    fn it_descends_to_a_minimum() {
        let mut weights = Weights::new(&Config::compact(), 1);
        let target = Weights::new(&Config::compact(), 2);
        let mut adam = AdamW::new(&weights);
        let distance = |w: &Weights| -> f64 {
            let pairs = w.params.iter().zip(&target.params).flat_map(|(a, b)| a.values.iter().zip(&b.values));
            pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum()
        };
        let before = distance(&weights);
        for _ in 0..300 {
            let mut g: Vec<Vec<f32>> = weights
                .params
                .iter()
                .zip(&target.params)
                .map(|(a, b)| a.values.iter().zip(&b.values).map(|(a, b)| a - b).collect())
                .collect();
            clip(&mut g, 1.0);
            adam.update(&mut weights, &g, 3e-3, 0.0);
        }
        assert!(distance(&weights) < 0.05 * before, "{} of {before}", distance(&weights));
    }

    #[test]
    fn clipping_keeps_the_direction() {
        let mut g = vec![vec![3.0, 0.0], vec![4.0]];
        assert_eq!(clip(&mut g, 1.0), 5.0);
        assert!((g[0][0] - 0.6).abs() < 1e-6 && (g[1][0] - 0.8).abs() < 1e-6);
        assert!((clip(&mut g, 2.0) - 1.0).abs() < 1e-6);
    }
}
