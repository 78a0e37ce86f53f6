//! Planes that openings may lie in, and rectangles on them.

use std::collections::HashMap;

use glam::{IVec3, Vec2, Vec3A};

use crate::scene::Scene;

/// Normals that planes are searched with, at least and at most.
const LEAST_NORMALS: usize = 3;
const MOST_NORMALS: usize = 8;
/// Smallest part of all area that surfaces of a further normal have.
const LEAST_AREA: f32 = 0.02;
/// Normals whose cosine exceeds this are the same.
const SAME: f32 = 0.9995;
/// Margin added on each side of a rectangle, as a fraction of its size.
const MARGIN: f32 = 0.01;

/// Returns the normals of large surfaces on both sides, of walls, ceilings and sloping roofs, and the direction of the height
/// on planes of each: vertical, or else along a wall.
pub fn normals(scene: &Scene) -> Vec<(Vec3A, Vec3A)> {
    let normals = of_large_surfaces(scene);
    normals.iter().flat_map(|&normal| [normal, -normal]).map(|normal| (normal, up(normal, &normals))).collect()
}

fn of_large_surfaces(scene: &Scene) -> Vec<Vec3A> {
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
    let all: f32 = groups.iter().map(|(area, _)| area).sum();
    let mut normals: Vec<Vec3A> = Vec::new();
    for (area, sum) in groups {
        let normal = sum.normalize_or_zero();
        if normals.len() == MOST_NORMALS || normals.len() >= LEAST_NORMALS && area < LEAST_AREA * all {
            break;
        }
        if normal != Vec3A::ZERO && normals.iter().all(|n| n.dot(normal).abs() < SAME) {
            normals.push(normal);
        }
    }
    normals
}

fn up(normal: Vec3A, normals: &[Vec3A]) -> Vec3A {
    let vertical = [Vec3A::Y];
    let others = normals.iter().copied().filter(|axis| axis.dot(normal).abs() < 0.3);
    let candidates = vertical.into_iter().filter(|axis| axis.dot(normal).abs() < 0.9).chain(others);
    let lead = candidates.chain([Vec3A::Z, Vec3A::X]).find(|axis| axis.dot(normal).abs() < 0.9);
    lead.unwrap_or(Vec3A::Y).reject_from_normalized(normal).normalize()
}

/// A plane that rays leave the room through, of one normal.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    /// Distance from the origin along the normal.
    pub offset: f32,
    /// Distance from the neighbouring planes.
    pub step: f32,
}

impl Plane {
    /// Returns `count` planes up to the neighbouring ones.
    pub fn around(self, count: usize) -> impl Iterator<Item = Self> {
        let step = 2.0 * self.step / count as f32;
        (0..=count).map(move |k| Self { offset: self.offset - self.step + k as f32 * step, step })
    }
}

/// A rectangle of a plane.
#[derive(Clone, Copy, Debug)]
pub struct Rectangle {
    pub low: Vec2,
    pub high: Vec2,
}

impl Rectangle {
    pub fn area(&self) -> f32 {
        (self.high - self.low).element_product()
    }

    /// Returns the rectangle enlarged by a fraction of its size.
    pub fn with_margin(&self) -> Self {
        let margin = MARGIN * (self.high - self.low);
        Self { low: self.low - margin, high: self.high + margin }
    }
}
