//! The directional albedo of Trowbridge-Reitz lobes, tabulated.

use std::sync::LazyLock;

use glam::{Vec2, Vec3};

use super::{Ggx, Kernel, ggx::schlick_weight};
use crate::flat::{FlatArray, FlatNumbers};

/// Nodes along the square roots of the cosine and of `alpha`, dense where the albedo is curved: at
/// grazing angles and for near mirrors.
const NODES: usize = 64;
/// Points along a side of the square over which each node is integrated. Weights are at most 1 and
/// smooth except at the horizon, where a row of points is uncertain: an error of at most 1/64 of the
/// lost fraction, about 1e-3.
const POINTS: usize = 32;

/// The directional albedo of a lobe as a function of `f0`: `f0 full + (1 - f0) grazing`.
#[derive(Clone, Copy, Debug, Default)]
struct Split {
    /// With F = 1.
    full: f32,
    /// With F = `(1 - cos)^5`.
    grazing: f32,
}

impl Split {
    #[inline(always)]
    fn albedo(self, f0: f32) -> f32 {
        f0 * self.full + (1.0 - f0) * self.grazing
    }

    #[inline(always)]
    fn lerp(self, other: Self, t: f32) -> Self {
        Self {
            full: self.full + t * (other.full - self.full),
            grazing: self.grazing + t * (other.grazing - self.grazing),
        }
    }
}

/// Albedos of one `alpha` at cosine nodes, and their mean over the hemisphere.
#[derive(Clone, Copy, Debug)]
struct Row {
    nodes: [Split; NODES],
    mean: Split,
}

/// Rows by the square root of `alpha`; computed on first use, which takes almost 1 s on one core.
static TABLE: LazyLock<[Row; NODES]> = LazyLock::new(|| std::array::from_fn(|i| Row::new(square_of_node(i))));

/// Computes the table unless that is done, so that the first pixel does not wait for it.
pub fn tabulate() {
    LazyLock::force(&TABLE);
}

/// Returns the table as rows by the square root of `alpha`, each of pairs (with F = 1, with F = `(1 - cos)^5`): at nodes by
/// the square root of the cosine, then the cosine-weighted mean. For renderers on other devices.
pub fn flat_lobe_albedo() -> FlatArray {
    let pair = |split: &Split| [split.full, split.grazing];
    let numbers = TABLE.iter().flat_map(|row| row.nodes.iter().chain([&row.mean]).flat_map(pair)).collect();
    FlatArray { name: "lobe_albedo", shape: vec![NODES, NODES + 1, 2], numbers: FlatNumbers::Floats(numbers) }
}

/// The albedos of the lobe of one `alpha`, linear between the nodes.
#[derive(Clone, Copy, Debug)]
pub(super) struct LobeAlbedo {
    /// The node below `alpha`, and the fractional position of `alpha` between it and the next one.
    row: usize,
    t: f32,
}

impl LobeAlbedo {
    #[inline(always)]
    pub fn new(alpha: f32) -> Self {
        let (row, t) = position(alpha);
        Self { row, t }
    }

    /// The fraction of light that the lobe reflects into all directions, for a cosine of incidence.
    #[inline(always)]
    pub fn at(self, cos: f32, f0: f32) -> f32 {
        let (k, s) = position(cos);
        let [near, far] = [&TABLE[self.row].nodes, &TABLE[self.row + 1].nodes];
        near[k].lerp(near[k + 1], s).lerp(far[k].lerp(far[k + 1], s), self.t).albedo(f0)
    }

    /// The cosine-weighted mean of [`Self::at`] over the hemisphere, exact for the interpolated values.
    #[inline(always)]
    pub fn mean(self, f0: f32) -> f32 {
        TABLE[self.row].mean.lerp(TABLE[self.row + 1].mean, self.t).albedo(f0)
    }
}

/// Cosine or `alpha` of a node.
fn square_of_node(node: usize) -> f32 {
    (node as f32 / (NODES - 1) as f32).powi(2)
}

/// The node below a value in `[0, 1]` and the distance to it in nodes, in `[0, 1]`.
#[inline(always)]
fn position(value: f32) -> (usize, f32) {
    let place = value.clamp(0.0, 1.0).sqrt() * (NODES - 1) as f32;
    let node = (place as usize).min(NODES - 2);
    (node, place - node as f32)
}

impl Row {
    fn new(alpha: f32) -> Self {
        let lobe = Ggx::new(alpha, Vec3::ONE);
        // At the horizon the albedo is undefined; its node holds the limit.
        let nodes = std::array::from_fn(|node| integrate(&lobe, square_of_node(node).max(1e-4)));
        // The mean is the integral of 2 cos d cos = 4 r^3 dr over r, the root of the cosine.
        let mean = |of: fn(&Split) -> f32| -> f32 {
            nodes.iter().enumerate().map(|(node, split)| node_weight(node) * f64::from(of(split))).sum::<f64>() as f32
        };
        let mean = Split { full: mean(|split| split.full), grazing: mean(|split| split.grazing) };
        Self { nodes, mean }
    }
}

/// The integral of `4 r^3` times the hat function of a node.
fn node_weight(node: usize) -> f64 {
    let step = 1.0 / (NODES - 1) as f64;
    let at = |node: usize| node as f64 * step;
    // The integral of 4 r^3 (r - zero) / slope from a to b.
    let ramp = |a: f64, b: f64, zero: f64, slope: f64| {
        let primitive = |r: f64| 0.8 * r.powi(5) - zero * r.powi(4);
        (primitive(b) - primitive(a)) / slope
    };
    let rise = if node == 0 { 0.0 } else { ramp(at(node - 1), at(node), at(node - 1), step) };
    let fall = if node + 1 == NODES { 0.0 } else { ramp(at(node), at(node + 1), at(node + 1), -step) };
    rise + fall
}

/// The mean weight of visible microfacets.
fn integrate(lobe: &Ggx, cos: f32) -> Split {
    let wo = Vec3::new((1.0 - cos * cos).max(0.0).sqrt(), 0.0, cos);
    let mut sum = Split::default();
    for k in 0..POINTS * POINTS {
        let u = Vec2::new((k % POINTS) as f32 + 0.5, (k / POINTS) as f32 + 0.5) / POINTS as f32;
        let (wi, pdf) = lobe.sample(Vec3::Z, wo, u);
        if pdf == 0.0 {
            continue;
        }
        let weight = lobe.lobe_cosine(Vec3::Z, wo, wi) / pdf;
        sum.full += weight;
        sum.grazing += weight * schlick_weight(0.5 * (wo + wi).length());
    }
    let points = (POINTS * POINTS) as f32;
    Split { full: sum.full / points, grazing: sum.grazing / points }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_smooth_mirror_has_the_albedo_of_schlick() {
        let smooth = LobeAlbedo::new(0.0);
        // Below a cosine of 20 widths, microfacets hide each other.
        for cos in (1..NODES).map(square_of_node).filter(|&cos| cos > 0.02) {
            for f0 in [0.0, 0.04, 1.0] {
                let expected = f0 + (1.0 - f0) * schlick_weight(cos);
                assert!((smooth.at(cos, f0) - expected).abs() < 5e-3, "{cos} {f0}: {}", smooth.at(cos, f0));
            }
        }
        // The integral of (1 - c)^5 2 c dc is 1/21; interpolation adds to a convex function.
        assert!((smooth.mean(0.0) - 1.0 / 21.0).abs() < 1e-3, "{}", smooth.mean(0.0));
    }

    #[test]
    fn the_roughest_surface_loses_light_at_normal_incidence() {
        // For alpha = 1 the integral has a closed form: 1 - ln 2.
        assert!((LobeAlbedo::new(1.0).at(1.0, 1.0) - (1.0 - 2.0_f32.ln())).abs() < 2e-3);
    }

    #[test]
    fn means_match_quadrature_of_the_interpolated_values() {
        for alpha in [0.003, 0.07, 0.5, 0.93] {
            let albedo = LobeAlbedo::new(alpha);
            let points = 100_000;
            let sum: f64 = (0..points)
                .map(|k| (k as f64 + 0.5) / points as f64)
                .map(|cos| 2.0 * cos * f64::from(albedo.at(cos as f32, 0.04)))
                .sum();
            assert!((sum / points as f64 - f64::from(albedo.mean(0.04))).abs() < 1e-5, "{alpha}");
        }
    }
}
