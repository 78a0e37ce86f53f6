//! The flow tail: a large unconditional spline flow between the intermediate square Y and the lat-long map X
//! (section 4.1 of the paper).

mod config;
mod network;

use std::f64::consts::PI;

use burn::{
    module::Module,
    optim::GradientsParams,
    prelude::{Device, Tensor},
};

pub use config::{FlowConfig, FlowForm};
use network::ResidualNetwork;

use crate::{
    Result,
    coupling::Coordinate,
    linear::{self, Initializer},
    spline,
};

/// A flow tail. The density direction x -> y is closed form and runs the coupling layers in order.
#[derive(Module, Debug)]
pub struct Flow {
    networks: Vec<ResidualNetwork>,
    #[module(skip)]
    config: FlowConfig,
}

impl Flow {
    /// Returns a flow that is the identity, equal on every backend.
    ///
    /// # Errors
    /// If the configuration is out of range.
    pub fn new(config: FlowConfig, seed: u64, device: &Device) -> Result<Self> {
        config.validate()?;
        let mut initializer = Initializer::new(seed);
        let mut network = |coupling| {
            let inputs = config.features(config.target(coupling));
            ResidualNetwork::new(inputs, &config, &mut initializer, device)
        };
        Ok(Self { networks: (0..config.couplings).map(&mut network).collect(), config })
    }

    /// Returns the flow's shape.
    pub fn config(&self) -> &FlowConfig {
        &self.config
    }

    /// Maps `x -> (y, ln |dy/dx|)`, the density direction: `[samples, 2]` to `[samples, 2]` and `[samples]`.
    pub fn inverse(&self, x: &Tensor<2>) -> (Tensor<2>, Tensor<1>) {
        let [samples, _] = x.dims();
        let column = |index: usize| x.clone().narrow(1, index, 1).reshape([1, samples]);
        let (mut u, mut v) = (column(0), column(1));
        let mut log = Tensor::<2>::zeros([1, samples], &x.device());
        for (coupling, network) in self.networks.iter().enumerate() {
            let target = self.config.target(coupling);
            let (own, other) = match target {
                Coordinate::Elevation => (&mut v, &u),
                Coordinate::Azimuth => (&mut u, &v),
            };
            let mut other = other.clone().reshape([samples]);
            if !self.config.sees_other(target) {
                other = other.zeros_like();
            }
            let seen = features(target, &other, self.config.octaves);
            let logits = network.forward(seen).unsqueeze_dim::<3>(0);
            let (moved, log_slope) = spline::inverse(target.topology(), own.clone(), &logits);
            *own = moved;
            log = log + log_slope;
        }
        (Tensor::cat(vec![u.reshape([samples, 1]), v.reshape([samples, 1])], 1), log.reshape([samples]))
    }

    /// Returns the number of weights.
    pub fn weight_count(&self) -> usize {
        linear::count(self.linears())
    }

    /// Returns all weights in one list: per network the first layer, the two layers of each block, the last
    /// layer; per layer a row-major `[out, in]` weight, then a bias.
    pub fn flat_weights(&self) -> Vec<f32> {
        linear::flat_weights(self.linears())
    }

    /// Returns a flow of the same shape with other weights, on `device`.
    ///
    /// # Panics
    /// If `flat` does not have [`weight_count`](Self::weight_count) numbers.
    #[must_use]
    pub fn with_flat_weights(mut self, flat: &[f32], device: &Device) -> Self {
        linear::set_flat(self.networks.iter_mut().flat_map(ResidualNetwork::linears_mut), flat, device);
        self
    }

    /// Returns the gradients in the order of [`flat_weights`](Self::flat_weights).
    pub fn flat_gradients(&self, gradients: &GradientsParams) -> Vec<f32> {
        linear::flat_gradients(self.linears(), gradients)
    }

    fn linears(&self) -> impl Iterator<Item = &burn::nn::Linear> {
        self.networks.iter().flat_map(ResidualNetwork::linears)
    }
}

/// Returns the features `[samples, features]` of the coordinate other than `target`. Azimuth: the cosines,
/// then the sines, of `2 pi 2^k u`. Elevation: `2 v - 1`, then the cosines of `pi 2^k v` for `k >= 1`.
fn features(target: Coordinate, other: &Tensor<1>, octaves: usize) -> Tensor<2> {
    let scaled = |factor: f64, k: usize| other.clone().mul_scalar(factor * f64::from(1 << k)).unsqueeze_dim::<2>(1);
    let columns: Vec<Tensor<2>> = match target {
        Coordinate::Elevation => {
            let angles = (0..octaves).map(|k| scaled(2.0 * PI, k));
            let cosines = angles.clone().map(Tensor::cos);
            cosines.chain(angles.map(Tensor::sin)).collect()
        }
        Coordinate::Azimuth => {
            let plain = scaled(2.0, 0).sub_scalar(1.0);
            std::iter::once(plain).chain((1..octaves).map(|k| scaled(PI, k).cos())).collect()
        }
    };
    Tensor::cat(columns, 1)
}

#[cfg(test)]
mod tests {
    use burn::prelude::TensorData;

    use super::*;

    fn points(count: usize, device: &Device) -> Tensor<2> {
        let values: Vec<f32> = (0..2 * count).map(|k| (k * 7919 % 1009) as f32 / 1009.0).collect();
        Tensor::from_data(TensorData::new(values, [count, 2]), device)
    }

    #[test]
    fn a_new_flow_is_the_identity() {
        let device = crate::host();
        let flow = Flow::new(FlowConfig { couplings: 3, ..FlowConfig::SMALL }, 1, &device).unwrap();
        let x = points(50, &device);
        let (y, log) = flow.inverse(&x);
        let apart = (y - x).abs().max().into_scalar::<f32>();
        assert!(apart < 1e-5 && log.abs().max().into_scalar::<f32>() < 1e-5, "{apart}");
    }

    #[test]
    fn flat_weights_round_trip() {
        let device = crate::host();
        let flow = Flow::new(FlowConfig { couplings: 2, hidden: 8, ..FlowConfig::SMALL }, 1, &device).unwrap();
        let weights: Vec<f32> = (0..flow.weight_count()).map(|k| (k % 17) as f32 / 17.0 - 0.5).collect();
        assert_eq!(flow.with_flat_weights(&weights, &device).flat_weights(), weights);
    }

    #[test]
    fn the_papers_flow_has_the_documented_weight_count() {
        // 16 networks: first layer 3 x 256 or 2 x 256, four of 257 x 256, last 257 x 385.
        let expected = 8 * (3 + 2) * 256 + 16 * (4 * 257 * 256 + 257 * 385);
        let flow = Flow::new(FlowConfig::PAPER, 0, &crate::host()).unwrap();
        assert_eq!(flow.weight_count(), expected);
        assert_eq!(expected, 5_804_048);
    }

    #[test]
    fn sizes_out_of_range_are_rejected_by_name() {
        let device = crate::host();
        for (config, field) in [
            (FlowConfig { bins: 1, ..FlowConfig::SMALL }, "flow.shape.bins"),
            (FlowConfig { octaves: 0, ..FlowConfig::SMALL }, "flow.shape.octaves"),
            (FlowConfig { leaky_slope: f32::NAN, ..FlowConfig::SMALL }, "flow.shape.leaky_slope"),
        ] {
            assert!(Flow::new(config, 0, &device).unwrap_err().to_string().contains(field));
        }
    }
}
