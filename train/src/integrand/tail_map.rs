//! A tail for training: from Y to directions, and back.

use glam::{Vec2, Vec3A};
use headtail_render::{
    discrete::BELOW_ONE,
    latlong,
    tail::{Tail, TailWarp},
};

/// The tail's image of a point of Y.
#[derive(Clone, Copy, Debug)]
pub struct TailPoint {
    /// The point's image in X.
    pub x: [f32; 2],
    /// The direction, world space.
    pub direction: Vec3A,
    /// The direction's solid-angle pdf if Y is uniform.
    pub pdf: f32,
    /// The density over X at the point's image if Y is uniform: `|dy/dx|`.
    pub density: f32,
    /// The density of the light over [`TailPoint::density`]: 1 for an exact tail.
    pub light: f32,
}

/// A tail followed by the lat-long map. Processes lists of points, for which tails are fastest.
///
/// Implemented also by functions from Y to unit directions, without densities and inverse.
pub trait TailMap: Sync {
    /// Maps points of Y to directions.
    fn forward(&self, y: &[[f32; 2]]) -> Vec<TailPoint>;

    /// Maps directions to Y; `None` where there is no light.
    fn inverse(&self, directions: &[Vec3A]) -> Vec<Option<[f32; 2]>> {
        vec![None; directions.len()]
    }

    /// Returns the tail, if it is not a function.
    fn as_tail(&self) -> Option<&Tail> {
        None
    }

    /// Returns whether [`inverse`](Self::inverse) and [`TailPoint::pdf`] are meaningful.
    fn is_invertible(&self) -> bool {
        false
    }
}

impl TailMap for Tail {
    fn forward(&self, y: &[[f32; 2]]) -> Vec<TailPoint> {
        let y: Vec<Vec2> = y.iter().copied().map(Vec2::from_array).collect();
        let point = |(x, jacobian): (Vec2, f32)| TailPoint {
            x: x.to_array(),
            direction: latlong::direction(x),
            pdf: latlong::solid_angle_factor(x.y) / jacobian,
            density: 1.0 / jacobian,
            light: self.light_ratio(x),
        };
        self.forward_points(&y).into_iter().map(point).collect()
    }

    fn inverse(&self, directions: &[Vec3A]) -> Vec<Option<[f32; 2]>> {
        let x: Vec<Vec2> = directions.iter().map(|&direction| latlong::square(direction)).collect();
        let inside = |y: Vec2| y.clamp(Vec2::ZERO, Vec2::splat(BELOW_ONE)).to_array();
        self.inverse_points(&x).into_iter().map(|(y, density)| (density > 0.0).then(|| inside(y))).collect()
    }

    fn as_tail(&self) -> Option<&Tail> {
        Some(self)
    }

    fn is_invertible(&self) -> bool {
        true
    }
}

impl<F: Fn([f32; 2]) -> [f32; 3] + Sync> TailMap for F {
    fn forward(&self, y: &[[f32; 2]]) -> Vec<TailPoint> {
        let point = |&y| TailPoint { x: y, direction: Vec3A::from_array(self(y)), pdf: 1.0, density: 1.0, light: 1.0 };
        y.iter().map(point).collect()
    }
}
