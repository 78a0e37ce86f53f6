//! Predicts the gain of visibility weights from the shadow rays that they are learned from.

use super::{
    division::Division,
    estimate::{Rays, Visibility},
};
use crate::{columns::vectorized, simd::LANES};

/// Smallest predicted gain for which weights are used. Priors outweigh the few rays of a rendering, so that
/// measured gains are 1.4x to 3x larger (as logarithms); looking up and multiplying weights takes 20 % of a
/// sample's time.
const LEAST_GAIN: f64 = 1.15;
/// Smallest predicted gain, minus 1, after 1/8 and 1/4 of the rays for learning to go on, given at least
/// [`ENOUGH_RAYS`]. With fewer rays the prior dominates, and the threshold falls with this power of their
/// number.
///
/// In 11 scenes under 6 maps at 640 x 480, all views with a final prediction above [`LEAST_GAIN`] have at
/// least 0.08 after 1/8, and half of the others less than 0.03; at 96 x 72 (1600 rays) 0.005 and 0.001.
const LEAST_EARLY_GAIN: f64 = 0.05;
const ENOUGH_RAYS: f64 = 8000.0;
const EARLY_GAIN_POWER: f64 = 1.5;
/// Largest growth of the predicted gain from 1/2 of the rays to all, relative to that from 1/4 to 1/2. In
/// those scenes and maps it is 0.5 to 2.1.
const MOST_GROWTH: f64 = 2.0;
/// Relative variance of light within a fully visible patch.
const WITHIN: f32 = 0.02;
/// Smallest fraction of blocked rays for learning to go on.
const LEAST_BLOCKED: f64 = 0.02;

/// The variance of samples in proportion to the reflected light, with and without weights, summed over cells
/// weighted by their rays.
///
/// With stratified points, the choice of a patch adds little noise. The noise within a patch of visibility
/// `v` is `v (1 - v)`, plus a little from the light itself. Over 11 scenes under 6 maps the logarithm of the
/// measured gain correlates with this at 0.94, and with the predicted gain of independent samples at 0.72.
#[derive(Clone, Copy, Debug, Default)]
pub struct PredictedGain {
    /// Variance without weights.
    plain: f64,
    /// Variance with weights.
    weighted: f64,
    rays: f64,
    blocked: f64,
}

impl PredictedGain {
    /// Returns the gain of a cell. Rays are sent in proportion to the reflected light, so that their numbers
    /// estimate the light of each patch.
    pub fn of(rays: &Rays, visibility: &Visibility, division: &Division) -> Self {
        Self::of_weights(rays, visibility, &visibility.weigh(division).0)
    }

    fn of_weights(rays: &Rays, visibility: &Visibility, weights: &[f32]) -> Self {
        let mut sums = [0.0; 5];
        sum_noise(rays, visibility.patches(), weights, &mut sums);
        let [all, blocked, plain, weight, weighted] = sums;
        // A patch with a fraction e of the reflected light and the weight g gets the fraction p = e g / sum
        // of e g of the samples, each of which adds e / p if it is visible: its variance is e^2 v (1 - v) /
        // p, and e v (1 - v) without weights. Cells are weighted by their rays.
        Self { plain, weighted: weighted * weight / f64::max(all, 1.0), rays: all, blocked }
    }

    /// Returns the gain over two sets of cells.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        Self {
            plain: self.plain + other.plain,
            weighted: self.weighted + other.weighted,
            rays: self.rays + other.rays,
            blocked: self.blocked + other.blocked,
        }
    }

    /// Returns the gain over `count` sets of cells like this one.
    #[must_use]
    pub fn times(self, count: usize) -> Self {
        let Self { plain, weighted, rays, blocked } = self;
        let [plain, weighted, rays, blocked] = [plain, weighted, rays, blocked].map(|sum| sum * count as f64);
        Self { plain, weighted, rays, blocked }
    }

    /// Returns the variance without weights over the variance with them; 1 without rays.
    pub fn ratio(&self) -> f64 {
        if self.plain > 0.0 && self.weighted > 0.0 { self.plain / self.weighted } else { 1.0 }
    }

    /// Returns the number of rays.
    pub fn rays(&self) -> f64 {
        self.rays
    }

    /// Whether `factor` times as many rays could predict a gain that pays off. A factor of at most 2 is
    /// judged by the growth since `before`.
    pub fn could_pay(&self, factor: f64, before: Option<&Self>) -> bool {
        let gain = self.ratio();
        let is_likely = match before {
            Some(before) if factor <= 2.0 => gain + MOST_GROWTH * (gain - before.ratio()).max(0.0) >= LEAST_GAIN,
            _ => gain >= 1.0 + LEAST_EARLY_GAIN * (self.rays / ENOUGH_RAYS).min(1.0).powf(EARLY_GAIN_POWER),
        };
        self.blocked > LEAST_BLOCKED * self.rays && is_likely
    }

    /// Whether weights gain more than they cost.
    pub fn pays(&self) -> bool {
        self.ratio() >= LEAST_GAIN
    }
}

vectorized! {
    /// Sums over patches: rays, blocked rays, noise without weights, rays times weights, and noise over weights.
    fn sum_noise['a](_simd, rays: &'a Rays, visibility: &'a [f32], weights: &'a [f32], out: &'a mut [f64; 5]) {
        let mut sums = [[0.0; LANES]; 5];
        let lists = rays.all.chunks_exact(LANES).zip(rays.seen.chunks_exact(LANES));
        for ((all, seen), (visibility, weights)) in lists.zip(visibility.chunks_exact(LANES).zip(weights.chunks_exact(LANES))) {
            for k in 0..LANES {
                let noise = all[k] * visibility[k] * (1.0 - visibility[k] + WITHIN);
                let own = [all[k], all[k] - seen[k], noise, all[k] * weights[k], noise / weights[k]];
                for (sums, own) in sums.iter_mut().zip(own) {
                    sums[k] += own;
                }
            }
        }
        *out = sums.map(|lanes| lanes.iter().map(|&lane| f64::from(lane)).sum());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility::PATCHES;

    /// Returns the gain with 100 rays to each of two patches of these visibilities.
    fn gain(seen: [f32; 2]) -> PredictedGain {
        let mut rays = Rays { seen: vec![0.0; PATCHES], all: vec![0.0; PATCHES] };
        rays.all[..2].fill(100.0);
        let mut visibility = Visibility::unknown();
        visibility.set(&seen);
        let weights: Vec<f32> = (0..PATCHES).map(|patch| seen.get(patch).map_or(1.0, |seen| seen.max(0.3))).collect();
        PredictedGain::of_weights(&rays, &visibility, &weights)
    }

    #[test]
    fn predicted_gain_matches_the_variance() {
        // One visible, one blocked: all noise is in the first, which gets 10/13 of the samples instead of
        // 1/2.
        let expected = 2.0 * 10.0 / 13.0;
        assert!((gain([1.0, 0.0]).ratio() / expected - 1.0).abs() < 1e-6, "{}", gain([1.0, 0.0]).ratio());
        assert!(gain([1.0, 0.0]).pays());
        // The first is 25 % visible, the second 90 %. Noise is 0.25 x 0.77 and 0.9 x 0.12, weights are 0.3
        // and 0.9.
        let (a, b, g, h) = (0.25 * 0.77, 0.9 * 0.12, 0.3, 0.9);
        let expected = (a + b) / ((a / g + b / h) * (g + h) / 2.0);
        assert!((gain([0.25, 0.9]).ratio() / expected - 1.0).abs() < 1e-6, "{}", gain([0.25, 0.9]).ratio());
        assert!(!gain([0.25, 0.9]).pays());
    }

    #[test]
    fn equal_visibilities_have_no_gain() {
        for seen in [[1.0, 1.0], [0.5, 0.5]] {
            assert!((gain(seen).ratio() - 1.0).abs() < 1e-6 && !gain(seen).pays());
        }
        assert_eq!(PredictedGain::default().ratio(), 1.0);
    }

    #[test]
    fn learning_stops_where_no_ray_is_blocked() {
        let of = |visible: f32| {
            let mut rays = Rays { seen: vec![0.0; PATCHES], all: vec![0.0; PATCHES] };
            (rays.seen[0], rays.all[0]) = (visible, 100.0);
            PredictedGain::of_weights(&rays, &Visibility::unknown(), &[1.0; PATCHES])
        };
        let could_pay =
            |gain: PredictedGain| gain.could_pay(4.0, None) || gain.could_pay(2.0, Some(&PredictedGain::default()));
        assert!(!could_pay(PredictedGain::default()) && !could_pay(of(100.0)) && !could_pay(of(99.0)));
        // Nor where all patches are equally blocked.
        assert!(!could_pay(of(90.0)) && !could_pay(gain([0.5, 0.5])) && could_pay(gain([1.0, 0.0])));
    }

    #[test]
    fn a_gain_without_growth_stops_learning() {
        let of = |gain: f64| PredictedGain { plain: gain, weighted: 1.0, rays: 1e5, blocked: 5e4 };
        // Extrapolated gains: 1.07, 1.09, at most 1.13; and 1.04, 1.1, 1.22.
        let could_pay = |gain, before| of(gain).could_pay(2.0, Some(&of(before)));
        assert!(!could_pay(1.09, 1.07) && could_pay(1.1, 1.04) && could_pay(1.16, 1.17) && !could_pay(1.14, 1.15));
        // With 4 times as many rays, the growth is not a limit.
        assert!(of(1.09).could_pay(4.0, Some(&of(1.07))) && !of(1.04).could_pay(4.0, Some(&of(1.0))));
    }

    #[test]
    fn few_rays_have_a_lower_threshold() {
        let of = |gain: f64, rays: f64| PredictedGain { plain: gain, weighted: 1.0, rays, blocked: 0.5 * rays };
        // 2000 rays are 1/4 of 8000: the threshold is 0.05 / 8.
        let could_pay = |gain, rays| of(gain, rays).could_pay(8.0, None);
        assert!(could_pay(1.0063, 2000.0) && !could_pay(1.0062, 2000.0) && !could_pay(1.0063, 2050.0));
        assert!(could_pay(1.05, 1e6) && !could_pay(1.049, 8000.0));
    }

    #[test]
    fn cells_are_weighted_by_their_noise() {
        let [occluded, open, shaded, dark] = [[1.0, 0.0], [1.0, 1.0], [0.5, 0.5], [0.0, 0.0]].map(gain);
        let with_many = |other: PredictedGain| (0..100).fold(occluded, |sum, _| sum.with(other));
        assert!(with_many(open).ratio() < 1.01 && with_many(shaded).ratio() < 1.001);
        // Fully occluded cells have no noise.
        let many = with_many(dark);
        assert!((many.ratio() / occluded.ratio() - 1.0).abs() < 1e-9 && many.pays(), "{}", many.ratio());
    }
}
