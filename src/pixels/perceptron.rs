//! Fits the small networks of [`crate::solve::perceptron`] by Adam, through gradients written out.

use crate::rng::Rng;
use crate::solve::perceptron::{Layers, Perceptron};

/// Inputs that are judged together, and what is true of each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Group<const N: usize, T = f32> {
    /// What the network sees.
    pub inputs: Vec<[f32; N]>,
    /// What its loss compares the outputs with.
    pub truth: Vec<T>,
}

/// How a network is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recipe {
    /// Seed of the first weights and of the order.
    pub seed: u64,
    /// Passes over all groups.
    pub passes: usize,
    /// Groups a step.
    pub groups: usize,
    /// Largest learning rate of Adam; it falls to 0 along a cosine.
    pub rate: f32,
    /// The last output that it begins with; the others are 0.
    pub beginning: f32,
    /// Whether the layers cut off what is negative.
    pub rectified: bool,
}

/// Steps over which the learning rate rises to its largest.
const WARM_UP: f32 = 100.0;

/// Fits a network of one output: `loss` gives, for the outputs of a group and its truth, the derivative of the loss by each output.
#[must_use]
pub fn fit<const N: usize>(
    groups: &[Group<N>],
    recipe: &Recipe,
    loss: impl Fn(&[f32], &[f32]) -> Vec<f32>,
) -> Perceptron<N> {
    fit_outputs(groups, recipe, one_output(loss))
}

/// The loss of one output as that of a list.
fn one_output(loss: impl Fn(&[f32], &[f32]) -> Vec<f32>) -> impl Fn(&[[f32; 1]], &[f32]) -> Vec<[f32; 1]> {
    move |outputs, truth| loss(outputs.as_flattened(), truth).into_iter().map(|d| [d]).collect()
}

/// The same of any number of outputs, in layers of any width.
#[must_use]
pub fn fit_outputs<const N: usize, const O: usize, const W: usize, T>(
    groups: &[Group<N, T>],
    recipe: &Recipe,
    loss: impl Fn(&[[f32; O]], &[T]) -> Vec<[f32; O]>,
) -> Perceptron<N, O, W> {
    let mut rng = Rng::new(recipe.seed);
    let mut network = beginning(groups, recipe.beginning, &mut rng);
    network.rectified = recipe.rectified;
    let count = Perceptron::<N, O, W>::WEIGHTS;
    let steps = (recipe.passes * groups.len() / recipe.groups).max(1);
    let (mut mean, mut square) = (vec![0.0f32; count], vec![0.0f32; count]);
    for step in 0..steps {
        let mut gradient = vec![0.0f32; count];
        let mut rows = 0.0f32;
        for _ in 0..recipe.groups {
            let group = &groups[rng.below(groups.len())];
            add_gradient(&network, group, &loss, &mut gradient);
            rows += group.truth.len() as f32;
        }
        let progress = step as f32 / steps as f32;
        let rate = recipe.rate
            * 0.5
            * (1.0 + libm::cosf(std::f32::consts::PI * progress))
            * ((step + 1) as f32 / WARM_UP).min(1.0);
        let t = (step + 1).min(10_000) as i32;
        let (c1, c2) = (1.0 - 0.9f32.powi(t), 1.0 - 0.99f32.powi(t));
        for (((w, g), m), s) in network.weights.iter_mut().zip(gradient).zip(&mut mean).zip(&mut square) {
            let g = g / rows.max(1.0);
            *m = 0.9 * *m + 0.1 * g;
            *s = 0.99 * *s + 0.01 * g * g;
            *w -= rate * (*m / c1) / ((*s / c2).sqrt() + 1e-8);
        }
    }
    // Three decimals are enough, and keep the file small.
    network.weights.iter_mut().for_each(|w| *w = (*w * 1e3).round() / 1e3);
    network
}

/// Inputs in units of their spread; matrices uniform with the variance 1/inputs; the same output everywhere.
fn beginning<const N: usize, const O: usize, const W: usize, T>(
    groups: &[Group<N, T>],
    output: f32,
    rng: &mut Rng,
) -> Perceptron<N, O, W> {
    let (mut mean, mut deviation) = (Vec::with_capacity(N), Vec::with_capacity(N));
    for c in 0..N {
        let mut values: Vec<f32> = groups.iter().flat_map(|g| g.inputs.iter().map(|i| i[c])).collect();
        let (m, d) = spread(&mut values);
        mean.push((m * 1e4).round() / 1e4);
        deviation.push(if d > 1e-3 { (d * 1e4).round() / 1e4 } else { 1.0 });
    }
    let [bias, second, second_bias, ..] = Perceptron::<N, O, W>::PARTS;
    let mut weights = vec![0.0; Perceptron::<N, O, W>::WEIGHTS];
    for (part, inputs) in [(0..bias, N), (second..second_bias, W)] {
        let bound = (3.0 / inputs as f32).sqrt();
        weights[part].iter_mut().for_each(|w| *w = rng.range(-bound, bound));
    }
    if let Some(last) = weights.last_mut() {
        *last = output;
    }
    Perceptron { mean, deviation, weights, rectified: false }
}

/// Mean and standard deviation of all but the hundredth at each end: a few wild values must not set the scale.
fn spread(values: &mut [f32]) -> (f32, f32) {
    values.sort_unstable_by(f32::total_cmp);
    let cut = values.len() / 100;
    let some = &values[cut..values.len() - cut];
    let count = some.len().max(1) as f64;
    let mean = some.iter().map(|&v| f64::from(v)).sum::<f64>() / count;
    let square = some.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / count;
    (mean as f32, libm::sqrt(square) as f32)
}

/// Adds the gradient of the loss of a group.
fn add_gradient<const N: usize, const O: usize, const W: usize, T>(
    network: &Perceptron<N, O, W>,
    group: &Group<N, T>,
    loss: impl Fn(&[[f32; O]], &[T]) -> Vec<[f32; O]>,
    gradient: &mut [f32],
) {
    let layers: Vec<Layers<N, O, W>> = group.inputs.iter().map(|i| network.layers(i)).collect();
    let outputs: Vec<[f32; O]> = layers.iter().map(|l| l.outputs).collect();
    for (layers, d) in layers.iter().zip(loss(&outputs, &group.truth)) {
        add_row(network, layers, d, gradient);
    }
}

/// Goes back from the derivatives by the outputs to the weights.
fn add_row<const N: usize, const O: usize, const W: usize>(
    network: &Perceptron<N, O, W>,
    layers: &Layers<N, O, W>,
    d_outputs: [f32; O],
    gradient: &mut [f32],
) {
    let [bias, second, second_bias, last, last_bias] = Perceptron::<N, O, W>::PARTS;
    let w = network.weights.as_slice();
    let mut d_second = [0.0; W];
    for i in 0..W {
        let mut d = 0.0;
        for (o, d_output) in d_outputs.iter().enumerate() {
            gradient[last + i * O + o] += d_output * layers.second[i];
            d += d_output * w[last + i * O + o];
        }
        d_second[i] = d * network.slope(layers.second[i]);
        gradient[second_bias + i] += d_second[i];
    }
    for (total, d) in gradient[last_bias..].iter_mut().zip(d_outputs) {
        *total += d;
    }
    let mut d_first = [0.0; W];
    for j in 0..W {
        let row = second + j * W..second + (j + 1) * W;
        let mut d = 0.0;
        for ((total, w), d_second) in gradient[row.clone()].iter_mut().zip(&w[row]).zip(&d_second) {
            *total += d_second * layers.first[j];
            d += d_second * w;
        }
        d_first[j] = d * network.slope(layers.first[j]);
        gradient[bias + j] += d_first[j];
    }
    for (row, &input) in gradient[..bias].chunks_exact_mut(W).zip(&layers.inputs) {
        for (total, d) in row.iter_mut().zip(&d_first) {
            *total += d * input;
        }
    }
}

/// Checks `derivative` against differences of `loss`, all the way down to the weights.
#[cfg(test)]
pub(super) fn assert_gradient<const N: usize>(
    group: &Group<N>,
    loss: impl Fn(&[f64], &[f32]) -> f64,
    derivative: impl Fn(&[f32], &[f32]) -> Vec<f32>,
) {
    let flat = |outputs: &[[f64; 1]], truth: &[f32]| loss(outputs.as_flattened(), truth);
    assert_gradient_of::<N, 1, { crate::solve::perceptron::WIDTH }, f32>(group, flat, one_output(derivative));
}

/// The same for any number of outputs.
#[cfg(test)]
pub(super) fn assert_gradient_of<const N: usize, const O: usize, const W: usize, T>(
    group: &Group<N, T>,
    loss: impl Fn(&[[f64; O]], &[T]) -> f64,
    derivative: impl Fn(&[[f32; O]], &[T]) -> Vec<[f32; O]>,
) {
    let mut rng = Rng::new(4);
    let mut network: Perceptron<N, O, W> = beginning(std::slice::from_ref(group), 1.0, &mut rng);
    network.weights.iter_mut().for_each(|w| *w += 0.3 * rng.normal());
    let mut gradient = vec![0.0; Perceptron::<N, O, W>::WEIGHTS];
    add_gradient(&network, group, derivative, &mut gradient);
    let value = |network: &Perceptron<N, O, W>| {
        let outputs: Vec<[f64; O]> = group.inputs.iter().map(|i| network.outputs(i).map(f64::from)).collect();
        loss(&outputs, &group.truth)
    };
    let last = Perceptron::<N, O, W>::WEIGHTS - 1;
    for at in (0..last).step_by(37).chain([last]) {
        let step = 1e-2f32;
        let [more, less] = [step, -step].map(|d| {
            let mut moved = network.clone();
            moved.weights[at] += d;
            value(&moved)
        });
        let slope = ((more - less) / f64::from(2.0 * step)) as f32;
        assert!((gradient[at] - slope).abs() < 2e-2 * (1.0 + slope.abs()), "{at}: {} {slope}", gradient[at]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn made_up(groups: usize) -> Vec<Group<5>> {
        let mut rng = Rng::new(3);
        let mut one = || {
            let inputs: [f32; 5] = std::array::from_fn(|_| rng.normal());
            (inputs, 0.5 + inputs[1] - 0.7 * inputs[3].abs())
        };
        (0..groups)
            .map(|_| {
                let (inputs, truth) = (0..32).map(|_| one()).unzip();
                Group { inputs, truth }
            })
            .collect()
    }

    fn squares(outputs: &[f32], truth: &[f32]) -> Vec<f32> {
        outputs.iter().zip(truth).map(|(o, t)| 2.0 * (o - t)).collect()
    }

    #[test]
    fn a_function_is_found_again() {
        let mut all = made_up(120);
        let unseen = all.split_off(100);
        let recipe = Recipe { seed: 1, passes: 40, groups: 2, rate: 1e-2, beginning: 0.0, rectified: false };
        let network = fit(&all, &recipe, squares);
        assert!(network.is_whole());
        assert_eq!(network, fit(&all, &recipe, squares), "the same seed, the same weights");
        let rows = unseen.iter().flat_map(|g| g.inputs.iter().zip(&g.truth));
        let worst = rows.map(|(i, t)| (network.output(i) - t).abs()).fold(0.0, f32::max);
        assert!(worst < 0.4, "{worst}");
    }

    #[test]
    fn gradient_is_that_of_the_loss() {
        let loss = |outputs: &[f64], truth: &[f32]| {
            outputs.iter().zip(truth).map(|(o, &t)| (o - f64::from(t)).powi(2)).sum()
        };
        assert_gradient(&made_up(1)[0], loss, squares);
    }

    #[test]
    fn wild_values_do_not_set_the_scale() {
        let mut values: Vec<f32> = (0..1000).map(|i| (i % 10) as f32).collect();
        values[0] = 1e9;
        let (mean, deviation) = spread(&mut values);
        assert!((mean - 4.5).abs() < 0.1 && (deviation - 2.87).abs() < 0.1, "{mean} {deviation}");
    }
}
