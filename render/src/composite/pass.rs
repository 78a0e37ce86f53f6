//! Passes over the pixels of a photograph.

use std::{
    cell::RefCell,
    ops::Range,
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use super::{
    composition::{Composition, Settings},
    film::Film,
    worker::{Sums, Worker, Workspace},
};
use crate::{
    estimator::{Estimator, LearningSession, ViewGeometry},
    integrator::{MAX_SIDE, Part, TrainingPass, tiles::Tiles},
    points::{PointSet, Points},
};

/// Samples per pixel and pass.
const PASS: u32 = 8;

/// Sums all samples, or those of the passes until `stop` is set (at least one pass). `progress` receives the
/// completed fraction after every pass. Equal settings give equal films on any number of threads.
///
/// Estimators with a session train first, on 1/64 as many samples from separate points: the sampling density
/// does not depend on the film's samples, and the mask stays unbiased.
///
/// # Panics
/// If a side is longer than [`MAX_SIDE`].
pub fn compose(composition: Composition<'_>, settings: Settings, stop: &AtomicBool, progress: &dyn Fn(f64)) -> Film {
    let side = settings.width.max(settings.height);
    assert!(side <= MAX_SIDE, "an image of more pixels along a side than can be numbered");
    let start = Instant::now();
    composition.stage.all.prepare_materials();
    let session = learn(composition, settings, stop);
    let estimator = session.as_ref().map_or(composition.estimator, |session| session as &dyn Estimator);
    let run = Run { composition: Composition { estimator, ..composition }, settings, session: None };
    let points = Points::new(PointSet::Sobol, settings.seed);
    let total = settings.spp.max(1);
    let mut film = Film::new(settings.width, settings.height);
    let mut tiles = settings.tiles(|_| true);
    while film.spp < total {
        let samples = film.spp..total.min(film.spp + PASS);
        run.add(&mut tiles, points, samples.clone());
        film.spp = samples.end;
        progress(f64::from(film.spp) / f64::from(total));
        if stop.load(Ordering::Relaxed) {
            break;
        }
    }
    for (index, sums) in tiles.row_major().into_iter().enumerate() {
        film.mask_rays += sums.mask_rays;
        film.other_rays += sums.other_rays;
        film.catcher[index] = sums.catcher;
        film.object[index] = (sums.object_hits, sums.object);
    }
    film.seconds = start.elapsed().as_secs_f64();
    film
}

/// Trains the estimator on the visibility of the stage, with samples that are discarded; `None` if it has no
/// session.
fn learn<'a>(composition: Composition<'a>, settings: Settings, stop: &AtomicBool) -> Option<LearningSession<'a>> {
    let Settings { width, height, spp, seed, .. } = settings;
    let camera = composition.camera;
    let view = ViewGeometry { eye: camera.look_from(), pixel: camera.pixel_spread(height), pixels: width * height };
    let mut session = composition.estimator.learning_session(view)?;
    TrainingPass::before(spp, 0).in_parts(&mut session, |pass, session| {
        let mut tiles = settings.tiles(|key| pass.includes(key));
        pass.train(session, seed, stop, |session, points, sample| {
            let composition = Composition { estimator: session, ..composition };
            let run = Run { composition, settings: Settings { depth: 1, ..settings }, session: Some(session) };
            run.add(&mut tiles, points, sample..sample + 1);
        });
    });
    session.finish();
    Some(session)
}

impl Settings {
    /// Returns the pixels whose keys are chosen.
    fn tiles(&self, is_chosen: impl Fn(u32) -> bool) -> Tiles<Sums> {
        Tiles::new(Part { left: 0, top: 0, width: self.width, height: self.height }, is_chosen)
    }
}

/// The parameters for sampling tiles.
#[derive(Clone, Copy)]
struct Run<'a> {
    composition: Composition<'a>,
    settings: Settings,
    session: Option<&'a LearningSession<'a>>,
}

impl Run<'_> {
    /// Adds samples to all tiles.
    fn add(self, tiles: &mut Tiles<Sums>, points: Points, samples: Range<u32>) {
        let Self { composition, settings, session } = self;
        thread_local! {
            static WORKSPACE: RefCell<Workspace> = RefCell::default();
        }
        tiles.par_for_each(|pixels| {
            WORKSPACE.with_borrow_mut(|workspace| {
                let mut worker = Worker { composition, settings, session, points, workspace, pixels };
                for sample in samples.clone() {
                    worker.points = points.at_sample(sample);
                    worker.sample();
                }
            });
        });
    }
}
