//! Fully connected layers and the network that gives a spline its logits.

use super::{MAX_BINS, MAX_HIDDEN, Topology, spline::Spline};
use crate::error::{Error, Result};

/// Most logits of a spline.
pub(super) const MAX_LOGITS: usize = 3 * MAX_BINS + 1;

/// `y = W x + b`.
#[derive(Clone, Debug, PartialEq)]
pub struct Linear {
    inputs: usize,
    outputs: usize,
    /// `[inputs, outputs]`: the columns of W one after another, so that the sum over inputs runs over whole SIMD rows of outputs.
    columns: Vec<f32>,
    bias: Vec<f32>,
}

impl Linear {
    /// A layer of a row-major weight `[outputs, inputs]` and a bias `[outputs]` (PyTorch's order).
    ///
    /// # Errors
    /// The sizes do not fit, or a value is not finite.
    pub fn new(name: &str, inputs: usize, outputs: usize, weight: &[f32], bias: Vec<f32>) -> Result<Self> {
        if outputs == 0 || weight.len() != inputs * outputs || bias.len() != outputs {
            let reason = format!("{} weights and {} biases do not fit {outputs} x {inputs}", weight.len(), bias.len());
            return Err(Error::argument(name, reason));
        }
        if !weight.iter().chain(&bias).all(|value| value.is_finite()) {
            return Err(Error::argument(name, "holds a value that is not finite"));
        }
        let columns = (0..inputs * outputs).map(|k| weight[(k % outputs) * inputs + k / outputs]).collect();
        Ok(Self { inputs, outputs, columns, bias })
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
    pub fn weight(&self) -> Vec<f32> {
        let (inputs, outputs) = (self.inputs, self.outputs);
        (0..inputs * outputs).map(|k| self.columns[(k % inputs) * outputs + k / inputs]).collect()
    }

    /// The bias `[outputs]`.
    pub fn bias(&self) -> &[f32] {
        &self.bias
    }

    /// `out = W x + b`; `out` may be longer than the output.
    pub(super) fn forward(&self, x: &[f32], out: &mut [f32]) {
        let out = &mut out[..self.outputs];
        out.copy_from_slice(&self.bias);
        self.add_columns(0, x, out);
    }

    /// Adds the columns from `first` on, weighted by `x`, to `out`.
    #[inline]
    fn add_columns(&self, first: usize, x: &[f32], out: &mut [f32]) {
        let columns = &self.columns[first * self.outputs..][..x.len() * self.outputs];
        for (column, &x) in columns.chunks_exact(self.outputs).zip(x) {
            for (out, weight) in out.iter_mut().zip(column) {
                *out += weight * x;
            }
        }
    }
}

/// `x` where it is positive, `slope x` elsewhere.
pub(super) fn leaky_relu(x: &mut [f32], slope: f32) {
    for x in x {
        *x = x.max(slope * *x);
    }
}

/// The network of one spline: leaky ReLU after every layer but the last. Inputs are the condition, then the other coordinate's
/// features.
#[derive(Clone, Debug)]
pub struct SplineNetwork {
    topology: Topology,
    condition: usize,
    layers: Vec<Linear>,
}

impl SplineNetwork {
    /// Checks that layers follow each other and end in the logits of a spline.
    ///
    /// # Errors
    /// Names the layer that does not fit.
    pub fn new(name: &str, topology: Topology, condition: usize, features: usize, layers: Vec<Linear>) -> Result<Self> {
        if layers.len() < 2 {
            return Err(Error::argument(name, "needs at least one hidden layer and an output layer"));
        }
        let mut width = condition + features;
        for (index, layer) in layers.iter().enumerate() {
            let last = index + 1 == layers.len();
            let most = if last { MAX_LOGITS } else { MAX_HIDDEN };
            if layer.inputs != width || layer.outputs > most {
                let (inputs, outputs) = (layer.inputs, layer.outputs);
                let reason = format!("is {outputs} x {inputs}; {width} inputs and at most {most} outputs are expected");
                return Err(Error::argument(format!("{name}.linear{index}.weight"), reason));
            }
            if last && (outputs_to_bins(layer.outputs).is_none()) {
                let reason = format!("{} outputs are not 3 K + 1 logits with K at least 2", layer.outputs);
                return Err(Error::argument(format!("{name}.linear{index}.weight"), reason));
            }
            width = layer.outputs;
        }
        Ok(Self { topology, condition, layers })
    }

    /// The layers, first to last.
    pub fn layers(&self) -> &[Linear] {
        &self.layers
    }

    /// What the spline's two ends are to each other.
    pub(super) fn topology(&self) -> Topology {
        self.topology
    }

    /// Length of the first hidden layer.
    pub(super) fn first_outputs(&self) -> usize {
        self.layers[0].outputs
    }

    /// How many logits.
    pub(super) fn outputs(&self) -> usize {
        self.layers.last().expect("checked on construction").outputs
    }

    /// How many of the inputs are the condition.
    pub(super) fn condition(&self) -> usize {
        self.condition
    }

    /// The condition's part of the first hidden layer, before its activation.
    pub(super) fn prepare(&self, condition: &[f32], out: &mut [f32]) {
        let first = &self.layers[0];
        out[..first.outputs].copy_from_slice(&first.bias);
        first.add_columns(0, condition, &mut out[..first.outputs]);
    }

    /// The spline for the other coordinate's features.
    pub(super) fn spline(&self, prepared: &[f32; MAX_HIDDEN], features: &[f32], slope: f32) -> Spline {
        self.spline_of(&self.logits(prepared, features, slope))
    }

    /// The spline of logits, which may be followed by other numbers.
    pub(super) fn spline_of(&self, logits: &[f32]) -> Spline {
        Spline::new(self.topology, &logits[..self.outputs()])
    }

    /// The spline's logits for the other coordinate's features, then zeros.
    pub(super) fn logits(&self, prepared: &[f32; MAX_HIDDEN], features: &[f32], slope: f32) -> [f32; MAX_LOGITS] {
        let mut hidden = [0.0; MAX_HIDDEN];
        let mut next = [0.0; MAX_HIDDEN];
        let mut width = self.layers[0].outputs;
        hidden[..width].copy_from_slice(&prepared[..width]);
        self.layers[0].add_columns(self.condition, features, &mut hidden[..width]);
        leaky_relu(&mut hidden[..width], slope);
        let (last, inner) = self.layers[1..].split_last().expect("checked on construction");
        for layer in inner {
            layer.forward(&hidden[..width], &mut next);
            width = layer.outputs;
            leaky_relu(&mut next[..width], slope);
            std::mem::swap(&mut hidden, &mut next);
        }
        let mut logits = [0.0; MAX_LOGITS];
        last.forward(&hidden[..width], &mut logits);
        logits
    }
}

/// `K` where `outputs = 3 K + 1` and `K >= 2`.
fn outputs_to_bins(outputs: usize) -> Option<usize> {
    (outputs >= 7 && outputs % 3 == 1).then_some((outputs - 1) / 3)
}
