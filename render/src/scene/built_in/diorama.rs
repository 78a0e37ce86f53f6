//! A diorama on a round base: hills, a cottage, a tower, trees, a pond under a bridge. Many small shapes in one another's shade.

use std::f32::consts::{PI, TAU};

use glam::{Affine3A, Quat, Vec2, Vec3};

use super::{
    model::{Model, Paint},
    shapes::{ball, bar, block, curve, cushion, lathe, line, prism, sheet, tube},
};
use crate::{
    random::{Purpose, Stream},
    scene::Mesh,
};

/// Radius of the land, in metres.
const RADIUS: f32 = 1.0;
/// The pond's middle, radius and level.
const POND: [f32; 4] = [0.30, 0.36, 0.30, -0.035];
/// Positions of cottage and tower, and the extent of the flat ground around each.
const COTTAGE: [f32; 3] = [-0.34, 0.20, 0.30];
const TOWER: [f32; 3] = [0.26, -0.50, 0.20];

/// The land and all that is on it.
pub fn model() -> Model {
    let mut model = Model::seen([1.62, 1.75, 2.85], [0.0, 0.17, 0.0], 31.5);
    let table = model.paint([0.50, 0.48, 0.46]);
    let wood = model.gloss([0.30, 0.17, 0.09], 0.0, 0.55);
    let grass = model.paint([0.27, 0.36, 0.13]);
    let water = model.gloss([0.05, 0.14, 0.17], 0.0, 0.45);

    model.add(table, block([-8.0, 8.0], [-0.6, -0.24], [-8.0, 8.0]));
    model.add(wood, base());
    model.add(grass, land());
    model.add_at(water, &lathe(&[line([POND[2] + 0.06, 0.0], [0.0, 0.0])], 64), [[POND[0], POND[3], POND[1]]]);
    cottage(&mut model);
    tower(&mut model);
    bridge(&mut model);
    trees(&mut model);
    rocks(&mut model);
    fence(&mut model);
    model
}

/// The turned base.
fn base() -> Mesh {
    let profile = [
        curve([[1.10, -0.24], [1.12, -0.22], [1.10, -0.18], [1.04, -0.15]], 5),
        curve([[1.04, -0.15], [1.03, -0.10], [1.06, -0.06], [1.06, -0.03], [1.02, -0.02]], 5),
        line([1.02, -0.02], [0.98, -0.06]),
    ];
    lathe(&profile, 144)
}

/// Height of the ground: hills behind, a basin for the pond, and level ground under what stands on it.
fn ground(x: f32, z: f32) -> f32 {
    let near = |[cx, cz, radius]: [f32; 3]| (-((x - cx).powi(2) + (z - cz).powi(2)) / (radius * radius)).exp();
    let hills = 0.30 * near([-0.45, -0.55, 0.38]) + 0.22 * near([0.30, -0.55, 0.34]) + 0.10 * near([0.75, -0.05, 0.25]);
    let bumps = 0.012 * (9.0 * x + 2.0).sin() * (8.0 * z).cos() + 0.006 * (21.0 * x).cos() * (19.0 * z + 1.0).sin();
    let basin = 0.16 * near([POND[0], POND[1], 0.8 * POND[2]]);
    let open = hills + bumps - basin;
    let level = |[cx, cz, radius]: [f32; 3], open: f32, height: f32| {
        let away = ((x - cx).hypot(z - cz) / radius - 0.7).clamp(0.0, 0.6) / 0.6;
        let t = away * away * (3.0 - 2.0 * away);
        height + (open - height) * t
    };
    let rim = ((RADIUS - x.hypot(z)) / 0.1).clamp(0.0, 1.0);
    rim * level(TOWER, level(COTTAGE, open, 0.03), 0.22) - 0.02 * (1.0 - rim)
}

/// The ground as a disc.
fn land() -> Mesh {
    sheet([288, 144], |u, v| {
        let radius = RADIUS * (1.0 - v).clamp(1e-4, 1.0);
        let (sin, cos) = (TAU * u).sin_cos();
        let (x, z) = (radius * sin, radius * cos);
        Vec3::new(x, ground(x, z), z)
    })
}

/// Puts a shape on the ground, turned by `turn` degrees.
fn stand(model: &mut Model, paint: Paint, part: &Mesh, turn: f32, [x, z]: [f32; 2]) {
    model.add_turned(paint, part, turn, [x, ground(x, z), z]);
}

/// Walls with door and windows, a steep roof, a chimney.
fn cottage(model: &mut Model) {
    let plaster = model.paint([0.72, 0.66, 0.55]);
    let beam = model.paint([0.22, 0.13, 0.08]);
    let tiles = model.paint([0.50, 0.20, 0.12]);
    let brick = model.paint([0.45, 0.27, 0.20]);
    let glass = model.gloss([0.08, 0.10, 0.12], 0.0, 0.45);
    let [x, z] = [COTTAGE[0], COTTAGE[1]];
    let mut put = |paint: Paint, part: Mesh| stand(model, paint, &part, 24.0, [x, z]);
    let (w, d, h) = (0.20, 0.14, 0.17);

    put(brick, block([-w - 0.012, w + 0.012], [-0.05, 0.02], [-d - 0.012, d + 0.012]));
    put(plaster, block([-w, w], [0.0, h], [-d, d]));
    let gable = [Vec2::new(-d, h), Vec2::new(d, h), Vec2::new(0.0, h + 0.155)];
    let turned = Affine3A::from_quat(Quat::from_rotation_y(0.5 * PI));
    put(plaster, prism(&gable, [-w, w]).transformed(&turned));
    for side in [-1.0, 1.0_f32] {
        for x in [-w, -0.34 * w, 0.34 * w, w] {
            put(beam, block([x - 0.009, x + 0.009], [0.0, h], [side * d - 0.006, side * d + 0.006]));
        }
        put(beam, block([-w, w], [h - 0.014, h], [side * d - 0.007, side * d + 0.007]));
        // Rows of tiles, each standing over the one below.
        for row in 0..9 {
            let t = |k: f32| {
                let s = k / 9.0;
                Vec2::new(side * (d + 0.035) * (1.0 - s), h - 0.036 + (0.155 + 0.055) * s)
            };
            let (low, high) = (t(row as f32), t(row as f32 + 1.25));
            let mut outline = [low, low + Vec2::new(0.0, 0.020), high + Vec2::new(0.0, 0.010), high];
            if side < 0.0 {
                outline.reverse();
            }
            put(tiles, prism(&outline, [-w - 0.035, w + 0.035]).transformed(&turned));
        }
        for x in [-0.67 * w, 0.67 * w] {
            put(beam, block([x - 0.034, x + 0.034], [0.065, 0.135], [side * d - 0.010, side * d + 0.010]));
            for k in [-1.0, 1.0] {
                let x = x + 0.0145 * k;
                put(glass, block([x - 0.012, x + 0.012], [0.072, 0.128], [side * d - 0.012, side * d + 0.012]));
            }
        }
    }
    put(beam, block([-0.032, 0.032], [0.0, 0.118], [d, d + 0.010]));
    put(brick, block([-0.05, 0.05], [-0.03, 0.012], [d, d + 0.06]));
    put(brick, block([0.09, 0.145], [h, h + 0.20], [-0.065, -0.01]));
    put(brick, block([0.083, 0.152], [h + 0.20, h + 0.218], [-0.072, -0.003]));
}

/// A round tower with battlements.
fn tower(model: &mut Model) {
    let stone = model.paint([0.46, 0.44, 0.41]);
    let dark = model.paint([0.08, 0.07, 0.06]);
    let slate = model.paint([0.20, 0.24, 0.30]);
    let [x, z] = [TOWER[0], TOWER[1]];
    let mut put = |paint: Paint, part: Mesh| stand(model, paint, &part, 12.0, [x, z]);
    let wall = [
        curve([[0.145, -0.04], [0.135, 0.02], [0.125, 0.10], [0.120, 0.34]], 6),
        curve([[0.120, 0.34], [0.130, 0.355], [0.142, 0.365], [0.142, 0.40]], 4),
        line([0.142, 0.40], [0.0, 0.40]),
    ];
    put(stone, lathe(&wall, 72));
    for k in 0..10 {
        let turn = Quat::from_rotation_y(TAU * k as f32 / 10.0);
        let tooth = block([-0.026, 0.026], [0.40, 0.438], [0.114, 0.141]);
        put(stone, tooth.transformed(&Affine3A::from_quat(turn)));
        let slit = block([-0.008, 0.008], [0.17, 0.225], [0.10, 0.1265]);
        if k % 2 == 0 {
            put(dark, slit.transformed(&Affine3A::from_quat(turn)));
        }
    }
    let turret = [line([0.075, 0.38], [0.075, 0.52]), line([0.098, 0.51], [0.0, 0.70])];
    put(stone, lathe(&turret[..1], 40));
    put(slate, lathe(&turret[1..], 40));
    put(dark, block([-0.035, 0.035], [0.0, 0.09], [0.10, 0.138]));
    put(dark, bar(Vec3::Y * 0.68, Vec3::Y * 0.80, 0.004, 8));
    let flag = model.paint([0.62, 0.12, 0.10]);
    let cloth =
        sheet([24, 6], |u, v| Vec3::new(0.11 * u, 0.735 + 0.06 * v * (1.0 - 0.35 * u), 0.012 * (9.0 * u).sin() * u));
    stand(model, flag, &cloth, 12.0, [x, z]);
}

/// An arched bridge over the pond, with railings.
fn bridge(model: &mut Model) {
    let wood = model.paint([0.46, 0.14, 0.10]);
    let turn = Quat::from_rotation_y(0.95);
    let place = Affine3A::from_rotation_translation(turn, Vec3::new(POND[0], 0.0, POND[1]));
    let arch = |t: f32| Vec2::new(0.40 * t, 0.105 - 0.115 * t * t);
    for k in -16..=16 {
        let p = arch(k as f32 / 16.0);
        let plank = block([p.x - 0.0105, p.x + 0.0105], [p.y - 0.008, p.y + 0.004], [-0.075, 0.075]);
        model.add(wood, plank.transformed(&place));
    }
    for z in [-0.07, 0.07] {
        let along = |lift: f32| -> Vec<Vec3> {
            (-16..=16).map(|k| (arch(k as f32 / 16.0) + lift * Vec2::Y).extend(z)).collect()
        };
        for (lift, radius) in [(-0.014, 0.009), (0.075, 0.006), (0.042, 0.004)] {
            model.add(wood, tube(&along(lift), &[radius; 33], 10).transformed(&place));
        }
        for k in -5..=5 {
            let foot = arch(k as f32 / 5.0).extend(z);
            model.add(wood, bar(foot, foot + 0.088 * Vec3::Y, 0.006, 8).transformed(&place));
        }
    }
}

/// Whether a tree or rock of a radius fits at a place: on the land, off the water and away from the buildings.
fn is_free([x, z]: [f32; 2], radius: f32, taken: &[[f32; 3]]) -> bool {
    let apart = |&[cx, cz, other]: &[f32; 3]| (x - cx).hypot(z - cz) > radius + other;
    let bridge_ends = [[0.56, 0.0, 0.14], [0.06, 0.70, 0.14]];
    x.hypot(z) + radius < 0.96
        && apart(&[POND[0], POND[1], POND[2] + 0.02])
        && apart(&[COTTAGE[0], COTTAGE[1], 0.27])
        && apart(&[-0.20, 0.50, 0.16])
        && apart(&[TOWER[0], TOWER[1], 0.15])
        && bridge_ends.iter().all(apart)
        && taken.iter().all(apart)
}

/// Firs and round trees wherever there is room.
fn trees(model: &mut Model) {
    let bark = model.paint([0.25, 0.16, 0.10]);
    let needles = [[0.07, 0.19, 0.09], [0.10, 0.24, 0.11]].map(|color| model.paint(color));
    let leaves = [[0.42, 0.42, 0.10], [0.52, 0.30, 0.07], [0.30, 0.40, 0.12]].map(|color| model.paint(color));
    let mut random = Stream::new(8, Purpose::Bake, 1);
    let mut taken: Vec<[f32; 3]> = Vec::new();
    for k in 0..900 {
        let at = [2.0 * random.uniform() - 1.0, 2.0 * random.uniform() - 1.0];
        let size = 0.75 + 0.5 * random.uniform();
        if !is_free(at, 0.062 * size, &taken) || taken.len() == 62 {
            continue;
        }
        taken.push([at[0], at[1], 0.062 * size]);
        let turn = 360.0 * random.uniform();
        let scale = Affine3A::from_scale(Vec3::splat(size));
        let trunk = bar(Vec3::new(0.0, -0.03, 0.0), Vec3::new(0.0, 0.09, 0.0), 0.012, 10);
        stand(model, bark, &trunk.transformed(&scale), turn, at);
        if at[1] < 0.1 || k % 3 == 0 {
            stand(model, needles[k % 2], &fir().transformed(&scale), turn, at);
        } else {
            stand(model, leaves[k % 3], &crown(k as f32).transformed(&scale), turn, at);
        }
    }
}

/// The branches of a fir: cones, each under the next.
fn fir() -> Mesh {
    let mut fir = Mesh::default();
    for tier in 0..5 {
        let low = 0.045 + 0.052 * tier as f32;
        let radius = 0.085 - 0.0135 * tier as f32;
        let skirt = [
            curve([[0.2 * radius, low + 0.022], [0.7 * radius, low + 0.004], [radius, low]], 3),
            curve([[radius, low], [0.55 * radius, low + 0.035], [0.004, low + 0.095]], 3),
        ];
        fir.append(&super::shapes::fluted_lathe(&skirt, 54, |turn| {
            1.0 - 0.16 * (9.0 * PI * turn + tier as f32).sin().abs()
        }));
    }
    fir
}

/// The lumpy crown of a round tree.
fn crown(seed: f32) -> Mesh {
    let mut crown = ball(0.072, 40);
    for p in &mut crown.positions {
        let wave = (70.0 * p.x + seed).sin() * (64.0 * p.y + 2.0 * seed).sin() * (67.0 * p.z).cos();
        *p *= 1.0 + 0.13 * wave;
        p.y = 1.1 * p.y + 0.135;
    }
    smooth(crown)
}

/// The shape with normals from its triangles, weighted by their areas. Vertices at the seam of a ball keep their own.
fn smooth(mut shape: Mesh) -> Mesh {
    let old = std::mem::take(&mut shape.normals);
    let mut sums = vec![Vec3::ZERO; shape.positions.len()];
    for (t, indices) in shape.triangles.iter().enumerate() {
        let [a, b, c] = shape.corners(t);
        for &i in indices {
            sums[i as usize] += (b - a).cross(c - a);
        }
    }
    shape.normals = sums.iter().zip(old).map(|(sum, old)| sum.normalize_or(old)).collect();
    shape
}

/// Stones at the water and on the hills.
fn rocks(model: &mut Model) {
    let stone = model.paint([0.40, 0.39, 0.37]);
    let mut random = Stream::new(8, Purpose::Bake, 2);
    for k in 0..42 {
        let turn = TAU * random.uniform();
        let [x, z, size] = if k < 26 {
            let radius = POND[2] * (0.90 + 0.10 * random.uniform());
            [POND[0] + radius * turn.sin(), POND[1] + radius * turn.cos(), 0.016 + 0.022 * random.uniform()]
        } else {
            let radius = 0.35 * random.uniform().sqrt();
            [-0.5 + radius * turn.sin(), -0.5 + radius * turn.cos(), 0.02 + 0.03 * random.uniform()]
        };
        let half = size * Vec3::new(1.0 + 0.5 * random.uniform(), 0.6 + 0.3 * random.uniform(), 1.0);
        stand(model, stone, &cushion(half, 3.0, 24), turn.to_degrees(), [x, z]);
    }
}

/// A fence along the front of the garden.
fn fence(model: &mut Model) {
    let paint = model.paint([0.74, 0.72, 0.68]);
    const POSTS: usize = 19;
    let post = |k: usize| {
        let turn = -1.35 + 1.15 * k as f32 / (POSTS - 1) as f32;
        let (x, z) = (0.90 * turn.sin(), 0.90 * turn.cos());
        Vec3::new(x, ground(x, z), z)
    };
    for k in 0..POSTS {
        model.add(paint, bar(post(k) - 0.02 * Vec3::Y, post(k) + 0.075 * Vec3::Y, 0.008, 8));
        if k + 1 < POSTS {
            for lift in [0.030, 0.058] {
                model.add(paint, bar(post(k) + lift * Vec3::Y, post(k + 1) + lift * Vec3::Y, 0.005, 6));
            }
        }
    }
}
