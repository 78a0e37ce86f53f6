//! Offsets of the layers of a head and of a flow in their flat lists of weights.

use headtail_model::{EncoderConfig, FlowConfig, HeadConfig, Mode, coupling::Coordinate, head::MIXTURE_WEIGHT_HIDDEN};

use super::perceptron::Layer;

/// Offsets of the layers in the flat list of weights, see [`Head::flat_weights`](headtail_model::Head::flat_weights).
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    pub config: HeadConfig,
    pub encoder: Vec<Layer>,
    pub elevation: Vec<Layer>,
    pub azimuth: Vec<Layer>,
    pub mixture_weight: Vec<Layer>,
    pub length: usize,
}

impl Layout {
    pub fn new(config: HeadConfig) -> Self {
        let mut length = 0;
        let mut layers = |sizes: &[usize]| -> Vec<Layer> {
            let layer = |pair: &[usize]| {
                let layer = Layer { inputs: pair[0], outputs: pair[1], start: length };
                length += layer.length();
                layer
            };
            sizes.windows(2).map(layer).collect()
        };
        let condition = config.condition.length();
        let encoder = config.encoder.map(|EncoderConfig { hidden, output }| layers(&[condition, hidden, output]));
        let seen = config.network_condition();
        let mut network = |features: usize| {
            let hidden = std::iter::repeat_n(config.hidden, config.hidden_layers);
            layers(&std::iter::once(seen + features).chain(hidden).chain([config.logits()]).collect::<Vec<_>>())
        };
        let elevation = network(if config.mode == Mode::Coupled { 2 } else { 0 });
        let azimuth = network(1);
        let mixture_weight = if config.share { layers(&[seen, MIXTURE_WEIGHT_HIDDEN, 1]) } else { Vec::new() };
        Self { config, encoder: encoder.unwrap_or_default(), elevation, azimuth, mixture_weight, length }
    }
}

/// Offsets of the layers in the flat list of weights, see [`Flow::flat_weights`](headtail_model::Flow::flat_weights).
#[derive(Clone, Debug)]
pub(crate) struct FlowLayout {
    pub config: FlowConfig,
    /// The layers of each coupling's network: the first, two of each residual block, the last.
    pub networks: Vec<Vec<Layer>>,
    pub length: usize,
}

impl FlowLayout {
    pub fn new(config: FlowConfig) -> Self {
        let mut length = 0;
        let mut layer = |inputs: usize, outputs: usize| {
            let layer = Layer { inputs, outputs, start: length };
            length += layer.length();
            layer
        };
        let networks: Vec<Vec<Layer>> = (0..config.couplings)
            .map(|coupling| {
                let mut layers = vec![layer(config.features(config.target(coupling)), config.hidden)];
                layers.extend((0..2 * config.residual_blocks).map(|_| layer(config.hidden, config.hidden)));
                layers.push(layer(config.hidden, config.logits()));
                layers
            })
            .collect();
        Self { config, networks, length }
    }

    /// Returns the place of the coordinate that a coupling transforms.
    pub fn own_coordinate(&self, coupling: usize) -> usize {
        match self.config.target(coupling) {
            Coordinate::Azimuth => 0,
            Coordinate::Elevation => 1,
        }
    }
}
