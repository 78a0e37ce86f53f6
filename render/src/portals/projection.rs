//! Rays as lines over the planes of one normal.

use glam::{Vec2, Vec3A};

use headtail_sampling::portals::Portal;

use super::{
    plane::{Plane, Rectangle},
    rays::RoomRays,
};
use crate::scene::{Ray, Scene};

/// Smallest cosine between a plane's normal and a ray that counts as crossing it.
const LEAST_COSINE: f32 = 0.05;
/// Fraction of the crossings that may lie outside on each side of a rectangle.
const OUTLIERS: f32 = 0.001;

/// The rays that cross planes of one normal from inside.
pub struct Projection {
    /// Unit directions: out of the room, and of the width and the height of rectangles.
    outward: Vec3A,
    right: Vec3A,
    up: Vec3A,
    /// The lowest and highest coordinates of the scene along each.
    bounds: [Vec3A; 2],
    open: Vec<Line>,
    blocked: Vec<Line>,
}

/// A ray by its height over the plane through the origin.
#[derive(Clone, Copy)]
struct Line {
    height: f32,
    /// Where it is at that height, and its change with height.
    at: Vec2,
    slope: Vec2,
    /// Index of the ray.
    ray: u32,
}

impl Projection {
    pub fn new(scene: &Scene, [outward, up]: [Vec3A; 2], rays: &RoomRays) -> Self {
        let right = outward.cross(up);
        let own = |v: Vec3A| Vec3A::new(v.dot(right), v.dot(up), v.dot(outward));
        let corners = scene.bounds().corners().map(own);
        let bounds = [
            corners.iter().copied().fold(Vec3A::INFINITY, Vec3A::min),
            corners.iter().copied().fold(Vec3A::NEG_INFINITY, Vec3A::max),
        ];
        let lines = |rays: &[Ray]| -> Vec<Line> {
            let line = |(number, ray): (usize, &Ray)| {
                let (origin, direction) = (own(ray.origin), own(ray.direction));
                (direction.z >= LEAST_COSINE).then(|| Line {
                    height: origin.z,
                    at: origin.truncate(),
                    slope: direction.truncate() / direction.z,
                    ray: number as u32,
                })
            };
            rays.iter().enumerate().filter_map(line).collect()
        };
        Self { outward, right, up, bounds, open: lines(&rays.open), blocked: lines(&rays.blocked) }
    }

    /// Returns the lowest and highest coordinates that the scene has on its planes.
    pub fn extent(&self) -> [Vec2; 2] {
        self.bounds.map(Vec3A::truncate)
    }

    /// Returns one of `count` planes across the scene.
    pub fn plane(&self, number: usize, count: usize) -> Plane {
        let [first, last] = self.bounds.map(|corner| corner.z);
        let step = (last - first) / count as f32;
        // Those at both ends do not lie on the outermost surfaces, which rays do not cross.
        Plane { offset: first + (number as f32 + 0.5) * step, step }
    }

    /// Returns where the rays that reach the environment cross a plane.
    pub fn open(&self, plane: Plane) -> impl Iterator<Item = Vec2> + '_ {
        crossings(&self.open, plane)
    }

    /// Returns where the other rays cross it.
    pub fn blocked(&self, plane: Plane) -> impl Iterator<Item = Vec2> + '_ {
        crossings(&self.blocked, plane)
    }

    /// Returns the rectangle of the crossings within one, without outliers, and their number; `None` without
    /// crossings.
    pub fn fitted(&self, within: &Rectangle, plane: Plane) -> Option<(Rectangle, f32)> {
        let inside = |p: &Vec2| p.cmpge(within.low).all() && p.cmple(within.high).all();
        let points: Vec<Vec2> = self.open(plane).filter(inside).collect();
        if points.is_empty() {
            return None;
        }
        let outside = (OUTLIERS * points.len() as f32) as usize;
        let [(left, right), (bottom, top)] = [0, 1].map(|axis| {
            let mut values: Vec<f32> = points.iter().map(|point| point[axis]).collect();
            let last = values.len() - 1 - outside;
            let low = *values.select_nth_unstable_by(outside, f32::total_cmp).1;
            (low, *values.select_nth_unstable_by(last, f32::total_cmp).1)
        });
        Some((Rectangle { low: Vec2::new(left, bottom), high: Vec2::new(right, top) }, points.len() as f32))
    }

    /// Keeps, of the rays that reach the environment, those that remain.
    pub fn keep(&mut self, remaining: &[bool]) {
        self.open.retain(|line| remaining[line.ray as usize]);
    }

    /// Returns the portal of a rectangle of a plane.
    pub fn portal(&self, plane: &Plane, rectangle: &Rectangle) -> Portal {
        let (center, size) = (0.5 * (rectangle.low + rectangle.high), rectangle.high - rectangle.low);
        Portal {
            center: plane.offset * self.outward + center.x * self.right + center.y * self.up,
            normal: -self.outward,
            up: self.up,
            width: size.x,
            height: size.y,
        }
    }
}

#[inline]
fn crossings(lines: &[Line], plane: Plane) -> impl Iterator<Item = Vec2> + '_ {
    let above = lines.iter().map(move |line| (plane.offset - line.height, line));
    above.filter(|(distance, _)| *distance > 0.0).map(|(distance, line)| line.at + distance * line.slope)
}
