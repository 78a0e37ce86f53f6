//! A vaulted gallery: light through the arches along one side, and no sky from above.

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use super::{
    model::{Model, Paint},
    shapes::{arch, block, curve, cushion, fluted_lathe, lathe, sheet, tube},
};

/// Half the inner width and half the length, and the thickness of the walls.
const HALF: [f32; 2] = [1.9, 9.0];
const WALL: f32 = 0.4;
/// Positions along z of the columns at the side of -x, 3 m apart, and of the arches between them.
const COLUMNS: [f32; 7] = [-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0];
const ARCHES: [f32; 6] = [-7.5, -4.5, -1.5, 1.5, 4.5, 7.5];
/// Heights of the springing of arches and vaults and of the roof, and the rise of the vaults.
const SPRINGING: f32 = 2.6;
const ROOF: f32 = 4.6;
const RISE: f32 = 1.6;

/// The gallery, seen from between its middle and its near end.
pub fn model() -> Model {
    let mut model = Model::seen([-1.2, 1.65, 3.6], [1.0, 1.4, -3.4], 50.0);
    let lime = model.paint([0.78, 0.76, 0.71]);
    let marble = model.gloss([0.66, 0.62, 0.56], 0.0, 0.4);
    walls(&mut model, lime);
    arcade(&mut model, lime, marble);
    floor(&mut model, marble);
    furniture(&mut model, marble);
    model
}

/// The back wall with a dado and painted panels, the ends, the groin vaults, and a roof with eaves.
fn walls(model: &mut Model, lime: Paint) {
    let plaster = model.paint([0.72, 0.62, 0.48]);
    let brown = model.paint([0.30, 0.16, 0.10]);
    let panels = [[0.16, 0.30, 0.42], [0.58, 0.20, 0.12], [0.24, 0.36, 0.20]].map(|color| model.paint(color));
    let [x, z] = HALF;
    model.add(plaster, block([x, x + WALL], [-0.3, ROOF], [-z - WALL, z + WALL]));
    model.add(brown, block([x - 0.04, x], [0.0, 0.9], [-z, z]));
    model.add_at(brown, &block([x - 0.03, x], [1.18, 2.62], [-0.72, 0.72]), ARCHES.map(|z| [0.0, 0.0, z]));
    for (z, panel) in ARCHES.into_iter().zip(panels.into_iter().cycle()) {
        model.add(panel, block([x - 0.04, x], [1.26, 2.54], [z - 0.64, z + 0.64]));
    }
    model.add_at(plaster, &block([-x - WALL, x], [-0.3, ROOF], [0.0, WALL]), [-z - WALL, z].map(|z| [0.0, 0.0, z]));
    model.add(lime, block([-x - 1.3, x + WALL], [ROOF, ROOF + 0.2], [-z - WALL, z + WALL]));
    // Each of the four webs is a half cylinder cut along the diagonals; it extends into the walls and ribs.
    for [dx, dz] in [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]] {
        let web = sheet([32, 2], |u, v| {
            let (across, up) = (PI * (u - 0.5)).sin_cos();
            let along = across.abs() + v * (1.06 - across.abs());
            Vec3::new(x * (dx * along - dz * across), SPRINGING + RISE * up, 1.5 * (dz * along + dx * across))
        });
        model.add_at(lime, &web, ARCHES.map(|z| [0.0, 0.0, z]));
    }
}

/// The row of columns with its arches, and the ribs from there to pilasters at the back wall.
fn arcade(model: &mut Model, lime: Paint, marble: Paint) {
    let [x, line] = [HALF[0], -HALF[0] - 0.5 * WALL];
    let wall = arch(1.5, [1.23; 2], [SPRINGING, ROOF], [-0.5 * WALL, 0.5 * WALL]);
    for z in ARCHES {
        model.add_turned(lime, &wall, 90.0, [line, 0.0, z]);
    }
    let column = [
        curve([[0.25, 0.12], [0.29, 0.17], [0.25, 0.23], [0.20, 0.27], [0.22, 0.33]], 4),
        curve([[0.19, 0.33], [0.19, 1.2], [0.165, 2.22]], 3),
        curve([[0.165, 2.2], [0.2, 2.22], [0.165, 2.24]], 4),
        curve([[0.165, 2.24], [0.18, 2.36], [0.27, 2.48]], 4),
    ];
    let slab = |y: [f32; 2]| block([-0.3, 0.3], y, [-0.3, 0.3]);
    for part in [lathe(&column, 32), slab([0.0, 0.12]), slab([2.48, SPRINGING])] {
        model.add_at(marble, &part, COLUMNS.map(|z| [line, 0.0, z]));
    }
    let rib = arch(x, [x - 0.1, RISE - 0.12], [SPRINGING, ROOF], [-0.16, 0.16]);
    model.add_at(lime, &rib, COLUMNS.map(|z| [0.0, 0.0, z]));
    model.add_at(lime, &block([-0.12, 0.0], [0.0, 2.48], [-0.2, 0.2]), COLUMNS.map(|z| [x, 0.0, z]));
    model.add_at(marble, &block([-0.2, 0.0], [2.48, SPRINGING], [-0.28, 0.28]), COLUMNS.map(|z| [x, 0.0, z]));
}

/// Polished tiles in two colours, and the ground outside.
fn floor(model: &mut Model, marble: Paint) {
    let porphyry = model.gloss([0.20, 0.09, 0.06], 0.0, 0.3);
    let ground = model.paint([0.34, 0.32, 0.25]);
    let [x, z] = [HALF[0] + WALL, HALF[1]];
    model.add(ground, block([-16.0, HALF[0]], [-0.3, -0.006], [-z - 8.0, z + 8.0]));
    let tile = block([0.003, 0.597], [-0.04, 0.0], [0.003, 0.597]);
    for (i, k) in (0..7).flat_map(|i| (0..30).map(move |k| (i, k))) {
        let paint = if (i + k) % 2 == 0 { marble } else { porphyry };
        model.add_at(paint, &tile, [[0.6 * i as f32 - x, 0.0, 0.6 * k as f32 - z]]);
    }
}

/// A bronze figure on a pedestal before the far end, a bench, vases.
fn furniture(model: &mut Model, marble: Paint) {
    let bronze = model.gloss([0.62, 0.42, 0.22], 1.0, 0.35);
    let wood = model.gloss([0.30, 0.17, 0.09], 0.0, 0.5);
    let glaze = model.gloss([0.08, 0.22, 0.34], 0.0, 0.3);
    let clay = model.paint([0.58, 0.30, 0.18]);
    let robe = curve([[0.34, 0.0], [0.29, 0.5], [0.20, 1.0], [0.23, 1.3], [0.18, 1.42], [0.07, 1.5], [0.07, 1.6]], 4);
    let robe = fluted_lathe(&[robe], 88, |turn| 1.0 + 0.05 * (11.0 * TAU * turn).cos());
    let place = Vec3::new(0.2, 0.9, -7.6);
    model.add(marble, block([-0.3, 0.7], [0.0, 0.9], [-8.1, -7.1]));
    model.add_at(bronze, &robe, [place.into()]);
    model.add_at(bronze, &cushion(Vec3::new(0.1, 0.14, 0.12), 2.0, 32), [(place + 1.7 * Vec3::Y).into()]);
    let arm = curve([[0.2, 1.36], [0.33, 1.12], [0.0, 1.04]], 6);
    for side in [-1.0, 1.0] {
        let arm: Vec<Vec3> = arm.iter().map(|p| place + Vec3::new(side * p.x, p.y, 0.9 * (1.36 - p.y))).collect();
        model.add(bronze, tube(&arm, &[0.065; 13], 16));
    }
    model.add_at(wood, &cushion(Vec3::new(0.24, 0.05, 0.85), 12.0, 40), [[1.5, 0.45, -3.0]]);
    model.add_at(wood, &block([-0.18, 0.18], [0.0, 0.42], [-0.06, 0.06]), [[1.5, 0.0, -3.6], [1.5, 0.0, -2.4]]);
    let vase = lathe(&[curve([[0.14, 0.0], [0.28, 0.4], [0.11, 0.76], [0.18, 0.9], [0.1, 0.78]], 6)], 40);
    model.add_at(glaze, &vase, [[1.5, 0.0, -1.4], [1.5, 0.0, 6.2]]);
    model.add_at(clay, &vase, [[-1.5, 0.0, -3.7], [1.45, 0.0, -4.6], [-1.5, 0.0, 5.2]]);
}
