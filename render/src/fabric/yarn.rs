//! Yarns and fibres as triangles: ellipses swept along a path, with plies twisted around each other.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};

use crate::{error::Result, scene::Mesh};

/// The cross-section of a yarn.
#[derive(Clone, Copy, Debug)]
pub struct Section {
    /// Half the width and half the height, in tiles.
    pub radii: Vec2,
    /// Number of plies twisted around each other; only the grooves between them are modelled.
    pub plies: f32,
    /// Depth of the grooves, as a fraction of the radius.
    pub groove: f32,
    /// Turns of the plies along the path.
    pub twist: f32,
}

impl Section {
    /// Creates a smooth ellipse.
    pub fn smooth(radii: Vec2) -> Self {
        Self { radii, plies: 0.0, groove: 0.0, twist: 0.0 }
    }

    /// Returns the point at `angle`, in turns, of the cross-section at a path parameter in `[0, 1]`.
    fn at(&self, place: f32, angle: f32) -> Vec2 {
        let phase = 0.5 * TAU * self.plies * (angle - self.twist * place);
        let radius = 1.0 - self.groove * (1.0 - phase.cos().abs());
        self.radii * radius * Vec2::from_angle(TAU * angle)
    }
}

/// Triangles of one material.
#[derive(Debug, Default)]
pub struct TriangleSoup {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

impl TriangleSoup {
    /// Adds a strand along `path`, which is evaluated slightly beyond `[0, 1]` and may be vertical only at
    /// isolated points. `scale` multiplies the cross-section along the path; `steps` are segments along
    /// and around.
    pub fn sweep(
        &mut self,
        path: impl Fn(f32) -> Vec3,
        section: &Section,
        scale: impl Fn(f32) -> f32,
        steps: [usize; 2],
    ) {
        const STEP: f32 = 1e-3;
        let at = |s: f32, angle: f32| {
            let along = (path(s + STEP) - path(s - STEP)).normalize_or(Vec3::X);
            let side = along.cross(Vec3::Z).normalize_or(Vec3::Y);
            let across = section.at(s, angle) * scale(s);
            path(s) + across.x * side + across.y * side.cross(along)
        };
        let first = self.positions.len() as u32;
        let [along, around] = steps;
        for i in 0..=along {
            for k in 0..=around {
                let (s, angle) = (i as f32 / along as f32, k as f32 / around as f32);
                let ahead = at(s + STEP, angle) - at(s - STEP, angle);
                let beside = at(s, angle + STEP) - at(s, angle - STEP);
                self.positions.push(at(s, angle));
                self.normals.push(beside.cross(ahead).normalize_or(Vec3::Z));
            }
        }
        let columns = around as u32 + 1;
        for i in 0..along as u32 {
            for k in 0..around as u32 {
                let corner = first + i * columns + k;
                self.triangles.push([corner, corner + 1, corner + columns]);
                self.triangles.push([corner + 1, corner + columns + 1, corner + columns]);
            }
        }
    }

    /// Builds a mesh of the triangles and of their copies in the eight neighbouring tiles.
    pub fn tiled(&self, material: usize) -> Result<Mesh> {
        let (mut positions, mut normals, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
        for (x, y) in (-1..=1).flat_map(|x| (-1..=1).map(move |y| (x, y))) {
            let first = positions.len() as u32;
            let offset = Vec3::new(x as f32, y as f32, 0.0);
            positions.extend(self.positions.iter().map(|&p| p + offset));
            normals.extend(&self.normals);
            triangles.extend(self.triangles.iter().map(|triangle| triangle.map(|i| first + i)));
        }
        Mesh::new(positions, normals, vec![], triangles, material)
    }
}

/// Hashes a pair of indices to a number in `[0, 1)`, for irregularities that repeat with the tile.
pub fn irregular(a: usize, b: usize) -> f32 {
    let mut hash = (a as u32).wrapping_mul(0x9e37_79b9) ^ (b as u32).wrapping_mul(0x85eb_ca6b) ^ 0x27d4_eb2f;
    for (shift, factor) in [(16, 0x7feb_352d), (15, 0x846c_a68b)] {
        hash = (hash ^ (hash >> shift)).wrapping_mul(factor);
    }
    ((hash ^ (hash >> 16)) >> 8) as f32 / 16_777_216.0
}
