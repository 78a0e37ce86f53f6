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
use crate::{
    estimator::{Estimator, LearningSession},
    points::Points,
};

/// Samples per pixel and pass for a budget in samples.
const PASS: u32 = 16;
/// Samples per pixel and pass for a budget in time, so that a pass ends close to the limit.
const SHORT_PASS: u32 = 1;

/// Maximum width and height of an image.
pub const MAX_SIDE: usize = u16::MAX as usize;

/// Renders until the budget is spent or `stop` is set; an interrupted image holds the finished passes (at
/// least one).
///
/// `progress` is called after every pass with the fraction of the budget that is spent. Equal `points` (kind
/// and seed) and equal numbers of samples give equal bytes, on any number of threads and for either kind of
/// budget. Estimators that learn first train on other points, in a small fraction of the budget. Their
/// pictures also depend on the amount of training, which varies between runs with a budget in time.
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

/// Renders a part of the image as [`render`] does. At equal numbers of samples its pixels equal those of the
/// whole bit for bit, except with estimators that train, which then train on the part alone.
///
/// # Panics
/// As [`render`], and if the part extends beyond the image.
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
    // Without samples, means would be 0 / 0 and the spent fraction would never reach 1.
    let budget = if budget == Budget::Spp(0) { Budget::Spp(1) } else { budget };
    let pass = if matches!(budget, Budget::Spp(_)) { PASS } else { SHORT_PASS };
    let mut film = Film::new(part);
    let mut session = estimator.learning_session(view_geometry(&view, part));
    if let Some(session) = &mut session {
        learn_before((&view, part), session, budget, points.seed(), stop);
    }
    let estimator = session.as_ref().map_or(estimator, |session| session as &dyn Estimator);
    let mut points = if let Budget::Spp(spp) = budget { points.planned(spp) } else { points };
    let prepared = start.elapsed();
    let mut spp = 0;
    loop {
        let count = if let Budget::Spp(total) = budget { pass.min(total - spp) } else { pass };
        film.add(&view, &Pass { estimator, session: None, points, samples: (spp, spp + count) });
        spp += count;
        if let (1, Budget::Time(limit)) = (spp, budget) {
            // The first sample is the same for any number of samples.
            let of_sample = (start.elapsed() - prepared).as_secs_f64();
            points = points.planned(1.max(((limit.as_secs_f64() - prepared.as_secs_f64()) / of_sample).round() as u32));
        }
        let spent = match budget {
            Budget::Spp(total) => f64::from(spp) / f64::from(total),
            // Stops at the pass whose end is nearest to the limit.
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
    let learned = session.as_ref().map(LearningSession::size);
    Rendering { learned, ..film.resolve(points.set(), spp, start.elapsed().as_secs_f64()) }
}
