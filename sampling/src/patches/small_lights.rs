//! Allocates samples to small lights in multiples of 1/4, which preserves stratification.
//!
//! A sun or a lamp of 1 to 2 degrees is entirely visible or entirely hidden, and the rest of the sky is
//! partly hidden. Shadow noise arises from the rest, which should therefore get more samples than its
//! fraction of the light. But where a sample of the sun has a larger weight than one of the sky, the number
//! of samples of each determines the brightness of a pixel, and a fraction of samples that is not a multiple
//! of 1/4 makes that number random: from 4 samples on, stratified points place the exact number of samples in
//! 1/4, 1/2 and 3/4 of a dimension.

use super::moments::MomentMap;
use crate::{
    simd::{LANES, Lanes},
    tail::Node,
};

/// Variance of directions below which a cluster is a small light: about 2 degrees.
const SMALL: f32 = 1e-3;
/// The same for a cluster that is a smaller light with its glow, and for the core that holds half of its
/// light.
const SMALL_WITH_GLOW: f32 = 2e-3;
const SMALL_CORE: f32 = 2e-4;
/// Odds of small lights among samples divided by the root of their odds in reflected light: lights with at
/// least 39 % of the reflected light get 1/2 of the samples, with at least 83 % 3/4.
const ODDS: f32 = 0.75;
/// Fraction of reflected light up to which small lights are drawn in proportion to their light.
const LEAST: f32 = 0.05;
/// Largest fraction of the samples of patches that small lights get.
const MOST: f32 = 0.875;

/// Whether a cluster is a small light, or one with its glow.
pub fn is_small(map: &MomentMap<'_>, cluster: Node) -> bool {
    let variance = |node| map.moments(node).variance() as f32;
    let whole = variance(cluster);
    whole < SMALL || (whole < SMALL_WITH_GLOW && variance(core(map, cluster)) < SMALL_CORE)
}

/// Returns the smallest part of a cluster that has half of its light.
fn core(map: &MomentMap<'_>, cluster: Node) -> Node {
    let least = 0.5 * map.moments(cluster).energy;
    let mut core = cluster;
    while !core.is_cell()
        && let Some(part) = core.children().into_iter().find(|&part| map.moments(part).energy > least)
    {
        core = part;
    }
    core
}

/// Returns the fraction of small lights among samples of patches, where they reflect `own` and everything
/// else `rest`: a multiple of 1/4 of all samples, of which patches get the fraction `of_patches` beside BRDF
/// sampling. None where small lights are drawn in proportion to their light.
#[inline(always)]
fn sample_fraction(own: f32, rest: f32, of_patches: f32) -> Option<f32> {
    let odds = ODDS * (own / rest).sqrt();
    let quarters = (4.0 * of_patches * odds / (1.0 + odds) + 0.5).floor();
    let quarters = if quarters > 1.0 { quarters } else { 1.0 };
    let quarters = if 0.25 * quarters > MOST * of_patches { quarters - 1.0 } else { quarters };
    // Comparisons are false for NaN, where nothing is left to divide.
    ((own > LEAST * (own + rest)) & (rest > 0.0) & (quarters > 0.0)).then(|| 0.25 * quarters / of_patches)
}

/// Returns the changes of running sums: a factor for small lights, and an addition for the others. Only for
/// lanes that end at leaves: in narrower lobes the lobe dominates noise, and small lights are drawn in
/// proportion to their light.
#[inline(always)]
pub fn scales(own: &Lanes, all: &Lanes, of_patches: &Lanes, at_leaves: [bool; LANES]) -> [Lanes; 2] {
    let mut scales = [[1.0; LANES], [0.0; LANES]];
    for k in 0..LANES {
        let rest = all[k] - own[k];
        if at_leaves[k]
            && let Some(fraction) = sample_fraction(own[k], rest, of_patches[k])
        {
            let wanted = fraction / (1.0 - fraction) * rest;
            (scales[0][k], scales[1][k]) = (wanted / own[k], wanted - own[k]);
        }
    }
    scales
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_lights_get_multiples_of_a_quarter() {
        for (own, expected) in [
            (0.04, None),
            (0.06, Some(0.25)),
            (0.38, Some(0.25)),
            (0.5, Some(0.5)),
            (0.8, Some(0.5)),
            (0.9, Some(0.75)),
            (0.9999, Some(0.75)),
        ] {
            assert_eq!(sample_fraction(own, 1.0 - own, 1.0), expected, "{own}");
        }
        // With BRDF sampling, the multiple is of all samples, and the rest keeps 1/8 of the samples of
        // patches.
        for k in 1..=100 {
            let of_patches = k as f32 / 100.0;
            for own in [0.06, 0.5, 0.9, 0.9999] {
                let Some(fraction) = sample_fraction(own, 1.0 - own, of_patches) else {
                    assert!(of_patches < 0.25 / MOST);
                    continue;
                };
                let quarters = 4.0 * fraction * of_patches;
                assert!(
                    (quarters - quarters.round()).abs() < 1e-6 && quarters > 0.5 && fraction <= MOST,
                    "{fraction} {of_patches}"
                );
            }
        }
        for (own, rest) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (f32::NAN, 1.0), (1.0, -1e-9)] {
            assert_eq!(sample_fraction(own, rest, 1.0), None);
        }
    }

    #[test]
    fn scaled_masses_give_multiples_of_a_quarter() {
        for (own, all) in [(0.3, 0.5), (2e-6, 1e-5), (7.0, 7.1)] {
            let [factor, added] = scales(&[own; LANES], &[all; LANES], &[1.0; LANES], [true; LANES]);
            let fraction = own * factor[3] / (all + added[3]);
            assert!((4.0 * fraction - (4.0 * fraction).round()).abs() < 1e-5, "{fraction}");
            assert!((own * factor[3] - own - added[3]).abs() < 1e-6 * all);
        }
        for (own, at_leaves) in [(0.0, true), (0.5, false)] {
            let scales = scales(&[own; LANES], &[1.0; LANES], &[1.0; LANES], [at_leaves; LANES]);
            assert_eq!(scales, [[1.0; LANES], [0.0; LANES]]);
        }
    }
}
