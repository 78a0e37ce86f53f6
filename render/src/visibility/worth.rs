//! Whether what was learned is worth its price.

use super::{estimate::Visibility, weights::Weights};

/// The least gain at which weights are drawn with. To find and to multiply them takes a tenth of a sample's time, and pictures of
/// low-discrepancy points mostly gain less than independent samples.
const LEAST_GAIN: f64 = 1.2;
/// The least share of rays that are stopped at which there may be something to learn.
const LEAST_STOPPED: f64 = 0.02;

/// What weights change for samples that are drawn in proportion to what is reflected of the sky, summed over cells by their rays.
#[derive(Clone, Copy, Debug, Default)]
pub struct Worth {
    /// The square of what is seen.
    squared_mean: f64,
    /// The second moment of samples without weights.
    plain: f64,
    /// The same with weights.
    weighted: f64,
    /// Rays, and those of them that were stopped.
    rays: f64,
    stopped: f64,
}

impl Worth {
    /// That of a cell: the rays to each patch, which were drawn in that proportion, say how much of the light is in the patch.
    pub fn of(rays: impl Iterator<Item = [u32; 2]>, visibility: &Visibility, weights: &Weights) -> Self {
        let (mut all, mut stopped, mut seen, mut weight, mut squared) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (patch, ([came_through, rays], &visibility)) in rays.zip(visibility.patches()).enumerate() {
            stopped += f64::from(rays) - f64::from(came_through);
            let (rays, visibility, own) = (f64::from(rays), f64::from(visibility), f64::from(weights.of_patch(patch)));
            all += rays;
            seen += rays * visibility;
            weight += rays * own;
            squared += rays * visibility / own;
        }
        // A patch with share e of what is reflected (the sum of shares is 1) is drawn with probability e g / sum of e g, and adds e times
        // one over that if it is seen. So the second moment is (sum of e v / g)(sum of e g), and sum of e v without weights. Cells count by their rays.
        let one = 1.0 / f64::max(all, 1.0);
        Self { squared_mean: one * seen * seen, plain: seen, weighted: one * squared * weight, rays: all, stopped }
    }

    /// That of two sets of cells.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        Self {
            squared_mean: self.squared_mean + other.squared_mean,
            plain: self.plain + other.plain,
            weighted: self.weighted + other.weighted,
            rays: self.rays + other.rays,
            stopped: self.stopped + other.stopped,
        }
    }

    /// The variance of samples without weights over that of samples with them; 1 where nothing is known.
    pub fn gain(&self) -> f64 {
        let [plain, weighted] = [self.plain, self.weighted].map(|moment| moment - self.squared_mean);
        if plain > 0.0 && weighted > 0.0 { plain / weighted } else { 1.0 }
    }

    /// Whether more rays may come to foresee a gain that pays. What few rays foresee is nothing, as priors are stronger; how many of them were
    /// stopped is known soon.
    pub fn promises(&self) -> bool {
        self.stopped > LEAST_STOPPED * self.rays
    }

    /// Whether weights gain more than they take.
    pub fn pays(&self) -> bool {
        self.gain() >= LEAST_GAIN
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility::PATCHES;

    /// Rays to two patches, as many to each, with what is seen of them.
    fn worth(seen: [f32; 2]) -> Worth {
        let rays = (0..PATCHES).map(|patch| [0, if patch < 2 { 100 } else { 0 }]);
        let mut visibility = Visibility::unknown();
        visibility.set(&seen);
        let weights = Weights::new(|patch| seen.get(patch).map_or(1.0, |seen| seen.max(0.3)), &[1.0; PATCHES]);
        Worth::of(rays, &visibility, &weights)
    }

    #[test]
    fn the_gain_is_that_of_the_variance() {
        // Seen and not seen. Without weights the mean is 1/2 and its square 1/4, the second moment 1/2. With weights 1 and 77/255, the second moment is
        // 1/2 (1 + 77/255) / 2.
        let expected = 0.25 / (0.25 * (1.0 + 77.0 / 255.0) - 0.25);
        assert!((worth([1.0, 0.0]).gain() / expected - 1.0).abs() < 1e-6, "{}", worth([1.0, 0.0]).gain());
        assert!(worth([1.0, 0.0]).pays());
    }

    #[test]
    fn what_is_seen_alike_is_worth_nothing() {
        for seen in [[1.0, 1.0], [0.5, 0.5]] {
            assert!((worth(seen).gain() - 1.0).abs() < 1e-6 && !worth(seen).pays());
        }
        assert_eq!(Worth::default().gain(), 1.0);
    }

    #[test]
    fn where_no_ray_is_stopped_there_is_nothing_to_learn() {
        let of = |came_through: u32| {
            let rays = (0..PATCHES).map(|patch| if patch == 0 { [came_through, 100] } else { [0, 0] });
            Worth::of(rays, &Visibility::unknown(), &Weights::unknown())
        };
        assert!(!Worth::default().promises() && !of(100).promises() && !of(99).promises());
        assert!(of(90).promises() && of(0).promises());
    }

    #[test]
    fn cells_count_by_their_rays() {
        let [occluded, open] = [worth([1.0, 0.0]), worth([1.0, 1.0])];
        let many = (0..100).fold(occluded, |sum, _| sum.with(open));
        // Open cells have no variance at all.
        assert!((many.gain() / occluded.gain() - 1.0).abs() < 1e-9 && many.pays(), "{}", many.gain());
        let shaded = (0..100).fold(occluded, |sum, _| sum.with(worth([0.5, 0.5])));
        assert!(shaded.gain() < 1.01, "{}", shaded.gain());
    }
}
