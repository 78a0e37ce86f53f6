//! Affine layers: weights in file order, and packed for products of a small matrix with `[inputs, LANES]`.

use crate::{
    error::{Error, Result},
    simd::{self, LANES, Lanes, Simd, Vectorized},
};

/// `y = W x + b`.
#[derive(Clone, Debug, PartialEq)]
pub struct Linear {
    inputs: usize,
    outputs: usize,
    /// `[outputs, inputs]`, row-major.
    weight: Vec<f32>,
    bias: Vec<f32>,
}

impl Linear {
    /// Makes a layer of a row-major weight `[outputs, inputs]` and a bias `[outputs]` (PyTorch's order).
    ///
    /// # Errors
    /// The sizes do not match, or a value is not finite.
    pub fn new(name: &str, inputs: usize, outputs: usize, weight: &[f32], bias: Vec<f32>) -> Result<Self> {
        if outputs == 0 || weight.len() != inputs * outputs || bias.len() != outputs {
            let reason = format!("{} weights and {} biases do not fit {outputs} x {inputs}", weight.len(), bias.len());
            return Err(Error::argument(name, reason));
        }
        if !weight.iter().chain(&bias).all(|value| value.is_finite()) {
            return Err(Error::argument(name, "holds a value that is not finite"));
        }
        Ok(Self { inputs, outputs, weight: weight.to_vec(), bias })
    }

    /// Length of the input.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Length of the output.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// The row-major weight `[outputs, inputs]`.
    pub fn weight(&self) -> &[f32] {
        &self.weight
    }

    /// The bias `[outputs]`.
    pub fn bias(&self) -> &[f32] {
        &self.bias
    }

    /// Appends the weights for other devices, `[blocks, inputs, 4]`, where a block is four outputs, then the biases
    /// `[blocks, 4]`, whose place it returns. Missing outputs of the last block are 0.
    pub(crate) fn append_blocks(&self, out: &mut Vec<f32>) -> usize {
        const BLOCK: usize = 4;
        for first in (0..self.outputs).step_by(BLOCK) {
            for input in 0..self.inputs {
                let weight = |row: usize| self.weight.get(row * self.inputs + input).copied().unwrap_or(0.0);
                out.extend((first..first + BLOCK).map(weight));
            }
        }
        let biases = out.len();
        out.extend(&self.bias);
        out.resize(biases + self.outputs.next_multiple_of(BLOCK), 0.0);
        biases
    }
}

/// Appends a network for other devices, see [`crate::brdf::FlatBrdf`].
pub(crate) fn append_network(layers: &[Linear], leaky_slope: f32, out: &mut Vec<f32>) {
    out.extend([layers.len() as f32, leaky_slope]);
    for layer in layers {
        out.extend([layer.inputs as f32, layer.outputs as f32]);
        layer.append_blocks(out);
    }
}

/// Maximum outputs of a block. With [`LANES`] samples in two registers (AVX2), six outputs keep twelve
/// sums in registers: enough to hide the latency of a multiply-add, and few enough to leave room for
/// the factors.
const BLOCK: usize = 6;

/// A range of columns of a [`Linear`], with its weights in the order of reading: for each block of
/// outputs, for each input, the weights of the block.
#[derive(Clone, Debug)]
pub(crate) struct Packed {
    inputs: usize,
    bias: Vec<f32>,
    weights: Vec<f32>,
    /// Outputs of each block.
    blocks: Vec<usize>,
}

/// The value to which the products are added.
#[derive(Clone, Copy)]
pub(crate) enum Start<'a> {
    /// The layer's bias.
    Bias,
    /// The output of another part of the same layer.
    Of(&'a [Lanes]),
}

impl Packed {
    /// Packs a whole layer.
    pub fn new(layer: &Linear) -> Self {
        Self::part(layer, 0, layer.inputs())
    }

    /// Packs the part of a layer that reads `count` inputs from `first` on.
    pub fn part(layer: &Linear, first: usize, count: usize) -> Self {
        let (inputs, outputs) = (layer.inputs(), layer.outputs());
        let of_layer = layer.weight();
        let blocks = even_blocks(outputs);
        let mut weights = Vec::with_capacity(outputs * count);
        let mut start = 0;
        for &block in &blocks {
            for input in first..first + count {
                weights.extend((start..start + block).map(|output| of_layer[output * inputs + input]));
            }
            start += block;
        }
        Self { inputs: count, bias: layer.bias().to_vec(), weights, blocks }
    }

    /// Length of the output.
    pub fn outputs(&self) -> usize {
        self.bias.len()
    }

    /// Computes `out = start + W x`, then a leaky ReLU if `slope` is given. `x` and `out` may be longer
    /// than the layer's sizes.
    #[inline(always)]
    pub fn forward<S: Simd>(&self, simd: S, start: Start<'_>, x: &[Lanes], out: &mut [Lanes], slope: Option<f32>) {
        simd::call(simd, Forward { layer: self, start, x, out, slope });
    }
}

/// The work of [`Packed::forward`].
struct Forward<'a> {
    layer: &'a Packed,
    start: Start<'a>,
    x: &'a [Lanes],
    out: &'a mut [Lanes],
    slope: Option<f32>,
}

impl Vectorized for Forward<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { layer, start, x, out, slope } = self;
        let x = &x[..layer.inputs];
        let mut out = &mut out[..layer.outputs()];
        match start {
            Start::Bias => {
                for (out, &bias) in out.iter_mut().zip(&layer.bias) {
                    *out = [bias; LANES];
                }
            }
            Start::Of(start) => out.copy_from_slice(&start[..layer.outputs()]),
        }
        let mut weights = &layer.weights[..];
        for &block in &layer.blocks {
            let (own, rest) = weights.split_at(block * layer.inputs);
            let (rows, later) = out.split_at_mut(block);
            match block {
                1 => rows_of::<S, 1>(simd, own, x, rows, slope),
                2 => rows_of::<S, 2>(simd, own, x, rows, slope),
                3 => rows_of::<S, 3>(simd, own, x, rows, slope),
                4 => rows_of::<S, 4>(simd, own, x, rows, slope),
                5 => rows_of::<S, 5>(simd, own, x, rows, slope),
                _ => rows_of::<S, BLOCK>(simd, own, x, rows, slope),
            }
            (weights, out) = (rest, later);
        }
    }
}

/// Sizes of the fewest blocks, as even as possible: a block of one output would stall on its own sums.
fn even_blocks(outputs: usize) -> Vec<usize> {
    let count = outputs.div_ceil(BLOCK);
    (0..count).map(|k| (k + 1) * outputs / count - k * outputs / count).collect()
}

/// Computes a block of `R` outputs with the number of registers that [`LANES`] samples need.
#[inline(always)]
fn rows_of<S: Simd, const R: usize>(simd: S, weights: &[f32], x: &[Lanes], out: &mut [Lanes], slope: Option<f32>) {
    match S::F32_LANES {
        16 => kernel::<S, R, 1>(simd, weights, x, out, slope),
        8 => kernel::<S, R, 2>(simd, weights, x, out, slope),
        4 => kernel::<S, R, 4>(simd, weights, x, out, slope),
        _ => kernel::<S, R, LANES>(simd, weights, x, out, slope),
    }
}

/// Computes a block of `R` outputs; `N` registers hold [`LANES`] numbers.
#[inline(always)]
fn kernel<S: Simd, const R: usize, const N: usize>(
    simd: S,
    weights: &[f32],
    x: &[Lanes],
    out: &mut [Lanes],
    slope: Option<f32>,
) {
    let out: &mut [Lanes; R] = out.try_into().expect("a block has R outputs");
    let (weights, _) = weights.as_chunks::<R>();
    let mut sums = [[simd.splat_f32s(0.0); N]; R];
    for r in 0..R {
        sums[r] = registers::<S, N>(&out[r]);
    }
    for (x, weights) in x.iter().zip(weights) {
        let x = registers::<S, N>(x);
        for r in 0..R {
            let weight = simd.splat_f32s(weights[r]);
            for n in 0..N {
                sums[r][n] = simd.mul_add_e_f32s(weight, x[n], sums[r][n]);
            }
        }
    }
    if let Some(slope) = slope {
        let slope = simd.splat_f32s(slope);
        for sums in &mut sums {
            for sum in sums {
                *sum = simd.max_f32s(*sum, simd.mul_f32s(slope, *sum));
            }
        }
    }
    for r in 0..R {
        S::as_mut_simd_f32s(&mut out[r]).0.copy_from_slice(&sums[r]);
    }
}

#[inline(always)]
fn registers<S: Simd, const N: usize>(lanes: &Lanes) -> [S::f32s; N] {
    *S::as_simd_f32s(lanes).0.first_chunk().expect("LANES numbers fill N registers")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        random::{Purpose, Stream},
        simd::{Vectorized, dispatch},
    };

    #[test]
    fn blocks_are_even_and_complete() {
        for outputs in 1..200 {
            let blocks = even_blocks(outputs);
            let (least, most) = (blocks.iter().min().unwrap(), blocks.iter().max().unwrap());
            assert!(blocks.iter().sum::<usize>() == outputs && *most <= BLOCK && most - least <= 1);
        }
    }

    #[test]
    fn parts_add_up_to_the_layer() {
        struct Both<'a>([&'a Packed; 2], &'a [Lanes], &'a mut [Lanes]);
        impl Vectorized for Both<'_> {
            #[inline(always)]
            fn run<S: Simd>(self, simd: S) {
                let Self([first, second], x, out) = self;
                let mut between = vec![[0.0; LANES]; out.len()];
                first.forward(simd, Start::Bias, x, &mut between, None);
                second.forward(simd, Start::Of(&between), &x[first.inputs..], out, Some(0.1));
            }
        }
        let mut random = Stream::new(1, Purpose::Test, 0);
        for (inputs, outputs) in [(3, 1), (5, 13), (7, 64), (64, 97)] {
            let mut numbers = |count: usize| -> Vec<f32> { (0..count).map(|_| random.uniform() - 0.5).collect() };
            let layer = Linear::new("layer", inputs, outputs, &numbers(inputs * outputs), numbers(outputs)).unwrap();
            let x: Vec<Lanes> = (0..inputs).map(|_| std::array::from_fn(|_| numbers(1)[0])).collect();
            let mut out = vec![[f32::NAN; LANES]; outputs];
            let parts = [Packed::part(&layer, 0, 2), Packed::part(&layer, 2, inputs - 2)];
            dispatch(Both([&parts[0], &parts[1]], &x, &mut out));
            for lane in 0..LANES {
                let column: Vec<f32> = x.iter().map(|x| x[lane]).collect();
                let row = |(row, bias): (&[f32], &f32)| row.iter().zip(&column).map(|(w, x)| w * x).sum::<f32>() + bias;
                let expected: Vec<f32> = layer.weight().chunks_exact(inputs).zip(layer.bias()).map(row).collect();
                for (out, expected) in out.iter().zip(expected) {
                    let expected = if expected > 0.0 { expected } else { 0.1 * expected };
                    assert!((out[lane] - expected).abs() < 2e-6, "{inputs} {outputs}: {} {expected}", out[lane]);
                }
            }
        }
    }
}
