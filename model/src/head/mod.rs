//! The head warp `h: Z -> Y` under a condition: encoder, two coupling layers, and the learned mixture weight.
//!
//! | file | concept |
//! | --- | --- |
//! | `config.rs` | the shape of a head |
//! | `mixture_weight.rs` | the network of the learned mixture weight |
//! | `flat.rs` | weights and gradients as one list |

mod config;
mod flat;
mod mixture_weight;
#[cfg(test)]
mod tests;

use burn::{
    module::Module,
    nn::Linear,
    prelude::{Device, Tensor},
};

pub use config::{EncoderConfig, HeadConfig};
use headtail_render::head::Mode;
pub use mixture_weight::{
    MIXTURE_WEIGHT_FLOOR, MIXTURE_WEIGHT_HIDDEN, MixtureWeightNetwork, mixture_weight_of_logit,
    mixture_weight_of_logits,
};

use crate::{
    Error, NamedTensor, Result,
    coupling::{Coordinate, Coupling},
    linear::{self, Initializer},
    spline_network::SplineNetworkShape,
};

/// Names of the networks in exported files.
const PARTS: [&str; 4] = ["encoder", "layer0", "layer1", "selection"];

/// The head warp and its learned mixture weight beside BRDF sampling.
///
/// Points are grouped by condition: `y` is `[conditions, samples, 2]` and `c` is `[conditions, length]`, so
/// that terms that depend only on the condition are computed once. `samples` is 1 for one condition per
/// point.
#[derive(Module, Debug)]
pub struct Head {
    /// Empty, or the encoder's two layers.
    encoder: Vec<Linear>,
    layers: Vec<Coupling>,
    /// Empty, or one network.
    mixture_weight: Vec<MixtureWeightNetwork>,
    #[module(skip)]
    config: HeadConfig,
}

impl Head {
    /// Returns a head that is the identity: random weights, zero last layers. Equal on every backend.
    ///
    /// Training requires an autodiff device.
    ///
    /// # Errors
    /// [`Error::Config`] if the configuration is out of range.
    pub fn new(config: HeadConfig, seed: u64, device: &Device) -> Result<Self> {
        config.validate()?;
        let mut initializer = Initializer::new(seed);
        let encoder = config.encoder.map_or_else(Vec::new, |encoder| {
            vec![
                initializer.linear(config.condition.length(), encoder.hidden, device),
                initializer.linear(encoder.hidden, encoder.output, device),
            ]
        });
        let shape = SplineNetworkShape {
            condition: config.network_condition(),
            features: 0,
            hidden: config.hidden,
            hidden_layers: config.hidden_layers,
            outputs: config.logits(),
        };
        let first_sees = match config.mode {
            Mode::Coupled => Some(Coordinate::Azimuth),
            Mode::Autoregressive => None,
        };
        let slope = f64::from(config.leaky_slope);
        let mut layer = |target, other| Coupling::new(target, other, shape, slope, &mut initializer, device);
        let layers =
            vec![layer(Coordinate::Elevation, first_sees), layer(Coordinate::Azimuth, Some(Coordinate::Elevation))];
        let mixture_weight = if config.share {
            vec![MixtureWeightNetwork::new(config.network_condition(), slope, &mut initializer, device)]
        } else {
            Vec::new()
        };
        Ok(Self { encoder, layers, mixture_weight, config })
    }

    /// Returns the head's shape.
    pub fn config(&self) -> &HeadConfig {
        &self.config
    }

    /// Returns `ln q(y|c)` per unit area of Y, `[conditions, samples]`.
    pub fn log_density(&self, y: &Tensor<3>, c: Tensor<2>) -> Tensor<2> {
        self.inverse(y, c).1
    }

    /// Maps `y -> (z, ln |dz/dy|)`, the density direction, in closed form: `[conditions, samples, 2]` and
    /// `[conditions, samples]`.
    pub fn inverse(&self, y: &Tensor<3>, c: Tensor<2>) -> (Tensor<3>, Tensor<2>) {
        let condition = self.encode(c);
        let [u, v] = split(y);
        let (z_v, log_v) = self.layers[0].inverse(v.clone(), &u, condition.clone());
        let seen = match self.config.mode {
            Mode::Coupled => &z_v,
            Mode::Autoregressive => &v,
        };
        let (z_u, log_u) = self.layers[1].inverse(u, seen, condition);
        (join(z_u, z_v), log_v + log_u)
    }

    /// Samples: maps uniform `z` (`[conditions, samples, 2]`) to `y` and `ln q(y|c)` per unit area of Y.
    pub fn sample(&self, z: &Tensor<3>, c: Tensor<2>) -> (Tensor<3>, Tensor<2>) {
        let condition = self.encode(c);
        let [z_u, z_v] = split(z);
        match self.config.mode {
            Mode::Coupled => {
                let (u, log_u) = self.layers[1].forward(z_u, &z_v, condition.clone());
                let (v, log_v) = self.layers[0].forward(z_v, &u, condition);
                (join(u, v), log_v + log_u)
            }
            Mode::Autoregressive => {
                let (v, log_v) = self.layers[0].forward(z_v, &z_u, condition.clone());
                let (u, log_u) = self.layers[1].forward(z_u, &v, condition);
                (join(u, v), log_v + log_u)
            }
        }
    }

    /// Returns logits `[conditions, 1]` of the probability of drawing from the head rather than from the
    /// BRDF, for [`mixture_weight_of_logit`]; `None` without [`HeadConfig::share`].
    pub fn mixture_weight_logits(&self, c: Tensor<2>) -> Option<Tensor<2>> {
        let [network] = self.mixture_weight.as_slice() else { return None };
        Some(network.logits(self.encode(c)))
    }

    /// Returns all weights, row-major `[out, in]`, in the order in which they are drawn:
    /// `encoder.linear{0,1}.{weight,bias}` (with an encoder),
    /// `layer0.linear{0..=hidden_layers}.{weight,bias}` (elevation), then `layer1` (azimuth), then
    /// `selection.linear{0,1}` (with a learned mixture weight).
    ///
    /// Inputs of a layer's `linear0` are, in order: the condition `c`, the encoder's output, and the other
    /// coordinate's features (`cos 2 pi u`, `sin 2 pi u`, or `v`).
    pub fn weights(&self) -> Vec<NamedTensor> {
        let mut weights = Vec::new();
        for (part, layers) in self.parts() {
            linear::export(layers, part, &mut weights);
        }
        weights
    }

    /// Builds a head from [`weights`](Self::weights), in any order.
    ///
    /// # Errors
    /// If the configuration is out of range, a weight is missing, unknown, of the wrong shape or not finite.
    pub fn from_weights(config: HeadConfig, mut weights: Vec<NamedTensor>, device: &Device) -> Result<Self> {
        let mut head = Self::new(config, 0, device)?;
        for (part, layers) in head.parts_mut() {
            *layers = linear::import(layers, part, &mut weights, device)?;
        }
        match weights.pop() {
            Some(weight) => Err(Error::UnknownWeight(weight.name)),
            None => Ok(head),
        }
    }

    /// Iterates over the networks with their names in exported files, in the order in which they are drawn.
    fn parts(&self) -> impl Iterator<Item = (&'static str, &[Linear])> {
        let layers = self.layers.iter().map(|layer| layer.network().linears());
        let networks = layers.chain(self.mixture_weight.iter().map(MixtureWeightNetwork::linears));
        PARTS.into_iter().zip(std::iter::once(&self.encoder[..]).chain(networks))
    }

    fn parts_mut(&mut self) -> impl Iterator<Item = (&'static str, &mut Vec<Linear>)> {
        let layers = self.layers.iter_mut().map(|layer| layer.network_mut().linears_mut());
        let networks = layers.chain(self.mixture_weight.iter_mut().map(MixtureWeightNetwork::linears_mut));
        PARTS.into_iter().zip(std::iter::once(&mut self.encoder).chain(networks))
    }

    /// Returns the spline networks' condition: `c`, followed by the encoder's output.
    fn encode(&self, c: Tensor<2>) -> Tensor<2> {
        let slope = f64::from(self.config.leaky_slope);
        let activate = |x: Tensor<2>, layer: &Linear| linear::leaky_relu(layer.forward(x), slope);
        match self.encoder.as_slice() {
            [] => c,
            layers => {
                let latent = layers.iter().fold(c.clone(), activate);
                Tensor::cat(vec![c, latent], 1)
            }
        }
    }
}

/// Splits `[conditions, samples, 2]` into the coordinates `(u, v)`.
fn split(points: &Tensor<3>) -> [Tensor<2>; 2] {
    let [conditions, samples, _] = points.dims();
    let column = |index: usize| points.clone().narrow(2, index, 1).reshape([conditions, samples]);
    [column(0), column(1)]
}

fn join(u: Tensor<2>, v: Tensor<2>) -> Tensor<3> {
    Tensor::stack(vec![u, v], 2)
}
