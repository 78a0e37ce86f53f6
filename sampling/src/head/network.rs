//! The network of a spline's logits.

use crate::{
    error::{Error, Result},
    linear::{Linear, Packed, Start},
    simd::{Lanes, Simd},
    spline::Topology,
};

/// Maximum width of hidden layers.
pub const MAX_HIDDEN: usize = 256;

/// Maximum number of bins of a spline.
pub const MAX_BINS: usize = 64;

/// Maximum number of logits of a spline.
const MAX_LOGITS: usize = 3 * MAX_BINS + 1;

/// The network of one spline, with a leaky ReLU after every layer but the last. Inputs are the
/// condition, then the other coordinate's features; the first layer is packed in these two parts.
#[derive(Clone, Debug)]
pub struct SplineNetwork {
    pub(super) topology: Topology,
    layers: Vec<Linear>,
    pub(super) of_condition: Packed,
    of_features: Packed,
    later: Vec<Packed>,
}

impl SplineNetwork {
    /// Makes a network, and checks that the layers' sizes match and end in the logits of a spline.
    ///
    /// # Errors
    /// An error that names the layer of wrong size.
    pub fn new(name: &str, topology: Topology, condition: usize, features: usize, layers: Vec<Linear>) -> Result<Self> {
        let [first, .., _] = &layers[..] else {
            return Err(Error::argument(name, "needs at least one hidden layer and an output layer"));
        };
        let mut width = condition + features;
        for (index, layer) in layers.iter().enumerate() {
            let last = index + 1 == layers.len();
            let most = if last { MAX_LOGITS } else { MAX_HIDDEN };
            let (inputs, outputs) = (layer.inputs(), layer.outputs());
            if inputs != width || outputs > most {
                let reason = format!("is {outputs} x {inputs}; {width} inputs and at most {most} outputs are expected");
                return Err(Error::argument(format!("{name}.linear{index}.weight"), reason));
            }
            if last && !(outputs >= 7 && outputs % 3 == 1) {
                let reason = format!("{outputs} outputs are not 3 K + 1 logits with K at least 2");
                return Err(Error::argument(format!("{name}.linear{index}.weight"), reason));
            }
            width = outputs;
        }
        let (of_condition, of_features) = (Packed::part(first, 0, condition), Packed::part(first, condition, features));
        let later = layers[1..].iter().map(Packed::new).collect();
        Ok(Self { topology, of_condition, of_features, later, layers })
    }

    /// The layers, first to last.
    pub fn layers(&self) -> &[Linear] {
        &self.layers
    }

    /// Number of logits.
    pub(super) fn outputs(&self) -> usize {
        self.later.last().map_or(0, Packed::outputs)
    }

    /// Outputs of the widest layer.
    pub(super) fn widest(&self) -> usize {
        self.layers.iter().map(Linear::outputs).max().unwrap_or(0)
    }

    /// Computes the condition's part of the first hidden layer, before its activation.
    #[inline(always)]
    pub(super) fn prepare<S: Simd>(&self, simd: S, condition: &[Lanes], out: &mut [Lanes]) {
        self.of_condition.forward(simd, Start::Bias, condition, out, None);
    }

    /// Computes logits from the condition's part of the first layer and the other coordinate's features.
    #[inline(always)]
    pub(super) fn logits<S: Simd>(
        &self,
        simd: S,
        slope: f32,
        prepared: &[Lanes],
        features: &[Lanes],
        hidden: [&mut [Lanes]; 2],
        logits: &mut [Lanes],
    ) {
        let [mut from, mut to] = hidden;
        self.of_features.forward(simd, Start::Of(prepared), features, from, Some(slope));
        let (last, inner) = self.later.split_last().expect("a network has at least two layers");
        for layer in inner {
            layer.forward(simd, Start::Bias, from, to, Some(slope));
            std::mem::swap(&mut from, &mut to);
        }
        last.forward(simd, Start::Bias, from, logits, None);
    }
}
