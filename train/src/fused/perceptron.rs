//! Layers of perceptrons over matrices `[features, columns]`, forward and backward, with weights in one flat list.

use headtail_render::simd::LANES;

use super::matrix::{Form, Matrix, multiply};

/// Where an affine layer's numbers are in the flat list: `[out, in]` weight, then bias.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layer {
    pub inputs: usize,
    pub outputs: usize,
    pub start: usize,
}

impl Layer {
    /// How many numbers it has.
    pub fn length(&self) -> usize {
        self.outputs * (self.inputs + 1)
    }

    #[inline(always)]
    pub fn weight<'a>(&self, flat: &'a [f32]) -> Matrix<'a> {
        Matrix::new(&flat[self.start..][..self.outputs * self.inputs], self.outputs, self.inputs)
    }

    /// The weights of input `input` for output `output` onwards.
    #[inline(always)]
    pub fn weight_at(&self, output: usize, input: usize) -> usize {
        self.start + output * self.inputs + input
    }

    #[inline(always)]
    pub fn bias_at(&self) -> usize {
        self.start + self.outputs * self.inputs
    }

    #[inline(always)]
    fn bias<'a>(&self, flat: &'a [f32]) -> &'a [f32] {
        &flat[self.bias_at()..][..self.outputs]
    }

    /// `out = W[:, ..x.rows] x + b`.
    #[inline(always)]
    pub fn forward(&self, flat: &[f32], x: Matrix<'_>, out: &mut Vec<f32>) {
        out.clear();
        for &bias in self.bias(flat) {
            out.resize(out.len() + x.columns, bias);
        }
        multiply(Form::Plain, self.weight(flat).columns(0, x.rows), x, out, x.columns, true);
    }

    /// Adds `G x^T` to the gradient of the first `x.rows` columns of the weight, and the sums of the rows of `G` to that of the bias.
    #[inline(always)]
    pub fn add_gradient(&self, by_output: Matrix<'_>, x: Matrix<'_>, gradient: &mut [f32]) {
        multiply(Form::RightTransposed, by_output, x, &mut gradient[self.start..], self.inputs, true);
        let bias = &mut gradient[self.bias_at()..][..self.outputs];
        for (bias, row) in bias.iter_mut().zip(by_output.values.chunks_exact(by_output.stride)) {
            *bias += sum(row);
        }
    }

    /// `out = W[:, first..first + count]^T G`.
    #[inline(always)]
    pub fn backward(&self, flat: &[f32], (first, count): (usize, usize), by_output: Matrix<'_>, out: &mut Vec<f32>) {
        out.resize(count * by_output.columns, 0.0);
        let weight = self.weight(flat).columns(first, count);
        multiply(Form::LeftTransposed, weight, by_output, out, by_output.columns, false);
    }
}

/// `x` where it is positive, `slope x` elsewhere.
#[inline(always)]
pub(super) fn leaky_relu(values: &mut [f32], slope: f32) {
    for value in values {
        let scaled = slope * *value;
        *value = if *value > scaled { *value } else { scaled };
    }
}

/// Multiplies derivatives by the activation's slope; an activation has the sign of its argument.
#[inline(always)]
pub(super) fn leaky_relu_backward(derivatives: &mut [f32], activations: &[f32], slope: f32) {
    for (derivative, &activation) in derivatives.iter_mut().zip(activations) {
        *derivative *= if activation > 0.0 { 1.0 } else { slope };
    }
}

/// The sum, in lanes.
#[inline(always)]
pub(super) fn sum(values: &[f32]) -> f32 {
    let mut lanes = [0.0; LANES];
    let (chunks, rest) = values.as_chunks::<LANES>();
    for chunk in chunks {
        for l in 0..LANES {
            lanes[l] += chunk[l];
        }
    }
    let mut total = 0.0;
    for lane in lanes {
        total += lane;
    }
    for value in rest {
        total += value;
    }
    total
}

/// The sum of products, in lanes.
#[inline(always)]
pub(super) fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut lanes = [0.0; LANES];
    let ((a_chunks, a_rest), (b_chunks, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a_chunks.iter().zip(b_chunks) {
        for l in 0..LANES {
            lanes[l] += a[l] * b[l];
        }
    }
    let mut total = 0.0;
    for lane in lanes {
        total += lane;
    }
    for (a, b) in a_rest.iter().zip(b_rest) {
        total += a * b;
    }
    total
}
