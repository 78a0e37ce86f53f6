//! Small networks in SIMD lanes: those of neural materials, and of samplers trained for a material.

use crate::{
    error::{Error, Result},
    linear::{Linear, Packed, Start},
    simd::{LANES, Lanes, Simd},
};

/// The widest layer of a neural material's networks.
pub(super) const WIDEST: usize = 32;

/// Layers with a leaky ReLU after all but the last.
#[derive(Clone, Debug)]
pub(crate) struct Network {
    layers: Vec<Linear>,
    packed: Vec<Packed>,
    leaky_slope: f32,
}

impl Network {
    /// Makes a network, and checks its sizes, from input to output.
    pub fn new(name: &str, sizes: &[usize], layers: Vec<Linear>, leaky_slope: f32) -> Result<Self> {
        if layers.len() + 1 != sizes.len() {
            let reason = format!("has {} layers instead of {}", layers.len(), sizes.len() - 1);
            return Err(Error::argument(name, reason));
        }
        for (index, (layer, size)) in layers.iter().zip(sizes.windows(2)).enumerate() {
            let found = [layer.inputs(), layer.outputs()];
            if found != size {
                let reason = format!("is {} x {} instead of {} x {}", found[1], found[0], size[1], size[0]);
                return Err(Error::argument(format!("{name}.linear{index}.weight"), reason));
            }
        }
        if !(0.0..=1.0).contains(&leaky_slope) {
            return Err(Error::argument("leaky_slope", format!("{leaky_slope} is not in 0..=1")));
        }
        let packed = layers.iter().map(Packed::new).collect();
        Ok(Self { layers, packed, leaky_slope })
    }

    /// The layers, first to last.
    pub fn layers(&self) -> &[Linear] {
        &self.layers
    }

    /// Slope of the leaky ReLU.
    pub fn leaky_slope(&self) -> f32 {
        self.leaky_slope
    }

    /// Evaluates one strip of inputs. The outputs are the first entries of `out`, which is as wide as
    /// the widest layer.
    #[inline(always)]
    pub fn forward<S: Simd, const W: usize>(&self, simd: S, input: &[Lanes], out: &mut [Lanes; W]) {
        let mut other = [[0.0; LANES]; W];
        let last = self.packed.len() - 1;
        self.packed[0].forward(simd, Start::Bias, input, out, (last > 0).then_some(self.leaky_slope));
        for (index, layer) in self.packed.iter().enumerate().skip(1) {
            std::mem::swap(out, &mut other);
            layer.forward(simd, Start::Bias, &other, out, (index < last).then_some(self.leaky_slope));
        }
    }

    /// Evaluates one point.
    pub fn of_one(&self, input: &[f32], out: &mut [f32]) {
        let (mut x, mut y) = ([0.0; WIDEST], [0.0; WIDEST]);
        x[..input.len()].copy_from_slice(input);
        for (index, layer) in self.layers.iter().enumerate() {
            let rows = layer.weight().chunks_exact(layer.inputs()).zip(layer.bias());
            for (y, (row, bias)) in y.iter_mut().zip(rows) {
                let sum = row.iter().zip(&x).map(|(w, x)| w * x).sum::<f32>() + bias;
                *y = if index + 1 == self.layers.len() { sum } else { sum.max(self.leaky_slope * sum) };
            }
            std::mem::swap(&mut x, &mut y);
        }
        out.copy_from_slice(&x[..out.len()]);
    }
}
