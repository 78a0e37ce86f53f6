//! Tail warps t: Y -> X: unconditional bijections that map the uniform distribution to the light of an
//! environment map.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | the trait `TailWarp`, and the kinds of tail |
//! | `row_column.rs` | marginal and conditional |
//! | `hierarchical.rs`, `node.rs` | the quad-tree tail, and the rectangles that it halves |
//! | `flow.rs` | a fitted and tabulated flow, and its residual light |
//! | `warp_map.rs`, `repair.rs` | a warp as one table; making it one-to-one |
//! | `flat.rs` | tails as arrays, for other devices |

mod flat;
mod flow;
mod hierarchical;
mod node;
mod repair;
mod row_column;
mod warp_map;

pub use flow::FlowTail;
pub use hierarchical::Hierarchical;
pub use node::Node;
pub use repair::Repair;
pub use row_column::RowColumn;
pub use warp_map::WarpMap;

use glam::{Vec2, Vec3A};
use serde::{Deserialize, Serialize};

use crate::{
    columns::strips,
    environment::{BilinearDensity, Environment},
    latlong,
    simd::{LANES, Lanes},
};

/// A bijection of the unit square; coordinate 0 is a circle, coordinate 1 an interval, on both sides.
///
/// Implementations provide the column functions; those for single points fill columns with copies of the
/// point. `forward` and `inverse` are inverse to each other up to rounding, and both report the Jacobian of
/// the same map: `forward(y) = (x, |dx/dy|)`, `inverse(x) = (y, |dy/dx|)`. For an exact tail, `|dy/dx|` is
/// the normalised density of the light over X.
pub trait TailWarp: Send + Sync {
    /// Maps `y` in `[0, 1)^2` to `x` and `|dx/dy|`; the Jacobian is infinite where the light vanishes. All
    /// columns have equal length.
    fn forward_columns(&self, y: [&[Lanes]; 2], x: [&mut [Lanes]; 2], jacobian: &mut [Lanes]);

    /// Maps `x` in `[0, 1]^2` to `y` and `|dy/dx|`; where the light vanishes, the Jacobian is 0 and `y` is
    /// approximate.
    fn inverse_columns(&self, x: [&[Lanes]; 2], y: [&mut [Lanes]; 2], density: &mut [Lanes]);

    /// Computes `|dy/dx|` alone: the density over X that uniform Y induces.
    fn density_columns(&self, x: [&[Lanes]; 2], density: &mut [Lanes]);

    /// Applies [`Self::forward_columns`] to a list of points.
    fn forward_points(&self, y: &[Vec2]) -> Vec<(Vec2, f32)> {
        in_columns(y, |y, x, jacobian| self.forward_columns(y, x, jacobian))
    }

    /// Applies [`Self::inverse_columns`] to a list of points.
    fn inverse_points(&self, x: &[Vec2]) -> Vec<(Vec2, f32)> {
        in_columns(x, |x, y, density| self.inverse_columns(x, y, density))
    }

    /// Applies [`Self::forward_columns`] to one point.
    fn forward(&self, y: Vec2) -> (Vec2, f32) {
        one(y, |y, x, jacobian| self.forward_columns(y, x, jacobian))
    }

    /// Applies [`Self::inverse_columns`] to one point.
    fn inverse(&self, x: Vec2) -> (Vec2, f32) {
        one(x, |x, y, density| self.inverse_columns(x, y, density))
    }

    /// Applies [`Self::density_columns`] to one point.
    fn density(&self, x: Vec2) -> f32 {
        one(x, |x, _, density| self.density_columns(x, density)).1
    }
}

/// Applies a function over columns to one point; all lanes have the same point.
fn one(point: Vec2, warp: impl FnOnce([&[Lanes]; 2], [&mut [Lanes]; 2], &mut [Lanes])) -> (Vec2, f32) {
    let (from, mut to, mut factor) = ([[[point.x; LANES]], [[point.y; LANES]]], [[[0.0; LANES]]; 2], [[0.0; LANES]]);
    let [x, y] = &mut to;
    warp([&from[0], &from[1]], [x, y], &mut factor);
    (Vec2::new(to[0][0][0], to[1][0][0]), factor[0][0])
}

/// Applies a function over columns to a list of points.
fn in_columns(points: &[Vec2], warp: impl FnOnce([&[Lanes]; 2], [&mut [Lanes]; 2], &mut [Lanes])) -> Vec<(Vec2, f32)> {
    let column = || vec![[0.0; LANES]; strips(points.len())];
    let (mut from, mut to, mut factor) = ([column(), column()], [column(), column()], column());
    let [u, v] = from.each_mut().map(|column| column.as_flattened_mut());
    for ((point, u), v) in points.iter().zip(u).zip(v) {
        (*u, *v) = (point.x, point.y);
    }
    let [x, y] = &mut to;
    warp([&from[0], &from[1]], [x, y], &mut factor);
    let [x, y] = to.each_ref().map(|column| column.as_flattened());
    (0..points.len()).map(|k| (Vec2::new(x[k], y[k]), factor.as_flattened()[k])).collect()
}

/// Applies a function of single points lane by lane.
fn each_lane(from: [&[Lanes]; 2], to: [&mut [Lanes]; 2], factor: &mut [Lanes], warp: impl Fn(Vec2) -> (Vec2, f32)) {
    let [u, v] = from.map(<[Lanes]>::as_flattened);
    let [x, y] = to.map(<[Lanes]>::as_flattened_mut);
    for (k, factor) in factor.as_flattened_mut().iter_mut().enumerate() {
        let (point, own) = warp(Vec2::new(u[k], v[k]));
        (x[k], y[k], *factor) = (point.x, point.y, own);
    }
}

/// The kinds of tail warps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TailKind {
    /// Marginal over rows, conditional over columns.
    RowColumn,
    /// Quad-tree of the map (after Clarberg et al. 2005).
    Hierarchical,
    /// A smooth warp that is fitted to the map.
    Flow,
}

impl TailKind {
    /// Returns the name used in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::RowColumn => "row-column",
            Self::Hierarchical => "hierarchical",
            Self::Flow => "flow",
        }
    }

    /// Returns the kind with a name.
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
        Self::of_density(kind, BilinearDensity::new(width, height, luminance)?)
    }

    /// Builds an exact tail for the light of a map.
    ///
    /// # Errors
    /// A flow tail is fitted, not built.
    pub fn of_environment(kind: TailKind, environment: &Environment) -> crate::Result<Self> {
        Self::of_density(kind, environment.density().clone())
    }

    fn of_density(kind: TailKind, density: BilinearDensity) -> crate::Result<Self> {
        match kind {
            TailKind::RowColumn => Ok(Self::RowColumn(RowColumn::new(density))),
            TailKind::Hierarchical => Ok(Self::Hierarchical(Hierarchical::new(density))),
            TailKind::Flow => {
                let reason = "a flow is fitted to a map (headtail fit --tail flow), not built from it";
                Err(crate::Error::argument("tail", reason))
            }
        }
    }

    /// Returns the same warp with its densities replaced by an equal list, so that their storage is shared.
    #[must_use]
    pub fn with_light(mut self, light: &BilinearDensity) -> Self {
        let own = match &mut self {
            Self::RowColumn(tail) => tail.grid_mut(),
            Self::Hierarchical(tail) => tail.grid_mut(),
            Self::Flow(tail) => tail.light_mut(),
        };
        own.clone_from(light);
        self
    }

    /// Creates a flow tail from a table and the luminance `[height * width]` that it was fitted to.
    ///
    /// # Errors
    /// See [`BilinearDensity::new`].
    pub fn flow(map: WarpMap, width: usize, height: usize, luminance: &[f32]) -> crate::Result<Self> {
        Ok(Self::Flow(FlowTail::new(map, BilinearDensity::new(width, height, luminance)?)))
    }

    /// Returns the ratio of the light's density to the tail's at a point of X: 1 for exact tails.
    pub fn light_ratio(&self, x: Vec2) -> f32 {
        match self {
            Self::RowColumn(_) | Self::Hierarchical(_) => 1.0,
            Self::Flow(tail) => tail.light_ratio(x),
        }
    }

    /// Returns the normalised density of the map's light over X.
    pub fn light(&self) -> &BilinearDensity {
        match self {
            Self::RowColumn(tail) => tail.grid(),
            Self::Hierarchical(tail) => tail.grid(),
            Self::Flow(tail) => tail.light(),
        }
    }

    /// Returns the kind.
    pub fn kind(&self) -> TailKind {
        match self {
            Self::RowColumn(_) => TailKind::RowColumn,
            Self::Hierarchical(_) => TailKind::Hierarchical,
            Self::Flow(_) => TailKind::Flow,
        }
    }

    /// Maps a point of Y to X, its direction, and the solid-angle pdf of that direction for uniform Y.
    pub fn forward_direction(&self, y: Vec2) -> (Vec2, Vec3A, f32) {
        direction_of(self.forward(y))
    }

    /// Applies [`Self::forward_direction`] to a list of points.
    pub fn forward_directions(&self, y: &[Vec2]) -> impl Iterator<Item = (Vec2, Vec3A, f32)> {
        self.forward_points(y).into_iter().map(direction_of)
    }
}

/// Returns the direction of a point of X, and its pdf, from the Jacobian there.
fn direction_of((x, jacobian): (Vec2, f32)) -> (Vec2, Vec3A, f32) {
    (x, latlong::direction(x), latlong::solid_angle_factor(x.y) / jacobian)
}

impl Tail {
    fn warp(&self) -> &dyn TailWarp {
        match self {
            Self::RowColumn(tail) => tail,
            Self::Hierarchical(tail) => tail,
            Self::Flow(tail) => tail,
        }
    }
}

impl TailWarp for Tail {
    fn forward_columns(&self, y: [&[Lanes]; 2], x: [&mut [Lanes]; 2], jacobian: &mut [Lanes]) {
        self.warp().forward_columns(y, x, jacobian);
    }

    fn inverse_columns(&self, x: [&[Lanes]; 2], y: [&mut [Lanes]; 2], density: &mut [Lanes]) {
        self.warp().inverse_columns(x, y, density);
    }

    fn density_columns(&self, x: [&[Lanes]; 2], density: &mut [Lanes]) {
        self.warp().density_columns(x, density);
    }
}
