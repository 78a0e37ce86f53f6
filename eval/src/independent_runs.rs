//! Variance of an unbiased sampler from its own pictures, without a reference.

use headtail_render::image::Image;

use crate::{Budget, OpenedView, TimingBaseline, select};

/// Pictures of a sampler at one number of samples, one per seed.
#[derive(Debug, Default)]
pub struct IndependentRuns {
    /// Samples per pixel of each picture.
    pub samples: u32,
    pictures: Vec<Image>,
    /// Time of a sample of each picture relative to the baseline around it.
    ratios: Vec<f64>,
}

impl IndependentRuns {
    /// Returns no pictures yet, for `samples` samples per pixel.
    pub fn new(samples: u32) -> Self {
        Self { samples, ..Self::default() }
    }

    /// Renders up to `count` pictures of the `covered` pixels; picture `k` has seed `k + 1` for every
    /// sampler. Each is timed against the baseline, if there is one.
    pub fn extend(
        &mut self,
        view: &OpenedView,
        estimator: &dyn headtail_render::estimator::Estimator,
        baseline: Option<&TimingBaseline>,
        count: usize,
        covered: &[bool],
    ) {
        while self.pictures.len() < count {
            let seed = 1 + self.pictures.len() as u64;
            let render = || crate::timing_baseline::timed(view, estimator, Budget::Samples(self.samples), seed);
            let rendering = match baseline {
                Some(baseline) => {
                    let (rendering, ratio) = baseline.ratio_of(view, render);
                    self.ratios.push(ratio);
                    rendering
                }
                None => render().0,
            };
            self.pictures.push(select(&rendering.surfaces, covered));
        }
    }

    /// Returns the times of a sample relative to the baseline, one per picture. Outliers, of pictures during
    /// which another program started or ended, are clamped to within a factor of 1.5 of the median.
    pub fn time_ratios(&self) -> Vec<f64> {
        const FACTOR: f64 = 1.5;
        let mut sorted = self.ratios.clone();
        sorted.sort_by(f64::total_cmp);
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(1.0);
        self.ratios.iter().map(|ratio| ratio.clamp(median / FACTOR, median * FACTOR)).collect()
    }

    /// Returns the mean of [`Self::time_ratios`]; infinite before the first picture.
    pub fn time_ratio(&self) -> f64 {
        let ratios = self.time_ratios();
        if ratios.is_empty() { f64::INFINITY } else { ratios.iter().sum::<f64>() / ratios.len() as f64 }
    }

    /// Returns the mean squared error of each picture, estimated from the others: samplers are unbiased and
    /// seeds independent, so that `(x_k - mean of the others)^2` has the expectation `variance * n / (n -
    /// 1)`. Empty for fewer than two pictures.
    pub fn errors(&self) -> Vec<f64> {
        let count = self.pictures.len();
        if count < 2 {
            return Vec::new();
        }
        let size = self.pictures[0].pixels.len();
        let mut sums = vec![[0.0_f64; 3]; size];
        for picture in &self.pictures {
            for (sum, pixel) in sums.iter_mut().zip(&picture.pixels) {
                (0..3).for_each(|c| sum[c] += f64::from(pixel[c]));
            }
        }
        let n = count as f64;
        let error = |picture: &Image| {
            let pixels = picture.pixels.iter().zip(&sums);
            let squared = pixels.map(|(pixel, sum)| {
                let off = |c: usize| f64::from(pixel[c]) - (sum[c] - f64::from(pixel[c])) / (n - 1.0);
                (0..3).map(|c| off(c).powi(2)).sum::<f64>()
            });
            squared.sum::<f64>() / (3 * size) as f64 * (n - 1.0) / n
        };
        self.pictures.iter().map(error).collect()
    }
}

#[cfg(test)]
mod tests {
    use headtail_render::random::{Purpose, Stream};

    use super::*;

    #[test]
    fn errors_need_no_reference() {
        let mut random = Stream::new(1, Purpose::Test, 0);
        // Uniform numbers around values that differ between pixels: variance 1 / 12.
        let mut picture = || Image {
            width: 5000,
            height: 1,
            pixels: (0..5000).map(|k| [0; 3].map(|_: i32| (k % 7) as f32 + random.uniform())).collect(),
        };
        for count in [2, 5] {
            let pictures = (0..count).map(|_| picture()).collect();
            let errors = IndependentRuns { samples: 1, pictures, ratios: Vec::new() }.errors();
            let mean = errors.iter().sum::<f64>() / f64::from(count);
            // 15,000 numbers whose squares have a relative deviation of about 1.5: 1.2 %; the tolerance is
            // four of them.
            assert!((mean * 12.0 - 1.0).abs() < 0.05, "{count}: {mean}");
        }
        assert!(IndependentRuns::new(1).errors().is_empty());
    }
}
