//! Fully connected networks with ReLU between layers and a linear output.
//!
//! # Layout of the parameters
//! One flat vector. For each layer in order: weights `[inputs, outputs]` row-major (all outputs of
//! input 0, then of input 1, ...), then biases `[outputs]`.

use alloc::vec;
use alloc::vec::Vec;
use ndarray::{ArrayView1, ArrayView2};
use serde::{Deserialize, Serialize};

use super::buffer::Buffer;
use super::gemm::{Factors, Finish, Matrix, Output, Work};
use super::isa::{self, Isa};
use super::ones::Visits;
use super::optim::Adam;
use super::rows::Rows;
use crate::rng::Rng;

/// Samples that a word of marks has room for.
const WORD: usize = u64::BITS as usize;

/// A network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mlp {
    sizes: Vec<usize>,
    params: Buffer,
}

/// Working memory of forward and backward passes; holds no result between calls.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    /// Outputs of each layer, `[rows, outputs]`.
    layers: Vec<Buffer>,
    delta: Buffer,
    next_delta: Buffer,
    visits: Visits,
    products: Work,
}

/// Gradient of a network's parameters, in the layout of the parameters. One belongs to networks of the same sizes and
/// to one kind of rows.
#[derive(Clone, Debug, Default)]
pub struct Gradient {
    values: Buffer,
    /// Binary inputs that are one in a sample, ascending. The rows of the others are zero.
    touched: Vec<u32>,
    /// For every binary input, the samples in which it is one: a bit each.
    marks: Vec<u64>,
    row: usize,
}

impl Gradient {
    /// The numbers, in the layout of the parameters.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Notes which inputs are one in which of the first `count` rows, zeroes the first layer's rows of those that no
    /// longer are, and returns the words of marks per input.
    fn mark_samples(&mut self, rows: &Rows, count: usize) -> usize {
        let words = count.div_ceil(WORD);
        self.marks.clear();
        self.marks.resize(rows.width() * words, 0);
        for row in 0..count {
            let (word, bit) = (row / WORD, 1 << (row % WORD));
            rows.ones(row).iter().for_each(|&index| self.marks[index as usize * words + word] |= bit);
        }
        let marks = &self.marks;
        let is_one = |index: u32| marks[index as usize * words..][..words].iter().any(|mark| *mark != 0);
        for &index in self.touched.iter().filter(|index| !is_one(**index)) {
            self.values[index as usize * self.row..][..self.row].fill(0.0);
        }
        self.touched.clear();
        self.touched.extend((0..rows.width() as u32).filter(|index| is_one(*index)));
        words
    }

    /// Tells the optimiser which first-layer rows have a gradient.
    pub fn mark(&self, optimizer: &mut Adam) {
        self.touched.iter().for_each(|&index| optimizer.touch(index));
    }
}

/// One layer's place in the flat vector.
#[derive(Clone, Copy)]
struct Layer {
    inputs: usize,
    outputs: usize,
    weights: usize,
    bias: usize,
}

impl Mlp {
    /// A network of these layer sizes (input first, output last) with every weight and bias uniform in
    /// ±1/√inputs of its layer: the common frameworks' default (docs/method.md R1).
    ///
    /// # Panics
    /// With fewer than two sizes or a size of zero.
    pub fn new(sizes: &[usize], rng: &mut Rng) -> Self {
        let mut network = Self::zeros(sizes);
        for layer in network.layers().collect::<Vec<_>>() {
            let bound = 1.0 / libm::sqrtf(layer.inputs as f32);
            let end = layer.bias + layer.outputs;
            for value in &mut network.params[layer.weights..end] {
                *value = (2.0 * rng.uniform() - 1.0) * bound;
            }
        }
        network
    }

    /// A network of zeros.
    ///
    /// # Panics
    /// With fewer than two sizes or a size of zero.
    pub fn zeros(sizes: &[usize]) -> Self {
        assert!(sizes.len() >= 2 && sizes.iter().all(|&s| s > 0), "layer sizes {sizes:?}");
        let params = sizes.windows(2).map(|pair| pair[0] * pair[1] + pair[1]).sum();
        Self { sizes: sizes.to_vec(), params: Buffer::zeros(params) }
    }

    /// Layer sizes, input first.
    pub fn sizes(&self) -> &[usize] {
        &self.sizes
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.sizes[self.sizes.len() - 1]
    }

    /// All parameters, in the documented layout.
    pub fn params(&self) -> &[f32] {
        &self.params
    }

    /// All parameters, writable.
    pub fn params_mut(&mut self) -> &mut [f32] {
        &mut self.params
    }

    /// Whether every parameter is a finite number.
    pub fn is_finite(&self) -> bool {
        self.params.iter().all(|value| value.is_finite())
    }

    /// Multiply-adds of a forward pass of one row, by the dense definition: for shares of a machine's peak.
    pub fn forward_work(&self) -> u64 {
        self.layers().map(|layer| (layer.inputs * layer.outputs) as u64).sum()
    }

    /// Multiply-adds of a backward pass of one row: the gradients of all weights, and those of the inputs
    /// of every layer but the first.
    pub fn backward_work(&self) -> u64 {
        let first = (self.sizes[0] * self.sizes[1]) as u64;
        2 * self.forward_work() - first
    }

    /// Weights `[inputs, outputs]` and biases `[outputs]` of layer `index`.
    ///
    /// # Panics
    /// If there is no such layer.
    pub fn layer(&self, index: usize) -> (ArrayView2<'_, f32>, ArrayView1<'_, f32>) {
        let layer = self.layers().nth(index).expect("an existing layer");
        let weights = &self.params[layer.weights..layer.bias];
        let bias = &self.params[layer.bias..layer.bias + layer.outputs];
        let shape = (layer.inputs, layer.outputs);
        (ArrayView2::from_shape(shape, weights).expect("the layout fits"), ArrayView1::from(bias))
    }

    /// Number of first-layer rows and their length.
    pub fn first_rows(&self) -> (usize, usize) {
        (self.sizes[0], self.sizes[1])
    }

    fn layers(&self) -> impl Iterator<Item = Layer> + '_ {
        let mut at = 0;
        self.sizes.windows(2).map(move |pair| {
            let (inputs, outputs) = (pair[0], pair[1]);
            let layer = Layer { inputs, outputs, weights: at, bias: at + inputs * outputs };
            at = layer.bias + outputs;
            layer
        })
    }

    /// The layers with their index, the last first.
    fn layers_backwards(&self) -> impl Iterator<Item = (usize, Layer)> + '_ {
        let mut end = self.params.len();
        self.sizes.windows(2).enumerate().rev().map(move |(index, pair)| {
            let (inputs, outputs) = (pair[0], pair[1]);
            let bias = end - outputs;
            end = bias - inputs * outputs;
            (index, Layer { inputs, outputs, weights: end, bias })
        })
    }

    /// Outputs for every row, `[rows.len(), outputs]`, row-major. The slice lives in `scratch`.
    pub fn forward<'s>(&self, rows: &Rows, scratch: &'s mut Scratch) -> &'s [f32] {
        debug_assert_eq!(rows.width(), self.sizes[0], "width of the input");
        let isa = Isa::active();
        let count = rows.len();
        let last = self.sizes.len() - 2;
        scratch.layers.resize_with(last + 1, Buffer::default);
        for (index, layer) in self.layers().enumerate() {
            let (before, from) = scratch.layers.split_at_mut(index);
            let out = from[0].at_least(count * layer.outputs);
            let bias = &self.params[layer.bias..layer.bias + layer.outputs];
            let weights = Matrix::new(&self.params[layer.weights..], layer.inputs, layer.outputs);
            if index == 0 && rows.is_binary() && index != last {
                isa::sum_rows(isa, weights, rows, scratch.visits.order(rows), bias, out);
            } else {
                let written_out: Vec<f32>;
                let input = match before.last() {
                    Some(previous) => &previous[..count * layer.inputs],
                    // A network of one layer has no ReLU to fuse; such inputs are written out.
                    None if rows.is_binary() => {
                        written_out = write_out(rows);
                        &written_out
                    }
                    None => rows.dense(),
                };
                let finish = if index == last { Finish::Plain } else { Finish::Relu };
                let output = Output { data: out, bias: Some(bias), finish };
                isa::product(isa, factors(index), Matrix::new(input, count, layer.inputs), weights, output);
            }
        }
        &scratch.layers[last][..count * self.outputs()]
    }

    /// Activations of the first hidden layer from the last forward pass, `[rows, units]`.
    pub fn first_activations<'s>(&self, rows: &Rows, scratch: &'s Scratch) -> &'s [f32] {
        &scratch.layers[0][..rows.len() * self.sizes[1]]
    }

    /// Derivative of a scalar loss with respect to the inputs of a layer from input `from` on, given that
    /// with respect to its outputs, `[rows, outputs]`; writes `[rows, inputs - from]` to `out`.
    fn data_gradient(
        &self,
        layer: Layer,
        from: usize,
        delta: Matrix<'_>,
        finish: Finish<'_>,
        products: &mut Work,
        out: &mut Buffer,
    ) {
        let isa = Isa::active();
        let (inputs, outputs) = (layer.inputs - from, layer.outputs);
        let own = Matrix::new(&self.params[layer.weights + from * outputs..], inputs, outputs);
        let output = Output { data: out.at_least(delta.rows * inputs), bias: None, finish };
        isa::product_by_transposed(isa, delta, own, output, products);
    }

    /// Gradient of a scalar loss with respect to the inputs from input `from` on, `[count, width - from]`,
    /// given its derivative with respect to the outputs of the first `count` rows of the last forward pass
    /// with the same `scratch`. The slice lives in `scratch`.
    pub fn input_gradient<'s>(
        &self,
        count: usize,
        output_gradient: &[f32],
        from: usize,
        scratch: &'s mut Scratch,
    ) -> &'s [f32] {
        let Scratch { layers: activations, delta, next_delta, products, .. } = scratch;
        delta.at_least(output_gradient.len()).copy_from_slice(output_gradient);
        for (index, layer) in self.layers_backwards() {
            let d = Matrix::new(delta, count, layer.outputs);
            let (from, finish) =
                if index == 0 { (from, Finish::Plain) } else { (0, Finish::Where(&activations[index - 1])) };
            self.data_gradient(layer, from, d, finish, products, next_delta);
            core::mem::swap(delta, next_delta);
        }
        &delta[..count * (self.sizes[0] - from)]
    }

    /// Gradient of a scalar loss, given its derivative with respect to the outputs of the first `count`
    /// rows of the last forward pass with the same `rows` and `scratch`: `output_gradient` is
    /// `[count, outputs]`, row-major.
    pub fn backward(
        &self,
        rows: &Rows,
        count: usize,
        output_gradient: &[f32],
        scratch: &mut Scratch,
        gradient: &mut Gradient,
    ) {
        let isa = Isa::active();
        if gradient.values.len() != self.params.len() {
            gradient.values = Buffer::zeros(self.params.len());
            gradient.touched.clear();
            gradient.row = self.sizes[1];
        }
        let Scratch { layers: activations, delta, next_delta, products, .. } = scratch;
        delta.at_least(output_gradient.len()).copy_from_slice(output_gradient);
        for (index, layer) in self.layers_backwards() {
            let (inputs, outputs) = (layer.inputs, layer.outputs);
            let d = Matrix::new(delta, count, outputs);
            isa::sum_columns(isa, d, &mut gradient.values[layer.bias..layer.bias + outputs]);
            if index == 0 && rows.is_binary() {
                let words = gradient.mark_samples(rows, count);
                for &input in &gradient.touched {
                    let (at, marks) = (layer.weights + input as usize * outputs, input as usize * words);
                    let weights = &mut gradient.values[at..at + outputs];
                    isa::sum_marked(isa, d, &gradient.marks[marks..marks + words], weights);
                }
                break;
            }
            let weights = &mut gradient.values[layer.weights..layer.bias];
            if index > 0 {
                let h = Matrix::new(&activations[index - 1], count, inputs);
                isa::product_transposed(isa, factors(index), h, d, weights, products);
                self.data_gradient(layer, 0, d, Finish::Where(h.data), products, next_delta);
                core::mem::swap(delta, next_delta);
            } else {
                let x = Matrix::new(rows.dense(), count, inputs);
                isa::product_transposed(isa, factors(index), x, d, weights, products);
            }
        }
    }
}

/// What is known about the inputs of layer `index`: behind the first they come out of a ReLU.
fn factors(index: usize) -> Factors {
    if index == 0 { Factors::Dense } else { Factors::Sparse }
}

/// Binary rows as numbers.
fn write_out(rows: &Rows) -> Vec<f32> {
    let mut values = vec![0.0; rows.len() * rows.width()];
    for row in 0..rows.len() {
        rows.ones(row).iter().for_each(|&i| values[row * rows.width() + i as usize] = 1.0);
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::ObservationSpec;

    fn random_rows(spec: ObservationSpec, count: usize, rng: &mut Rng) -> Rows {
        let mut rows = Rows::new(spec);
        for _ in 0..count {
            let observation: Vec<f32> = (0..spec.width)
                .map(|_| if spec.binary { f32::from(u8::from(rng.bernoulli(0.3))) } else { rng.uniform() - 0.5 })
                .collect();
            rows.push_observation(&observation);
        }
        rows
    }

    #[test]
    fn work_is_that_of_the_dense_definition() {
        let network = Mlp::zeros(&[3, 4, 5, 2]);
        assert_eq!(network.forward_work(), 12 + 20 + 10);
        assert_eq!(network.backward_work(), (12 + 20 + 10) + (20 + 10));
    }

    /// The definition in f64, one row at a time.
    fn plain(network: &Mlp, input: &[f32]) -> Vec<f64> {
        let mut x: Vec<f64> = input.iter().map(|&v| f64::from(v)).collect();
        for index in 0..network.sizes.len() - 1 {
            let (weights, bias) = network.layer(index);
            let last = index == network.sizes.len() - 2;
            x = (0..bias.len())
                .map(|o| {
                    let sum: f64 = (0..x.len()).map(|i| x[i] * f64::from(weights[[i, o]])).sum::<f64>();
                    let z = sum + f64::from(bias[o]);
                    if last { z } else { z.max(0.0) }
                })
                .collect();
        }
        x
    }

    #[test]
    fn forward_is_the_definition() {
        for binary in [false, true] {
            let spec = ObservationSpec { width: 13, binary };
            let mut rng = Rng::new(1);
            let network = Mlp::new(&[13, 40, 24, 3], &mut rng);
            let rows = random_rows(spec, 9, &mut rng);
            let inputs = if binary { write_out(&rows) } else { rows.dense().to_vec() };
            let mut scratch = Scratch::default();
            let out = network.forward(&rows, &mut scratch).to_vec();
            for (input, out) in inputs.chunks(13).zip(out.chunks(3)) {
                for (a, b) in out.iter().zip(plain(&network, input)) {
                    assert!((f64::from(*a) - b).abs() < 1e-6, "{a} {b}");
                }
            }
        }
    }

    #[test]
    fn binary_and_dense_inputs_give_the_same_bits() {
        let mut rng = Rng::new(2);
        let network = Mlp::new(&[20, 32, 2], &mut rng);
        let (mut a, mut b) = (Scratch::default(), Scratch::default());
        let (mut ga, mut gb) = (Gradient::default(), Gradient::default());
        // Batch after batch: inputs that are no longer one have no gradient.
        for count in [5, 1, 70, 2] {
            let binary = random_rows(ObservationSpec { width: 20, binary: true }, count, &mut rng);
            let mut dense = Rows::new(ObservationSpec { width: 20, binary: false });
            write_out(&binary).chunks(20).for_each(|row| dense.push_observation(row));
            assert_eq!(network.forward(&binary, &mut a), network.forward(&dense, &mut b));
            let derivative: Vec<f32> = (0..2 * count).map(|i| i as f32 - 4.5).collect();
            network.backward(&binary, count, &derivative, &mut a, &mut ga);
            network.backward(&dense, count, &derivative, &mut b, &mut gb);
            assert_eq!(ga.values(), gb.values());
        }
        assert!(ga.values()[..20 * 32].chunks(32).any(|row| row.iter().all(|&x| x == 0.0)));
    }

    #[test]
    fn gradient_matches_finite_differences() {
        // Loss: Σ c_ij · out_ij over the first four of six rows.
        for binary in [false, true] {
            let mut rng = Rng::new(3);
            let mut network = Mlp::new(&[7, 10, 9, 2], &mut rng);
            let rows = random_rows(ObservationSpec { width: 7, binary }, 6, &mut rng);
            let c: Vec<f32> = (0..8).map(|_| rng.uniform() - 0.5).collect();
            let inputs = if binary { write_out(&rows) } else { rows.dense().to_vec() };
            let loss = |network: &Mlp| -> f64 {
                let outs = inputs.chunks(7).take(4).flat_map(|input| plain(network, input));
                outs.zip(&c).map(|(out, c)| out * f64::from(*c)).sum()
            };
            let (mut scratch, mut gradient) = (Scratch::default(), Gradient::default());
            network.forward(&rows, &mut scratch);
            network.backward(&rows, 4, &c, &mut scratch, &mut gradient);
            let mut compared = 0;
            for i in 0..network.params().len() {
                let h = 1e-3;
                let at = network.params[i];
                network.params[i] = at + h;
                let up = loss(&network);
                network.params[i] = at - h;
                let down = loss(&network);
                network.params[i] = at;
                let step = f64::from((at + h) - (at - h));
                let slope = (up - down) / step;
                let error = (slope - f64::from(gradient.values()[i])).abs();
                assert!(error < 2e-3 + 1e-2 * slope.abs(), "parameter {i}: {slope} against {}", gradient.values()[i]);
                compared += usize::from(slope.abs() > 1e-6);
            }
            assert!(compared > 50, "most slopes are not zero: {compared}");
        }
    }

    #[test]
    fn weights_are_uniform_in_their_bound() {
        let network = Mlp::new(&[100, 128, 4], &mut Rng::new(4));
        let (weights, bias) = network.layer(0);
        let all: Vec<f32> = weights.iter().chain(bias.iter()).copied().collect();
        assert!(all.iter().all(|w| w.abs() <= 0.1));
        let variance = all.iter().map(|w| w * w).sum::<f32>() / all.len() as f32;
        assert!((variance - 0.01 / 3.0).abs() < 2e-4, "{variance}");
        assert_eq!(vec![100, 128, 4], network.sizes());
    }
}
