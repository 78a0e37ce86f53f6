//! Passes over the pixels of a photograph.

use std::{
    cell::RefCell,
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use rayon::prelude::*;

use super::{
    composition::{Composition, Settings},
    film::Film,
    worker::{Pixels, Worker, Workspace},
};
use crate::points::{PointSet, Points};

/// Samples per pixel and pass.
const PASS: u32 = 8;

/// Sums up all samples, or those of the passes until `stop` is set (at least one pass). `progress` is called after every pass with the share that is
/// done. The same settings give the same film on any number of threads.
///
/// # Panics
/// If a side is longer than [`crate::integrator::MAX_SIDE`].
pub fn compose(composition: Composition<'_>, settings: Settings, stop: &AtomicBool, progress: &dyn Fn(f64)) -> Film {
    let side = settings.width.max(settings.height);
    assert!(side <= crate::integrator::MAX_SIDE, "an image of more pixels along a side than can be numbered");
    let start = Instant::now();
    composition.stage.all.prepare_materials();
    let total = settings.spp.max(1);
    let mut film = Film::new(settings.width, settings.height);
    let mut tiles = Pixels::tiles(settings.width, settings.height);
    while film.spp < total {
        let samples = film.spp..total.min(film.spp + PASS);
        tiles.par_iter_mut().for_each(|pixels| {
            thread_local! {
                static WORKSPACE: RefCell<Workspace> = RefCell::default();
            }
            WORKSPACE.with_borrow_mut(|workspace| {
                for sample in samples.clone() {
                    let points = Points::new(PointSet::Sobol, settings.seed).at_sample(sample);
                    Worker { composition, settings, points, workspace, pixels }.sample();
                }
            });
        });
        film.spp = samples.end;
        progress(f64::from(film.spp) / f64::from(total));
        if stop.load(Ordering::Relaxed) {
            break;
        }
    }
    for tile in &tiles {
        film.mask_rays += tile.mask_rays;
        film.other_rays += tile.other_rays;
        for (&(x, y), sums) in tile.places.iter().zip(&tile.sums) {
            let index = usize::from(y) * settings.width + usize::from(x);
            film.catcher[index] = sums.catcher;
            film.object[index] = (sums.object_hits, sums.object);
        }
    }
    film.seconds = start.elapsed().as_secs_f64();
    film
}
