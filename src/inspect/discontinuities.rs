//! Discontinuities of a tail: points of Y that are mapped to distant points of the map, however close they
//! are.

use glam::Vec2;
use headtail_render::tail::{Tail, TailWarp};

/// Points along a side of Y, which are compared with their neighbours.
pub const SIDE: usize = 256;
/// Number of bisections of two neighbours, always towards the half with the larger jump: to 2^-20 of a side.
const HALVINGS: usize = 12;
/// Minimum jump, as a fraction of the map's side: points at this distance are separated, or stretched more
/// than 1000 times.
const LEAST: f32 = 1.0 / 1024.0;

/// The discontinuities of a tail.
pub struct Discontinuities {
    /// Length in sides of Y, along both axes.
    pub length: f64,
    /// Mean jump, as a fraction of the map's width or height, whichever is larger; 0 if there are none.
    pub mean: f64,
    /// For each of `SIDE x SIDE` points, the larger of its jumps to the right and downwards.
    pub jumps: Vec<f32>,
}

impl Discontinuities {
    /// Bisects every pair of neighbours towards its largest jump.
    pub fn of(tail: &Tail) -> Self {
        let mut pairs: Vec<[Vec2; 2]> = (0..SIDE * SIDE).flat_map(neighbours).collect();
        for _ in 0..HALVINGS {
            let middles: Vec<Vec2> = pairs.iter().map(|[a, b]| 0.5 * (a + b)).collect();
            let ends = [0, 1].map(|end| pairs.iter().map(|pair| pair[end]).collect::<Vec<_>>());
            let [from, to] = ends.each_ref().map(|points| images(tail, points));
            let between = images(tail, &middles);
            for (k, pair) in pairs.iter_mut().enumerate() {
                let is_first = apart(from[k], between[k]) > apart(between[k], to[k]);
                pair[usize::from(is_first)] = middles[k];
            }
        }
        let [from, to] = [0, 1].map(|end| images(tail, &pairs.iter().map(|pair| pair[end]).collect::<Vec<_>>()));
        let gaps: Vec<f32> = from.into_iter().zip(to).map(|(a, b)| apart(a, b)).collect();
        let separated: Vec<f64> = gaps.iter().filter(|&&gap| gap > LEAST).map(|&gap| f64::from(gap)).collect();
        Self {
            length: separated.len() as f64 / SIDE as f64,
            mean: if separated.is_empty() { 0.0 } else { separated.iter().sum::<f64>() / separated.len() as f64 },
            jumps: gaps.chunks_exact(2).map(|gaps| gaps[0].max(gaps[1])).collect(),
        }
    }

    /// Returns colours over Y: white where the tail is continuous, darker for larger jumps.
    pub fn colors(&self) -> Vec<[u8; 3]> {
        let color = |jump: &f32| {
            // From 0.1 % to half of the map.
            let level = (jump / LEAST).max(1.0).log2() / (0.5 / LEAST).log2();
            [1.0, 0.85, 0.4].map(|tint| (255.0 * (1.0 - level.min(1.0) * tint)).round() as u8)
        };
        self.jumps.iter().map(color).collect()
    }
}

/// Returns a point of the grid paired with its neighbours to the right (also across the seam) and below; the
/// last row has none below.
fn neighbours(k: usize) -> [[Vec2; 2]; 2] {
    let at = |column: usize, row: usize| Vec2::new(column as f32 + 0.5, row as f32 + 0.5) / SIDE as f32;
    let (column, row) = (k % SIDE, k / SIDE);
    let point = at(column, row);
    [[point, at(column + 1, row)], [point, at(column, (row + 1).min(SIDE - 1))]]
}

/// Maps points through the tail; their first coordinate may exceed 1.
fn images(tail: &Tail, points: &[Vec2]) -> Vec<Vec2> {
    let points: Vec<Vec2> = points.iter().map(|y| Vec2::new(y.x.fract(), y.y)).collect();
    tail.forward_points(&points).into_iter().map(|(x, _)| x).collect()
}

/// Returns the distance of two points of the map: u is periodic.
fn apart(a: Vec2, b: Vec2) -> f32 {
    let across = (a.x - b.x).abs();
    across.min(1.0 - across).max((a.y - b.y).abs())
}

#[cfg(test)]
mod tests {
    use headtail_render::tail::TailKind;

    use super::*;

    fn of(kind: TailKind, luminance: impl Fn(usize, usize) -> f32) -> Discontinuities {
        let texels: Vec<f32> = (0..64 * 32).map(|k| luminance(k % 64, k / 64)).collect();
        Discontinuities::of(&Tail::new(kind, 64, 32, &texels).unwrap())
    }

    #[test]
    fn tails_of_uniform_light_are_continuous() {
        for kind in [TailKind::RowColumn, TailKind::Hierarchical] {
            let found = of(kind, |_, _| 1.0);
            assert!(found.length == 0.0 && found.mean == 0.0, "{}: {} sides", kind.name(), found.length);
            assert_eq!(found.colors()[0], [255; 3]);
        }
    }

    /// Two halves that are bright at opposite ends: their rows do not meet. The centres of their light are
    /// 1/4 of a side of the map apart.
    #[test]
    fn rows_that_do_not_meet_are_discontinuities() {
        let found = of(TailKind::Hierarchical, |column, row| if (column < 32) == (row < 16) { 1.0 } else { 0.1 });
        // The halves meet twice on the circle, each time along the whole height of Y.
        assert!((1.5..4.0).contains(&found.length), "{} sides", found.length);
        assert!(found.mean > 0.1, "{}", found.mean);
    }
}
