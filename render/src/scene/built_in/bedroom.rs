//! A bedroom: light through a window and from the side that is left open, soft shade in corners and under the bed.

use std::f32::consts::PI;

use glam::{Affine3A, Quat, Vec3};

use super::{
    model::{Model, Paint, fabric},
    shapes::{ball, bar, block, curve, cushion, lathe, line, sheet},
    worn::mapped,
};
use crate::scene::Mesh;

/// The room: half its width, its depth (towards -z from the open side), its height.
const ROOM: [f32; 3] = [2.1, 4.0, 2.6];
/// The window in the left wall: z from and to, y from and to.
const WINDOW: [f32; 4] = [-3.05, -0.75, 0.45, 2.2];
/// The bed's middle, half its width and length, the top of its frame.
const BED: [f32; 5] = [0.55, -2.7, 0.82, 1.05, 0.30];

/// The furnished room.
pub fn model() -> Model {
    let mut model = Model::seen([-0.65, 1.52, 2.75], [0.12, 0.86, -2.0], 42.0);
    let plaster = model.paint([0.74, 0.71, 0.66]);
    let accent = model.paint([0.33, 0.42, 0.42]);
    let trim = model.paint([0.80, 0.79, 0.76]);
    let oak = model.worn([0.46, 0.30, 0.17], 0.0, [0.45, 0.75]);
    let walnut = model.worn([0.23, 0.13, 0.08], 0.0, [0.40, 0.65]);
    let brass = model.worn([0.80, 0.62, 0.30], 1.0, [0.40, 0.60]);

    room(&mut model, plaster, accent, trim);
    floor(&mut model, oak, walnut);
    bed(&mut model, walnut);
    nightstand(&mut model, walnut, brass);
    curtains(&mut model, brass);
    wardrobe(&mut model, oak, brass);
    pictures(&mut model, walnut, trim);
    model
}

/// Three walls, the left one with a window, the ceiling, and boards along the floor.
fn room(model: &mut Model, plaster: Paint, accent: Paint, trim: Paint) {
    let [x, depth, height] = ROOM;
    let [z0, z1, y0, y1] = WINDOW;
    let left = [-x - 0.25, -x];
    model.add(accent, block([-x, x], [0.0, height], [-depth - 0.1, -depth]));
    model.add(plaster, block([x, x + 0.1], [0.0, height], [-depth - 0.1, 0.4]));
    model.add(plaster, block([-x - 0.25, x + 0.1], [height, height + 0.1], [-depth - 0.1, 0.4]));
    model.add(plaster, block(left, [0.0, height], [-depth - 0.1, z0]));
    model.add(plaster, block(left, [0.0, height], [z1, 0.4]));
    model.add(plaster, block(left, [0.0, y0], [z0, z1]));
    model.add(plaster, block(left, [y1, height], [z0, z1]));

    // Frame and bars of the window, the sill.
    let pane = [-x - 0.16, -x - 0.12];
    for z in [z0, 0.5 * (z0 + z1), z1] {
        model.add(trim, block(pane, [y0, y1], [z - 0.03, z + 0.03]));
    }
    for y in [y0, y0 + 0.62 * (y1 - y0), y1] {
        model.add(trim, block(pane, [y - 0.03, y + 0.03], [z0, z1]));
    }
    model.add(trim, block([-x - 0.2, -x + 0.08], [y0 - 0.04, y0], [z0 - 0.06, z1 + 0.06]));

    let board = 0.02;
    model.add(trim, block([-x, x], [0.0, 0.1], [-depth, -depth + board]));
    model.add(trim, block([x - board, x], [0.0, 0.1], [-depth, 0.4]));
    model.add(trim, block([-x, -x + board], [0.0, 0.1], [-depth, 0.4]));
    model.add(trim, block([-x, x], [height - 0.07, height], [-depth, -depth + 0.05]));
    model.add(trim, block([x - 0.05, x], [height - 0.07, height], [-depth, 0.4]));
}

/// Boards of two woods with narrow gaps, and a round rug.
fn floor(model: &mut Model, oak: Paint, dark: Paint) {
    let [x, depth, _] = ROOM;
    const BOARDS: usize = 24;
    let width = 2.0 * x / BOARDS as f32;
    model.add(dark, block([-x - 0.25, x + 0.1], [-0.12, -0.012], [-depth - 0.1, 0.45]));
    for i in 0..BOARDS {
        let left = i as f32 * width - x;
        let end = -depth + 1.5 + 1.1 * ((7 * i % 5) as f32) / 5.0;
        for z in [[-depth, end - 0.002], [end + 0.002, 0.4]] {
            model.add(oak, mapped(block([left + 0.002, left + width - 0.002], [-0.02, 0.0], z), 1.7));
        }
    }
    let rug = model.paint([0.62, 0.55, 0.45]);
    let band = model.paint([0.50, 0.22, 0.16]);
    let ring = |inner: f32, outer: f32| {
        lathe(
            &[curve([[outer, 0.0], [outer + 0.006, 0.007], [outer, 0.014]], 3), line([outer, 0.014], [inner, 0.014])],
            96,
        )
    };
    model.add_at(rug, &ring(0.0, 0.62), [[-0.95, 0.0, -1.05]]);
    model.add_at(band, &ring(0.625, 0.70), [[-0.95, 0.0, -1.05]]);
    model.add_at(rug, &ring(0.706, 0.80), [[-0.95, 0.0, -1.05]]);
}

/// Frame, headboard, mattress, pillows and a blanket that hangs over the sides.
fn bed(model: &mut Model, wood: Paint) {
    let linen = model.paint([0.78, 0.76, 0.72]);
    let blanket = model.paint([0.20, 0.33, 0.44]);
    let ochre = model.paint([0.70, 0.45, 0.12]);
    let [x, z, half_x, half_z, top] = BED;
    let at = |part: Mesh, dx: f32, y: f32, dz: f32| {
        part.transformed(&Affine3A::from_translation(Vec3::new(x + dx, y, z + dz)))
    };
    let wooden = |part: Mesh| mapped(part, 0.8);

    model.add(wood, wooden(at(cushion(Vec3::new(half_x + 0.05, 0.09, half_z + 0.05), 14.0, 96), 0.0, top - 0.05, 0.0)));
    model.add(wood, wooden(at(cushion(Vec3::new(half_x + 0.07, 0.50, 0.04), 10.0, 96), 0.0, 0.62, -half_z - 0.06)));
    for [dx, dz] in [[-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]] {
        let [dx, dz] = [dx * (half_x - 0.06), dz * (half_z - 0.08)];
        model.add(wood, wooden(at(bar(Vec3::ZERO, Vec3::new(0.0, top - 0.1, 0.0), 0.035, 20), dx, 0.0, dz)));
    }
    model.add(linen, at(cushion(Vec3::new(half_x, 0.125, half_z), 7.0, 128), 0.0, top + 0.13, 0.0));
    for (dx, turn) in [(-0.40, 4.0), (0.40, -6.0)] {
        model.add_turned(linen, &pillow(0.36, 0.24), turn, [x + dx, top + 0.36, z - 0.74]);
    }
    model.add_turned(ochre, &pillow(0.22, 0.20), 12.0, [x - 0.08, top + 0.43, z - 0.46]);
    model.add(blanket, fabric(at(covers(half_x, top), 0.0, 0.0, 0.0)));
}

/// A pillow of `half_x` by `half_y`, leaning back.
fn pillow(half_x: f32, half_y: f32) -> Mesh {
    let lean = Affine3A::from_quat(Quat::from_rotation_x(-0.62));
    let plump = cushion(Vec3::new(half_x, half_y, 0.10), 2.6, 64);
    plump.transformed(&lean)
}

/// The blanket: over the mattress, down at both sides in folds, with its upper end turned back.
fn covers(half_x: f32, top: f32) -> Mesh {
    let height = top + 0.268;
    sheet([160, 160], |u, v| {
        // Along u around the bed's cross-section: up one side, over the top, down the other.
        let drop = 0.36;
        let around = (u - 0.5) * 2.0 * (half_x + drop);
        let beyond = (around.abs() - half_x).max(0.0);
        // The foot end hangs over too: `foot` metres of it.
        let along = 1.30 - 1.66 * v;
        let foot = (along - 1.06).max(0.0);
        let z = along.min(1.06) + 0.03 * (1.0 - (-foot / 0.03).exp());
        let fold = (13.0 * z + 2.0 * (3.0 * z).sin() + 4.0 * around.signum()).sin();
        let corner = 0.03;
        let side = (around.abs().min(half_x)
            + corner * (1.0 - (-beyond / corner).exp())
            + 0.055 * beyond / drop * (1.0 + fold))
            .copysign(around);
        let sag = corner * (1.0 - (-((half_x - around.abs()).max(0.0)) / corner).exp()) - corner;
        let wrinkle = 0.007 * (9.0 * z + 5.0 * around).sin() * (7.0 * around - 3.0 * z).sin();
        let turned_back = 0.028 * (-((v - 0.97) / 0.06).powi(2)).exp();
        Vec3::new(side, height + sag + wrinkle + turned_back - beyond.max(foot), z)
    })
}

/// A small cabinet with a lamp, a book and a mug.
fn nightstand(model: &mut Model, wood: Paint, brass: Paint) {
    let shade = model.paint([0.80, 0.72, 0.58]);
    let glaze = model.gloss([0.55, 0.18, 0.12], 0.0, 0.5);
    let paper = model.paint([0.25, 0.36, 0.30]);
    let [x, z] = [-0.70, -3.55];
    let at = |part: Mesh, dx: f32, y: f32, dz: f32| {
        part.transformed(&Affine3A::from_translation(Vec3::new(x + dx, y, z + dz)))
    };
    model.add(wood, mapped(at(cushion(Vec3::new(0.27, 0.17, 0.21), 16.0, 96), 0.0, 0.39, 0.0), 0.8));
    for [dx, dz] in [[-0.2, 0.14], [0.2, 0.14], [-0.2, -0.14], [0.2, -0.14]] {
        model.add(wood, mapped(at(bar(Vec3::ZERO, Vec3::Y * 0.25, 0.018, 16), dx, 0.0, dz), 0.8));
    }
    for y in [0.31, 0.46] {
        model.add(wood, mapped(at(cushion(Vec3::new(0.24, 0.065, 0.012), 16.0, 48), 0.0, y, 0.208), 0.8));
        model.add(brass, mapped(at(ball(0.016, 24), 0.0, y, 0.232), 0.5));
    }
    let foot = [
        curve([[0.10, 0.0], [0.105, 0.012], [0.06, 0.03], [0.02, 0.045], [0.016, 0.07]], 4),
        curve([[0.016, 0.07], [0.05, 0.13], [0.055, 0.18], [0.02, 0.24], [0.012, 0.30]], 5),
    ];
    model.add(brass, mapped(at(lathe(&foot, 48), -0.08, 0.56, -0.02), 0.5));
    let lampshade = [line([0.17, 0.27], [0.105, 0.49]), line([0.100, 0.49], [0.165, 0.27])];
    model.add(shade, at(lathe(&lampshade, 72), -0.08, 0.56, -0.02));
    let mug = [
        curve([[0.0, 0.0], [0.034, 0.002], [0.038, 0.012], [0.040, 0.05], [0.041, 0.09]], 4),
        curve([[0.041, 0.09], [0.039, 0.094], [0.037, 0.09]], 3),
        curve([[0.037, 0.09], [0.036, 0.05], [0.034, 0.014], [0.0, 0.01]], 4),
    ];
    model.add(glaze, at(lathe(&mug, 48), 0.16, 0.56, 0.10));
    model.add_turned(paper, &block([-0.07, 0.07], [0.0, 0.028], [-0.10, 0.10]), 20.0, [x + 0.10, 0.56, z - 0.08]);
}

/// Two curtains in folds beside the window, on a rod.
fn curtains(model: &mut Model, brass: Paint) {
    let cotton = model.paint([0.72, 0.62, 0.48]);
    let [z0, z1, _, top] = WINDOW;
    let x = -ROOM[0] + 0.09;
    let rod = Vec3::new(x, top + 0.17, 0.0);
    model.add(brass, mapped(bar(rod.with_z(z0 - 0.45), rod.with_z(z1 + 0.45), 0.014, 20), 0.5));
    for z in [z0 - 0.46, z1 + 0.46] {
        model.add_at(brass, &mapped(ball(0.03, 28), 0.5), [[x, rod.y, z]]);
    }
    for (from, to) in [(z0 - 0.40, z0 + 0.10), (z1 - 0.10, z1 + 0.40)] {
        model.add(
            cotton,
            sheet([220, 24], |u, v| {
                let depth = 0.045 * (1.0 - 0.35 * v);
                let fold = (7.0 * 2.0 * PI * u + 0.8 * (5.0 * u).sin()).sin() + 0.25 * (3.0 * v + 11.0 * u).sin();
                Vec3::new(x + depth * fold, 0.03 + (rod.y - 0.03) * v, to + (from - to) * u)
            }),
        );
    }
}

/// A wardrobe against the right wall, seen from the side of its doors.
fn wardrobe(model: &mut Model, wood: Paint, brass: Paint) {
    let [x, ..] = ROOM;
    let at = |part: Mesh, px: f32, y: f32, z: f32| {
        mapped(part.transformed(&Affine3A::from_translation(Vec3::new(px, y, z))), 1.1)
    };
    model.add(wood, at(cushion(Vec3::new(0.28, 1.0, 0.55), 24.0, 128), x - 0.29, 1.03, -0.75));
    for z in [-1.01, -0.49] {
        model.add(wood, at(cushion(Vec3::new(0.014, 0.92, 0.245), 24.0, 96), x - 0.575, 1.05, z));
        let handle = z + if z < -0.75 { 0.18 } else { -0.18 };
        model.add(brass, at(cushion(Vec3::new(0.012, 0.09, 0.01), 3.0, 32), x - 0.60, 1.05, handle));
    }
}

/// Framed pictures over the bed.
fn pictures(model: &mut Model, frame: Paint, mat: Paint) {
    let prints = [[0.55, 0.30, 0.20], [0.22, 0.34, 0.40], [0.62, 0.52, 0.30]].map(|color| model.paint(color));
    let wall = -ROOM[1];
    for (k, &print) in prints.iter().enumerate() {
        let x = BED[0] + 0.58 * (k as f32 - 1.0);
        let layer = |half: [f32; 2], z: f32| {
            block([x - half[0], x + half[0]], [1.62 - half[1], 1.62 + half[1]], [wall, wall + z])
        };
        model.add(frame, mapped(layer([0.21, 0.27], 0.02), 0.8));
        model.add(mat, layer([0.19, 0.25], 0.023));
        model.add(print, layer([0.13, 0.17], 0.025));
        model.add_at(mat, &ball(0.06, 32), [[x, 1.58 + 0.04 * k as f32, wall - 0.026]]);
    }
}
