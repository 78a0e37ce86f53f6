//! Times relative to a baseline that is rendered before and after, so that other load on the machine slows
//! down both.

use std::{
    cell::Cell,
    sync::atomic::AtomicBool,
    time::{Duration, Instant},
};

use headtail_render::{
    estimator::Estimator,
    integrator::Rendering,
    points::{PointSet, Points},
};

use crate::{Budget, OpenedView, clock::with_processor_seconds};

/// A sampler that others are timed against.
pub struct TimingBaseline {
    estimator: Box<dyn Estimator>,
    samples: u32,
    /// Seconds of one sample per pixel: the minimum of several renderings.
    pub sample_seconds: f64,
    /// The last time: the one after a picture also serves as the one before the next.
    last: Cell<Option<(Instant, f64)>>,
}

/// How long a time is reused.
const FRESH: Duration = Duration::from_millis(20);

impl TimingBaseline {
    /// Prepares a baseline and times it at `samples` samples per pixel.
    pub fn new(view: &OpenedView, estimator: Box<dyn Estimator>, samples: u32) -> Self {
        let mut baseline = Self { estimator, samples, sample_seconds: f64::INFINITY, last: Cell::new(None) };
        for _ in 0..4 {
            baseline.sample_seconds = baseline.sample_seconds.min(baseline.time(view));
        }
        baseline
    }

    /// Renders between two renderings of the baseline; returns the picture and the time of its sample
    /// relative to the baseline's.
    pub(crate) fn ratio_of(&self, view: &OpenedView, render: impl FnOnce() -> (Rendering, f64)) -> (Rendering, f64) {
        let fresh = self.last.get().filter(|(time, _)| time.elapsed() < FRESH);
        let before = fresh.map_or_else(|| self.time(view), |(_, seconds)| seconds);
        let (rendering, seconds) = render();
        let after = self.time(view);
        (rendering, seconds / (0.5 * (before + after)))
    }

    fn time(&self, view: &OpenedView) -> f64 {
        let seconds = timed(view, &*self.estimator, Budget::Samples(self.samples), 0).1;
        self.last.set(Some((Instant::now(), seconds)));
        seconds
    }
}

/// Renders a picture; also returns the seconds of one sample per pixel: processor time divided by the threads
/// where the system reports it, else wall-clock time.
pub(crate) fn timed(view: &OpenedView, estimator: &dyn Estimator, budget: Budget, seed: u64) -> (Rendering, f64) {
    let (points, never) = (Points::new(PointSet::Sobol, seed), AtomicBool::new(false));
    let (rendering, used) = with_processor_seconds(|| view.render(estimator, budget, points, &never, &|_| {}));
    let seconds = used.map_or(rendering.seconds, |used| used / rayon::current_num_threads() as f64);
    let samples = f64::from(rendering.spp.max(1));
    (rendering, seconds / samples)
}
