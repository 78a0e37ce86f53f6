//! Rays, their hits, and axis-aligned bounds.

use glam::{Vec3, Vec3A};

/// A half-line; distances along it are metres because the direction has unit length.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Start, in metres.
    pub origin: Vec3A,
    /// Unit direction.
    pub direction: Vec3A,
}

impl Ray {
    /// Creates a ray from `origin` along the unit vector `direction`.
    pub fn new(origin: Vec3A, direction: Vec3A) -> Self {
        debug_assert!((direction.length_squared() - 1.0).abs() < 1e-3, "{direction} is not a unit vector");
        Self { origin, direction }
    }

    /// Returns the point at distance `t` (metres).
    pub fn at(&self, t: f32) -> Vec3A {
        self.origin + t * self.direction
    }
}

/// Which surfaces rays hit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RayKind {
    /// Rays of a camera, to which the back faces of single-sided surfaces are invisible.
    Camera,
    /// Rays from surfaces, which hit both sides.
    Bounce,
}

/// The nearest intersection along a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index of the triangle, in the order given to [`Bvh::build`](super::Bvh::build), or in that of
    /// [`Scene::triangles`](super::Scene::triangles).
    pub triangle: usize,
    /// Distance in metres.
    pub t: f32,
    /// Barycentric weight of the triangle's second corner.
    pub u: f32,
    /// Barycentric weight of the triangle's third corner.
    pub v: f32,
}

/// An axis-aligned box, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// The corner of least coordinates.
    pub min: Vec3A,
    /// The corner of greatest coordinates.
    pub max: Vec3A,
}

impl Default for Bounds {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl Bounds {
    /// The box that contains nothing; extending it by a point gives that point.
    pub const EMPTY: Self = Self { min: Vec3A::INFINITY, max: Vec3A::NEG_INFINITY };

    /// Returns whether the box is empty.
    pub fn is_empty(&self) -> bool {
        self.min.cmpgt(self.max).any()
    }

    /// Grows the box until it contains `point`.
    pub fn extend(&mut self, point: Vec3) {
        self.min = self.min.min(point.into());
        self.max = self.max.max(point.into());
    }

    /// Returns the smallest box that contains both.
    #[must_use]
    pub fn union(&self, other: &Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// Returns the middle of the box.
    pub fn center(&self) -> Vec3A {
        0.5 * (self.min + self.max)
    }

    /// Returns the lengths of the edges; zero for an empty box.
    pub fn extent(&self) -> Vec3A {
        if self.is_empty() { Vec3A::ZERO } else { self.max - self.min }
    }

    /// Returns the eight corners.
    pub fn corners(&self) -> [Vec3A; 8] {
        std::array::from_fn(|i| {
            let pick = |axis: usize| if i >> axis & 1 == 0 { self.min[axis] } else { self.max[axis] };
            Vec3A::new(pick(0), pick(1), pick(2))
        })
    }
}
