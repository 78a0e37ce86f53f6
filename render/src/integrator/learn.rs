//! Trains visibility on samples that are not part of a picture: before rendering it, or for a file.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

use super::{
    film::{Film, Pass},
    rendering::Budget,
    view::{Part, View},
};
use crate::{
    estimator::{LearnedVisibility, LearningSession, ViewGeometry},
    points::{PointSet, Points},
    visibility::{CacheSize, FlatVisibility, SceneVisibility},
};

/// First sample number of training. Pictures use lower ones, so that they are independent of it.
const FIRST_SAMPLE: u32 = 1 << 31;
/// Samples of a picture per training sample.
const PARTS: u32 = 64;
/// Cost of a training sample, with its eight shadow rays, relative to a sample of a picture: 7 to 10.
const PRICE: u32 = 8;
/// Pixels of an 8 x 8 block. Passes of less than one sample per pixel train on some pixels of each block.
const BLOCK: u32 = 64;

/// Returns the camera and size of a part of a view.
pub(super) fn view_geometry(view: &View<'_>, part: Part) -> ViewGeometry {
    ViewGeometry {
        eye: view.camera.look_from(),
        pixel: view.camera.pixel_spread(view.height),
        pixels: part.width * part.height,
    }
}

/// Samples that visibility is trained on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TrainingPass {
    /// The first sample.
    first: u32,
    /// Samples of each pixel.
    samples: u32,
    /// Range of pixels of each block.
    pixels: (u32, u32),
}

impl TrainingPass {
    /// Creates the pass before a picture of `samples` samples per pixel.
    pub(crate) fn before(samples: u32, first: u32) -> Self {
        let pixels = (samples / (PARTS / BLOCK)).clamp(1, BLOCK);
        Self { first, samples: (samples / PARTS).max(1), pixels: (0, pixels) }
    }

    /// Runs the pass in up to four parts and stops early when the predicted gain is too small.
    pub(crate) fn in_parts(
        self,
        session: &mut LearningSession<'_>,
        mut run: impl FnMut(Self, &mut LearningSession<'_>),
    ) {
        let (first, end) = self.pixels;
        for part in self.parts() {
            run(part, session);
            let done = part.pixels.1 - first;
            if part.pixels.1 == end || !session.could_pay(f64::from(end - first) / f64::from(done)) {
                break;
            }
        }
    }

    fn parts(self) -> impl Iterator<Item = Self> {
        let (first, end) = self.pixels;
        let [eighth, quarter, half] = [8, 4, 2].map(|part| first + (end - first) / part);
        let parts = [(first, eighth), (eighth, quarter), (quarter, half), (half, end)]
            .into_iter()
            .filter(|(first, end)| first < end);
        parts.map(move |pixels| Self { pixels, ..self })
    }

    /// Returns whether the pass includes the pixel with this key.
    pub(crate) fn includes(&self, key: u32) -> bool {
        // Reversed bits spread the first pixels over the block.
        let place = (key % BLOCK).reverse_bits() >> (32 - BLOCK.ilog2());
        (self.pixels.0..self.pixels.1).contains(&place)
    }

    /// Trains on each sample: `observe` traces it for all pixels of the pass, given the points and the sample
    /// number.
    pub(crate) fn train(
        self,
        session: &mut LearningSession<'_>,
        seed: u64,
        stop: &AtomicBool,
        mut observe: impl FnMut(&LearningSession<'_>, Points, u32),
    ) {
        let points = Points::new(PointSet::Independent, seed);
        session.explore(true);
        for sample in 0..self.samples {
            observe(&*session, points, FIRST_SAMPLE + self.first + sample);
            let count = sample + 1;
            let is_last = count == self.samples || stop.load(Ordering::Relaxed);
            if is_last {
                session.learn();
                break;
            }
            if count.is_power_of_two() {
                session.settle();
            }
        }
        session.explore(false);
    }
}

/// Trains for a part of a picture, in a fraction of its budget.
pub(super) fn learn_before(
    view: (&View<'_>, Part),
    session: &mut LearningSession<'_>,
    budget: Budget,
    seed: u64,
    stop: &AtomicBool,
) {
    let show = |_: f64| {};
    match budget {
        Budget::Spp(spp) => {
            TrainingPass::before(spp, 0)
                .in_parts(session, |part, session| learn(view, session, part, seed, stop, &show));
        }
        Budget::Time(limit) => {
            let start = Instant::now();
            let first = TrainingPass::before(1, 0);
            learn(view, session, first, seed, stop, &show);
            let sample = start.elapsed() * BLOCK / (PRICE * first.pixels.1);
            let samples = limit.as_secs_f64() / sample.max(Duration::from_nanos(1)).as_secs_f64();
            let rest = TrainingPass::before(samples as u32, first.samples);
            if rest.pixels.1 > 1 {
                rest.in_parts(session, |part, session| learn(view, session, part, seed, stop, &show));
            }
        }
    }
    session.finish();
}

/// Trains visibility for a part of a picture as [`render_part`](super::render_part) does before the first sample, for
/// renderers on other devices. Returns the weights, if they are used, and the size of the cache.
pub fn learn_weights(
    (view, part): (View<'_>, Part),
    estimator: &LearnedVisibility,
    budget: Budget,
    seed: u64,
    stop: &AtomicBool,
) -> (Option<FlatVisibility>, CacheSize) {
    view.scene.prepare_materials();
    let mut session = estimator.session(view_geometry(&view, part));
    learn_before((&view, part), &mut session, budget, seed, stop);
    (session.flat(), session.size())
}

fn learn(
    (view, part): (&View<'_>, Part),
    session: &mut LearningSession<'_>,
    pass: TrainingPass,
    seed: u64,
    stop: &AtomicBool,
    progress: &dyn Fn(f64),
) {
    let mut film = Film::of(part, |key| pass.includes(key));
    pass.train(session, seed, stop, |session, points, sample| {
        film.add(view, &Pass { estimator: session, session: Some(session), points, samples: (sample, sample + 1) });
        progress(f64::from(sample + 1 - FIRST_SAMPLE - pass.first) / f64::from(pass.samples));
    });
}

/// Trains visibility on `samples` independent samples per pixel of a view, for all views of the scene.
///
/// Resumes from `before`, which must be of the same scene and map. `progress` receives the completed
/// fraction. If `stop` is set, returns the visibility trained so far.
///
/// # Panics
/// If `samples` is 0, or 2^31 or more.
pub fn learn_visibility(
    view: View<'_>,
    estimator: &LearnedVisibility,
    before: Option<SceneVisibility>,
    (samples, seed): (u32, u64),
    stop: &AtomicBool,
    progress: &dyn Fn(f64),
) -> SceneVisibility {
    assert!((1..FIRST_SAMPLE).contains(&samples), "1 to 2^31 samples");
    view.scene.prepare_materials();
    let mut session = estimator.session(view_geometry(&view, view.whole()));
    if let Some(before) = before {
        session = session.resuming(before);
    }
    learn(
        (&view, view.whole()),
        &mut session,
        TrainingPass { first: 0, samples, pixels: (0, BLOCK) },
        seed,
        stop,
        progress,
    );
    session.into_visibility(view.scene.geometry_hash())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passes_are_a_small_fraction_of_the_picture() {
        for samples in [1, 2, 3, 4, 8, 16, 31, 32, 64, 100, 1 << 20] {
            let pass = TrainingPass::before(samples, 0);
            let pixels = (0..BLOCK).filter(|&key| pass.includes(key)).count() as u32;
            assert_eq!((0, pixels), pass.pixels);
            let of_parts = |key: u32| pass.parts().filter(|part| part.includes(key)).count();
            assert!(
                (0..BLOCK).all(|key| of_parts(key) == usize::from(pass.includes(key))),
                "{samples}: each pixel once"
            );
            let cost = f64::from(pass.samples * pixels) / f64::from(BLOCK) / f64::from(samples);
            // At least one pixel of a block; rounding down leaves more than half of 1 / 64.
            assert!(cost <= f64::max(1.0 / 64.0, 1.0 / f64::from(64 * samples)), "{samples}: {cost}");
            assert!(cost > 1.0 / 129.0, "{samples}: {cost}");
        }
    }
}
