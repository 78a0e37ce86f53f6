//! Layers of perceptrons over matrices `[features, columns]`, forward and backward; weights in one flat list.

use headtail_render::simd::LANES;

use super::matrix::{Form, Matrix, multiply};

/// Offset of an affine layer in the flat list: `[out, in]` weight, then bias.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Layer {
    pub inputs: usize,
    pub outputs: usize,
    pub start: usize,
}

impl Layer {
    /// Returns the number of values.
    pub fn length(&self) -> usize {
        self.outputs * (self.inputs + 1)
    }

    #[inline(always)]
    pub fn weight<'a>(&self, flat: &'a [f32]) -> Matrix<'a> {
        Matrix::new(&flat[self.start..][..self.outputs * self.inputs], self.outputs, self.inputs)
    }

    /// Returns the weights from input `input` for output `output` onwards.
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

    /// Computes `out = W[:, ..x.rows] x + b`.
    #[inline(always)]
    pub fn forward(&self, flat: &[f32], x: Matrix<'_>, out: &mut Vec<f32>) {
        out.clear();
        for &bias in self.bias(flat) {
            out.resize(out.len() + x.columns, bias);
        }
        multiply(Form::Plain, self.weight(flat).columns(0, x.rows), x, out, x.columns, true);
    }

    /// Adds `G x^T` to the gradient of the first `x.rows` columns of the weight, and the row sums of `G` to
    /// that of the bias.
    #[inline(always)]
    pub fn add_gradient(&self, d_output: Matrix<'_>, x: Matrix<'_>, gradient: &mut [f32]) {
        multiply(Form::RightTransposed, d_output, x, &mut gradient[self.start..], self.inputs, true);
        let bias = &mut gradient[self.bias_at()..][..self.outputs];
        for (bias, row) in bias.iter_mut().zip(d_output.values.chunks_exact(d_output.stride)) {
            *bias += sum(row);
        }
    }

    /// Computes `out = W^T G`.
    #[inline(always)]
    pub fn backward(&self, flat: &[f32], d_output: Matrix<'_>, out: &mut Vec<f32>) {
        out.resize(self.inputs * d_output.columns, 0.0);
        multiply(Form::LeftTransposed, self.weight(flat), d_output, out, d_output.columns, false);
    }
}

/// The hidden layers of a perceptron over some columns: leaky ReLU after every layer but the last.
#[derive(Default)]
pub(crate) struct Hidden(Vec<Vec<f32>>);

/// Buffers of the backward pass.
#[derive(Default)]
pub(crate) struct BackwardScratch {
    /// Derivatives with respect to the first layer's output before its activation.
    pub d_hidden: Vec<f32>,
    d_activation: Vec<f32>,
}

impl Hidden {
    /// Returns the first layer's output, to be filled before [`forward`](Self::forward).
    #[inline(always)]
    pub fn first(&mut self, layers: &[Layer]) -> &mut Vec<f32> {
        self.0.resize(layers.len() - 1, Vec::new());
        &mut self.0[0]
    }

    /// Computes the last layer's output from the first layer's.
    #[inline(always)]
    pub fn forward(&mut self, layers: &[Layer], flat: &[f32], slope: f32, columns: usize, out: &mut Vec<f32>) {
        leaky_relu(&mut self.0[0], slope);
        for (index, layer) in layers.iter().enumerate().skip(1) {
            let (before, after) = self.0.split_at_mut(index);
            let x = Matrix::new(&before[index - 1], layer.inputs, columns);
            match after.first_mut() {
                Some(after) => {
                    layer.forward(flat, x, after);
                    leaky_relu(after, slope);
                }
                None => layer.forward(flat, x, out),
            }
        }
    }

    /// Propagates derivatives from the last layer's output to the first layer's; adds those of the weights in
    /// between.
    #[inline(always)]
    pub fn backward(
        &self,
        layers: &[Layer],
        flat: &[f32],
        slope: f32,
        d_output: Matrix<'_>,
        scratch: &mut BackwardScratch,
        gradient: &mut [f32],
    ) {
        let columns = d_output.columns;
        for (index, layer) in layers.iter().enumerate().skip(1).rev() {
            let hidden = &self.0[index - 1];
            let last = index + 1 == layers.len();
            let d_output = if last { d_output } else { Matrix::new(&scratch.d_hidden, layer.outputs, columns) };
            layer.add_gradient(d_output, Matrix::new(hidden, layer.inputs, columns), gradient);
            layer.backward(flat, d_output, &mut scratch.d_activation);
            leaky_relu_backward(&scratch.d_activation, hidden, slope, &mut scratch.d_hidden);
        }
    }
}

/// Applies `x` where positive, `slope x` elsewhere.
#[inline(always)]
pub(super) fn leaky_relu(values: &mut [f32], slope: f32) {
    for value in values {
        // `max` avoids a conditional write.
        *value = value.max(slope * *value);
    }
}

/// Multiplies derivatives by the activation's slope; an activation has the sign of its argument.
///
/// Writes to another buffer: in place, a factor of 1 would become a conditional write, which is slow on many
/// CPUs.
#[inline(always)]
pub(super) fn leaky_relu_backward(derivatives: &[f32], activations: &[f32], slope: f32, out: &mut Vec<f32>) {
    out.resize(activations.len(), 0.0);
    for ((out, derivative), &activation) in out.iter_mut().zip(derivatives).zip(activations) {
        *out = derivative * if activation > 0.0 { 1.0 } else { slope };
    }
}

/// Returns the sum, in lanes.
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

/// Returns the dot product, in lanes.
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
