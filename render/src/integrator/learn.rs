//! Learning what is seen of the sky: before a picture, from samples of its view that are no part of it, or for a file.

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
    estimator::{LearnedVisibility, Learner, Setting},
    points::{PointSet, Points},
    visibility::SceneVisibility,
};

/// The first sample that is learned from: pictures have samples below, so that none depends on the points that it was learned from.
const FIRST_SAMPLE: u32 = 1 << 31;
/// The share of the points of a picture that is learned from before it, as one over this number.
const PARTS: u32 = 64;
/// The time of a point of a lesson, which sends eight shadow rays, over that of a point of a picture: seven to ten.
const PRICE: u32 = 8;
/// Pixels of a block of which some are learned from where less than one sample of each pixel is: eight along a side.
const BLOCK: u32 = 64;

/// What estimators that learn are told of a view.
pub(super) fn setting(view: &View<'_>, part: Part) -> Setting {
    Setting {
        eye: view.camera.look_from(),
        pixel: view.camera.pixel_spread(view.height),
        pixels: part.width * part.height,
    }
}

/// Samples to learn from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Lesson {
    /// The first of them.
    first: u32,
    /// How many for each pixel.
    samples: u32,
    /// The first of the pixels of a block, and the first after them.
    pixels: (u32, u32),
}

impl Lesson {
    /// One for a picture of so many samples per pixel.
    pub(crate) fn before(samples: u32, first: u32) -> Self {
        let pixels = (samples / (PARTS / BLOCK)).clamp(1, BLOCK);
        Self { first, samples: (samples / PARTS).max(1), pixels: (0, pixels) }
    }

    /// Lets it be given in four parts, if it has as many pixels: a learner to whom an eighth or a quarter of it promises nothing, or half of it too little, is spared the rest.
    pub(crate) fn in_parts(self, learner: &mut dyn Learner, mut give: impl FnMut(Self, &mut dyn Learner)) {
        let (first, end) = self.pixels;
        for part in self.parts() {
            give(part, learner);
            let given = part.pixels.1 - first;
            if part.pixels.1 == end || !learner.promises(f64::from(end - first) / f64::from(given)) {
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

    /// Whether it has a pixel with this key.
    pub(crate) fn has(&self, key: u32) -> bool {
        // Reversed bits spread the first few over the block.
        let place = (key % BLOCK).reverse_bits() >> (32 - BLOCK.ilog2());
        (self.pixels.0..self.pixels.1).contains(&place)
    }

    /// Lets a learner learn from each sample, which `observe` takes for all pixels of the lesson; it is told the points and the number of the sample.
    pub(crate) fn teach(
        self,
        learner: &mut dyn Learner,
        seed: u64,
        stop: &AtomicBool,
        mut observe: impl FnMut(&dyn Learner, Points, u32),
    ) {
        let points = Points::new(PointSet::Independent, seed);
        learner.explore(true);
        for sample in 0..self.samples {
            observe(&*learner, points, FIRST_SAMPLE + self.first + sample);
            let count = sample + 1;
            let is_last = count == self.samples || stop.load(Ordering::Relaxed);
            if is_last {
                learner.learn();
                break;
            }
            if count.is_power_of_two() {
                learner.settle();
            }
        }
        learner.explore(false);
    }
}

/// Learns for a part of a picture, in a part of its budget.
pub(super) fn learn_before(
    view: (&View<'_>, Part),
    learner: &mut dyn Learner,
    budget: Budget,
    seed: u64,
    stop: &AtomicBool,
) {
    let show = |_: f64| {};
    match budget {
        Budget::Spp(spp) => {
            Lesson::before(spp, 0).in_parts(learner, |part, learner| learn(view, learner, part, seed, stop, &show));
        }
        Budget::Time(limit) => {
            let start = Instant::now();
            let first = Lesson::before(1, 0);
            learn(view, learner, first, seed, stop, &show);
            let sample = start.elapsed() * BLOCK / (PRICE * first.pixels.1);
            let promised = limit.as_secs_f64() / sample.max(Duration::from_nanos(1)).as_secs_f64();
            let lesson = Lesson::before(promised as u32, first.samples);
            if lesson.pixels.1 > 1 {
                lesson.in_parts(learner, |part, learner| learn(view, learner, part, seed, stop, &show));
            }
        }
    }
    learner.finish();
}

fn learn(
    (view, part): (&View<'_>, Part),
    learner: &mut dyn Learner,
    lesson: Lesson,
    seed: u64,
    stop: &AtomicBool,
    progress: &dyn Fn(f64),
) {
    let mut film = Film::of(part, |key| lesson.has(key));
    lesson.teach(learner, seed, stop, |learner, points, sample| {
        film.add(view, &Pass { estimator: learner, learner: Some(learner), points, samples: (sample, sample + 1) });
        progress(f64::from(sample + 1 - FIRST_SAMPLE - lesson.first) / f64::from(lesson.samples));
    });
}

/// Learns from `samples` independent samples of each pixel of a view; what is learned serves other views of the scene, too. Goes on where `before` has
/// ended, if that is of the same scene and map. `progress` is called with the share that is done; where `stop` is set, what was learned so far is
/// the result.
///
/// # Panics
/// If there are no samples, or 2^31 and more.
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
    let mut session = estimator.session(setting(&view, view.whole()));
    if let Some(before) = before {
        session = session.resuming(before);
    }
    learn((&view, view.whole()), &mut session, Lesson { first: 0, samples, pixels: (0, BLOCK) }, seed, stop, progress);
    session.into_visibility(view.scene.geometry_hash())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lesson_is_a_small_part_of_the_picture() {
        for samples in [1, 2, 3, 4, 8, 16, 31, 32, 64, 100, 1 << 20] {
            let lesson = Lesson::before(samples, 0);
            let pixels = (0..BLOCK).filter(|&key| lesson.has(key)).count() as u32;
            assert_eq!((0, pixels), lesson.pixels);
            let of_parts = |key: u32| lesson.parts().filter(|part| part.has(key)).count();
            assert!((0..BLOCK).all(|key| of_parts(key) == usize::from(lesson.has(key))), "{samples}: each pixel once");
            let cost = f64::from(lesson.samples * pixels) / f64::from(BLOCK) / f64::from(samples);
            // At least one pixel of a block; numbers are rounded down, to more than a half.
            assert!(cost <= f64::max(1.0 / 64.0, 1.0 / f64::from(64 * samples)), "{samples}: {cost}");
            assert!(cost > 1.0 / 129.0, "{samples}: {cost}");
        }
    }
}
