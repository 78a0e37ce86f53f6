//! A cloth that has fallen over a ball and the floor: folds of every width, in the shade of one another.

use glam::Vec3;

use super::{
    model::{Model, fabric},
    shapes::{ball, block},
};
use crate::scene::Mesh;

/// Threads along a side of the cloth, its width in metres, and how far above the floor it starts.
const THREADS: usize = 72;
const WIDTH: f32 = 2.1;
const START: f32 = 1.06;

/// Radius of the ball under the cloth, which stands on the floor, in metres.
const BALL: f32 = 0.5;
/// Half the thickness of the cloth: how far it stays away from ball and floor.
const SKIN: f32 = 0.012;

/// Time steps of 1/120 s, and rounds of corrections in each.
const STEPS: usize = 300;
const ROUNDS: usize = 8;

/// Pieces into which the gap between two threads is divided when the cloth is drawn.
const REFINEMENT: usize = 3;

/// Cloth, ball and floor.
pub fn model() -> Model {
    let mut model = Model::seen([1.55, 1.45, 2.75], [0.02, 0.30, 0.02], 32.0);
    let floor = model.paint([0.48, 0.46, 0.44]);
    let linen = model.paint([0.62, 0.17, 0.13]);
    let wood = model.paint([0.55, 0.40, 0.26]);

    model.add(floor, block([-12.0, 12.0], [-0.2, 0.0], [-12.0, 12.0]));
    model.add_at(wood, &ball(BALL, 64), [[0.0, BALL, 0.0]]);
    model.add_at(wood, &ball(0.12, 48), [[0.78, 0.12, 0.92], [-0.98, 0.12, 0.62]]);
    model.add(linen, fabric(drawn(&fallen())));
    model
}

/// `[THREADS * THREADS]` positions of the crossings of the threads after the fall: position-based dynamics (Müller et al.
/// 2007) with stretching, shearing and bending springs.
fn fallen() -> Vec<Vec3> {
    let gap = WIDTH / (THREADS - 1) as f32;
    let at = |i: usize| {
        let (x, z) = (i % THREADS, i / THREADS);
        // Turned a little and off the middle, so that no two sides fold alike.
        let (x, z) = (x as f32 * gap - 0.5 * WIDTH, z as f32 * gap - 0.5 * WIDTH);
        Vec3::new(0.94 * x - 0.342 * z + 0.06, START + 0.01 * (9.0 * x).sin() * (7.0 * z).cos(), 0.342 * x + 0.94 * z)
    };
    let mut positions: Vec<Vec3> = (0..THREADS * THREADS).map(at).collect();
    let mut before = positions.clone();
    let springs = springs(gap);
    for _ in 0..STEPS {
        for (p, old) in positions.iter_mut().zip(&mut before) {
            let velocity = 0.985 * (*p - *old);
            *old = *p;
            *p += velocity + Vec3::new(0.0, -9.81 / (120.0 * 120.0), 0.0);
        }
        for _ in 0..ROUNDS {
            for &(a, b, length, stiffness) in &springs {
                let apart = positions[b] - positions[a];
                let distance = apart.length();
                // Bending springs resist being folded, never being stretched.
                if stiffness < 0.5 && distance > length {
                    continue;
                }
                let correction = apart * (0.5 * stiffness * (1.0 - length / distance.max(1e-6)));
                positions[a] += correction;
                positions[b] -= correction;
            }
            for (p, old) in positions.iter_mut().zip(&mut before) {
                stay_outside(p, old);
            }
        }
    }
    positions
}

/// (crossing, crossing, length, stiffness) of the springs between neighbours, across squares, and over the next thread.
fn springs(gap: f32) -> Vec<(usize, usize, f32, f32)> {
    let reaches: [([isize; 2], f32); 6] =
        [([1, 0], 1.0), ([0, 1], 1.0), ([1, 1], 0.6), ([-1, 1], 0.6), ([3, 0], 0.12), ([0, 3], 0.12)];
    let mut springs = Vec::new();
    for i in 0..THREADS * THREADS {
        for ([dx, dz], stiffness) in reaches {
            let [x, z] = [(i % THREADS) as isize + dx, (i / THREADS) as isize + dz];
            let inside = |k: isize| (0..THREADS as isize).contains(&k);
            if inside(x) && inside(z) {
                let length = gap * ((dx * dx + dz * dz) as f32).sqrt();
                springs.push((i, z as usize * THREADS + x as usize, length, stiffness));
            }
        }
    }
    springs
}

/// Moves a point out of ball and floor; there it keeps part of its speed along the surface.
fn stay_outside(p: &mut Vec3, before: &mut Vec3) {
    let center = Vec3::new(0.0, BALL, 0.0);
    let from_center = *p - center;
    let inside = from_center.length() < BALL + SKIN;
    if inside {
        *p = center + from_center.normalize_or(Vec3::Y) * (BALL + SKIN);
    }
    let below = p.y < SKIN;
    if below {
        p.y = SKIN;
    }
    if inside || below {
        *before = before.lerp(*p, 0.25);
    }
}

/// The mesh through the crossings: bicubic between them (Catmull and Rom 1974).
fn drawn(crossings: &[Vec3]) -> Mesh {
    let last = THREADS as isize - 1;
    let crossing = |x: isize, z: isize| crossings[(z.clamp(0, last) * (last + 1) + x.clamp(0, last)) as usize];
    let cubic = |[a, b, c, d]: [Vec3; 4], t: f32| {
        b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)))
    };
    let at = |u: f32, v: f32| {
        let (x, z) = (u * last as f32, (1.0 - v) * last as f32);
        let (left, top) = ((x.floor() as isize).clamp(0, last - 1), (z.floor() as isize).clamp(0, last - 1));
        let row = |z: isize| cubic([-1, 0, 1, 2].map(|k| crossing(left + k, z)), x - left as f32);
        cubic([-1, 0, 1, 2].map(|k| row(top + k)), z - top as f32)
    };
    super::shapes::sheet([REFINEMENT * (THREADS - 1); 2], at)
}
