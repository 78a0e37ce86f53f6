//! Tail warps t: Y -> X: unconditional bijections that carry the uniform distribution to the light of an environment map.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | the trait `TailWarp`, and the kinds of tail |
//! | `row_column.rs` | marginal and conditional |
//! | `hierarchical.rs`, `node.rs` | the quad-tree tail, and the rectangles that it halves |
//! | `flow.rs` | a fitted and tabulated flow, and the light that it leaves over |
//! | `warp_map.rs`, `repair.rs` | a warp as one table; making it one to one |
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
/// Columns are what an implementation gives; the forms for single points are columns with one live lane. `forward` and `inverse` are
/// inverse to each other to rounding, and both report the Jacobian of the same map: `forward(y) = (x, |dx/dy|)`,
/// `inverse(x) = (y, |dy/dx|)`. For an exact tail `|dy/dx|` is the normalised density of the light over X.
pub trait TailWarp: Send + Sync {
    /// `y` in `[0, 1)^2` to `x` and `|dx/dy|`; the Jacobian is infinite where the light vanishes. All columns are equally long.
    fn forward_columns(&self, y: [&[Lanes]; 2], x: [&mut [Lanes]; 2], jacobian: &mut [Lanes]);

    /// `x` in `[0, 1]^2` to `y` and `|dy/dx|`; the Jacobian is 0 where the light vanishes, and `y` is then only near.
    fn inverse_columns(&self, x: [&[Lanes]; 2], y: [&mut [Lanes]; 2], density: &mut [Lanes]);

    /// `|dy/dx|` alone: the density over X into which the uniform density over Y is carried.
    fn density_columns(&self, x: [&[Lanes]; 2], density: &mut [Lanes]);

    /// [`Self::forward_columns`] of a list of points.
    fn forward_points(&self, y: &[Vec2]) -> Vec<(Vec2, f32)> {
        in_columns(y, |y, x, jacobian| self.forward_columns(y, x, jacobian))
    }

    /// [`Self::inverse_columns`] of a list of points.
    fn inverse_points(&self, x: &[Vec2]) -> Vec<(Vec2, f32)> {
        in_columns(x, |x, y, density| self.inverse_columns(x, y, density))
    }

    /// [`Self::forward_columns`] of one point.
    fn forward(&self, y: Vec2) -> (Vec2, f32) {
        one(y, |y, x, jacobian| self.forward_columns(y, x, jacobian))
    }

    /// [`Self::inverse_columns`] of one point.
    fn inverse(&self, x: Vec2) -> (Vec2, f32) {
        one(x, |x, y, density| self.inverse_columns(x, y, density))
    }

    /// [`Self::density_columns`] of one point.
    fn density(&self, x: Vec2) -> f32 {
        one(x, |x, _, density| self.density_columns(x, density)).1
    }
}

/// One point through a function over columns; the other lanes have the same point.
fn one(point: Vec2, warp: impl FnOnce([&[Lanes]; 2], [&mut [Lanes]; 2], &mut [Lanes])) -> (Vec2, f32) {
    let (from, mut to, mut factor) = ([[[point.x; LANES]], [[point.y; LANES]]], [[[0.0; LANES]]; 2], [[0.0; LANES]]);
    let [x, y] = &mut to;
    warp([&from[0], &from[1]], [x, y], &mut factor);
    (Vec2::new(to[0][0][0], to[1][0][0]), factor[0][0])
}

/// A list of points through a function over columns.
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

/// A warp that is written for one point, lane by lane.
fn each_lane(from: [&[Lanes]; 2], to: [&mut [Lanes]; 2], factor: &mut [Lanes], warp: impl Fn(Vec2) -> (Vec2, f32)) {
    let [u, v] = from.map(<[Lanes]>::as_flattened);
    let [x, y] = to.map(<[Lanes]>::as_flattened_mut);
    for (k, factor) in factor.as_flattened_mut().iter_mut().enumerate() {
        let (point, own) = warp(Vec2::new(u[k], v[k]));
        (x[k], y[k], *factor) = (point.x, point.y, own);
    }
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

    /// The same warp, which takes its densities from an equal list that others use too.
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
        direction_of(self.forward(y))
    }

    /// [`Self::forward_direction`] of a list of points.
    pub fn forward_directions(&self, y: &[Vec2]) -> impl Iterator<Item = (Vec2, Vec3A, f32)> {
        self.forward_points(y).into_iter().map(direction_of)
    }
}

/// The direction of a point of X, and its pdf, from the Jacobian there.
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
