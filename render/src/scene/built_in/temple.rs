//! A temple: columns around a cella, on a podium, under a tiled roof. Deep shade beside open sky.

use std::f32::consts::PI;

use glam::{Affine3A, Quat, Vec2, Vec3};

use super::{
    model::{Model, Paint},
    shapes::{block, curve, fluted_lathe, lathe, line, prism, stairs},
};
use crate::scene::Mesh;

/// Half width and half length of the rectangle on which the columns stand.
const COLUMNS: [f32; 2] = [6.0, 9.6];
/// Distance between neighbouring columns.
const SPACING: f32 = 2.4;
/// Top of the podium, of the columns, of the beams on them.
const PODIUM: f32 = 1.8;
const CAPITALS: f32 = PODIUM + 6.0;
const BEAMS: f32 = CAPITALS + 1.5;
/// Half width of the roof, its half length, and the height of its ridge over the eaves.
const ROOF: [f32; 3] = [7.3, 10.9, 2.3];
/// Flutes of a column.
const FLUTES: u8 = 20;

/// The temple, its front towards +Z.
pub fn model() -> Model {
    let mut model = Model::seen([18.5, 5.2, 28.5], [-0.6, 5.3, 1.0], 35.0);
    let limestone = model.paint([0.60, 0.55, 0.46]);
    let marble = model.paint([0.68, 0.64, 0.57]);
    let plaster = model.paint([0.58, 0.50, 0.40]);
    let paving = model.paint([0.38, 0.36, 0.33]);
    let tiles = model.paint([0.47, 0.26, 0.18]);

    model.add(paving, block([-60.0, 60.0], [-1.0, 0.0], [-60.0, 60.0]));
    podium(&mut model, limestone, marble);
    model.add_at(marble, &column(), column_places().map(|[x, z]| [x, PODIUM, z]));
    cella(&mut model, plaster, limestone);
    entablature(&mut model, marble);
    roof(&mut model, tiles, marble);
    model
}

/// The podium with mouldings, and the stairs between two walls with urns.
fn podium(model: &mut Model, body: Paint, trim: Paint) {
    let [x, z] = [COLUMNS[0] + 0.9, COLUMNS[1] + 0.9];
    let layer = |out: f32, y: [f32; 2]| block([-x - out, x + out], y, [-z - out, z + out]);
    model.add(body, layer(0.0, [0.0, PODIUM]));
    model.add(trim, layer(0.22, [0.0, 0.22]));
    model.add(trim, layer(0.12, [0.22, 0.36]));
    model.add(trim, layer(0.08, [PODIUM - 0.34, PODIUM - 0.24]));
    model.add(trim, layer(0.18, [PODIUM - 0.24, PODIUM]));

    let foot = z + 3.4;
    model.add(trim, stairs([-3.6, 3.6], [0.0, PODIUM], [foot, z + 0.1], 10));
    for side in [-1.0, 1.0] {
        let wall = |out: f32, y: [f32; 2]| {
            let [from, to] = [side * (3.6 - out), side * (4.6 + out)];
            block([from.min(to), from.max(to)], y, [z, foot + 0.2 + out])
        };
        model.add(body, wall(0.0, [0.0, PODIUM - 0.18]));
        model.add(trim, wall(0.1, [PODIUM - 0.18, PODIUM]));
        model.add_at(trim, &urn(1.0), [[side * 4.1, PODIUM, foot - 0.45]]);
    }
}

/// Where columns stand: the outline of a rectangle, and two more between the ends of the cella's walls.
fn column_places() -> impl Iterator<Item = [f32; 2]> {
    let [half_x, half_z] = COLUMNS;
    let [across, along] = [half_x, half_z].map(|half| (2.0 * half / SPACING).round() as usize);
    let at = |i: usize, half: f32| i as f32 * SPACING - half;
    let ends = (0..=across).flat_map(move |i| [[at(i, half_x), half_z], [at(i, half_x), -half_z]]);
    let sides = (1..along).flat_map(move |i| [[half_x, at(i, half_z)], [-half_x, at(i, half_z)]]);
    ends.chain(sides).chain([[-1.2, 6.6], [1.2, 6.6]])
}

/// A column of 6 m: a base of two rings on a plinth, a fluted shaft that swells, a capital under its slab.
fn column() -> Mesh {
    const SHAFT: [f32; 2] = [0.50, 5.30];
    let radius = |t: f32| 0.46 - 0.085 * t * t;
    let shaft = (0..=4).map(|i| i as f32 / 4.0);
    let shaft = shaft.map(|t| Vec2::new(radius(t), SHAFT[0] + t * (SHAFT[1] - SHAFT[0]))).collect();
    let mut column = fluted_lathe(&[shaft], 6 * usize::from(FLUTES), |turn| {
        1.0 - 0.07 * (PI * f32::from(FLUTES) * turn).sin().abs()
    });

    let rings = [
        curve([[0.60, 0.16], [0.66, 0.20], [0.66, 0.27], [0.60, 0.31]], 3),
        curve([[0.54, 0.31], [0.51, 0.36], [0.53, 0.40]], 3),
        curve([[0.55, 0.40], [0.59, 0.43], [0.59, 0.47], [0.52, 0.50]], 3),
        line([0.52, 0.50], [0.0, 0.50]),
    ];
    let capital = [
        curve([[0.37, 5.28], [0.42, 5.30], [0.42, 5.35], [0.38, 5.37]], 3),
        line([0.385, 5.37], [0.385, 5.47]),
        curve([[0.40, 5.47], [0.50, 5.55], [0.62, 5.68], [0.65, 5.75], [0.63, 5.78]], 3),
    ];
    column.append(&lathe(&rings, 32));
    column.append(&lathe(&capital, 32));
    column.append(&with_face_normals(&block([-0.68, 0.68], [0.0, 0.16], [-0.68, 0.68])));
    column.append(&with_face_normals(&block([-0.68, 0.68], [5.77, 6.0], [-0.68, 0.68])));
    column
}

/// Returns the flat mesh with a vertex per corner and explicit normals, so that it can join smooth ones.
fn with_face_normals(flat: &Mesh) -> Mesh {
    let mut mesh = Mesh::default();
    for triangle in 0..flat.triangles.len() {
        let corners = flat.corners(triangle);
        let first = mesh.positions.len() as u32;
        let [a, b, c] = corners;
        mesh.positions.extend(corners);
        mesh.normals.extend([(b - a).cross(c - a).normalize(); 3]);
        mesh.triangles.push([first, first + 1, first + 2]);
    }
    mesh
}

/// The room inside: four walls with a door, on a low plinth.
fn cella(model: &mut Model, walls: Paint, trim: Paint) {
    const X: [f32; 2] = [3.2, 3.6];
    const Z: [f32; 2] = [-7.0, 4.6];
    let y = [PODIUM, CAPITALS];
    for side in [-1.0, 1.0_f32] {
        let span = |from: f32, to: f32| [(side * from).min(side * to), (side * from).max(side * to)];
        // The side walls run on beyond the front wall, and end in a pilaster.
        model.add(walls, block(span(X[0], X[1]), y, [Z[0], 6.4]));
        model.add(trim, block(span(X[0] - 0.08, X[1] + 0.08), y, [6.4, 6.9]));
        model.add(trim, block(span(X[0], X[1] + 0.12), [PODIUM, PODIUM + 0.5], [Z[0] - 0.12, 6.4]));
        model.add(walls, block(span(1.1, X[0]), y, [Z[1] - 0.4, Z[1]]));
        model.add(trim, block(span(1.1, 1.4), [PODIUM, PODIUM + 4.3], [Z[1], Z[1] + 0.12]));
    }
    model.add(walls, block([-X[0], X[0]], y, [Z[0], Z[0] + 0.4]));
    model.add(walls, block([-1.1, 1.1], [PODIUM + 4.2, CAPITALS], [Z[1] - 0.4, Z[1]]));
    model.add(trim, block([-1.6, 1.6], [PODIUM + 4.3, PODIUM + 4.65], [Z[1], Z[1] + 0.2]));
    model.add(trim, block([-0.9, 0.9], [PODIUM, PODIUM + 1.2], [-5.6, -3.8]));
    model.add_at(trim, &urn(1.6), [[0.0, PODIUM + 1.2, -4.7]]);
}

/// Beams, frieze and cornice around the top of the columns, and the ceiling.
fn entablature(model: &mut Model, paint: Paint) {
    let [x, z] = COLUMNS;
    // Four beams, so that the ceiling between them lies deeper than their underside.
    let ring = |out: f32, inner: f32, y: [f32; 2]| {
        let mut ring = Mesh::default();
        for side in [-1.0, 1.0_f32] {
            let span = |half: f32| {
                [(side * (half - inner)).min(side * (half + out)), (side * (half - inner)).max(side * (half + out))]
            };
            ring.append(&block(span(x), y, [-z - out, z + out]));
            ring.append(&block([-x + inner, x - inner], y, span(z)));
        }
        ring
    };
    model.add(paint, ring(0.42, 0.42, [CAPITALS, CAPITALS + 0.34]));
    model.add(paint, ring(0.46, 0.42, [CAPITALS + 0.34, CAPITALS + 0.62]));
    model.add(paint, ring(0.54, 0.42, [CAPITALS + 0.62, CAPITALS + 0.70]));
    model.add(paint, ring(0.42, 0.42, [CAPITALS + 0.70, BEAMS - 0.22]));
    model.add(paint, block([-x, x], [CAPITALS + 0.75, BEAMS - 0.25], [-z, z]));
    model.add(paint, block([-x - 0.62, x + 0.62], [BEAMS - 0.22, BEAMS - 0.08], [-z - 0.62, z + 0.62]));
    model.add(paint, block([-x - 1.05, x + 1.05], [BEAMS - 0.08, BEAMS + 0.12], [-z - 1.05, z + 1.05]));

    // Three upright bars over every column and every gap.
    let bar = block([-0.07, 0.07], [CAPITALS + 0.70, BEAMS - 0.22], [-0.07, 0.07]);
    let places = |half: f32| {
        let n = (4.0 * half / SPACING).round() as usize;
        (0..=n).flat_map(move |i| [-0.19, 0.0, 0.19].map(|bar| i as f32 * 0.5 * SPACING - half + bar))
    };
    for side in [-1.0, 1.0] {
        model.add_at(paint, &bar, places(x).map(|at| [at, 0.0, side * (z + 0.45)]));
        model.add_at(paint, &bar, places(z).map(|at| [side * (x + 0.45), 0.0, at]));
    }
    // A row of teeth under the cornice.
    let tooth = block([-0.07, 0.07], [BEAMS - 0.22, BEAMS - 0.08], [-0.1, 0.1]);
    let teeth = |half: f32| {
        let n = (2.0 * half / 0.3).round() as usize;
        (0..=n).map(move |i| (2.0 * i as f32 / n as f32 - 1.0) * half)
    };
    for side in [-1.0, 1.0] {
        model.add_at(paint, &tooth, teeth(x + 0.6).map(|at| [at, 0.0, side * (z + 0.7)]));
        model.add_at(paint, &tooth, teeth(z + 0.6).map(|at| [side * (x + 0.7), 0.0, at]));
    }
}

/// The gable roof: deep pediments at both ends, rows of round tiles, urns at the corners.
fn roof(model: &mut Model, tiles: Paint, stone: Paint) {
    let [half_x, half_z, rise] = ROOF;
    let eaves = BEAMS + 0.12;
    let ridge = Vec2::new(0.0, eaves + rise);
    let pitch = rise.atan2(half_x);

    // Raking cornices stand out over the walls of the pediments, which lie 0.7 m back.
    let gable = |x: f32, y: f32| [Vec2::new(-x, eaves), Vec2::new(x, eaves), Vec2::new(0.0, y)];
    model.add(stone, prism(&gable(half_x - 0.5, ridge.y - 0.25), [0.7 - half_z, half_z - 0.7]));
    for side in [-1.0, 1.0] {
        let thick = Vec2::new(0.0, 0.26);
        let foot = Vec2::new(side * half_x, eaves);
        let mut slope = [foot - 0.1 * thick, foot + thick, ridge + thick, ridge - 0.4 * thick];
        if side < 0.0 {
            slope.reverse();
        }
        model.add(tiles, prism(&slope, [0.25 - half_z, half_z - 0.25]));
        model.add(stone, prism(&slope.map(|p| p - 0.06 * Vec2::Y), [half_z - 0.6, half_z]));
        model.add(stone, prism(&slope.map(|p| p - 0.06 * Vec2::Y), [-half_z, 0.6 - half_z]));

        // Round tiles down the slope, from the ridge to beyond the eaves.
        let length = rise.hypot(half_x) + 0.06;
        let tile = lathe(&[line([0.0, 0.0], [0.085, 0.0]), line([0.085, 0.0], [0.085, length])], 12);
        let turn = Quat::from_rotation_z(-side * (0.5 * PI + pitch));
        let tile = tile.transformed(&Affine3A::from_rotation_translation(turn, (ridge + 0.95 * thick).extend(0.0)));
        let rows = (2.0 * (half_z - 0.4) / 0.46).round() as usize;
        let places = (0..=rows).map(|i| [0.0, 0.0, (2.0 * i as f32 / rows as f32 - 1.0) * (half_z - 0.4)]);
        model.add_at(tiles, &tile, places);
    }
    let cap = lathe(&[line([0.17, -half_z], [0.17, half_z])], 16);
    let cap = cap.transformed(&Affine3A::from_rotation_translation(
        Quat::from_rotation_x(0.5 * PI),
        Vec3::new(0.0, ridge.y + 0.24, 0.0),
    ));
    model.add(tiles, cap);
    for z in [half_z - 0.35, 0.35 - half_z] {
        let corners = [[0.0, ridge.y + 0.2, z], [half_x - 0.3, eaves + 0.3, z], [0.3 - half_x, eaves + 0.3, z]];
        model.add_at(stone, &urn(0.85), corners);
    }
}

/// An urn on a foot, `height` metres tall.
fn urn(height: f32) -> Mesh {
    let profile = [
        line([0.0, 0.0], [0.22, 0.0]),
        line([0.22, 0.0], [0.22, 0.08]),
        curve([[0.20, 0.08], [0.10, 0.14], [0.08, 0.22], [0.12, 0.28]], 5),
        curve([[0.12, 0.28], [0.30, 0.45], [0.36, 0.62], [0.27, 0.78], [0.19, 0.84]], 6),
        curve([[0.19, 0.84], [0.20, 0.92], [0.29, 1.00]], 5),
        curve([[0.29, 1.00], [0.20, 0.96], [0.0, 0.94]], 4),
    ];
    lathe(&profile.map(|curve| curve.into_iter().map(|p| height * p).collect()), 40)
}
