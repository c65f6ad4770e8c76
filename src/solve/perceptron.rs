//! Two layers of [`WIDTH`] over some numbers: small enough to be committed as text and run on every pixel.

use serde::{Deserialize, Serialize};

/// Width of the two layers.
pub const WIDTH: usize = 24;
/// Inputs beyond this many standard deviations count as this many.
const REACH: f32 = 4.0;

/// Maps `N` numbers to one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Perceptron<const N: usize> {
    /// Mean of each input over what it was fitted to.
    pub mean: Vec<f32>,
    /// Standard deviation of each input.
    pub deviation: Vec<f32>,
    /// First layer (one row of [`WIDTH`] for each input) and its bias, second layer and its bias, last layer and its bias.
    pub weights: Vec<f32>,
}

/// One layer's values.
pub type Row = [f32; WIDTH];

/// What the layers made of some inputs; training goes back through it.
#[derive(Clone, Copy, Debug)]
pub struct Layers<const N: usize> {
    /// The inputs in standard deviations from their means.
    pub inputs: [f32; N],
    /// After the first layer.
    pub first: Row,
    /// After the second layer.
    pub second: Row,
    /// After the last.
    pub output: f32,
}

/// x/(1 + |x|): no table, no library, the same on every machine.
fn soft_sign(x: f32) -> f32 {
    x / (1.0 + x.abs())
}

impl<const N: usize> Perceptron<N> {
    /// Where the first layer's bias, the second layer, its bias and the last layer begin.
    pub const PARTS: [usize; 4] = {
        let bias = N * WIDTH;
        let second = bias + WIDTH;
        let second_bias = second + WIDTH * WIDTH;
        [bias, second, second_bias, second_bias + WIDTH]
    };
    /// Number of weights.
    pub const WEIGHTS: usize = Self::PARTS[3] + WIDTH + 1;

    /// Whether all lists have their lengths and all numbers are finite.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        let all = [&self.mean, &self.deviation, &self.weights];
        all.map(Vec::len) == [N, N, Self::WEIGHTS] && all.into_iter().flatten().all(|v| v.is_finite())
    }

    /// Through all layers.
    #[must_use]
    pub fn layers(&self, inputs: &[f32; N]) -> Layers<N> {
        let mut standard = [0.0; N];
        for (c, s) in standard.iter_mut().enumerate() {
            *s = ((inputs[c] - self.mean[c]) / self.deviation[c]).clamp(-REACH, REACH);
        }
        let [bias, second, second_bias, last] = Self::PARTS;
        let w = self.weights.as_slice();
        let first = layer(&standard, &w[..bias], &w[bias..second]);
        let second = layer(&first, &w[second..second_bias], &w[second_bias..last]);
        let output = w[last + WIDTH] + second.iter().zip(&w[last..]).map(|(a, b)| a * b).sum::<f32>();
        Layers { inputs: standard, first, second, output }
    }

    /// What comes out.
    #[must_use]
    pub fn output(&self, inputs: &[f32; N]) -> f32 {
        self.layers(inputs).output
    }
}

fn layer(inputs: &[f32], weights: &[f32], bias: &[f32]) -> Row {
    let mut sum: Row = std::array::from_fn(|i| bias[i]);
    for (&input, row) in inputs.iter().zip(weights.chunks_exact(WIDTH)) {
        for (s, &w) in sum.iter_mut().zip(row) {
            *s += input * w;
        }
    }
    sum.map(soft_sign)
}
