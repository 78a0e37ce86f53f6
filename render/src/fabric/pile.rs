//! Pile fabrics such as velvet: bent fibres that stand on the lining.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};

use super::yarn::{Section, TriangleSoup, irregular};

/// Tufts along a side of the tile.
const TUFTS: usize = 36;
/// Segments along and around a fibre.
const STEPS: [usize; 2] = [6, 6];
/// Height of the pile and horizontal offset ([`BEND`]) of its tips, in tiles.
const HEIGHT: f32 = 0.085;
const BEND: f32 = 0.16;

/// Adds flattened pile, whose fibres lean roughly along u, in waves.
pub fn velvet(soup: &mut TriangleSoup) {
    let section = Section::smooth(Vec2::splat(0.016));
    for (i, j) in (0..TUFTS).flat_map(|i| (0..TUFTS).map(move |j| (i, j))) {
        let jitter = Vec2::new(irregular(i, 2 * j), irregular(i, 2 * j + 1));
        let root = (Vec2::new(i as f32, j as f32) + jitter) / TUFTS as f32;
        let wave = (TAU * root.y).sin() + 0.6 * (TAU * (root.x + 2.0 * root.y)).cos();
        let angle = 0.35 * wave + 0.5 * (irregular(i + 100, j) - 0.5);
        let pressed = 0.8 + 0.25 * (TAU * (root.x - root.y)).sin() + 0.2 * (irregular(i, j + 100) - 0.5);
        let over = BEND * pressed * Vec2::from_angle(angle);
        let height = HEIGHT * (1.25 - 0.4 * pressed);
        let path = |s: f32| {
            let bent = over * s * s;
            Vec3::new(root.x + bent.x, root.y + bent.y, height * (1.0 - (1.0 - s) * (1.0 - s)))
        };
        // Fibres taper towards the tip.
        soup.sweep(path, &section, |s| 1.0 - 0.75 * s.clamp(0.0, 1.0).powi(3), STEPS);
    }
}
