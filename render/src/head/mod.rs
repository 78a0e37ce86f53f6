//! Native inference of an exported head warp h: Z -> Y, one point at a time.

mod condition;
mod network;
mod spline;

pub use condition::{Condition, MAX_CONDITION};
pub use network::{Linear, SplineNetwork};
pub use spline::{Spline, Topology};

use std::f32::consts::TAU;

use glam::{Vec2, Vec3A};
use serde::{Deserialize, Serialize};

use crate::{
    error::{Error, Result},
    sampler::{IntermediateDensity, ShadingPoint},
};

/// Widest hidden layer: activations live on the stack.
pub const MAX_HIDDEN: usize = 256;
/// Most bins of a spline.
pub const MAX_BINS: usize = 64;

/// How the two coupling layers see each other's coordinate; layer 0 transforms elevation, layer 1 azimuth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// `z_v = F0(y_v; y_u, c)`, `z_u = F1(y_u; z_v, c)` (the paper's).
    Coupled,
    /// `z_v = F0(y_v; c)`, `z_u = F1(y_u; y_v, c)`: layer 0 runs once per condition.
    Autoregressive,
}

/// Least probability of either strategy in the mixture of head and BRDF sampling.
const SELECTION_FLOOR: f32 = 0.02;

/// A head warp with its weights, ready to sample.
#[derive(Clone, Debug)]
pub struct Head {
    condition: Condition,
    mode: Mode,
    leaky_slope: f32,
    /// Empty, or layers with leaky ReLU after each; their output joins the condition.
    encoder: Vec<Linear>,
    elevation: SplineNetwork,
    azimuth: SplineNetwork,
    /// Empty, or two layers that end in the logit of the share of samples that the head gives beside BRDF sampling.
    selection: Vec<Linear>,
}

/// What the head computes once per condition.
#[derive(Clone, Debug)]
pub struct PreparedHead {
    /// The condition's part of the first hidden layer of the elevation network.
    elevation: [f32; MAX_HIDDEN],
    /// The same of the azimuth network.
    azimuth: [f32; MAX_HIDDEN],
    /// The elevation spline, where it depends on the condition alone.
    elevation_spline: Option<Spline>,
    /// Share of samples that the head gives in a mixture with BRDF sampling.
    share_beside_brdf: f32,
}

impl Head {
    /// Puts a head together from its networks.
    ///
    /// # Errors
    /// The sizes of the layers do not fit each other, or are above [`MAX_HIDDEN`] or [`MAX_BINS`].
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
        Ok(Self { condition, mode, leaky_slope, encoder, elevation, azimuth, selection: Vec::new() })
    }

    /// Adds the network of the learned selection probability: two layers from what the spline networks see to one logit, or none.
    ///
    /// # Errors
    /// The layers do not fit.
    pub fn with_selection(mut self, selection: Vec<Linear>) -> Result<Self> {
        let seen = self.condition.length() + self.encoder.last().map_or(0, Linear::outputs);
        let fits = match &selection[..] {
            [] => true,
            [first, second] => {
                let hidden = first.outputs();
                first.inputs() == seen && hidden <= MAX_HIDDEN && second.inputs() == hidden && second.outputs() == 1
            }
            _ => false,
        };
        if !fits {
            return Err(Error::argument("selection", format!("is not two layers from {seen} numbers to one")));
        }
        self.selection = selection;
        Ok(self)
    }

    /// Whether the head has learned how often to draw from BRDF sampling instead.
    pub fn has_selection(&self) -> bool {
        !self.selection.is_empty()
    }

    /// What the head is conditioned on.
    pub fn condition(&self) -> Condition {
        self.condition
    }

    /// How the layers are joined.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Slope of the leaky ReLU for negative arguments.
    pub fn leaky_slope(&self) -> f32 {
        self.leaky_slope
    }

    /// The layers by name, `encoder.linear0`, ..., `layer0.linear0`, ..., `layer1.linear0`, ...,
    /// `selection.linear0`, ...
    pub fn layers(&self) -> Vec<(String, &Linear)> {
        let parts = [
            ("encoder", &self.encoder[..]),
            ("layer0", self.elevation.layers()),
            ("layer1", self.azimuth.layers()),
            ("selection", &self.selection[..]),
        ];
        let named = |(part, layers): (&'static str, _)| {
            <[Linear]>::iter(layers).enumerate().map(move |(index, layer)| (format!("{part}.linear{index}"), layer))
        };
        parts.into_iter().flat_map(named).collect()
    }

    /// Prepares a head that is conditioned on the normal alone for a unit normal.
    ///
    /// # Panics
    /// If the head's condition is another.
    pub fn prepare_normal(&self, normal: Vec3A) -> PreparedHead {
        assert_eq!(self.condition, Condition::Normal, "the head is conditioned on the normal");
        self.prepare_condition(&normal.to_array())
    }

    /// Prepares the head for a condition vector of [`Condition::length`] numbers.
    pub fn prepare_condition(&self, condition: &[f32]) -> PreparedHead {
        let mut seen = [0.0; 2 * MAX_HIDDEN];
        seen[..condition.len()].copy_from_slice(condition);
        let mut length = condition.len();
        if !self.encoder.is_empty() {
            let mut latent = [0.0; MAX_HIDDEN];
            let mut width = condition.len();
            latent[..width].copy_from_slice(condition);
            for layer in &self.encoder {
                let input = latent;
                layer.forward(&input[..width], &mut latent);
                width = layer.outputs();
                network::leaky_relu(&mut latent[..width], self.leaky_slope);
            }
            seen[length..length + width].copy_from_slice(&latent[..width]);
            length += width;
        }
        let mut prepared = PreparedHead {
            elevation: [0.0; MAX_HIDDEN],
            azimuth: [0.0; MAX_HIDDEN],
            elevation_spline: None,
            share_beside_brdf: self.share_beside_brdf(&seen[..length]),
        };
        self.elevation.prepare(&seen[..length], &mut prepared.elevation);
        self.azimuth.prepare(&seen[..length], &mut prepared.azimuth);
        if self.mode == Mode::Autoregressive {
            prepared.elevation_spline = Some(self.elevation.spline(&prepared.elevation, &[], self.leaky_slope));
        }
        prepared
    }

    /// `0.02 + 0.96 sigmoid(logit)`; 1/2 where nothing was learned.
    fn share_beside_brdf(&self, seen: &[f32]) -> f32 {
        let [first, second] = &self.selection[..] else { return 0.5 };
        let mut hidden = [0.0; MAX_HIDDEN];
        first.forward(seen, &mut hidden);
        network::leaky_relu(&mut hidden[..first.outputs()], self.leaky_slope);
        let mut logit = [0.0];
        second.forward(&hidden[..first.outputs()], &mut logit);
        SELECTION_FLOOR + (1.0 - 2.0 * SELECTION_FLOOR) / (1.0 + (-logit[0]).exp())
    }

    /// Carries a uniform `z` to `(y, density over Y)`.
    pub fn sample_at(&self, prepared: &PreparedHead, z: Vec2) -> (Vec2, f32) {
        match &prepared.elevation_spline {
            Some(elevation) => {
                let (v, log_v) = elevation.forward(z.y);
                let (u, log_u) = self.azimuth_spline(prepared, v).forward(z.x);
                (Vec2::new(u, v), (log_u + log_v).exp())
            }
            None => {
                let (u, log_u) = self.azimuth_spline(prepared, z.y).forward(z.x);
                let (v, log_v) = self.elevation_spline(prepared, u).forward(z.y);
                (Vec2::new(u, v), (log_u + log_v).exp())
            }
        }
    }

    /// The density direction `y -> (z, density over Y)`.
    pub fn inverse_at(&self, prepared: &PreparedHead, y: Vec2) -> (Vec2, f32) {
        let (z_v, log_v, seen) = match &prepared.elevation_spline {
            Some(elevation) => {
                let (z_v, log_v) = elevation.inverse(y.y);
                (z_v, log_v, y.y)
            }
            None => {
                let (z_v, log_v) = self.elevation_spline(prepared, y.x).inverse(y.y);
                (z_v, log_v, z_v)
            }
        };
        let (z_u, log_u) = self.azimuth_spline(prepared, seen).inverse(y.x);
        (Vec2::new(z_u, z_v), (log_u + log_v).exp())
    }

    fn azimuth_spline(&self, prepared: &PreparedHead, seen: f32) -> Spline {
        self.azimuth.spline(&prepared.azimuth, &[seen], self.leaky_slope)
    }

    fn elevation_spline(&self, prepared: &PreparedHead, azimuth: f32) -> Spline {
        let (sin, cos) = (TAU * azimuth).sin_cos();
        self.elevation.spline(&prepared.elevation, &[cos, sin], self.leaky_slope)
    }
}

impl IntermediateDensity for Head {
    type Prepared = PreparedHead;

    fn prepare(&self, at: &ShadingPoint) -> PreparedHead {
        self.prepare_condition(&self.condition.of(at)[..self.condition.length()])
    }

    fn share_beside_brdf(&self, prepared: &PreparedHead) -> f32 {
        prepared.share_beside_brdf
    }

    fn sample(&self, prepared: &PreparedHead, z: Vec2) -> (Vec2, f32) {
        self.sample_at(prepared, z)
    }

    fn density(&self, prepared: &PreparedHead, y: Vec2) -> f32 {
        self.inverse_at(prepared, y).1
    }
}
