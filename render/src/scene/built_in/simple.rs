//! White test scenes: one sphere, one plane.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

use super::{model::Model, shapes::lathe};
use crate::scene::Mesh;

/// A white unit sphere around the origin, finely tessellated, with smooth normals.
pub fn sphere() -> Model {
    let mut model = Model::seen([0.0, 0.0, 4.0], [0.0; 3], 35.0);
    let white = model.paint([1.0; 3]);
    const RINGS: usize = 128;
    let meridian = (0..=RINGS).map(|i| Vec2::from_angle(PI * (i as f32 / RINGS as f32 - 0.5)));
    // The poles are on the axis up to rounding; exactly there, their triangles have no area and are left out.
    let meridian = meridian.map(|p| if p.x.abs() < 1e-6 { Vec2::new(0.0, p.y) } else { p }).collect();
    let mut ball = lathe(&[meridian], 2 * RINGS);
    ball.normals.clone_from(&ball.positions);
    model.add(white, ball);
    model
}

/// A white square of 2 m that faces up, around the origin.
pub fn plane() -> Model {
    let mut model = Model::seen([0.0, 1.5, 2.5], [0.0; 3], 45.0);
    let white = model.paint([1.0; 3]);
    let corner = |x: f32, z: f32| Vec3::new(x, 0.0, z);
    model.add(
        white,
        Mesh {
            positions: vec![corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0), corner(-1.0, -1.0)],
            texcoords: vec![Vec2::new(0.0, 1.0), Vec2::ONE, Vec2::new(1.0, 0.0), Vec2::ZERO],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        },
    );
    model
}
