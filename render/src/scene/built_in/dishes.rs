//! A table laid with crockery: smooth surfaces of revolution, contact shadows, concave insides.

use std::f32::consts::{PI, TAU};

use glam::{Affine3A, Quat, Vec2, Vec3};

use super::{
    model::{Model, Paint},
    shapes::{curve, lathe, line, tube},
};
use crate::scene::Mesh;

/// Height of the table, in metres.
const TABLE: f32 = 0.75;

/// Segments around a vessel.
const SEGMENTS: usize = 72;

/// The table and what stands on it.
pub fn model() -> Model {
    let mut model = Model::seen([0.62, 1.27, 0.98], [0.0, 0.80, -0.02], 29.0);
    let wood = model.paint([0.36, 0.24, 0.15]);
    let porcelain = model.paint([0.76, 0.74, 0.70]);
    let glaze = model.paint([0.30, 0.38, 0.44]);
    let clay = model.paint([0.52, 0.31, 0.22]);
    let sage = model.paint([0.42, 0.47, 0.34]);
    let orange = model.paint([0.68, 0.34, 0.10]);

    table(&mut model, wood);
    teapot(&mut model, glaze, [-0.16, TABLE, -0.13]);
    model.add_at(clay, &vase(), [[0.16, TABLE, -0.24]]);
    for (k, paint) in [porcelain, sage, porcelain, sage].into_iter().enumerate() {
        model.add_at(paint, &plate(0.135), [[0.27, TABLE + 0.0075 * k as f32, 0.06]]);
    }
    model.add_at(porcelain, &bowl(0.085), [[0.27, TABLE + 0.0330, 0.06]]);
    model.add_at(sage, &bowl(0.12), [[-0.05, TABLE, 0.17]]);
    let fruit = [[-0.075, 0.055, 0.155], [-0.005, 0.055, 0.158], [-0.042, 0.056, 0.218], [-0.040, 0.106, 0.176]];
    model.add_at(orange, &ball(0.036), fruit.map(|[x, y, z]| [x, TABLE + y, z]));
    cup(&mut model, porcelain, glaze, [0.13, TABLE, 0.26], 0.4);
    cup(&mut model, porcelain, clay, [-0.29, TABLE, 0.08], 3.4);
    model
}

/// A round table on a turned foot.
fn table(model: &mut Model, paint: Paint) {
    let top = [
        line([0.0, -0.035], [0.54, -0.035]),
        curve([[0.54, -0.035], [0.575, -0.028], [0.585, -0.012], [0.575, -0.002], [0.56, 0.0]], 3),
        line([0.56, 0.0], [0.0, 0.0]),
    ];
    let foot = [
        line([0.0, 0.0], [0.30, 0.0]),
        curve([[0.30, 0.0], [0.31, 0.02], [0.28, 0.05], [0.12, 0.09], [0.06, 0.16]], 4),
        curve([[0.06, 0.16], [0.09, 0.24], [0.06, 0.34], [0.045, 0.50], [0.06, 0.64], [0.16, 0.716]], 4),
    ];
    model.add_at(paint, &lathe(&top, 2 * SEGMENTS), [[0.0, TABLE, 0.0]]);
    model.add(paint, lathe(&foot, SEGMENTS));
}

/// A plate with a foot ring and a wide rim.
fn plate(radius: f32) -> Mesh {
    scaled(
        radius,
        [
            line([0.0, 0.02], [0.52, 0.02]),
            line([0.52, 0.02], [0.53, 0.0]),
            line([0.53, 0.0], [0.57, 0.0]),
            curve([[0.57, 0.0], [0.62, 0.035], [0.80, 0.085], [0.98, 0.125]], 4),
            curve([[0.98, 0.125], [1.0, 0.137], [0.98, 0.145]], 4),
            curve([[0.98, 0.145], [0.82, 0.115], [0.69, 0.088], [0.60, 0.062], [0.50, 0.055]], 3),
            line([0.50, 0.055], [0.0, 0.055]),
        ],
    )
}

/// A round bowl on a foot ring.
fn bowl(radius: f32) -> Mesh {
    scaled(
        radius,
        [
            line([0.0, 0.03], [0.36, 0.03]),
            line([0.36, 0.03], [0.38, 0.0]),
            line([0.38, 0.0], [0.43, 0.0]),
            curve([[0.43, 0.0], [0.44, 0.06], [0.72, 0.20], [0.92, 0.42], [0.985, 0.64]], 5),
            curve([[0.985, 0.64], [0.98, 0.665], [0.95, 0.66]], 4),
            curve([[0.95, 0.66], [0.88, 0.44], [0.68, 0.24], [0.36, 0.12], [0.0, 0.09]], 5),
        ],
    )
}

/// A cup with a handle, turned by `angle` radians, on a saucer.
fn cup(model: &mut Model, saucer: Paint, paint: Paint, place: [f32; 3], angle: f32) {
    model.add_at(saucer, &plate(0.075), [place]);
    let [x, y, z] = place;
    let stand = Affine3A::from_rotation_translation(Quat::from_rotation_y(angle), Vec3::new(x, y + 0.0041, z));
    let body = scaled(
        0.04,
        [
            line([0.0, 0.04], [0.46, 0.04]),
            line([0.46, 0.04], [0.50, 0.0]),
            line([0.50, 0.0], [0.58, 0.0]),
            curve([[0.58, 0.0], [0.60, 0.08], [0.84, 0.36], [0.96, 0.90], [1.02, 1.46]], 5),
            curve([[1.02, 1.46], [1.01, 1.495], [0.97, 1.48]], 4),
            curve([[0.97, 1.48], [0.91, 0.92], [0.78, 0.42], [0.50, 0.20], [0.0, 0.16]], 5),
        ],
    );
    let handle =
        bent_tube([[0.0385, 0.050], [0.052, 0.054], [0.064, 0.044], [0.058, 0.027], [0.0335, 0.017]], 0.0042, 0.0036);
    model.add(paint, body.transformed(&stand));
    model.add(paint, handle.transformed(&stand));
}

/// A teapot: body, lid with a knob, spout and handle.
fn teapot(model: &mut Model, paint: Paint, place: [f32; 3]) {
    let [x, y, z] = place;
    let stand = Affine3A::from_rotation_translation(Quat::from_rotation_y(1.12 * PI), Vec3::new(x, y, z));
    let body = scaled(
        0.1,
        [
            line([0.0, 0.0], [0.62, 0.0]),
            curve([[0.62, 0.0], [0.66, 0.05], [0.92, 0.34], [1.04, 0.72], [0.88, 1.12], [0.56, 1.32]], 5),
            curve([[0.56, 1.32], [0.57, 1.37], [0.53, 1.38]], 3),
            line([0.53, 1.38], [0.50, 1.36]),
            curve([[0.50, 1.36], [0.36, 1.46], [0.16, 1.52], [0.09, 1.54]], 4),
            curve([[0.09, 1.54], [0.07, 1.60], [0.13, 1.68], [0.12, 1.76], [0.0, 1.80]], 4),
        ],
    );
    let spout = [[0.080, 0.050], [0.120, 0.062], [0.142, 0.092], [0.158, 0.124], [0.178, 0.140]];
    let handle = [[-0.082, 0.110], [-0.120, 0.128], [-0.156, 0.110], [-0.152, 0.070], [-0.118, 0.044], [-0.090, 0.038]];
    for part in [body, bent_tube(spout, 0.026, 0.011), bent_tube(handle, 0.010, 0.008)] {
        model.add(paint, part.transformed(&stand));
    }
}

/// A tall vase with a narrow neck.
fn vase() -> Mesh {
    scaled(
        0.3,
        [
            line([0.0, 0.0], [0.17, 0.0]),
            curve([[0.17, 0.0], [0.19, 0.03], [0.27, 0.26], [0.26, 0.48], [0.13, 0.72], [0.11, 0.84], [0.17, 0.98]], 5),
            curve([[0.17, 0.98], [0.175, 0.995], [0.16, 0.995]], 4),
            curve([[0.16, 0.995], [0.10, 0.86], [0.11, 0.74], [0.23, 0.48], [0.0, 0.05]], 5),
        ],
    )
}

/// A sphere on the ground.
fn ball(radius: f32) -> Mesh {
    let meridian = (0..=36).map(|i| radius * Vec2::from_angle(PI * (i as f32 / 36.0 - 0.5)));
    lathe(&[meridian.map(|p| Vec2::new(p.x.max(0.0), p.y)).collect()], SEGMENTS)
}

/// A tube in the xy plane along a smooth path, from one radius to another.
fn bent_tube<const N: usize>(path: [[f32; 2]; N], from: f32, to: f32) -> Mesh {
    let path: Vec<Vec3> = curve(path, 6).into_iter().map(|p| p.extend(0.0)).collect();
    let last = (path.len() - 1) as f32;
    let radii: Vec<f32> = (0..path.len()).map(|i| from + (to - from) * (TAU * 0.25 * i as f32 / last).sin()).collect();
    tube(&path, &radii, 20)
}

/// A vessel whose profile is given in units of `size` metres.
fn scaled<const N: usize>(size: f32, profile: [Vec<Vec2>; N]) -> Mesh {
    lathe(&profile.map(|curve| curve.into_iter().map(|p| size * p).collect()), SEGMENTS)
}
