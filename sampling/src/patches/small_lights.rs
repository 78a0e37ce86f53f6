//! Small lights, which samples go to by quarters.
//!
//! A sun or a lamp of a degree or two is seen as a whole or not at all, and the rest of the sky is partly hidden: that is where the noise of shadows is, so more samples
//! belong there than its light says. But where a sample of the sun is worth more than one of the sky, the number of either decides how bright a pixel
//! is, and a share of samples that is no multiple of a quarter leaves that number to chance: of points that keep their strata just so many fall
//! into a quarter, a half and three quarters of a dimension as there should be, from four samples on.

use super::{mass::Patch, moments::MomentMap};
use crate::{
    simd::{LANES, Lanes},
    tail::Node,
};

/// The variance of a cluster's directions below which it is a small light: some two degrees.
const SMALL: f32 = 1e-3;
/// The same of one that is the glow around a smaller light, and of that: what holds half of the cluster's light.
const SMALL_WITH_GLOW: f32 = 2e-3;
const SMALL_CORE: f32 = 2e-4;
/// Odds of small lights among samples over the root of their odds among what is reflected: a light of 39 % and more has half of the samples, one of 83 %
/// and more three quarters.
const ODDS: f32 = 0.75;
/// The share of what is reflected up to which small lights are drawn as their light says.
const LEAST: f32 = 0.05;
/// The part of all samples that their sampler takes which small lights get at most.
const MOST: f32 = 0.875;

/// Whether a cluster is a small light, or one with its glow.
pub fn is_small(map: &MomentMap<'_>, cluster: Node) -> bool {
    let variance = |node| Patch::new(map, node).variance();
    let whole = variance(cluster);
    whole < SMALL || (whole < SMALL_WITH_GLOW && variance(core(map, cluster)) < SMALL_CORE)
}

/// The smallest part of a cluster that has half of its light.
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

/// The share of small lights among samples of patches, where they have `own` of what is reflected and everything else `rest`: a number of quarters of all
/// samples, of which patches have `of_patches` beside BRDF sampling. None where small lights are drawn as their light says.
#[inline(always)]
fn share(own: f32, rest: f32, of_patches: f32) -> Option<f32> {
    let odds = ODDS * (own / rest).sqrt();
    let quarters = (4.0 * of_patches * odds / (1.0 + odds) + 0.5).floor();
    let quarters = if quarters > 1.0 { quarters } else { 1.0 };
    let quarters = if 0.25 * quarters > MOST * of_patches { quarters - 1.0 } else { quarters };
    // Where nothing is left to divide, comparisons are false.
    ((own > LEAST * (own + rest)) & (rest > 0.0) & (quarters > 0.0)).then(|| 0.25 * quarters / of_patches)
}

/// What running sums are changed by: a factor for those of small lights, and what is added to the others. Only for lanes
/// that end at leaves: in narrower lobes the noise is the lobe's, and small lights are drawn as their light says.
#[inline(always)]
pub fn scales(own: &Lanes, all: &Lanes, of_patches: &Lanes, at_leaves: [bool; LANES]) -> [Lanes; 2] {
    let mut scales = [[1.0; LANES], [0.0; LANES]];
    for k in 0..LANES {
        let rest = all[k] - own[k];
        if at_leaves[k]
            && let Some(share) = share(own[k], rest, of_patches[k])
        {
            let wanted = share / (1.0 - share) * rest;
            (scales[0][k], scales[1][k]) = (wanted / own[k], wanted - own[k]);
        }
    }
    scales
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_lights_have_quarters_of_all_samples() {
        for (own, expected) in [
            (0.04, None),
            (0.06, Some(0.25)),
            (0.38, Some(0.25)),
            (0.5, Some(0.5)),
            (0.8, Some(0.5)),
            (0.9, Some(0.75)),
            (0.9999, Some(0.75)),
        ] {
            assert_eq!(share(own, 1.0 - own, 1.0), expected, "{own}");
        }
        // Beside BRDF sampling, of all samples: the rest keeps an eighth of what is left.
        for k in 1..=100 {
            let of_patches = k as f32 / 100.0;
            for own in [0.06, 0.5, 0.9, 0.9999] {
                let Some(share) = share(own, 1.0 - own, of_patches) else {
                    assert!(of_patches < 0.25 / MOST);
                    continue;
                };
                let quarters = 4.0 * share * of_patches;
                assert!(
                    (quarters - quarters.round()).abs() < 1e-6 && quarters > 0.5 && share <= MOST,
                    "{share} {of_patches}"
                );
            }
        }
        for (own, rest) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (f32::NAN, 1.0), (1.0, -1e-9)] {
            assert_eq!(share(own, rest, 1.0), None);
        }
    }

    #[test]
    fn scaled_masses_have_that_share() {
        for (own, all) in [(0.3, 0.5), (2e-6, 1e-5), (7.0, 7.1)] {
            let [factor, added] = scales(&[own; LANES], &[all; LANES], &[1.0; LANES], [true; LANES]);
            let share = own * factor[3] / (all + added[3]);
            assert!((4.0 * share - (4.0 * share).round()).abs() < 1e-5, "{share}");
            assert!((own * factor[3] - own - added[3]).abs() < 1e-6 * all);
        }
        for (own, at_leaves) in [(0.0, true), (0.5, false)] {
            let scales = scales(&[own; LANES], &[1.0; LANES], &[1.0; LANES], [at_leaves; LANES]);
            assert_eq!(scales, [[1.0; LANES], [0.0; LANES]]);
        }
    }
}
