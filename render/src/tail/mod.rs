//! Tail warps t: Y -> X: unconditional bijections that carry the uniform distribution to the light of an environment map.

mod bilinear;
mod density;
mod flow;
mod hierarchical;
mod repair;
mod row_column;
mod warp_map;

pub use density::BilinearDensity;
pub use flow::FlowTail;
pub use hierarchical::Hierarchical;
pub use repair::Repair;
pub use row_column::RowColumn;
pub use warp_map::WarpMap;

use glam::{Vec2, Vec3A};
use serde::{Deserialize, Serialize};

use crate::{latlong, simd::Lanes};

/// The largest f32 below 1: square coordinates are kept in `[0, 1)` where a cell is looked up.
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// A bijection of the unit square; coordinate 0 is a circle, coordinate 1 an interval, on both sides.
///
/// `forward` and `inverse` are inverse to each other to rounding, and both report the Jacobian of the same map:
/// `forward(y) = (x, |dx/dy|)`, `inverse(x) = (y, |dy/dx|)`. For an exact tail `|dy/dx|` is the normalised density of the
/// light over X.
pub trait TailWarp: Send + Sync {
    /// `y` in `[0, 1)^2` to `(x, |dx/dy|)`; the Jacobian is infinite where the light vanishes.
    fn forward(&self, y: Vec2) -> (Vec2, f32);

    /// [`Self::forward`] of many points; `y` and `out` have equal length.
    fn forward_batch(&self, y: &[Vec2], out: &mut [(Vec2, f32)]) {
        for (&y, out) in y.iter().zip(out) {
            *out = self.forward(y);
        }
    }

    /// `x` in `[0, 1]^2` to `(y, |dy/dx|)`; the Jacobian is 0 where the light vanishes, and `y` is then only near.
    fn inverse(&self, x: Vec2) -> (Vec2, f32);

    /// `|dy/dx|` alone: the density over X into which the uniform density over Y is carried.
    fn density(&self, x: Vec2) -> f32;
}

/// Which tail warp to build.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TailKind {
    /// Marginal over rows, conditional over columns.
    RowColumn,
    /// Quad-tree of the map (after Clarberg et al. 2005).
    Hierarchical,
    /// A smooth warp that was fitted to the map.
    Flow,
}

impl TailKind {
    /// The name used in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::RowColumn => "row-column",
            Self::Hierarchical => "hierarchical",
            Self::Flow => "flow",
        }
    }

    /// The kind of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::RowColumn, Self::Hierarchical, Self::Flow].into_iter().find(|kind| kind.name() == name)
    }
}

/// A tail warp of any kind.
#[derive(Clone, Debug)]
pub enum Tail {
    /// See [`RowColumn`].
    RowColumn(RowColumn),
    /// See [`Hierarchical`].
    Hierarchical(Hierarchical),
    /// See [`FlowTail`].
    Flow(FlowTail),
}

impl Tail {
    /// Builds an exact tail for the luminance `[height * width]` of an environment map.
    ///
    /// # Errors
    /// See [`BilinearDensity::new`]; a flow tail is fitted, not built.
    pub fn new(kind: TailKind, width: usize, height: usize, luminance: &[f32]) -> crate::Result<Self> {
        let density = BilinearDensity::new(width, height, luminance)?;
        Ok(match kind {
            TailKind::RowColumn => Self::RowColumn(RowColumn::new(density)),
            TailKind::Hierarchical => Self::Hierarchical(Hierarchical::new(density)),
            TailKind::Flow => {
                let reason = "a flow is fitted to a map (headtail fit --tail flow), not built from it";
                return Err(crate::Error::argument("tail", reason));
            }
        })
    }

    /// A flow tail of a table and the luminance `[height * width]` that it was fitted to.
    ///
    /// # Errors
    /// See [`BilinearDensity::new`].
    pub fn flow(map: WarpMap, width: usize, height: usize, luminance: &[f32]) -> crate::Result<Self> {
        Ok(Self::Flow(FlowTail::new(map, BilinearDensity::new(width, height, luminance)?)))
    }

    /// The density of the light over that of the tail at a point of X: 1 for exact tails.
    pub fn light_ratio(&self, x: Vec2) -> f32 {
        match self {
            Self::RowColumn(_) | Self::Hierarchical(_) => 1.0,
            Self::Flow(tail) => tail.light_ratio(x),
        }
    }

    /// The normalised density of the map's light over X.
    pub fn light(&self) -> &BilinearDensity {
        match self {
            Self::RowColumn(tail) => tail.grid(),
            Self::Hierarchical(tail) => tail.grid(),
            Self::Flow(tail) => tail.light(),
        }
    }

    /// [`TailWarp::density`] at as many points as there are lanes.
    #[inline(always)]
    pub(crate) fn density_lanes(&self, u: &Lanes, v: &Lanes) -> Lanes {
        match self {
            Self::RowColumn(tail) => tail.grid().density_lanes(u, v),
            Self::Hierarchical(tail) => tail.grid().density_lanes(u, v),
            Self::Flow(tail) => std::array::from_fn(|k| tail.density(Vec2::new(u[k], v[k]))),
        }
    }

    /// The kind.
    pub fn kind(&self) -> TailKind {
        match self {
            Self::RowColumn(_) => TailKind::RowColumn,
            Self::Hierarchical(_) => TailKind::Hierarchical,
            Self::Flow(_) => TailKind::Flow,
        }
    }

    /// The direction to which a point of Y is carried, and the solid-angle pdf of that direction when Y is uniform.
    pub fn forward_direction(&self, y: Vec2) -> (Vec2, Vec3A, f32) {
        let (x, jacobian) = self.forward(y);
        (x, latlong::direction(x), latlong::solid_angle_factor(x.y) / jacobian)
    }
}

impl TailWarp for Tail {
    fn forward(&self, y: Vec2) -> (Vec2, f32) {
        match self {
            Self::RowColumn(tail) => tail.forward(y),
            Self::Hierarchical(tail) => tail.forward(y),
            Self::Flow(tail) => tail.forward(y),
        }
    }

    fn forward_batch(&self, y: &[Vec2], out: &mut [(Vec2, f32)]) {
        match self {
            Self::RowColumn(tail) => tail.forward_batch(y, out),
            Self::Hierarchical(tail) => tail.forward_batch(y, out),
            Self::Flow(tail) => tail.forward_batch(y, out),
        }
    }

    fn inverse(&self, x: Vec2) -> (Vec2, f32) {
        match self {
            Self::RowColumn(tail) => tail.inverse(x),
            Self::Hierarchical(tail) => tail.inverse(x),
            Self::Flow(tail) => tail.inverse(x),
        }
    }

    fn density(&self, x: Vec2) -> f32 {
        match self {
            Self::RowColumn(tail) => tail.grid().density(x),
            Self::Hierarchical(tail) => tail.grid().density(x),
            Self::Flow(tail) => tail.density(x),
        }
    }
}
