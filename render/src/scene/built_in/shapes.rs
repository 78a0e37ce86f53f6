//! The shapes of which built-in scenes are made: blocks, prisms, surfaces of revolution, tubes, sheets, cushions.

use std::f32::consts::{PI, TAU};

use glam::{Affine3A, Quat, Vec2, Vec3};

use super::super::Mesh;

/// An axis-aligned block, given by its range on each axis.
pub fn block(x: [f32; 2], y: [f32; 2], z: [f32; 2]) -> Mesh {
    prism(&[Vec2::new(x[0], y[0]), Vec2::new(x[1], y[0]), Vec2::new(x[1], y[1]), Vec2::new(x[0], y[1])], z)
}

/// A convex outline in the xy plane, counter-clockwise, drawn out along z.
pub fn prism(outline: &[Vec2], z: [f32; 2]) -> Mesh {
    let n = outline.len() as u32;
    let ring = |z: f32| outline.iter().map(move |p| p.extend(z));
    let mut triangles = Vec::new();
    for i in 0..n {
        let next = (i + 1) % n;
        triangles.extend([[i, next, n + next], [i, n + next, n + i]]);
    }
    for i in 1..n - 1 {
        triangles.extend([[0, i + 1, i], [n, n + i, n + i + 1]]);
    }
    Mesh { positions: ring(z[0]).chain(ring(z[1])).collect(), triangles, ..Mesh::default() }
}

/// `steps` steps that rise from `y[0]` to `y[1]` while z falls from `z[0]` to `z[1]`, between `x[0]` and `x[1]`.
pub fn stairs(x: [f32; 2], y: [f32; 2], z: [f32; 2], steps: usize) -> Mesh {
    let mut flight = Mesh::default();
    for i in 0..steps {
        let part = |k: usize, [from, to]: [f32; 2]| from + (to - from) * k as f32 / steps as f32;
        flight.append(&block(x, [y[0], part(i + 1, y)], [z[1], part(i, z)]));
    }
    flight
}

/// A wall above an elliptical arch: `2 half_width` wide along x, with its ranges on the other axes.
///
/// The arch springs from `y[0]`; `opening` holds half its width and its rise.
pub fn arch(half_width: f32, opening: [f32; 2], y: [f32; 2], z: [f32; 2]) -> Mesh {
    const PIECES: usize = 24;
    let angles = (0..=PIECES).map(|i| PI * (i as f32 / PIECES as f32 - 0.5));
    let mut soffit = vec![Vec2::new(-half_width, y[0])];
    soffit.extend(angles.map(|a| Vec2::new(opening[0] * a.sin(), y[0] + opening[1] * a.cos().max(0.0))));
    soffit.push(Vec2::new(half_width, y[0]));
    let mut arch = Mesh::default();
    for [from, to] in soffit.array_windows() {
        arch.append(&prism(&[*from, *to, to.with_y(y[1]), from.with_y(y[1])], z));
    }
    arch
}

/// A surface of revolution about the y axis.
///
/// Each curve is a smooth run of (radius, height) points; between curves there is an edge. Going along the curves, the
/// outside is on the right: outwards below, upwards outside, inwards above.
pub fn lathe(curves: &[Vec<Vec2>], segments: usize) -> Mesh {
    fluted_lathe(curves, segments, |_| 1.0)
}

/// [`lathe`] whose radius at each angle (in turns) is multiplied by `flute`; its normals follow the flutes too.
pub fn fluted_lathe(curves: &[Vec<Vec2>], segments: usize, flute: impl Fn(f32) -> f32) -> Mesh {
    let mut mesh = Mesh::default();
    for curve in curves {
        let first = mesh.positions.len() as u32;
        for (i, point) in curve.iter().enumerate() {
            let along = curve[(i + 1).min(curve.len() - 1)] - curve[i.saturating_sub(1)];
            for k in 0..=segments {
                let turn = k as f32 / segments as f32;
                let (sin, cos) = (TAU * turn).sin_cos();
                let radius = point.x * flute(turn);
                let slope = point.x * (flute(turn + 1e-3) - flute(turn - 1e-3)) / (2e-3 * TAU);
                let profile = Vec3::new(along.x * flute(turn) * sin, along.y, along.x * flute(turn) * cos);
                let around = Vec3::new(slope * sin + radius * cos, 0.0, slope * cos - radius * sin);
                // On the axis, `around` is zero: the surface is assumed to be level there.
                let normal = around.cross(profile).try_normalize().unwrap_or(Vec3::Y * -along.x.signum());
                mesh.positions.push(Vec3::new(radius * sin, point.y, radius * cos));
                mesh.normals.push(normal);
            }
        }
        mesh.triangles.extend(grid(first, curve.len() as u32, segments as u32 + 1));
    }
    mesh
}

/// A tube around a path, of the given radius at each of its points, open at the ends.
pub fn tube(path: &[Vec3], radii: &[f32], segments: usize) -> Mesh {
    let mut mesh = Mesh::default();
    let tangent = |i: usize| (path[(i + 1).min(path.len() - 1)] - path[i.saturating_sub(1)]).normalize();
    let mut side = tangent(0).any_orthonormal_vector();
    for (i, (&center, &radius)) in path.iter().zip(radii).enumerate() {
        // Carried along the path, so that the tube does not twist.
        side = side.reject_from_normalized(tangent(i)).normalize();
        let other = tangent(i).cross(side);
        for k in 0..=segments {
            let normal = Vec2::from_angle(TAU * k as f32 / segments as f32);
            let normal = normal.x * side + normal.y * other;
            mesh.positions.push(center + radius * normal);
            mesh.normals.push(normal);
        }
    }
    mesh.triangles.extend(grid(0, path.len() as u32, segments as u32 + 1));
    mesh
}

/// The surface of `at(u, v)` over `[0, 1]^2` in `columns` x `rows` pieces; its outside is where u to the right and v upwards
/// turn counter-clockwise.
pub fn sheet([columns, rows]: [usize; 2], at: impl Fn(f32, f32) -> Vec3) -> Mesh {
    const STEP: f32 = 1e-3;
    let mut mesh = Mesh::default();
    for row in 0..=rows {
        for column in 0..=columns {
            let (u, v) = (column as f32 / columns as f32, row as f32 / rows as f32);
            let (right, up) = (at(u + STEP, v) - at(u - STEP, v), at(u, v + STEP) - at(u, v - STEP));
            mesh.positions.push(at(u, v));
            mesh.normals.push(right.cross(up).normalize_or(Vec3::Y));
            // v points down, as everywhere.
            mesh.texcoords.push(Vec2::new(u, 1.0 - v));
        }
    }
    mesh.triangles.extend(grid(0, rows as u32 + 1, columns as u32 + 1));
    mesh
}

/// The body `|x / half.x|^p + |y / half.y|^p + |z / half.z|^p = 1` around the origin: an ellipsoid for p = 2, a pillow, a box with round
/// edges for p = 6 and more.
pub fn cushion(half: Vec3, p: f32, segments: usize) -> Mesh {
    let mut mesh = Mesh::default();
    let rings = segments / 2;
    for ring in 0..=rings {
        for segment in 0..=segments {
            let (latitude, longitude) =
                (PI * (ring as f32 / rings as f32 - 0.5), TAU * segment as f32 / segments as f32);
            let [(sin, cos), (s, c)] = [latitude.sin_cos(), longitude.sin_cos()];
            let direction = Vec3::new(cos.max(0.0) * s, sin, cos.max(0.0) * c);
            let power = |x: f32| x.abs().powf(p);
            let norm = (power(direction.x) + power(direction.y) + power(direction.z)).powf(1.0 / p);
            let unit = direction / norm;
            mesh.positions.push(half * unit);
            let slope = |x: f32, half: f32| x.abs().powf(p - 1.0).copysign(x) / half;
            let normal = Vec3::new(slope(unit.x, half.x), slope(unit.y, half.y), slope(unit.z, half.z));
            mesh.normals.push(normal.normalize_or(Vec3::Y));
        }
    }
    mesh.triangles.extend(grid(0, rings as u32 + 1, segments as u32 + 1));
    mesh
}

/// A ball around the origin.
pub fn ball(radius: f32, segments: usize) -> Mesh {
    cushion(Vec3::splat(radius), 2.0, segments)
}

/// A straight round bar from one point to another, with flat ends.
pub fn bar(from: Vec3, to: Vec3, radius: f32, segments: usize) -> Mesh {
    let length = (to - from).length();
    let bar = lathe(
        &[
            line([0.0, 0.0], [radius, 0.0]),
            line([radius, 0.0], [radius, length]),
            line([radius, length], [0.0, length]),
        ],
        segments,
    );
    let turn = Quat::from_rotation_arc(Vec3::Y, (to - from) / length);
    bar.transformed(&Affine3A::from_rotation_translation(turn, from))
}

/// The smooth curve through the given points (Catmull and Rom 1974), with `steps` pieces between neighbours.
pub fn curve<const N: usize>(points: [[f32; 2]; N], steps: usize) -> Vec<Vec2> {
    let control = |i: isize| Vec2::from(points[i.clamp(0, N as isize - 1) as usize]);
    let mut curve = Vec::new();
    for i in 0..N as isize - 1 {
        let [a, b, c, d] = [control(i - 1), control(i), control(i + 1), control(i + 2)];
        for k in 0..steps {
            let t = k as f32 / steps as f32;
            let cubic = (3.0 * (b - c) + d - a) * t + 2.0 * a - 5.0 * b + 4.0 * c - d;
            curve.push(b + 0.5 * t * (c - a + t * cubic));
        }
    }
    curve.push(control(N as isize - 1));
    curve
}

/// The straight run between two points of a profile.
pub fn line(from: [f32; 2], to: [f32; 2]) -> Vec<Vec2> {
    vec![from.into(), to.into()]
}

/// The triangles of `rows` x `columns` vertices from `first` on.
fn grid(first: u32, rows: u32, columns: u32) -> impl Iterator<Item = [u32; 3]> {
    (0..rows - 1).flat_map(move |row| {
        (0..columns - 1).flat_map(move |column| {
            let a = first + row * columns + column;
            let (b, c, d) = (a + 1, a + columns + 1, a + columns);
            [[a, b, c], [a, c, d]]
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six times the volume inside a closed mesh: positive when its triangles are wound outwards.
    fn signed_volume(mesh: &Mesh) -> f32 {
        (0..mesh.triangles.len()).map(|t| mesh.corners(t)).map(|[a, b, c]| a.dot(b.cross(c))).sum()
    }

    fn assert_normals_agree_with_windings(mesh: &Mesh) {
        for t in (0..mesh.triangles.len()).filter(|&t| !mesh.is_degenerate(t)) {
            let [a, b, c] = mesh.corners(t);
            let wound = (b - a).cross(c - a).normalize();
            for i in mesh.triangles[t] {
                let normal = mesh.normals[i as usize];
                assert!(wound.dot(normal) > 0.0, "triangle {t}: {wound} against {normal}");
            }
        }
    }

    #[test]
    fn blocks_and_stairs_are_wound_outwards() {
        assert!((signed_volume(&block([1.0, 3.0], [2.0, 3.0], [0.0, 4.0])) / 6.0 - 8.0).abs() < 1e-4);
        assert!(signed_volume(&stairs([0.0, 2.0], [0.0, 1.0], [3.0, 0.0], 4)) > 0.0);
    }

    #[test]
    fn arches_leave_half_an_ellipse_open() {
        let volume = signed_volume(&arch(2.0, [1.5, 1.0], [1.0, 3.0], [-0.5, 0.5])) / 6.0;
        // The polygon of 24 sides has 0.3 % less area than the half ellipse.
        assert!((volume / (8.0 - 0.5 * PI * 1.5) - 1.0).abs() < 3e-3, "{volume}");
    }

    #[test]
    fn lathes_and_tubes_have_outward_normals() {
        let vessel = [
            line([0.0, 0.0], [0.5, 0.0]),
            curve([[0.5, 0.0], [0.9, 0.5], [0.7, 1.0]], 6),
            line([0.7, 1.0], [0.0, 1.0]),
        ];
        let vessel = lathe(&vessel, 24);
        assert!(signed_volume(&vessel) > 0.0);
        assert_normals_agree_with_windings(&vessel);
        let column = fluted_lathe(&[line([1.0, 0.0], [0.8, 5.0])], 96, |turn| 1.0 + 0.03 * (8.0 * TAU * turn).cos());
        assert_normals_agree_with_windings(&column);
        let path = [Vec3::ZERO, Vec3::new(0.3, 1.0, 0.0), Vec3::new(1.0, 1.5, 0.4)];
        assert_normals_agree_with_windings(&tube(&path, &[0.1, 0.15, 0.1], 12));
    }

    #[test]
    fn cushions_balls_bars_and_sheets_have_outward_normals() {
        let bodies = [
            cushion(Vec3::new(0.5, 0.2, 0.3), 4.0, 48),
            ball(0.7, 24),
            bar(Vec3::X, Vec3::new(0.2, -1.0, 0.4), 0.1, 12),
        ];
        for body in bodies {
            assert!(signed_volume(&body) > 0.0);
            assert_normals_agree_with_windings(&body);
        }
        let volume = signed_volume(&ball(1.0, 96)) / 6.0;
        // Sagitta of facets of 2 pi / 96: 2e-3 of the volume.
        assert!((volume / (4.0 / 3.0 * PI) - 1.0).abs() < 4e-3, "{volume}");
        let hill = sheet([16, 16], |u, v| Vec3::new(u, 0.1 * (6.0 * u).sin() * (5.0 * v).cos(), -v));
        assert_normals_agree_with_windings(&hill);
        assert!(hill.normals.iter().all(|normal| normal.y > 0.5));
    }
}
