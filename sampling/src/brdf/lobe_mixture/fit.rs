//! Fits a mixture of lobes for the least relative variance under a white sky, by quadrature over points
//! that do not depend on the BRDF.
//!
//! With techniques of pdfs `p_k`, the second moment of an estimate is the integral of
//! `f^2 / sum_k w_k p_k`, which is convex in the weights. It decreases with every step of
//! `w_k <- w_k sqrt(integral of p_k f^2 / p^2)`, normalised (a majorisation: `f^2 / p` is at most the
//! sum of `a_k^2 f^2 / (w_k p_k)` for any `a_k` that sum to 1, with equality at `a_k = w_k p_k / p`).

use std::sync::LazyLock;

use crate::parallel::*;
use glam::{Vec2, Vec3};

use super::{DIFFUSE, LOBES, LobeMixture, NODES, Weights, cosine_of};
use crate::{
    brdf::{Ggx, Kernel, MAX_PARAMETERS, Surfaces},
    columns::strips,
    simd::{LANES, Lanes},
};

/// Number of candidate widths of lobes, spaced by 1/3 octave.
const WIDTHS: usize = 28;
/// The narrowest candidate width.
const NARROWEST: f32 = 2e-3;
/// Techniques of the quadrature: the cosine lobe, and one lobe per width.
const TECHNIQUES: usize = WIDTHS + 1;
/// Points per technique.
const POINTS: usize = 96;
/// The least weight of the cosine lobe. It bounds sample weights where the lobes' tails are thinner
/// than the BRDF's.
const LEAST_DIFFUSE: f32 = 0.05;
/// The least weight of the lobe in [`Weights::single`].
const LEAST_SINGLE: f32 = 0.02;
/// The cosine used for the node at the horizon.
const GRAZING: f32 = 2e-3;
/// Iterations of the weights while widths are chosen, and for the result.
const COARSE_STEPS: usize = 12;
const FINE_STEPS: usize = 60;

/// A candidate width.
fn width(k: usize) -> f32 {
    // The last one is 1.
    NARROWEST.powf(1.0 - k as f32 / (WIDTHS - 1) as f32)
}

/// Points of the upper hemisphere for one cosine of `wo`, with the normal along z.
struct Quadrature {
    wo: Vec3,
    /// Columns of directions.
    wi: [Vec<Lanes>; 3],
    /// The pdfs of all techniques at each point.
    pdfs: Vec<[f32; TECHNIQUES]>,
    /// Solid angles that the points represent.
    solid_angles: Vec<f32>,
}

/// The points of all nodes, weighted by the balance heuristic over all techniques.
///
/// Computed by one thread: a thread that waits for others within a `LazyLock` may steal work that waits
/// for the same lock.
static QUADRATURES: LazyLock<Vec<Quadrature>> =
    LazyLock::new(|| (0..NODES).map(|node| Quadrature::new(cosine_of(node).max(GRAZING))).collect());

impl Quadrature {
    fn new(cos: f32) -> Self {
        let wo = Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos);
        let lobe = |k: usize| Ggx::new(width(k), Vec3::ONE);
        let mut drawn = Vec::with_capacity(TECHNIQUES * POINTS);
        for technique in 0..TECHNIQUES {
            for k in 0..POINTS {
                // Hammersley points, rotated per technique.
                let x = (k as f32 + 0.5) / POINTS as f32;
                let turned = (k as u32).reverse_bits() as f32 / 4_294_967_296.0 + 0.618_034 * technique as f32;
                let u = Vec2::new(turned.fract(), x);
                let (wi, pdf) = if technique == 0 {
                    DIFFUSE.sample(Vec3::Z, wo, u)
                } else {
                    lobe(technique - 1).sample(Vec3::Z, wo, u)
                };
                if pdf > 0.0 {
                    drawn.push(wi);
                }
            }
        }
        let mut wi = [(); 3].map(|()| vec![[0.0; LANES]; strips(drawn.len())]);
        for (place, w) in drawn.iter().enumerate() {
            for (column, number) in wi.iter_mut().zip(w.to_array()) {
                column.as_flattened_mut()[place] = number;
            }
        }
        let all = |wi: &Vec3| {
            let of = |k: usize| if k == 0 { DIFFUSE.pdf(Vec3::Z, wo, *wi) } else { lobe(k - 1).pdf(Vec3::Z, wo, *wi) };
            std::array::from_fn(of)
        };
        let pdfs: Vec<[f32; TECHNIQUES]> = drawn.iter().map(all).collect();
        let solid_angles = pdfs.iter().map(|own| 1.0 / (POINTS as f32 * own.iter().sum::<f32>())).collect();
        Self { wo, wi, pdfs, solid_angles }
    }

    /// Luminance times the square root of the solid angle at each point, whose squares sum to the
    /// second moment of a uniform pdf; scaled so that the integral of the luminance is 1. `None` if it
    /// is black.
    fn values(&self, reflected: &impl Reflected) -> Option<Vec<f32>> {
        let count = self.wi[0].len();
        let constant = |value: f32| vec![[value; LANES]; count];
        let [up, none, x, z] = [constant(1.0), constant(0.0), constant(self.wo.x), constant(self.wo.z)];
        let surfaces =
            Surfaces { n: [&none, &none, &up], wo: [&x, &none, &z], parameters: [&none[..]; MAX_PARAMETERS] };
        let mut out = [(); 3].map(|()| constant(0.0));
        let [red, green, blue] = &mut out;
        reflected(&surfaces, self.wi.each_ref().map(Vec::as_slice), [red, green, blue]);
        let [red, green, blue] = out.each_ref().map(|column| column.as_flattened());
        let luminance = |k: usize| 0.2126 * red[k] + 0.7152 * green[k] + 0.0722 * blue[k];
        let integral: f64 = self.solid_angles.iter().enumerate().map(|(k, area)| f64::from(luminance(k) * area)).sum();
        if !(integral > 0.0 && integral.is_finite()) {
            return None;
        }
        let value = |(k, area): (usize, &f32)| luminance(k) / integral as f32 * area.sqrt();
        Some(self.solid_angles.iter().enumerate().map(value).collect())
    }

    /// Optimises the weights of some techniques in `steps` steps; returns them and their second moment.
    fn weights<const K: usize>(
        &self,
        values: &[f32],
        techniques: [usize; K],
        least: [f32; K],
        steps: usize,
    ) -> ([f32; K], f64) {
        let mut weights = [1.0 / K as f32; K];
        let mut moment = f64::INFINITY;
        for _ in 0..=steps {
            let (mut sums, mut sum) = ([0.0_f64; K], 0.0);
            for (value, pdfs) in values.iter().zip(&self.pdfs) {
                let own = techniques.map(|k| pdfs[k]);
                let pdf: f32 = own.iter().zip(&weights).map(|(p, w)| p * w).sum();
                let part = value * value / pdf;
                sum += f64::from(part);
                for (sum, p) in sums.iter_mut().zip(own) {
                    *sum += f64::from(part * (p / pdf));
                }
            }
            moment = sum;
            for ((weight, sum), least) in weights.iter_mut().zip(sums).zip(least) {
                *weight = (*weight * sum.sqrt() as f32).max(least);
            }
            let total: f32 = weights.iter().sum();
            weights = weights.map(|weight| weight / total);
        }
        (weights, moment)
    }
}

/// BRDF times cosine over columns, per channel: [`crate::brdf::Brdf::evaluate_cosine`] of a BRDF
/// without parameters.
pub trait Reflected: Fn(&Surfaces<'_>, [&[Lanes]; 3], [&mut [Lanes]; 3]) + Sync {}
impl<F: Fn(&Surfaces<'_>, [&[Lanes]; 3], [&mut [Lanes]; 3]) + Sync> Reflected for F {}

/// The least weights of a mixture.
const LEAST: [f32; LOBES + 1] = [LEAST_DIFFUSE, 0.0, 0.0, 0.0];

/// The sum of the logarithms of second moments over some nodes, for three widths.
fn cost(nodes: &[(usize, Vec<f32>)], widths: [usize; LOBES]) -> f64 {
    let techniques = [0, widths[0] + 1, widths[1] + 1, widths[2] + 1];
    let moment =
        |(node, values): &(usize, Vec<f32>)| QUADRATURES[*node].weights(values, techniques, LEAST, COARSE_STEPS).1;
    nodes.iter().map(|node| moment(node).ln()).sum()
}

impl LobeMixture {
    /// Fits a mixture to an isotropic BRDF.
    pub fn fit(reflected: impl Reflected) -> Self {
        let values: Vec<Option<Vec<f32>>> =
            QUADRATURES.iter().map(|quadrature| quadrature.values(&reflected)).collect();
        let views: Vec<(usize, Vec<f32>)> =
            (1..NODES).step_by(3).filter_map(|node| Some((node, values[node].clone()?))).collect();
        // Coordinate descent over the lobes' widths, until none changes.
        let mut widths = [WIDTHS - 1; LOBES];
        let mut best = f64::INFINITY;
        loop {
            let before = best;
            for lobe in 0..LOBES {
                let tried: Vec<([usize; LOBES], f64)> = (0..WIDTHS)
                    .into_par_iter()
                    .map(|width| {
                        let mut widths = widths;
                        widths[lobe] = width;
                        (widths, cost(&views, widths))
                    })
                    .collect();
                for (other, cost) in tried {
                    if cost < best - 1e-4 {
                        (widths, best) = (other, cost);
                    }
                }
            }
            if best >= before {
                break;
            }
        }
        widths.sort_unstable();
        let nodes: Vec<(Weights, f64)> = values
            .par_iter()
            .enumerate()
            .map(|(node, values)| match values {
                Some(values) => node_weights(&QUADRATURES[node], values, widths),
                None => (Weights { techniques: [1.0, 0.0, 0.0, 0.0], single: [LEAST_SINGLE, 1.0] }, 1.0),
            })
            .collect();
        let second_moment = nodes[1..].iter().map(|(_, moment)| moment).sum::<f64>() / (NODES - 1) as f64;
        let nodes = Box::new(std::array::from_fn(|node| nodes[node].0));
        Self { alphas: widths.map(width), nodes, second_moment }
    }
}

/// The weights at a node, and their second moment.
fn node_weights(quadrature: &Quadrature, values: &[f32], widths: [usize; LOBES]) -> (Weights, f64) {
    let all = [0, widths[0] + 1, widths[1] + 1, widths[2] + 1];
    let (techniques, moment) = quadrature.weights(values, all, LEAST, FINE_STEPS);
    let single = (0..WIDTHS)
        .map(|k| (k, quadrature.weights(values, [0, k + 1], [0.0, LEAST_SINGLE], COARSE_STEPS)))
        .min_by(|(_, (_, a)), (_, (_, b))| a.total_cmp(b));
    let (k, ([_, lobe_weight], _)) = single.expect("there are widths");
    (Weights { techniques, single: [lobe_weight, width(k)] }, moment)
}
