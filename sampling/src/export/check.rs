//! Checks that a file holds a density: evaluation at a few points finds finite weights that do not give one.

use glam::{Vec2, Vec3, Vec3A};

use super::Intermediate;
use crate::{
    brdf::{Ggx, Lambert},
    columns::strips,
    head::Condition,
    one_point::OnePoint,
    sampler::IntermediateDensity,
    simd::{LANES, Lanes},
    tile::ShadingPoint,
};

/// Points along an edge of the square.
const SIDE: usize = 8;
/// Widths at which heads for glossy surfaces are checked.
const WIDTHS: [f32; 2] = [0.1, 0.7];

impl Intermediate {
    /// Evaluates the density for normals along and between the axes; the error describes an invalid value.
    pub(super) fn check(&self) -> Result<(), String> {
        let diffuse = [Lambert { albedo: Vec3::ONE }.into()];
        let glossy = WIDTHS.map(|alpha| Ggx::new(alpha, Vec3::ONE).into());
        let (density, surfaces): (&dyn IntermediateDensity, &[_]) = match self {
            Self::Head(head) if head.condition() == Condition::Normal => (head, &diffuse),
            Self::Head(head) => (head, &glossy),
            Self::Bake(table) | Self::DirectBake(table) => (table, &diffuse),
        };
        for n in [Vec3A::X, Vec3A::Y, Vec3A::Z, -Vec3A::X, -Vec3A::Y, -Vec3A::Z, Vec3A::ONE.normalize()] {
            let wo = (n + 0.5 * n.any_orthonormal_vector()).normalize();
            for &surface in surfaces {
                check_at(density, &ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface })?;
            }
        }
        Ok(())
    }
}

/// Draws from a density, and evaluates it at the drawn points.
fn check_at(density: &dyn IntermediateDensity, at: &ShadingPoint) -> Result<(), String> {
    let point = OnePoint::new(at, SIDE * SIDE);
    let mut state: Vec<Lanes> = vec![[0.0; LANES]; density.columns() * strips(SIDE * SIDE)];
    let rows = point.tile().rows();
    density.prepare(&rows, &mut state, &point.arena);
    let centre = |k: usize| Vec2::new((k % SIDE) as f32 + 0.5, (k / SIDE) as f32 + 0.5) / SIDE as f32;
    let z: Vec<Vec2> = (0..SIDE * SIDE).map(centre).collect();
    let draw =
        |z: [&[Lanes]; 2], [u, v, q]: [&mut [Lanes]; 3]| density.sample(&rows, &state, z, [u, v], q, &point.arena);
    let drawn: Vec<[f32; 3]> = point.map(&z, draw).collect();
    let evaluate = |y: [&[Lanes]; 2], [q]: [&mut [Lanes]; 1]| density.density(&rows, &state, y, q, &point.arena);
    let y: Vec<Vec2> = drawn.iter().map(|&[u, v, _]| Vec2::new(u, v)).collect();
    let is_inside = y.iter().all(|y| (0.0..=1.0).contains(&y.x) && (0.0..=1.0).contains(&y.y));
    let sampled = drawn.iter().map(|&[.., q]| q).find(|q| !(*q > 0.0 && q.is_finite()));
    let evaluated = || point.map(&y, evaluate).map(|[q]| q).find(|q| !(*q >= 0.0 && q.is_finite()));
    let wrong = if is_inside { sampled.or_else(evaluated) } else { Some(f32::NAN) };
    let Some(q) = wrong else { return Ok(()) };
    let n = at.ns;
    Err(format!("they make no density: it is {q} for the normal {:.2}, {:.2}, {:.2}", n.x, n.y, n.z))
}
