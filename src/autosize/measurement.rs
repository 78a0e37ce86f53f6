//! Trial pictures of one sampler, and what they say without a reference.

use std::{
    cell::Cell,
    time::{Duration, Instant},
};

use headtail_render::{
    estimator::Estimator,
    image::Image,
    integrator::{Budget, Rendering},
    points::{PointSet, Points},
};

use crate::{arguments::OpenedView, compare, render::quietly};

/// The pictures of a sampler at one number of samples, one for each seed.
#[derive(Debug, Default)]
pub struct Measurement {
    /// Samples per pixel of each picture.
    pub spp: u32,
    pictures: Vec<Image>,
    /// The time of a sample of each picture over that of the yardstick, which was rendered just before it.
    ratios: Vec<f64>,
}

/// What times are measured against: a sampler that is timed before and after every picture, so that what else the machine does slows down both.
pub struct Yardstick {
    estimator: Box<dyn Estimator>,
    spp: u32,
    /// Seconds of its sample of every pixel on a machine that does nothing else, as far as that was seen.
    pub sample_seconds: f64,
    /// The last measurement: the one after a picture is the one before the next.
    last: Cell<Option<(Instant, f64)>>,
}

/// So long is a measurement of the yardstick that of now.
const FRESH: Duration = Duration::from_millis(20);

impl Yardstick {
    /// By the least of a few times.
    pub fn new(opened: &OpenedView, estimator: Box<dyn Estimator>, spp: u32) -> Self {
        let mut yardstick = Self { estimator, spp, sample_seconds: f64::INFINITY, last: Cell::new(None) };
        for _ in 0..4 {
            yardstick.sample_seconds = yardstick.sample_seconds.min(yardstick.after(opened));
        }
        yardstick
    }

    /// Before a picture.
    fn before(&self, opened: &OpenedView) -> f64 {
        let fresh = self.last.get().filter(|(time, _)| time.elapsed() < FRESH);
        fresh.map_or_else(|| self.after(opened), |(_, seconds)| seconds)
    }

    /// After a picture.
    fn after(&self, opened: &OpenedView) -> f64 {
        let seconds = timed(opened, &*self.estimator, self.spp, 0).1;
        self.last.set(Some((Instant::now(), seconds)));
        seconds
    }
}

/// A picture, and the seconds of a sample of every pixel: those of the processor, shared by the threads, where the system tells them, else those
/// of the clock.
fn timed(opened: &OpenedView, estimator: &dyn Estimator, spp: u32, seed: u64) -> (Rendering, f64) {
    let before = processor_seconds();
    let rendering = quietly(opened.view(), estimator, Budget::Spp(spp), Points::new(PointSet::Sobol, seed));
    let used = processor_seconds().zip(before).map(|(after, before)| after - before);
    let seconds = used.map_or(rendering.seconds, |used| used / rayon::current_num_threads() as f64);
    (rendering, seconds / f64::from(spp))
}

impl Measurement {
    /// Before the first picture of `spp` samples.
    pub fn new(spp: u32) -> Self {
        Self { spp, pictures: Vec::new(), ratios: Vec::new() }
    }

    /// Renders up to `count` pictures; number `k` has the seed `k`, for every sampler.
    pub fn extend(
        &mut self,
        opened: &OpenedView,
        estimator: &dyn Estimator,
        yardstick: &Yardstick,
        count: usize,
        covered: &[bool],
    ) {
        while self.pictures.len() < count {
            let before = yardstick.before(opened);
            let (rendering, seconds) = timed(opened, estimator, self.spp, 1 + self.pictures.len() as u64);
            let after = yardstick.after(opened);
            self.ratios.push(seconds / (0.5 * (before + after)));
            self.pictures.push(compare::select(&rendering.surfaces, covered));
        }
    }

    /// The same without times.
    pub fn extend_untimed(&mut self, opened: &OpenedView, estimator: &dyn Estimator, count: usize, covered: &[bool]) {
        while self.pictures.len() < count {
            let rendering = timed(opened, estimator, self.spp, 1 + self.pictures.len() as u64).0;
            self.pictures.push(compare::select(&rendering.surfaces, covered));
        }
    }

    /// Times of a sample of every pixel over those of the yardstick, one for each picture. Those of a picture during which something else began or ended
    /// are moved to within a factor of the median.
    pub fn ratios(&self) -> Vec<f64> {
        const FACTOR: f64 = 1.5;
        let mut sorted = self.ratios.clone();
        sorted.sort_by(f64::total_cmp);
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(1.0);
        self.ratios.iter().map(|ratio| ratio.clamp(median / FACTOR, median * FACTOR)).collect()
    }

    /// Their mean; infinite before the first picture.
    pub fn ratio(&self) -> f64 {
        let ratios = self.ratios();
        if ratios.is_empty() { f64::INFINITY } else { ratios.iter().sum::<f64>() / ratios.len() as f64 }
    }

    /// The mean squared error of each picture, estimated from the others: every sampler is unbiased and seeds are independent, so that
    /// `(x_k - mean of the others)^2` has the expectation `variance * n / (n - 1)`. Empty of fewer than two pictures.
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
                (0..3)
                    .map(|c| {
                        let own = f64::from(pixel[c]);
                        (own - (sum[c] - own) / (n - 1.0)).powi(2)
                    })
                    .sum::<f64>()
            });
            squared.sum::<f64>() / (3 * size) as f64 * (n - 1.0) / n
        };
        self.pictures.iter().map(error).collect()
    }
}

/// Seconds that all threads of this process have run.
#[cfg(unix)]
#[expect(clippy::unnecessary_wraps, reason = "other systems do not tell")]
fn processor_seconds() -> Option<f64> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64)
}

#[cfg(not(unix))]
fn processor_seconds() -> Option<f64> {
    None
}

#[cfg(test)]
mod tests {
    use headtail_render::random::{Purpose, Stream};

    use super::*;

    #[test]
    fn errors_need_no_reference() {
        let mut random = Stream::new(1, Purpose::Test, 0);
        // Uniform numbers around values that differ from pixel to pixel: variance 1 / 12.
        let mut picture = || Image {
            width: 5000,
            height: 1,
            pixels: (0..5000).map(|k| [0; 3].map(|_: i32| (k % 7) as f32 + random.uniform())).collect(),
        };
        for count in [2, 5] {
            let pictures = (0..count).map(|_| picture()).collect();
            let errors = Measurement { spp: 1, pictures, ratios: Vec::new() }.errors();
            let mean = errors.iter().sum::<f64>() / f64::from(count);
            // 15,000 numbers whose squares have a relative deviation of about 1.5: 1.2 %; four of them.
            assert!((mean * 12.0 - 1.0).abs() < 0.05, "{count}: {mean}");
        }
        assert!(Measurement::new(1).errors().is_empty());
    }
}
