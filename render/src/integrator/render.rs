//! Passes over an image until a budget is spent.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use super::{
    film::{Film, Pass},
    learn::{learn_before, view_geometry},
    rendering::{Budget, Rendering},
    view::{Part, View},
};
use crate::{estimator::Estimator, points::Points};

/// Samples per pixel and pass where their number is the budget.
const PASS: u32 = 16;
/// The same where time is the budget: a pass should end close to the limit.
const SHORT_PASS: u32 = 1;

/// Largest width and height.
pub const MAX_SIDE: usize = u16::MAX as usize;

/// Renders until the budget is spent or `stop` is set; an interrupted image holds the passes that were finished (at least one).
///
/// `progress` is called after every pass with the share of the budget that is spent. Same `points` (their kind and seed) and same number of
/// samples: same bytes, on any number of threads and whatever the budget was given in. An estimator that learns does so first, from other points, in
/// a small part of the budget: its pictures depend on how much that was, too, which for a budget in time is not always the same.
///
/// # Panics
/// If a side is longer than [`MAX_SIDE`].
pub fn render(
    view: View<'_>,
    estimator: &dyn Estimator,
    budget: Budget,
    points: Points,
    stop: &AtomicBool,
    progress: &dyn Fn(f64),
) -> Rendering {
    render_part(view, view.whole(), estimator, budget, points, stop, progress)
}

/// [`render`] of a part of the image: at equal samples its pixels are those of the whole, bit for bit, but of an estimator that learns, to which
/// the others would have told something.
///
/// # Panics
/// As [`render`], and if the part is not inside of the image.
pub fn render_part(
    view: View<'_>,
    part: Part,
    estimator: &dyn Estimator,
    budget: Budget,
    points: Points,
    stop: &AtomicBool,
    progress: &dyn Fn(f64),
) -> Rendering {
    assert!(
        part.left + part.width <= view.width && part.top + part.height <= view.height,
        "{part:?} of {} x {}",
        view.width,
        view.height
    );
    assert!(view.width.max(view.height) <= MAX_SIDE, "an image of more than {MAX_SIDE} pixels along a side");
    view.scene.prepare_materials();
    let start = Instant::now();
    // Without a sample there is no mean: 0 / 0 would be black with NaN, and the share of the budget never reach 1.
    let budget = if budget == Budget::Spp(0) { Budget::Spp(1) } else { budget };
    let pass = if matches!(budget, Budget::Spp(_)) { PASS } else { SHORT_PASS };
    let mut film = Film::new(part);
    let mut trainer = estimator.trainer(view_geometry(&view, part));
    if let Some(trainer) = &mut trainer {
        learn_before((&view, part), &mut **trainer, budget, points.seed(), stop);
    }
    let estimator = trainer.as_ref().map_or(estimator, |trainer| &**trainer as &dyn Estimator);
    let mut spp = 0;
    loop {
        let count = if let Budget::Spp(total) = budget { pass.min(total - spp) } else { pass };
        film.add(&view, &Pass { estimator, trainer: None, points, samples: (spp, spp + count) });
        spp += count;
        let spent = match budget {
            Budget::Spp(total) => f64::from(spp) / f64::from(total),
            // Half a pass more is as near to the limit as half a pass less.
            Budget::Time(limit) => {
                let elapsed = start.elapsed().as_secs_f64();
                let half_pass = 0.5 * elapsed * f64::from(pass) / f64::from(spp);
                (elapsed + half_pass) / limit.as_secs_f64()
            }
        };
        progress(spent.min(1.0));
        if spent >= 1.0 || stop.load(Ordering::Relaxed) {
            break;
        }
    }
    let learned = trainer.map(|trainer| trainer.size());
    Rendering { learned, ..film.resolve(points.set(), spp, start.elapsed().as_secs_f64()) }
}
