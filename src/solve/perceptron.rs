//! Two layers over some numbers: small enough to be committed as text and run on every pixel.

use serde::{Deserialize, Serialize};

/// Width of the two layers where no other is said.
pub const WIDTH: usize = 24;
/// Inputs beyond this many standard deviations count as this many.
const REACH: f32 = 4.0;

/// Maps `N` numbers to `O` through two layers of `W`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Perceptron<const N: usize, const O: usize = 1, const W: usize = WIDTH> {
    /// Mean of each input over what it was fitted to.
    pub mean: Vec<f32>,
    /// Standard deviation of each input.
    pub deviation: Vec<f32>,
    /// First layer (one row of `W` for each input) and its bias, second layer and its bias, last layer (one row of `O` for each of `W`) and its bias.
    pub weights: Vec<f32>,
    /// Whether layers cut off what is negative (`Perceptron::bent`).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub rectified: bool,
}

/// What the layers made of some inputs; training goes back through it.
#[derive(Clone, Copy, Debug)]
pub struct Layers<const N: usize, const O: usize = 1, const W: usize = WIDTH> {
    /// The inputs in standard deviations from their means.
    pub inputs: [f32; N],
    /// After the first layer.
    pub first: [f32; W],
    /// After the second layer.
    pub second: [f32; W],
    /// After the last.
    pub outputs: [f32; O],
}

impl<const N: usize, const O: usize, const W: usize> Perceptron<N, O, W> {
    /// Where the first layer's bias, the second layer, its bias, the last layer and its bias begin.
    pub const PARTS: [usize; 5] = {
        let bias = N * W;
        let second = bias + W;
        let second_bias = second + W * W;
        let last = second_bias + W;
        [bias, second, second_bias, last, last + W * O]
    };
    /// Number of weights.
    pub const WEIGHTS: usize = Self::PARTS[4] + O;

    /// Whether all lists have their lengths and all numbers are finite.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        let all = [&self.mean, &self.deviation, &self.weights];
        all.map(Vec::len) == [N, N, Self::WEIGHTS] && all.into_iter().flatten().all(|v| v.is_finite())
    }

    /// What a layer makes of a sum: its positive part, or x/(1 + |x|). No table, no library, the same on every machine.
    fn bent(&self, x: f32) -> f32 {
        if self.rectified { x.max(0.0) } else { x / (1.0 + x.abs()) }
    }

    /// Derivative of `Perceptron::bent` where its value is `y`.
    #[must_use]
    pub fn slope(&self, y: f32) -> f32 {
        match self.rectified {
            true => f32::from(y > 0.0),
            false => (1.0 - y.abs()) * (1.0 - y.abs()),
        }
    }

    /// Through all layers.
    #[must_use]
    pub fn layers(&self, inputs: &[f32; N]) -> Layers<N, O, W> {
        let mut standard = [0.0; N];
        for (c, s) in standard.iter_mut().enumerate() {
            *s = ((inputs[c] - self.mean[c]) / self.deviation[c]).clamp(-REACH, REACH);
        }
        let [bias, second, second_bias, last, last_bias] = Self::PARTS;
        let w = self.weights.as_slice();
        let first = layer(&standard, &w[..bias], &w[bias..second]).map(|x| self.bent(x));
        let second = layer(&first, &w[second..second_bias], &w[second_bias..last]).map(|x| self.bent(x));
        let sums: [f32; O] = layer(&second, &w[last..last_bias], &[0.0; O]);
        let outputs = std::array::from_fn(|o| w[last_bias + o] + sums[o]);
        Layers { inputs: standard, first, second, outputs }
    }

    /// What comes out.
    #[must_use]
    pub fn outputs(&self, inputs: &[f32; N]) -> [f32; O] {
        self.layers(inputs).outputs
    }
}

impl<const N: usize, const W: usize> Perceptron<N, 1, W> {
    /// What comes out.
    #[must_use]
    pub fn output(&self, inputs: &[f32; N]) -> f32 {
        self.outputs(inputs)[0]
    }
}

fn layer<const W: usize>(inputs: &[f32], weights: &[f32], bias: &[f32]) -> [f32; W] {
    let mut sum: [f32; W] = std::array::from_fn(|i| bias[i]);
    for (&input, row) in inputs.iter().zip(weights.chunks_exact(W)) {
        for (s, &w) in sum.iter_mut().zip(row) {
            *s += input * w;
        }
    }
    sum
}
