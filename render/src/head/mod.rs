//! Native inference of an exported head warp h: Z -> Y, for one point and for many at a time.

mod abreast;
mod condition;
mod network;
mod spline;

pub use condition::{Condition, MAX_CONDITION};
pub use network::{Linear, SplineNetwork};
pub use spline::Spline;

pub use crate::spline::Topology;

use std::{f32::consts::TAU, sync::Arc};

use glam::{Vec2, Vec3A};
use serde::{Deserialize, Serialize};

use crate::{
    error::{Error, Result},
    sampler::{IntermediateDensity, ShadingPoint},
    simd::LANES,
};
use abreast::{HeadAbreast, Job};
use network::MAX_LOGITS;

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

/// Least probability of either strategy in the mixture of head and BRDF sampling: a weight of the mixture is at most 50 times that of
/// the strategy that fits.
pub const SELECTION_FLOOR: f32 = 0.02;

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
    /// The same networks for many samples.
    abreast: Box<HeadAbreast>,
}

/// What the head computes once per condition: a column of a matrix that all conditions of a batch share.
#[derive(Clone, Debug)]
pub struct PreparedHead {
    /// For each batch of conditions: rows of the elevation network, then rows of the azimuth network.
    ///
    /// The former are the condition's part of the first hidden layer (coupled), or the logits of the elevation spline, which depend on nothing
    /// else (autoregressive); the latter are the condition's part of the first hidden layer.
    values: Arc<Vec<f32>>,
    /// Where the column begins, and from one row to the next.
    start: usize,
    stride: usize,
    /// Share of samples that the head gives in a mixture with BRDF sampling.
    share_beside_brdf: f32,
}

impl PreparedHead {
    /// Rows from `first` on.
    fn rows(&self, first: usize, out: &mut [f32]) {
        for (row, out) in out.iter_mut().enumerate() {
            *out = self.values[self.start + (first + row) * self.stride];
        }
    }
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
        let abreast = Box::new(HeadAbreast::new((condition, mode, leaky_slope), &encoder, [&elevation, &azimuth]));
        Ok(Self { condition, mode, leaky_slope, encoder, elevation, azimuth, selection: Vec::new(), abreast })
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
        self.abreast = Box::new(self.abreast.with_selection(&selection));
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
        let mut values = vec![0.0; self.elevation_rows() + self.azimuth.first_outputs()];
        let (elevation, azimuth) = values.split_at_mut(self.elevation_rows());
        self.azimuth.prepare(&seen[..length], azimuth);
        let mut first = [0.0; MAX_HIDDEN];
        self.elevation.prepare(&seen[..length], &mut first);
        if self.mode == Mode::Autoregressive {
            let logits = self.elevation.logits(&first, &[], self.leaky_slope);
            first[..MAX_LOGITS].copy_from_slice(&logits);
        }
        elevation.copy_from_slice(&first[..elevation.len()]);
        let share_beside_brdf = self.share_beside_brdf(&seen[..length]);
        PreparedHead { values: Arc::new(values), start: 0, stride: 1, share_beside_brdf }
    }

    /// Rows of a prepared condition that belong to the elevation network.
    fn elevation_rows(&self) -> usize {
        match self.mode {
            Mode::Coupled => self.elevation.first_outputs(),
            Mode::Autoregressive => self.elevation.outputs(),
        }
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
        let ((u, log_u), (v, log_v));
        if self.mode == Mode::Autoregressive {
            (v, log_v) = self.elevation_spline(prepared, 0.0).forward(z.y);
            (u, log_u) = self.azimuth_spline(prepared, v).forward(z.x);
        } else {
            (u, log_u) = self.azimuth_spline(prepared, z.y).forward(z.x);
            (v, log_v) = self.elevation_spline(prepared, u).forward(z.y);
        }
        (Vec2::new(u, v), (log_u + log_v).exp())
    }

    /// The density direction `y -> (z, density over Y)`.
    pub fn inverse_at(&self, prepared: &PreparedHead, y: Vec2) -> (Vec2, f32) {
        let (z_v, log_v) = self.elevation_spline(prepared, y.x).inverse(y.y);
        let seen = if self.mode == Mode::Coupled { z_v } else { y.y };
        let (z_u, log_u) = self.azimuth_spline(prepared, seen).inverse(y.x);
        (Vec2::new(z_u, z_v), (log_u + log_v).exp())
    }

    fn azimuth_spline(&self, prepared: &PreparedHead, seen: f32) -> Spline {
        let mut first = [0.0; MAX_HIDDEN];
        prepared.rows(self.elevation_rows(), &mut first[..self.azimuth.first_outputs()]);
        self.azimuth.spline(&first, &[seen], self.leaky_slope)
    }

    fn elevation_spline(&self, prepared: &PreparedHead, azimuth: f32) -> Spline {
        let mut rows = [0.0; MAX_HIDDEN];
        prepared.rows(0, &mut rows[..self.elevation_rows()]);
        if self.mode == Mode::Autoregressive {
            return self.elevation.spline_of(&rows);
        }
        let (sin, cos) = (TAU * azimuth).sin_cos();
        self.elevation.spline(&rows, &[cos, sin], self.leaky_slope)
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

    fn density_batch(&self, at: &[ShadingPoint], y: &[Vec2], q: &mut [f32]) {
        self.abreast.run(Job::DensityAt { at, y, q });
    }

    fn share_batch(&self, at: &[ShadingPoint], shares: &mut [f32]) {
        if self.has_selection() {
            self.abreast.run(Job::Share { at, shares });
        } else {
            shares.fill(0.5);
        }
    }

    fn prepare_batch(&self, at: &[ShadingPoint]) -> Vec<PreparedHead> {
        let (mut values, mut shares) = (Vec::new(), Vec::with_capacity(at.len()));
        self.abreast.run(Job::Prepare { at, values: &mut values, shares: &mut shares });
        let (values, rows) = (Arc::new(values), self.elevation_rows() + self.azimuth.first_outputs());
        let column = |(index, share_beside_brdf): (usize, f32)| PreparedHead {
            values: values.clone(),
            start: index / LANES * rows * LANES + index % LANES,
            stride: LANES,
            share_beside_brdf,
        };
        shares.into_iter().enumerate().map(column).collect()
    }

    fn sample_batch(&self, at: &[ShadingPoint], z: &[Vec2], y: &mut [Vec2], q: &mut [f32]) {
        self.abreast.run(Job::Sample { at, z, y, q });
    }

    fn sample_prepared(&self, prepared: &[&PreparedHead], z: &[Vec2], y: &mut [Vec2], q: &mut [f32]) {
        self.abreast.run(Job::SamplePrepared { prepared, z, y, q });
    }

    fn density_prepared(&self, prepared: &[&PreparedHead], y: &[Vec2], q: &mut [f32]) {
        self.abreast.run(Job::Density { prepared, y, q });
    }
}
