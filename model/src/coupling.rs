//! A coupling layer: a spline of one coordinate, with logits from the condition and the other coordinate.

use std::f64::consts::TAU;

use burn::{
    module::Module,
    prelude::{Device, Tensor},
};

use crate::{
    linear::Initializer,
    spline::{self, Topology},
    spline_network::{SplineNetwork, SplineNetworkShape},
};

/// A coordinate of the base square Z and of the intermediate square Y.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coordinate {
    /// Coordinate 0, `u`: azimuth, a circle.
    Azimuth,
    /// Coordinate 1, `v`: elevation, an interval.
    Elevation,
}

impl Coordinate {
    /// Returns how the coordinate's ends are joined.
    pub const fn topology(self) -> Topology {
        match self {
            Self::Azimuth => Topology::Circle,
            Self::Elevation => Topology::Interval,
        }
    }

    /// Returns the number of features in [`features`](Self::features).
    pub const fn feature_count(self) -> usize {
        match self {
            Self::Azimuth => 2,
            Self::Elevation => 1,
        }
    }

    /// Returns the coordinate as network inputs `[conditions, samples, features]`:
    /// `(cos 2 pi u, sin 2 pi u)`, or `v` unchanged.
    pub fn features(self, values: Tensor<2>) -> Tensor<3> {
        match self {
            Self::Azimuth => {
                let angle = values.mul_scalar(TAU).unsqueeze_dim::<3>(2);
                Tensor::cat(vec![angle.clone().cos(), angle.sin()], 2)
            }
            Self::Elevation => values.unsqueeze_dim(2),
        }
    }
}

/// The spline of one coordinate and its network. Every coordinate is `[conditions, samples]`.
#[derive(Module, Debug)]
pub struct Coupling {
    network: SplineNetwork,
    #[module(skip)]
    target: Coordinate,
    #[module(skip)]
    other: Option<Coordinate>,
}

impl Coupling {
    /// Builds a layer that transforms `target` and depends on the coordinate `other` or, with `None`, on the
    /// condition alone.
    ///
    /// Overrides `shape.features`.
    pub fn new(
        target: Coordinate,
        other: Option<Coordinate>,
        shape: SplineNetworkShape,
        leaky_slope: f64,
        initializer: &mut Initializer,
        device: &Device,
    ) -> Self {
        let shape = SplineNetworkShape { features: other.map_or(0, Coordinate::feature_count), ..shape };
        Self { network: SplineNetwork::new(shape, leaky_slope, initializer, device), target, other }
    }

    /// Returns the logits for conditions `[conditions, length]` and the other coordinate's values.
    pub fn logits(&self, other: &Tensor<2>, condition: Tensor<2>) -> Tensor<3> {
        let features = self.other.map(|coordinate| coordinate.features(other.clone()));
        self.network.forward(condition, features)
    }

    /// Maps `y -> (z, ln |dz/dy|)` for the target coordinate.
    pub fn inverse(&self, y: Tensor<2>, other: &Tensor<2>, condition: Tensor<2>) -> (Tensor<2>, Tensor<2>) {
        spline::inverse(self.target.topology(), y, &self.logits(other, condition))
    }

    /// Maps `z -> (y, ln |dz/dy|)` for the target coordinate.
    pub fn forward(&self, z: Tensor<2>, other: &Tensor<2>, condition: Tensor<2>) -> (Tensor<2>, Tensor<2>) {
        spline::forward(self.target.topology(), z, &self.logits(other, condition))
    }

    pub(crate) fn network(&self) -> &SplineNetwork {
        &self.network
    }

    pub(crate) fn network_mut(&mut self) -> &mut SplineNetwork {
        &mut self.network
    }
}
