//! Planes that openings may lie in, and rectangles on them.

use std::collections::HashMap;

use glam::{IVec3, Vec2, Vec3A};

use super::{Portal, rays::RoomRays};
use crate::scene::{Ray, Scene};

/// Normals that planes are searched with at most.
const MOST_NORMALS: usize = 8;
/// Normals whose cosine exceeds this are the same.
const SAME: f32 = 0.9995;
/// Smallest cosine between a plane's normal and a ray that counts as crossing it.
const LEAST_COSINE: f32 = 0.05;
/// Fraction of the crossings that may lie outside on each side of a rectangle, and the margin added, as a
/// fraction of its size.
const OUTLIERS: f32 = 0.001;
const MARGIN: f32 = 0.01;

/// The normals of large surfaces: of walls, ceilings and sloping roofs.
pub struct Axes(Vec<Vec3A>);

impl Axes {
    pub fn of(scene: &Scene) -> Self {
        let mut areas: HashMap<IVec3, (f32, Vec3A)> = HashMap::new();
        for [a, b, c] in scene.triangles().map(|corners| corners.map(Vec3A::from)) {
            let twice_area = (b - a).cross(c - a);
            // Opposite normals are one axis.
            let lead = if twice_area.x.abs() > 1e-3 * twice_area.length() {
                twice_area.x
            } else if twice_area.y.abs() > 1e-3 * twice_area.length() {
                twice_area.y
            } else {
                twice_area.z
            };
            let facing = if lead < 0.0 { -twice_area } else { twice_area };
            let key = (128.0 * facing.normalize_or_zero()).round().as_ivec3();
            let (area, sum) = areas.entry(key).or_insert((0.0, Vec3A::ZERO));
            *area += twice_area.length();
            *sum += facing;
        }
        let mut groups: Vec<(f32, Vec3A)> = areas.into_values().collect();
        // Those of equal area by their coordinates, because the order of a hash map is random.
        groups.sort_by(|(a, of_a), (b, of_b)| {
            let by_axis = |axis: usize| of_a[axis].total_cmp(&of_b[axis]);
            b.total_cmp(a).then_with(|| by_axis(0)).then_with(|| by_axis(1)).then_with(|| by_axis(2))
        });
        let mut normals: Vec<Vec3A> = Vec::new();
        for normal in groups.iter().map(|(_, sum)| sum.normalize_or_zero()) {
            if normals.len() < MOST_NORMALS
                && normal != Vec3A::ZERO
                && normals.iter().all(|n| n.dot(normal).abs() < SAME)
            {
                normals.push(normal);
            }
        }
        Self(normals)
    }

    /// Returns planes across the scene, `steps` for each normal and each side.
    pub fn planes<'a>(&'a self, scene: &'a Scene, steps: usize) -> impl Iterator<Item = Plane> + 'a {
        let corners = scene.bounds().corners();
        self.0.iter().flat_map(|&axis| [axis, -axis]).flat_map(move |outward| {
            let up = self.up(outward);
            let of = |direction: Vec3A| {
                let along = corners.map(|corner| corner.dot(direction));
                [
                    along.iter().copied().fold(f32::INFINITY, f32::min),
                    along.iter().copied().fold(f32::NEG_INFINITY, f32::max),
                ]
            };
            let ([first, last], [left, right], [bottom, top]) = (of(outward), of(outward.cross(up)), of(up));
            let step = (last - first) / steps as f32;
            let extent = (Vec2::new(left, bottom), Vec2::new(right, top));
            // Those at both ends do not lie on the outermost surfaces, which rays do not cross.
            (0..steps).map(move |k| Plane { outward, up, extent, offset: first + (k as f32 + 0.5) * step, step })
        })
    }

    /// Returns the direction of the height on planes of a normal: vertical, or else along a wall.
    fn up(&self, normal: Vec3A) -> Vec3A {
        let vertical = [Vec3A::Y];
        let others = self.0.iter().copied().filter(|axis| axis.dot(normal).abs() < 0.3);
        let candidates = vertical.into_iter().filter(|axis| axis.dot(normal).abs() < 0.9).chain(others);
        let lead = candidates.chain([Vec3A::Z, Vec3A::X]).find(|axis| axis.dot(normal).abs() < 0.9);
        lead.unwrap_or(Vec3A::Y).reject_from_normalized(normal).normalize()
    }
}

/// A plane that rays leave the room through.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    outward: Vec3A,
    up: Vec3A,
    /// Distance from the origin along the normal.
    offset: f32,
    /// Distance from the neighbouring planes.
    step: f32,
    /// The lowest and highest coordinates that the scene has along both axes.
    pub extent: (Vec2, Vec2),
}

impl Plane {
    /// Returns `count` planes up to the neighbouring ones.
    pub fn around(self, count: usize) -> impl Iterator<Item = Self> {
        let step = 2.0 * self.step / count as f32;
        (0..=count).map(move |k| Self { offset: self.offset - self.step + k as f32 * step, step, ..self })
    }

    /// Returns the coordinates at which a ray crosses the plane, if it does so from inside.
    #[inline]
    pub fn crossing(&self, ray: &Ray) -> Option<Vec2> {
        let along = ray.direction.dot(self.outward);
        let distance = self.offset - ray.origin.dot(self.outward);
        if along < LEAST_COSINE || distance <= 0.0 {
            return None;
        }
        let at = ray.origin + (distance / along) * ray.direction;
        Some(Vec2::new(at.dot(self.outward.cross(self.up)), at.dot(self.up)))
    }

    /// Returns the portal of a rectangle of the plane.
    pub fn portal(&self, rectangle: &Rectangle) -> Portal {
        let (center, size) = (0.5 * (rectangle.low + rectangle.high), rectangle.high - rectangle.low);
        let right = self.outward.cross(self.up);
        Portal {
            center: self.offset * self.outward + center.x * right + center.y * self.up,
            normal: -self.outward,
            up: self.up,
            width: size.x,
            height: size.y,
        }
    }
}

/// A rectangle of a plane.
#[derive(Clone, Copy, Debug)]
pub struct Rectangle {
    pub low: Vec2,
    pub high: Vec2,
}

impl Rectangle {
    /// Returns the rectangle of the crossings within this one, without outliers, and their number; `None` without
    /// crossings.
    pub fn fitted(&self, plane: &Plane, rays: &RoomRays) -> Option<(Self, f32)> {
        let inside = |p: &Vec2| p.cmpge(self.low).all() && p.cmple(self.high).all();
        let points: Vec<Vec2> = rays.open.iter().filter_map(|ray| plane.crossing(ray)).filter(inside).collect();
        if points.is_empty() {
            return None;
        }
        let [(left, right), (bottom, top)] = [0, 1].map(|axis| {
            let mut values: Vec<f32> = points.iter().map(|point| point[axis]).collect();
            values.sort_by(f32::total_cmp);
            let outside = (OUTLIERS * values.len() as f32) as usize;
            (values[outside], values[values.len() - 1 - outside])
        });
        Some((Self { low: Vec2::new(left, bottom), high: Vec2::new(right, top) }, points.len() as f32))
    }

    pub fn area(&self) -> f32 {
        (self.high - self.low).element_product()
    }

    /// Returns the rectangle enlarged by a fraction of its size.
    pub fn with_margin(&self) -> Self {
        let margin = MARGIN * (self.high - self.low);
        Self { low: self.low - margin, high: self.high + margin }
    }
}
