//! A head as flat arrays, for implementations on other devices.

use super::{Head, Mode};
use crate::{flat::FlatArray, spline::bin_count};

impl Head {
    /// The arrays that draws and pdfs read. Layers are in the order of [`Self::layers`]: encoder,
    /// networks of elevation, azimuth and mixture weight.
    ///
    /// - `head.layers` `[layers, 4]`: inputs, outputs, and the starts of weights and biases in
    ///   `head.weights`.
    /// - `head.weights` `[numbers]`: for each layer the weights `[blocks, inputs, 4]`, where a block is four
    ///   outputs, then the biases `[blocks, 4]`. Missing outputs of the last block are 0.
    /// - `head.shape` `[8]`: length of the condition ([`super::Condition::length`]); 1 for coupled layers, 0
    ///   for autoregressive ones; numbers of layers of the encoder and of the networks of elevation, azimuth
    ///   and mixture weight; bins of elevation, bins of azimuth.
    /// - `head.slope` `[1]`: slope of the leaky ReLU for negative arguments.
    pub fn flat(&self) -> Vec<FlatArray> {
        let (mut layers, mut weights) = (Vec::new(), Vec::new());
        for (_, layer) in self.layers() {
            let start = weights.len();
            let biases = layer.append_blocks(&mut weights);
            layers.extend([layer.inputs(), layer.outputs(), start, biases].map(|number| number as u32));
        }
        let [elevation, azimuth] = [&self.elevation, &self.azimuth];
        let shape = [
            self.condition.length(),
            usize::from(self.mode == Mode::Coupled),
            self.encoder.layers.len(),
            elevation.layers().len(),
            azimuth.layers().len(),
            self.mixture_weight.layers.len(),
            bin_count(elevation.outputs()),
            bin_count(azimuth.outputs()),
        ];
        vec![
            FlatArray::integers("head.layers", vec![layers.len() / 4, 4], layers),
            FlatArray::floats("head.weights", vec![weights.len()], weights),
            FlatArray::integers("head.shape", vec![shape.len()], shape.map(|number| number as u32).to_vec()),
            FlatArray::floats("head.slope", vec![1], vec![self.leaky_slope]),
        ]
    }
}
