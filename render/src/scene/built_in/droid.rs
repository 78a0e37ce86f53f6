//! Two droids in a workshop: worn metal and lacquer, joints and cables, roughness that changes over every part.

use std::f32::consts::{PI, TAU};

use glam::{Affine3A, Quat, Vec2, Vec3};

use super::{
    model::{Model, Paint},
    shapes::{ball, bar, block, curve, cushion, lathe, line, tube},
    worn::mapped,
};
use crate::scene::Mesh;

/// Period of the wear of a surface, in metres.
const WEAR: f32 = 0.9;

/// The paints of a droid.
#[derive(Clone, Copy)]
struct Paints {
    shell: Paint,
    trim: Paint,
    steel: Paint,
    rubber: Paint,
    glass: Paint,
}

/// The droids on the workshop's floor.
pub fn model() -> Model {
    let mut model = Model::seen([1.75, 1.35, 3.05], [-0.05, 0.66, 0.0], 31.0);
    let floor = model.worn([0.30, 0.29, 0.28], 0.0, [0.45, 0.9]);
    let paints = Paints {
        shell: model.worn([0.72, 0.70, 0.66], 0.0, [0.40, 0.70]),
        trim: model.worn([0.62, 0.20, 0.05], 0.0, [0.40, 0.70]),
        steel: model.worn([0.56, 0.57, 0.58], 1.0, [0.45, 0.75]),
        rubber: model.gloss([0.05, 0.05, 0.055], 0.0, 0.8),
        glass: model.gloss([0.02, 0.03, 0.04], 0.0, 0.45),
    };
    model.add(floor, mapped(block([-9.0, 9.0], [-0.1, 0.0], [-9.0, 9.0]), 3.0));
    walker(&mut model, paints, DroidPose { turn: 28.0, at: Vec3::new(-0.42, 0.0, -0.10) });
    let brass = model.worn([0.78, 0.58, 0.26], 1.0, [0.45, 0.70]);
    roller(
        &mut model,
        Paints { shell: paints.steel, trim: brass, ..paints },
        DroidPose { turn: 5.0, at: Vec3::new(0.62, 0.0, 0.38) },
    );
    crates(&mut model, paints);
    model
}

/// Position of a droid, and its rotation in degrees.
#[derive(Clone, Copy)]
struct DroidPose {
    turn: f32,
    at: Vec3,
}

impl DroidPose {
    fn put(self, model: &mut Model, paint: Paint, part: Mesh) {
        let turn = Quat::from_rotation_y(self.turn.to_radians());
        model.add(paint, mapped(part.transformed(&Affine3A::from_rotation_translation(turn, self.at)), WEAR));
    }
}

/// Moves a part to its position on a droid.
fn moved(part: Mesh, x: f32, y: f32, z: f32) -> Mesh {
    part.transformed(&Affine3A::from_translation(Vec3::new(x, y, z)))
}

/// The part with its y axis turned to the x axis.
fn lying(part: Mesh) -> Mesh {
    part.transformed(&Affine3A::from_quat(Quat::from_rotation_z(-0.5 * PI)))
}

/// A droid of 1.35 m on two legs.
fn walker(model: &mut Model, paints: Paints, pose: DroidPose) {
    let torso = [
        curve([[0.0, 0.60], [0.12, 0.605], [0.17, 0.63]], 4),
        curve([[0.17, 0.63], [0.225, 0.72], [0.25, 0.84], [0.245, 0.94], [0.20, 1.02]], 6),
        curve([[0.20, 1.02], [0.13, 1.045], [0.0, 1.05]], 4),
    ];
    let belt = [curve([[0.21, 0.655], [0.245, 0.67], [0.245, 0.70], [0.215, 0.715]], 4)];
    let collar = [curve([[0.17, 1.015], [0.20, 1.03], [0.19, 1.06], [0.14, 1.075]], 4)];
    pose.put(model, paints.shell, lathe(&torso, 72));
    pose.put(model, paints.trim, lathe(&belt, 72));
    pose.put(model, paints.steel, lathe(&collar, 64));
    pose.put(model, paints.steel, bar(Vec3::new(0.0, 1.03, 0.0), Vec3::new(0.0, 1.13, 0.0), 0.06, 32));
    head(model, paints, pose);

    // A plate on the chest, with lamps and a row of slots.
    pose.put(model, paints.trim, moved(cushion(Vec3::new(0.11, 0.075, 0.03), 6.0, 48), 0.0, 0.88, 0.232));
    for (x, radius) in [(-0.055, 0.022), (0.0, 0.015), (0.042, 0.015)] {
        pose.put(model, paints.glass, moved(ball(radius, 24), x, 0.90, 0.258));
    }
    for k in 0..4 {
        pose.put(
            model,
            paints.rubber,
            moved(
                cushion(Vec3::new(0.065, 0.005, 0.006), 4.0, 24),
                0.0,
                0.775 - 0.016 * k as f32,
                0.236 - 0.004 * k as f32,
            ),
        );
    }
    for side in [-1.0, 1.0] {
        arm(model, paints, pose, side);
        leg(model, paints, pose, side);
    }
}

/// A wide head with two eyes and an antenna.
fn head(model: &mut Model, paints: Paints, pose: DroidPose) {
    pose.put(model, paints.shell, moved(cushion(Vec3::new(0.19, 0.115, 0.135), 3.2, 72), 0.0, 1.235, 0.0));
    pose.put(model, paints.rubber, moved(cushion(Vec3::new(0.155, 0.066, 0.03), 4.5, 48), 0.0, 1.24, 0.115));
    for side in [-1.0, 1.0] {
        let ring = lathe(&[curve([[0.036, -0.01], [0.048, 0.0], [0.048, 0.02], [0.036, 0.028], [0.030, 0.02]], 4)], 40);
        let forward = ring.transformed(&Affine3A::from_quat(Quat::from_rotation_x(0.5 * PI)));
        pose.put(model, paints.steel, moved(forward, 0.075 * side, 1.245, 0.132));
        pose.put(model, paints.glass, moved(ball(0.034, 32), 0.075 * side, 1.245, 0.132));
        let ear = lathe(
            &[line([0.0, 0.0], [0.05, 0.0]), line([0.05, 0.0], [0.05, 0.022]), line([0.05, 0.022], [0.0, 0.03])],
            32,
        );
        let ear =
            lying(ear).transformed(&Affine3A::from_quat(Quat::from_rotation_y(if side < 0.0 { PI } else { 0.0 })));
        pose.put(model, paints.trim, moved(ear, 0.18 * side, 1.235, 0.0));
    }
    pose.put(model, paints.steel, bar(Vec3::new(-0.10, 1.33, -0.03), Vec3::new(-0.13, 1.53, -0.06), 0.006, 12));
    pose.put(model, paints.trim, moved(ball(0.017, 20), -0.13, 1.535, -0.06));
}

/// An arm of two bars with a claw; the droid's right arm is raised.
fn arm(model: &mut Model, paints: Paints, pose: DroidPose, side: f32) {
    let shoulder = Vec3::new(0.285 * side, 0.955, 0.0);
    let (elbow, wrist) = if side < 0.0 {
        (Vec3::new(-0.47, 0.80, 0.05), Vec3::new(-0.54, 1.00, 0.22))
    } else {
        (Vec3::new(0.40, 0.735, -0.02), Vec3::new(0.40, 0.545, 0.14))
    };
    pose.put(model, paints.steel, bar(Vec3::new(0.2 * side, 0.955, 0.0), shoulder, 0.045, 24));
    pose.put(model, paints.trim, moved(ball(0.078, 40), shoulder.x, shoulder.y, shoulder.z));
    pose.put(model, paints.steel, bar(shoulder, elbow, 0.032, 24));
    pose.put(model, paints.shell, moved(ball(0.052, 36), elbow.x, elbow.y, elbow.z));
    pose.put(model, paints.shell, bar(elbow, elbow.lerp(wrist, 0.75), 0.045, 28));
    pose.put(model, paints.steel, bar(elbow.lerp(wrist, 0.7), wrist, 0.028, 24));
    pose.put(model, paints.rubber, moved(ball(0.04, 28), wrist.x, wrist.y, wrist.z));
    let along = (wrist - elbow).normalize();
    let across = along.cross(Vec3::Y).normalize();
    for k in 0..3 {
        let out = Quat::from_axis_angle(along, TAU * k as f32 / 3.0) * across;
        let path = [
            wrist,
            wrist + 0.05 * along + 0.045 * out,
            wrist + 0.10 * along + 0.040 * out,
            wrist + 0.125 * along + 0.012 * out,
        ];
        pose.put(model, paints.steel, tube(&path, &[0.013, 0.013, 0.011, 0.007], 12));
    }
}

/// A leg with a round foot.
fn leg(model: &mut Model, paints: Paints, pose: DroidPose, side: f32) {
    let (hip, knee, ankle) =
        (Vec3::new(0.11 * side, 0.61, 0.0), Vec3::new(0.15 * side, 0.36, 0.05), Vec3::new(0.15 * side, 0.09, 0.0));
    pose.put(model, paints.steel, moved(ball(0.066, 32), hip.x, hip.y, hip.z));
    pose.put(model, paints.steel, bar(hip, knee, 0.036, 24));
    pose.put(model, paints.trim, moved(ball(0.06, 36), knee.x, knee.y, knee.z));
    pose.put(model, paints.shell, bar(knee.lerp(ankle, 0.12), ankle.lerp(knee, 0.15), 0.055, 32));
    pose.put(model, paints.steel, moved(ball(0.042, 28), ankle.x, ankle.y, ankle.z));
    pose.put(
        model,
        paints.shell,
        moved(cushion(Vec3::new(0.085, 0.045, 0.145), 3.0, 48), ankle.x, 0.052, ankle.z + 0.04),
    );
    pose.put(
        model,
        paints.rubber,
        moved(cushion(Vec3::new(0.092, 0.016, 0.152), 5.0, 48), ankle.x, 0.016, ankle.z + 0.04),
    );
    // A cable behind the leg.
    let path: Vec<Vec3> = curve([[0.62, -0.04], [0.50, -0.13], [0.30, -0.12], [0.12, -0.05]], 8)
        .into_iter()
        .map(|p| Vec3::new(0.13 * side, p.x, p.y))
        .collect();
    pose.put(model, paints.rubber, tube(&path, &vec![0.010; path.len()], 12));
}

/// A droid that is a ball with a dome on it.
fn roller(model: &mut Model, paints: Paints, pose: DroidPose) {
    pose.put(model, paints.shell, moved(ball(0.25, 96), 0.0, 0.25, 0.0));
    // Rings around three axes of the ball.
    for (turn, tilt) in [(0.5, 0.35), (2.2, -0.5), (1.2, 1.25)] {
        let ring =
            lathe(&[curve([[0.2465, -0.03], [0.2545, -0.022], [0.2560, 0.0], [0.2545, 0.022], [0.2465, 0.03]], 4)], 96);
        let turned = ring.transformed(&Affine3A::from_quat(Quat::from_rotation_y(turn) * Quat::from_rotation_x(tilt)));
        pose.put(model, paints.trim, moved(turned, 0.0, 0.25, 0.0));
    }
    let dome = [
        curve([[0.10, 0.475], [0.155, 0.485], [0.165, 0.50]], 4),
        line([0.165, 0.50], [0.165, 0.53]),
        curve([[0.165, 0.53], [0.160, 0.59], [0.125, 0.645], [0.07, 0.675], [0.0, 0.685]], 7),
    ];
    pose.put(model, paints.shell, lathe(&dome, 72));
    pose.put(
        model,
        paints.trim,
        lathe(&[curve([[0.164, 0.505], [0.171, 0.51], [0.171, 0.522], [0.164, 0.527]], 3)], 72),
    );
    let eye = Vec3::new(0.03, 0.59, 0.14);
    pose.put(model, paints.rubber, moved(ball(0.048, 36), eye.x, eye.y, eye.z));
    pose.put(model, paints.glass, moved(ball(0.032, 32), eye.x + 0.006, eye.y + 0.004, eye.z + 0.026));
    pose.put(model, paints.steel, bar(Vec3::new(-0.06, 0.66, -0.02), Vec3::new(-0.07, 0.80, -0.03), 0.005, 12));
}

/// Crates and a pipe behind the droids.
fn crates(model: &mut Model, paints: Paints) {
    let shadow = model.worn([0.16, 0.24, 0.30], 0.0, [0.45, 0.75]);
    for (half, turn, at) in [
        (Vec3::new(0.34, 0.26, 0.27), 12.0, [-1.15, 0.26, -0.95]),
        (Vec3::new(0.24, 0.19, 0.22), -18.0, [-1.10, 0.71, -0.98]),
        (Vec3::new(0.30, 0.22, 0.24), -8.0, [0.62, 0.22, -1.0]),
    ] {
        model.add_turned(shadow, &mapped(cushion(half, 14.0, 96), WEAR), turn, at);
        for x in [-0.55, 0.55] {
            let strap =
                moved(cushion(Vec3::new(0.025, half.y + 0.006, half.z + 0.006), 14.0, 96), x * half.x, 0.0, 0.0);
            model.add_turned(paints.steel, &mapped(strap, WEAR), turn, at);
        }
    }
    let pipe: Vec<Vec3> = curve([[-3.0, -1.5], [-1.0, -1.45], [0.6, -1.55], [3.0, -1.5]], 10)
        .into_iter()
        .map(|p: Vec2| Vec3::new(p.x, 0.08, p.y))
        .collect();
    model.add(paints.steel, mapped(tube(&pipe, &vec![0.08; pipe.len()], 32), WEAR));
}
