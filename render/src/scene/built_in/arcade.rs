//! A vaulted gallery: light through the arches along one side, no sky from above, shade behind the columns.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};

use super::{
    Model, Paint,
    shapes::{ball, bar, block, curve, cushion, fluted_lathe, lathe, line, prism, sheet, tube},
};
use crate::scene::Mesh;

/// Number of bays along z, and the length of each.
const BAYS: usize = 6;
const BAY: f32 = 3.0;
/// Half the inner width and half the length; the arches are on the side of -x.
const HALF: [f32; 2] = [1.9, 0.5 * BAY * BAYS as f32];
/// Thickness of the walls.
const WALL: f32 = 0.4;
/// Height of the springing line of arches and vaults, rise of the vaults, height of the roof.
const SPRINGING: f32 = 2.6;
const RISE: f32 = 1.6;
const ROOF: f32 = 4.6;

/// The gallery, seen from the middle of its length.
pub fn model() -> Model {
    let mut model = Model::seen([-1.3, 1.65, 3.4], [0.75, 1.75, -4.0], 52.0);
    let plaster = model.paint([0.72, 0.62, 0.48]);
    let lime = model.paint([0.78, 0.76, 0.71]);
    let marble = model.gloss([0.66, 0.62, 0.56], 0.0, 0.4);
    walls(&mut model, plaster, lime);
    arcade(&mut model, marble, lime);
    floor(&mut model, marble);
    panels(&mut model);
    furniture(&mut model, marble);
    model
}

/// The centres of the bays along z; with one more, half a bay earlier, the lines between them.
fn bays() -> impl Iterator<Item = f32> {
    (0..BAYS).map(|i| (i as f32 + 0.5) * BAY - HALF[1])
}

/// The back wall, the ends, the vaults, and a roof with eaves.
fn walls(model: &mut Model, plaster: Paint, lime: Paint) {
    let [x, z] = HALF;
    model.add(plaster, block([x, x + WALL], [-0.3, ROOF], [-z - WALL, z + WALL]));
    for end in [[-z - WALL, -z], [z, z + WALL]] {
        model.add(plaster, block([-x - WALL, x], [-0.3, ROOF], end));
    }
    model.add(lime, block([-x - 1.3, x + WALL], [ROOF, ROOF + 0.2], [-z - WALL, z + WALL]));
    // Each web of a groin vault is a half cylinder cut along the diagonals; it reaches into walls and ribs.
    for [dx, dz] in [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]] {
        let web = sheet([32, 4], |u, v| {
            let (across, up) = (PI * (u - 0.5)).sin_cos();
            let along = across.abs() + v * (1.06 - across.abs());
            let [ex, ez] = [dx * along - dz * across, dz * along + dx * across];
            Vec3::new(x * ex, SPRINGING + RISE * up, 0.5 * BAY * ez)
        });
        model.add_at(lime, &web, bays().map(|z| [0.0, 0.0, z]));
    }
}

/// A wall of `2 half_width` by `2 half_depth` from the springing line to the roof over an elliptical arch.
fn arch(half_width: f32, opening: [f32; 2], half_depth: f32) -> Mesh {
    const PIECES: usize = 24;
    let angle = |i: usize| PI * (i as f32 / PIECES as f32 - 0.5);
    let at = |i: usize| Vec2::new(opening[0] * angle(i).sin(), SPRINGING + opening[1] * angle(i).cos().max(0.0));
    let mut soffit = vec![Vec2::new(-half_width, SPRINGING)];
    soffit.extend((0..=PIECES).map(at));
    soffit.push(Vec2::new(half_width, SPRINGING));
    let mut arch = Mesh::default();
    for ab in soffit.windows(2) {
        let outline = [ab[0], ab[1], ab[1].with_y(ROOF), ab[0].with_y(ROOF)];
        arch.append(&prism(&outline, [-half_depth, half_depth]));
    }
    arch
}

/// The row of columns with its arches, and the ribs from there to pilasters at the back wall.
fn arcade(model: &mut Model, marble: Paint, lime: Paint) {
    let x = -HALF[0] - 0.5 * WALL;
    let opening = 0.5 * BAY - 0.27;
    let wall = arch(0.5 * BAY, [opening; 2], 0.5 * WALL);
    let path: Vec<Vec3> =
        (0..=24).map(|i| Vec2::from_angle(PI * i as f32 / 24.0)).map(|p| Vec3::new(0.0, p.y, p.x)).collect();
    let path: Vec<Vec3> = path.into_iter().map(|p| p * (opening + 0.1)).collect();
    for z in bays() {
        model.add_turned(lime, &wall, 90.0, [x, 0.0, z]);
        model.add_at(marble, &tube(&path, &[0.06; 25], 12), [[-HALF[0], SPRINGING, z]]);
    }
    let shaft = [
        curve([[0.25, 0.12], [0.29, 0.17], [0.25, 0.23]], 4),
        curve([[0.23, 0.23], [0.20, 0.28], [0.22, 0.33]], 4),
        curve([[0.19, 0.33], [0.19, 1.2], [0.165, 2.22]], 4),
        curve([[0.165, 2.2], [0.2, 2.22], [0.165, 2.24]], 4),
        curve([[0.165, 2.24], [0.18, 2.36], [0.27, 2.48]], 6),
    ];
    let shaft = lathe(&shaft, 32);
    let slab = |y: [f32; 2], half: f32| block([-half, half], y, [-half, half]);
    let lines = || (0..=BAYS).map(|i| i as f32 * BAY - HALF[1]);
    for part in [shaft, slab([0.0, 0.12], 0.3), slab([2.48, SPRINGING], 0.3)] {
        model.add_at(marble, &part, lines().map(|z| [x, 0.0, z]));
    }
    model.add_at(lime, &arch(HALF[0], [HALF[0] - 0.1, RISE - 0.12], 0.16), lines().map(|z| [0.0, 0.0, z]));
    model.add_at(lime, &block([-0.12, 0.0], [0.0, 2.48], [-0.2, 0.2]), lines().map(|z| [HALF[0], 0.0, z]));
    model.add_at(marble, &block([-0.2, 0.0], [2.48, SPRINGING], [-0.28, 0.28]), lines().map(|z| [HALF[0], 0.0, z]));
}

/// Polished tiles in two colours, and the ground outside.
fn floor(model: &mut Model, pale: Paint) {
    let dark = model.gloss([0.20, 0.09, 0.06], 0.0, 0.3);
    let ground = model.paint([0.34, 0.32, 0.25]);
    let [x, z] = HALF;
    model.add(ground, block([-16.0, -x - WALL], [-0.6, -0.3], [-z - 8.0, z + 8.0]));
    model.add(ground, block([-x - WALL, x], [-0.5, -0.006], [-z, z]));
    let tile = block([0.003, 0.597], [-0.04, 0.0], [0.003, 0.597]);
    for (i, k) in (0..7).flat_map(|i| (0..30).map(move |k| (i, k))) {
        let paint = if (i + k) % 2 == 0 { pale } else { dark };
        model.add_at(paint, &tile, [[0.6 * i as f32 - x - WALL, 0.0, 0.6 * k as f32 - z]]);
    }
}

/// A dado and painted panels on the back wall.
fn panels(model: &mut Model) {
    let frame = model.paint([0.30, 0.16, 0.10]);
    let colors = [[0.16, 0.30, 0.42], [0.58, 0.20, 0.12], [0.24, 0.36, 0.20]].map(|color| model.paint(color));
    let [x, z] = HALF;
    model.add(frame, block([x - 0.04, x], [0.0, 0.9], [-z, z]));
    for (z, paint) in bays().zip(colors.into_iter().cycle()) {
        let layer = |half: f32, depth: f32| block([x - depth, x], [1.9 - half, 1.9 + half], [z - half, z + half]);
        model.add(frame, layer(0.72, 0.03));
        model.add(paint, layer(0.64, 0.04));
    }
}

/// A bronze figure before the far end, benches, vases.
fn furniture(model: &mut Model, marble: Paint) {
    let bronze = model.gloss([0.62, 0.42, 0.22], 1.0, 0.35);
    let wood = model.gloss([0.30, 0.17, 0.09], 0.0, 0.5);
    let glaze = model.gloss([0.08, 0.22, 0.34], 0.0, 0.3);
    let clay = model.paint([0.58, 0.30, 0.18]);
    let robe = [curve([[0.34, 0.0], [0.29, 0.5], [0.21, 1.0], [0.25, 1.3], [0.22, 1.42], [0.07, 1.5], [0.06, 1.6]], 6)];
    let robe = fluted_lathe(&robe, 96, |turn| 1.0 + 0.05 * (11.0 * TAU * turn).cos());
    let place = [0.3, 0.9, -7.6];
    model.add(marble, block([-0.2, 0.8], [0.0, 0.9], [-8.1, -7.1]));
    model.add_at(bronze, &robe, [place]);
    model.add_at(bronze, &cushion(Vec3::new(0.1, 0.14, 0.12), 2.0, 32), [[place[0], place[1] + 1.7, place[2]]]);
    let _ = (ball(0.1, 8), bar(Vec3::ZERO, Vec3::Y, 0.1, 8));
    for z in [-3.0, 3.0] {
        model.add_at(wood, &cushion(Vec3::new(0.24, 0.05, 0.85), 12.0, 48), [[1.5, 0.45, z]]);
        model.add_at(
            wood,
            &block([-0.18, 0.18], [0.0, 0.42], [-0.06, 0.06]),
            [[1.5, 0.0, z - 0.6], [1.5, 0.0, z + 0.6]],
        );
    }
    let vase = [
        line([0.0, 0.0], [0.14, 0.0]),
        curve([[0.14, 0.0], [0.17, 0.04], [0.28, 0.36], [0.25, 0.58], [0.12, 0.74], [0.12, 0.82], [0.18, 0.9]], 6),
        curve([[0.18, 0.9], [0.1, 0.82], [0.1, 0.74], [0.0, 0.7]], 4),
    ];
    let vase = lathe(&vase, 48);
    model.add_at(glaze, &vase, [[1.5, 0.0, -1.4], [1.5, 0.0, 6.2]]);
    model.add_at(clay, &vase, [[-1.5, 0.0, -3.7], [1.45, 0.0, -4.6], [-1.5, 0.0, 5.2]]);
}
