//! Native inference of an exported head warp h: Z -> Y.
//!
//! | file | concept |
//! | --- | --- |
//! | `condition.rs` | the layouts of condition vectors |
//! | `network.rs` | the network of a spline's logits |
//! | `inference.rs` | sampling and density over strips of samples |
//! | `flat.rs` | a head as arrays, for other devices |

mod condition;
mod flat;
mod inference;
mod network;

pub use crate::linear::Linear;
pub use condition::{Condition, MAX_CONDITION};
pub use inference::HeadAt;
use network::SplineNetwork;
pub use network::{MAX_BINS, MAX_HIDDEN};

use serde::{Deserialize, Serialize};

use crate::{
    error::{Error, Result},
    linear::Packed,
    spline::Topology,
};

/// The dependence of the two coupling layers on each other's coordinate; layer 0 transforms elevation,
/// layer 1 azimuth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// `z_v = F0(y_v; y_u, c)`, `z_u = F1(y_u; z_v, c)` (as in the paper).
    Coupled,
    /// `z_v = F0(y_v; c)`, `z_u = F1(y_u; y_v, c)`: layer 0 runs once per condition.
    Autoregressive,
}

/// Least mixture weight of either strategy in the mixture of head and BRDF sampling: sample
/// weights are at most 50 times those of the better strategy alone.
pub const MIXTURE_WEIGHT_FLOOR: f32 = 0.02;

/// The logit of a mixture weight, clamped to +-6.9: the inverse of `mixture_weight = 0.02 + 0.96 sigmoid(logit)`.
pub fn logit_of_mixture_weight(mixture_weight: f32) -> f32 {
    let inside = ((mixture_weight - MIXTURE_WEIGHT_FLOOR) / (1.0 - 2.0 * MIXTURE_WEIGHT_FLOOR)).clamp(1e-3, 1.0 - 1e-3);
    (inside / (1.0 - inside)).ln()
}

/// A head warp with its weights, ready to sample.
#[derive(Clone, Debug)]
pub struct Head {
    condition: Condition,
    mode: Mode,
    leaky_slope: f32,
    /// Empty, or layers with leaky ReLU after each; their output is appended to the condition.
    encoder: Layers,
    elevation: SplineNetwork,
    azimuth: SplineNetwork,
    /// Empty, or two layers whose output is the logit of the mixture weight against BRDF sampling.
    mixture_weight: Layers,
}

/// Layers in file order, and packed.
#[derive(Clone, Debug, Default)]
struct Layers {
    layers: Vec<Linear>,
    packed: Vec<Packed>,
}

impl Head {
    /// Makes a head of its networks.
    ///
    /// # Errors
    /// The sizes of the layers do not match, or exceed [`MAX_HIDDEN`] or [`MAX_BINS`].
    pub fn new(
        condition: Condition,
        mode: Mode,
        leaky_slope: f32,
        encoder: Vec<Linear>,
        [elevation, azimuth]: [Vec<Linear>; 2],
    ) -> Result<Self> {
        if !(0.0..=1.0).contains(&leaky_slope) {
            return Err(Error::argument("leaky_slope", format!("{leaky_slope} is not in 0..=1")));
        }
        let mut width = condition.length();
        for (index, layer) in encoder.iter().enumerate() {
            if layer.inputs() != width || layer.outputs() > MAX_HIDDEN {
                let reason = format!("takes {} and gives {} numbers, after {width}", layer.inputs(), layer.outputs());
                return Err(Error::argument(format!("encoder.linear{index}"), reason));
            }
            width = layer.outputs();
        }
        let seen = condition.length() + encoder.last().map_or(0, Linear::outputs);
        let features = if mode == Mode::Coupled { 2 } else { 0 };
        let elevation = SplineNetwork::new("layer0", Topology::Interval, seen, features, elevation)?;
        let azimuth = SplineNetwork::new("layer1", Topology::Circle, seen, 1, azimuth)?;
        let packed = encoder.iter().map(Packed::new).collect();
        let encoder = Layers { layers: encoder, packed };
        Ok(Self { condition, mode, leaky_slope, encoder, elevation, azimuth, mixture_weight: Layers::default() })
    }

    /// Adds the network of the learned mixture weight: two layers from the inputs of the spline
    /// networks to one logit, or none.
    ///
    /// # Errors
    /// The sizes of the layers do not match.
    pub fn with_mixture_weight(mut self, layers: Vec<Linear>) -> Result<Self> {
        let seen = self.condition.length() + self.encoder.layers.last().map_or(0, Linear::outputs);
        let fits = match &layers[..] {
            [] => true,
            [first, second] => {
                let hidden = first.outputs();
                first.inputs() == seen && hidden <= MAX_HIDDEN && second.inputs() == hidden && second.outputs() == 1
            }
            _ => false,
        };
        if !fits {
            return Err(Error::argument(
                "share (selection.linear)",
                format!("is not two layers from {seen} numbers to one"),
            ));
        }
        let packed = layers.iter().map(Packed::new).collect();
        self.mixture_weight = Layers { layers, packed };
        Ok(self)
    }

    /// Whether the head has a learned mixture weight against BRDF sampling.
    pub fn has_mixture_weight(&self) -> bool {
        !self.mixture_weight.layers.is_empty()
    }

    /// The layout of the condition.
    pub fn condition(&self) -> Condition {
        self.condition
    }

    /// The dependence between the coupling layers.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Slope of the leaky ReLU for negative arguments.
    pub fn leaky_slope(&self) -> f32 {
        self.leaky_slope
    }

    /// The layers by name, `encoder.linear0`, ..., `layer0.linear0`, ..., `layer1.linear0`, ...,
    /// `selection.linear0`, ... (the network of the mixture weight).
    pub fn layers(&self) -> Vec<(String, &Linear)> {
        let parts = [
            ("encoder", &self.encoder.layers[..]),
            ("layer0", self.elevation.layers()),
            ("layer1", self.azimuth.layers()),
            ("selection", &self.mixture_weight.layers[..]),
        ];
        let named = |(part, layers): (&'static str, _)| {
            <[Linear]>::iter(layers).enumerate().map(move |(index, layer)| (format!("{part}.linear{index}"), layer))
        };
        parts.into_iter().flat_map(named).collect()
    }
}
