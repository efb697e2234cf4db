//! A small network that is trained by Adam: the one of `runtime/src/perception/choice.rs`.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use runtime::perception::choice::{CANDIDATES, FEATURES, HIDDEN};

/// Samples of one part of a batch. The parts are added in their order, so that the result does not depend on the number of cores.
const PART: usize = 512;

/// One cell.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    pub features: [f32; FEATURES],
    /// Whether each candidate is right; `None` where there is none.
    pub right: [Option<bool>; CANDIDATES],
}

/// A layer of `I` inputs and `O` outputs.
#[derive(Debug, Clone)]
pub struct Layer<const I: usize, const O: usize> {
    /// For every input, its weight in each output.
    weights: Vec<[f32; O]>,
    pub biases: [f32; O],
}

impl<const I: usize, const O: usize> Layer<I, O> {
    fn zero() -> Self {
        Self { weights: vec![[0.0; O]; I], biases: [0.0; O] }
    }

    /// He initialization: uniform with a variance of 2 / I.
    fn random(random: &mut Pcg64Mcg) -> Self {
        let limit = (6.0 / I as f32).sqrt();
        let mut layer = Self::zero();
        for weight in layer.weights.as_flattened_mut() {
            *weight = random.random_range(-limit..limit);
        }
        layer
    }

    /// For every output, the weights of all inputs.
    #[must_use]
    pub fn rows(&self) -> Vec<Vec<f32>> {
        (0..O).map(|output| self.weights.iter().map(|weights| weights[output]).collect()).collect()
    }

    fn forward(&self, inputs: &[f32; I]) -> [f32; O] {
        let mut outputs = self.biases;
        for (weights, input) in self.weights.iter().zip(inputs) {
            for (output, weight) in outputs.iter_mut().zip(weights) {
                *output += weight * input;
            }
        }
        outputs
    }

    /// Adds to the gradient of the loss by these weights, and returns that by the inputs.
    fn backward(&self, inputs: &[f32; I], by_output: &[f32; O], gradient: &mut Self) -> [f32; I] {
        let mut by_input = [0.0; I];
        let weights = self.weights.iter().zip(&mut gradient.weights);
        for (((weights, gradient), input), by_input) in weights.zip(inputs).zip(&mut by_input) {
            for ((weight, gradient), by_output) in weights.iter().zip(gradient).zip(by_output) {
                *gradient += input * by_output;
                *by_input += weight * by_output;
            }
        }
        for (bias, by_output) in gradient.biases.iter_mut().zip(by_output) {
            *bias += by_output;
        }
        by_input
    }

    fn values(&self) -> impl Iterator<Item = &f32> {
        self.weights.as_flattened().iter().chain(&self.biases)
    }

    fn values_mut(&mut self) -> impl Iterator<Item = &mut f32> {
        self.weights.as_flattened_mut().iter_mut().chain(&mut self.biases)
    }
}

#[derive(Debug, Clone)]
struct Layers {
    first: Layer<FEATURES, HIDDEN>,
    second: Layer<HIDDEN, HIDDEN>,
    third: Layer<HIDDEN, CANDIDATES>,
}

impl Layers {
    fn zero() -> Self {
        Self { first: Layer::zero(), second: Layer::zero(), third: Layer::zero() }
    }

    fn values(&self) -> impl Iterator<Item = &f32> {
        self.first.values().chain(self.second.values()).chain(self.third.values())
    }

    fn values_mut(&mut self) -> impl Iterator<Item = &mut f32> {
        let last = self.second.values_mut().chain(self.third.values_mut());
        self.first.values_mut().chain(last)
    }

    /// Adds the gradient of one sample, and returns its loss: the sum of the cross entropies of its candidates.
    fn learn(&self, sample: &Sample, gradient: &mut Self) -> f32 {
        let first = self.first.forward(&sample.features).map(|value| value.max(0.0));
        let second = self.second.forward(&first).map(|value| value.max(0.0));
        let logits = self.third.forward(&second);
        let mut loss = 0.0;
        let mut by_logit = [0.0; CANDIDATES];
        for ((logit, right), by_logit) in logits.iter().zip(sample.right).zip(&mut by_logit) {
            let Some(right) = right else { continue };
            let probability = 1.0 / (1.0 + (-logit).exp());
            *by_logit = probability - f32::from(u8::from(right));
            let of_truth = if right { probability } else { 1.0 - probability };
            loss -= of_truth.max(1e-6).ln();
        }
        let by_second = self.third.backward(&second, &by_logit, &mut gradient.third);
        let by_second = rectified(&second, by_second);
        let by_first = self.second.backward(&first, &by_second, &mut gradient.second);
        self.first.backward(&sample.features, &rectified(&first, by_first), &mut gradient.first);
        loss
    }
}

/// The gradient before a rectifier.
fn rectified<const N: usize>(values: &[f32; N], mut gradient: [f32; N]) -> [f32; N] {
    for (gradient, value) in gradient.iter_mut().zip(values) {
        if *value <= 0.0 {
            *gradient = 0.0;
        }
    }
    gradient
}

/// The network and the state of Adam (Kingma and Ba 2015, with its values of beta).
#[derive(Debug, Clone)]
pub struct Perceptron {
    layers: Layers,
    mean: Layers,
    square: Layers,
    steps: i32,
}

impl Perceptron {
    /// A network with random weights.
    #[must_use]
    pub fn new(random: &mut Pcg64Mcg) -> Self {
        let first = Layer::random(random);
        let second = Layer::random(random);
        let third = Layer::random(random);
        let layers = Layers { first, second, third };
        Self { layers, mean: Layers::zero(), square: Layers::zero(), steps: 0 }
    }

    #[must_use]
    pub fn first(&self) -> &Layer<FEATURES, HIDDEN> {
        &self.layers.first
    }

    #[must_use]
    pub fn second(&self) -> &Layer<HIDDEN, HIDDEN> {
        &self.layers.second
    }

    #[must_use]
    pub fn third(&self) -> &Layer<HIDDEN, CANDIDATES> {
        &self.layers.third
    }

    /// Improves the weights by one batch, and returns its mean loss before.
    pub fn step(&mut self, batch: &[&Sample], rate: f32) -> f32 {
        let parts: Vec<(Layers, f32)> = batch
            .par_chunks(PART)
            .map(|samples| {
                let mut gradient = Layers::zero();
                let losses = samples.iter().map(|sample| self.layers.learn(sample, &mut gradient));
                let loss = losses.sum();
                (gradient, loss)
            })
            .collect();
        let mut gradient = Layers::zero();
        let mut loss = 0.0;
        for (part, part_loss) in &parts {
            gradient.values_mut().zip(part.values()).for_each(|(sum, value)| *sum += value);
            loss += part_loss;
        }
        self.steps += 1;
        let scale = 1.0 / batch.len() as f32;
        let mean_share = 1.0 - 0.9_f32.powi(self.steps);
        let square_share = 1.0 - 0.999_f32.powi(self.steps);
        let state = self.mean.values_mut().zip(self.square.values_mut());
        let values = self.layers.values_mut().zip(state).zip(gradient.values());
        for ((value, (mean, square)), gradient) in values {
            let gradient = gradient * scale;
            *mean += 0.1 * (gradient - *mean);
            *square += 0.001 * (gradient * gradient - *square);
            *value -= rate * (*mean / mean_share) / ((*square / square_share).sqrt() + 1e-8);
        }
        loss * scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn sample(random: &mut Pcg64Mcg) -> Sample {
        let features: [f32; FEATURES] = std::array::from_fn(|_| random.random_range(-1.0..1.0));
        // Not linear: the first candidate is right where the first two features have the same sign.
        let right = features[0] * features[1] > 0.0;
        let mut all = [None; CANDIDATES];
        all[0] = Some(right);
        all[2] = Some(!right);
        Sample { features, right: all }
    }

    #[test]
    fn a_rule_that_is_not_linear_is_learnt() {
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let mut network = Perceptron::new(&mut random);
        let all: Vec<Sample> = (0..4096).map(|_| sample(&mut random)).collect();
        let batch: Vec<&Sample> = all.iter().collect();
        let first = network.step(&batch, 5e-3);
        let last = (0..300).map(|_| network.step(&batch, 5e-3)).last().unwrap();
        assert!(first > 1.2 && last < 0.3, "{first} {last}");
    }

    #[test]
    fn the_gradient_is_that_of_finite_differences() {
        let mut random = Pcg64Mcg::seed_from_u64(4);
        let network = Perceptron::new(&mut random).layers;
        let sample = sample(&mut random);
        let mut gradient = Layers::zero();
        network.learn(&sample, &mut gradient);
        for index in [0, 100, FEATURES * HIDDEN + 3, FEATURES * HIDDEN + HIDDEN + 20] {
            let loss = |change: f32| {
                let mut network = network.clone();
                *network.values_mut().nth(index).unwrap() += change;
                network.learn(&sample, &mut Layers::zero())
            };
            let expected = (loss(1e-3) - loss(-1e-3)) / 2e-3;
            let found = *gradient.values().nth(index).unwrap();
            assert!(
                (found - expected).abs() < 2e-3 + 0.01 * expected.abs(),
                "{index}: {found} {expected}"
            );
        }
    }
}
