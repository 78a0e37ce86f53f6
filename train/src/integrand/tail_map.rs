//! A tail as training sees it: from Y to directions, and back.

use glam::{Vec2, Vec3A};
use headtail_render::{
    latlong,
    tail::{Tail, TailWarp},
};

/// Where the tail takes a point of Y.
#[derive(Clone, Copy, Debug)]
pub struct TailPoint {
    /// The point's image in X.
    pub x: [f32; 2],
    /// The direction, world space.
    pub direction: Vec3A,
    /// The direction's solid-angle pdf when Y is uniform.
    pub pdf: f32,
    /// The density over X at the point's image when Y is uniform: `|dy/dx|`.
    pub density: f32,
    /// The density of the light over [`TailPoint::density`]: 1 for an exact tail.
    pub light: f32,
}

/// A tail followed by the lat-long map.
///
/// A function from Y to unit directions is one that knows no densities and no way back.
pub trait TailMap: Sync {
    /// From Y to a direction.
    fn forward(&self, y: [f32; 2]) -> TailPoint;

    /// From a direction to Y; `None` where there is no light.
    fn inverse(&self, _direction: Vec3A) -> Option<[f32; 2]> {
        None
    }

    /// Whether [`inverse`](Self::inverse) and [`TailPoint::pdf`] mean something.
    fn is_invertible(&self) -> bool {
        false
    }
}

impl TailMap for Tail {
    fn forward(&self, y: [f32; 2]) -> TailPoint {
        let (x, jacobian) = TailWarp::forward(self, Vec2::from_array(y));
        TailPoint {
            x: x.to_array(),
            direction: latlong::direction(x),
            pdf: latlong::solid_angle_factor(x.y) / jacobian,
            density: 1.0 / jacobian,
            light: self.light_ratio(x),
        }
    }

    fn inverse(&self, direction: Vec3A) -> Option<[f32; 2]> {
        /// The largest number below 1: points of Y are in `[0, 1)`.
        const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;
        let (y, density) = TailWarp::inverse(self, latlong::square(direction));
        (density > 0.0).then(|| y.clamp(Vec2::ZERO, Vec2::splat(BELOW_ONE)).to_array())
    }

    fn is_invertible(&self) -> bool {
        true
    }
}

impl<F: Fn([f32; 2]) -> [f32; 3] + Sync> TailMap for F {
    fn forward(&self, y: [f32; 2]) -> TailPoint {
        TailPoint { x: y, direction: Vec3A::from_array(self(y)), pdf: 1.0, density: 1.0, light: 1.0 }
    }
}
