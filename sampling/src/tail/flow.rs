//! The flow tail: a tabulated smooth warp, fitted to a map.

use glam::Vec2;

use super::{TailWarp, WarpMap, each_lane};
use crate::{environment::BilinearDensity, simd::Lanes};

/// A tabulated smooth warp with the light that it is fitted to. It is a bijection with an exact density,
/// which only approximates the light: the residual multiplies the target of a head
/// ([`FlowTail::light_ratio`]).
#[derive(Clone, Debug)]
pub struct FlowTail {
    map: WarpMap,
    light: BilinearDensity,
}

impl FlowTail {
    /// Combines a table with the density of the map's light.
    pub fn new(map: WarpMap, light: BilinearDensity) -> Self {
        Self { map, light }
    }

    /// Returns the table.
    pub fn map(&self) -> &WarpMap {
        &self.map
    }

    /// Returns the density of the map's light.
    pub fn light(&self) -> &BilinearDensity {
        &self.light
    }

    pub(super) fn light_mut(&mut self) -> &mut BilinearDensity {
        &mut self.light
    }

    /// Returns the ratio of the light's density to the warp's at `x`; 1 everywhere for an exact tail.
    pub fn light_ratio(&self, x: Vec2) -> f32 {
        self.light.density(x) / self.map.inverse(x).1
    }
}

impl TailWarp for FlowTail {
    fn forward_columns(&self, y: [&[Lanes]; 2], x: [&mut [Lanes]; 2], jacobian: &mut [Lanes]) {
        each_lane(y, x, jacobian, |y| self.map.forward(y));
    }

    fn inverse_columns(&self, x: [&[Lanes]; 2], y: [&mut [Lanes]; 2], density: &mut [Lanes]) {
        each_lane(x, y, density, |x| self.map.inverse(x));
    }

    fn density_columns(&self, x: [&[Lanes]; 2], density: &mut [Lanes]) {
        for (strip, out) in density.iter_mut().enumerate() {
            for (lane, out) in out.iter_mut().enumerate() {
                *out = self.map.inverse(Vec2::new(x[0][strip][lane], x[1][strip][lane])).1;
            }
        }
    }
}
