//! Learning the visibility of a scene before anything is rendered.

use std::sync::atomic::{AtomicBool, Ordering};

use super::{
    render::{Film, Pass, setting},
    stages::Stages,
    view::View,
};
use crate::{
    estimator::{LearnedVisibility, Learner},
    points::{PointSet, Points},
    visibility::{Grouping, SceneVisibility},
};

/// The first sample of learning: renderings have samples below, so that no picture depends on the points that it was learned from.
const FIRST_SAMPLE: u32 = 1 << 31;

/// Learns from `samples` independent samples of each pixel of a view, all of them; what is learned serves other views of the scene, too. Goes on where `before` has
/// ended, if that is of the same scene and map. `progress` is called with the share that is done; where `stop` is set, what was learned so far is
/// the result.
///
/// # Panics
/// If there are 2^31 samples or more.
pub fn learn_visibility(
    view: View<'_>,
    estimator: &LearnedVisibility,
    before: Option<SceneVisibility>,
    (samples, seed): (u32, u64),
    stop: &AtomicBool,
    progress: &dyn Fn(f64),
) -> SceneVisibility {
    assert!(samples < FIRST_SAMPLE, "at most 2^31 samples");
    view.scene.prepare_materials();
    let mut session = estimator.session(setting(&view, Grouping::One));
    if let Some(before) = before {
        session = session.resuming(before);
    }
    let (points, stages) = (Points::new(PointSet::Independent, seed), Stages::new(PointSet::Independent, samples));
    let mut film = Film::new(view.width, view.height);
    for sample in 0..samples {
        let stage = stages.of(sample);
        let samples_here = (FIRST_SAMPLE + sample, FIRST_SAMPLE + sample + 1);
        let pass = Pass {
            estimator,
            learner: Some(&session),
            points,
            stages,
            stage,
            samples: samples_here,
            observes_all: true,
        };
        film.add(&view, &pass);
        progress(f64::from(sample + 1) / f64::from(samples));
        let ends = sample + 1 == samples || stop.load(Ordering::Relaxed);
        if ends || stages.of(sample + 1).number > stage.number {
            session.learn(ends);
        }
        if ends {
            break;
        }
    }
    session.into_visibility(view.scene.geometry_hash())
}
