//! The measuring loop: renders every sampler at every budget, run by run, and compares with one reference.

use std::{
    path::PathBuf,
    sync::atomic::{AtomicBool, Ordering},
};

use headtail_render::{
    image::Image,
    integrator::Rendering,
    statistics::{TileTest, compare_images, ttuv},
};

use crate::{
    Budget, Entry, Error, Measurement, Noise, OpenedView, Reference, Result,
    calibration::{Calibration, calibrate},
    clock::with_processor_seconds,
    select,
};

/// Samples of a run over all pixels, from which on the time of a sample is measured by a rendering of
/// [`TRIAL`] seconds; shorter runs assume [`SAMPLE`] seconds.
const LONG_RUN: f64 = 1e6;
const TRIAL: f64 = 0.05;
const SAMPLE: f64 = 3e-7;
/// Width and height, in pixels, of the tiles whose means are tested; and the significance of a picture's
/// test.
const TILE: usize = 16;
/// Minimum samples per pixel for testing tiles: with fewer, means of tiles that light seldom reaches are far
/// from normal.
const TESTED: f64 = 64.0;
const SIGNIFICANCE: f64 = 0.01;

/// What is measured, and how often.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The scene's name in measurements.
    pub scene: String,
    /// The map's name in measurements.
    pub env: String,
    /// The material's name in measurements.
    pub material: String,
    /// Budgets of the runs.
    pub budgets: Vec<Budget>,
    /// Runs of each sampler at each budget.
    pub runs: u32,
    /// Seed of the first run; run `k` has `seed + k`.
    pub seed: u64,
    /// Cache folder for the reference after refinement.
    pub cache: Option<PathBuf>,
}

impl Plan {
    /// Returns the number of runs of all samplers.
    pub fn count(&self, samplers: usize) -> usize {
        self.budgets.len() * samplers * self.runs as usize
    }
}

/// Observes the progress of a measurement.
pub trait Watch {
    /// Receives the estimated seconds of all runs, before the first one.
    fn planned(&self, _seconds: f64) {}
    /// Receives a description of the current rendering.
    fn message(&self, _text: &str) {}
    /// Receives the estimated part of [`Self::planned`] that is done, in seconds.
    fn spent(&self, _seconds: f64) {}
    /// Receives a caveat about the measurements.
    fn warning(&self, _text: &str) {}
}

impl Watch for () {}

/// Result of one run.
pub struct Run<'a> {
    /// Index of the sampler.
    pub sampler: usize,
    /// Index of the budget.
    pub budget: usize,
    /// The record.
    pub measurement: &'a Measurement,
    /// The picture.
    pub rendering: &'a Rendering,
}

/// Renders every sampler at every budget and passes each run to `record`. Returns all measurements, or, if
/// `stop` is set, the completed ones; the current run is finished first.
///
/// The first run of every sampler at every budget comes before the second of any, so that an interrupted
/// measurement has about equally many runs of each, and a temporary slowdown of the machine affects all
/// samplers. After the first runs the reference is refined (see [`Reference::refine`]); the returned
/// measurements have errors against the refined one, while `record` receives the first runs with errors
/// against the earlier one.
///
/// # Errors
/// If sizes differ, or the error of `record`.
pub fn measure<E: From<Error>>(
    view: &OpenedView,
    entries: &[Entry],
    reference: &mut Reference,
    plan: &Plan,
    (stop, watch): (&AtomicBool, &dyn Watch),
    record: &mut dyn FnMut(Run<'_>) -> std::result::Result<(), E>,
) -> std::result::Result<Vec<Measurement>, E> {
    let mut loop_ = Loop { view, entries, plan, stop, watch, done: 0.0, measurements: Vec::new(), first: Vec::new() };
    loop_.run(reference, record)?;
    Ok(loop_.measurements)
}

struct Loop<'a> {
    view: &'a OpenedView,
    entries: &'a [Entry],
    plan: &'a Plan,
    stop: &'a AtomicBool,
    watch: &'a dyn Watch,
    done: f64,
    measurements: Vec<Measurement>,
    /// Pictures of the first runs, until the reference is refined: surfaces with and without the background.
    first: Vec<[Image; 2]>,
}

impl Loop<'_> {
    fn run<E: From<Error>>(
        &mut self,
        reference: &mut Reference,
        record: &mut dyn FnMut(Run<'_>) -> std::result::Result<(), E>,
    ) -> std::result::Result<(), E> {
        let seconds = self.seconds_of_runs()?;
        self.watch.planned(seconds.iter().flatten().sum::<f64>() * f64::from(self.plan.runs));
        let mut truth = Truth::of(reference);
        let mut taken: Vec<Vec<Budget>> = Vec::new();
        for run in 0..self.plan.runs {
            for (number, budget) in self.plan.budgets.iter().enumerate() {
                if run == 0 {
                    let calibrated = self.entries.iter().map(|entry| self.calibrated(entry, *budget));
                    let Some(calibrated) = calibrated.collect::<Result<Option<_>>>()? else { return Ok(()) };
                    taken.push(calibrated);
                }
                for sampler in 0..self.entries.len() {
                    if self.stop.load(Ordering::Relaxed) {
                        return Ok(());
                    }
                    let (rendering, measurement) =
                        self.one(sampler, (*budget, taken[number][sampler]), run, seconds[number][sampler], &truth)?;
                    record(Run { sampler, budget: number, measurement: &measurement, rendering: &rendering })?;
                    if run == 0 {
                        self.first.push([rendering.composite(), rendering.surfaces]);
                    }
                    self.measurements.push(measurement);
                }
            }
            if run == 0 {
                self.refine(reference, &mut truth)?;
            }
        }
        Ok(())
    }

    /// Performs one run to its end, ignoring the stop flag.
    fn one(
        &mut self,
        sampler: usize,
        (asked, taken): (Budget, Budget),
        run: u32,
        seconds: f64,
        truth: &Truth,
    ) -> Result<(Rendering, Measurement)> {
        let entry = &self.entries[sampler];
        let seed = self.plan.seed + u64::from(run);
        self.watch.message(&format!("{} {asked}", entry.name));
        let show = |done: f64| self.watch.spent(self.done + done * seconds);
        let never = AtomicBool::new(false);
        let points = self.view.points(seed);
        let (rendering, used) =
            with_processor_seconds(|| self.view.render_by(entry.at(asked).0, taken, points, &never, &show));
        let rendering = rendering?;
        self.done += seconds;
        self.watch.spent(self.done);
        let measurement = Measurement {
            scene: self.plan.scene.clone(),
            env: self.plan.env.clone(),
            material: self.plan.material.clone(),
            sampler: entry.name.clone(),
            budget: asked.to_string(),
            run,
            seed,
            preparation: entry.at(asked).1,
            processor_seconds: used.unwrap_or(f64::NAN),
            ..truth.measure(&rendering, [&rendering.composite(), &rendering.surfaces])?
        };
        Ok((rendering, measurement))
    }

    /// Refines the reference by the smallest error of the first runs and measures their errors again.
    fn refine(&mut self, reference: &mut Reference, truth: &mut Truth) -> Result<()> {
        let smallest = self.measurements.iter().map(|own| own.mse).fold(f64::INFINITY, f64::min);
        let first = std::mem::take(&mut self.first);
        self.watch.message("reference");
        match reference.refine(self.view, smallest, self.plan.cache.as_deref(), self.stop, &|_| {}) {
            Ok(true) => {}
            Ok(false) | Err(Error::Interrupted(_)) => return Ok(()),
            Err(error) => return Err(error),
        }
        *truth = Truth::of(reference);
        for (measurement, [composite, surfaces]) in self.measurements.iter_mut().zip(&first) {
            *measurement = truth.errors_of(measurement, [composite, surfaces])?;
        }
        Ok(())
    }

    /// Returns `[budget][sampler]` estimated seconds of a run, by a short rendering with each sampler; if all
    /// runs are short, every sample counts the same.
    fn seconds_of_runs(&self) -> Result<Vec<Vec<f64>>> {
        let pixels = (self.view.part().width * self.view.part().height) as f64;
        let samples = |budget: &Budget| if let Budget::Samples(samples) = budget { f64::from(*samples) } else { 0.0 };
        let is_long = self.plan.budgets.iter().any(|budget| samples(budget) * pixels >= LONG_RUN);
        let sample = |entry: &Entry| {
            if !is_long || self.stop.load(Ordering::Relaxed) {
                return Ok(pixels * SAMPLE);
            }
            let trial = Budget::Seconds(TRIAL);
            let points = self.view.points(self.plan.seed);
            let renderer = entry.at(self.plan.budgets[0]).0;
            let rendering = self.view.render_by(renderer, trial, points, self.stop, &|_| {})?;
            Ok(rendering.seconds / f64::from(rendering.spp.max(1)))
        };
        let of_sample: Vec<f64> = self.entries.iter().map(sample).collect::<Result<_>>()?;
        let seconds = |budget: &Budget, of_sample: f64| budget.seconds().unwrap_or(samples(budget) * of_sample);
        let of_budget = |budget| of_sample.iter().map(|&of| seconds(budget, of)).collect();
        Ok(self.plan.budgets.iter().map(of_budget).collect())
    }

    /// Converts a budget of time to samples. `None` if the stop flag is set in the meantime.
    fn calibrated(&self, entry: &Entry, budget: Budget) -> Result<Option<Budget>> {
        let Some(seconds) = budget.seconds() else { return Ok(Some(budget)) };
        self.watch.message(&format!("{}: samples that fit into {seconds} s", entry.name));
        let points = self.view.points(self.plan.seed);
        let render = |trial: Budget| {
            let rendering = self.view.render_by(entry.at(budget).0, trial, points, self.stop, &|_| {})?;
            Ok((!self.stop.load(Ordering::Relaxed)).then_some((rendering.spp, rendering.seconds)))
        };
        let Some(Calibration { samples, off }) = calibrate(seconds, render)? else { return Ok(None) };
        if let Some(taken) = off {
            self.watch.warning(&format!(
                "{}: renderings of {seconds} s take {taken:.3} s where they were to be equally long: the machine does other things, too; its \
                 equal-time ratios say little",
                entry.name
            ));
        }
        Ok(Some(Budget::Samples(samples)))
    }
}

/// The reference in the form that pictures are compared with.
struct Truth {
    image: Image,
    covered: Vec<bool>,
    selected: Image,
    noise: Option<Noise>,
}

impl Truth {
    fn of(reference: &Reference) -> Self {
        let (image, covered) = (reference.image.clone(), reference.covered.clone());
        Self { image, covered, selected: reference.selected(), noise: reference.noise }
    }

    fn measure(&self, rendering: &Rendering, pictures: [&Image; 2]) -> Result<Measurement> {
        let own = Measurement::of(rendering, &select(pictures[1], &self.covered), &self.selected)?;
        Ok(self.without_noise(own, pictures[0]))
    }

    /// Recomputes the errors of a measurement against this reference.
    fn errors_of(&self, known: &Measurement, [composite, surfaces]: [&Image; 2]) -> Result<Measurement> {
        let pixels = select(surfaces, &self.covered);
        let metrics = headtail_render::statistics::ErrorMetrics::of(&pixels, &self.selected)?;
        let reference_luminance = crate::measurement::mean_luminance(&self.selected);
        let (mse, relmse, relmse_trimmed) = (metrics.mse, metrics.relmse, metrics.relmse_trimmed);
        let own = Measurement { mse, relmse, relmse_trimmed, reference_luminance, ..known.clone() };
        Ok(self.without_noise(own, composite))
    }

    fn without_noise(&self, own: Measurement, composite: &Image) -> Measurement {
        let test = (own.spp >= TESTED).then(|| compare_images(composite, &self.image, TILE, SIGNIFICANCE).ok());
        let p_value = |test: TileTest| 1.0 - (1.0 - test.worst().2).powi(test.tests.len() as i32);
        let tile_p = test.flatten().map_or(f64::NAN, p_value);
        let Some(noise) = self.noise else { return Measurement { tile_p, ..own } };
        let (mse, relmse) = (Noise::without(own.mse, noise.mse), Noise::without(own.relmse, noise.relmse));
        Measurement { mse, relmse, ttuv: ttuv(mse, own.seconds), reference_mse: noise.mse, tile_p, ..own }
    }
}

#[cfg(test)]
mod tests {
    use std::{cell::RefCell, convert::Infallible};

    use super::*;
    use crate::{CameraSettings, ReferencePolicy, ViewSettings};

    #[derive(Debug)]
    struct Never;
    impl From<Error> for Never {
        fn from(error: Error) -> Self {
            panic!("{error}");
        }
    }
    impl From<Infallible> for Never {
        fn from(never: Infallible) -> Self {
            match never {}
        }
    }

    fn entries(view: &OpenedView, specs: &[&str]) -> Vec<Entry> {
        let entry = |spec: &&str| Entry::new(*spec, view.estimator(&spec.parse().unwrap()).unwrap());
        specs.iter().map(entry).collect()
    }

    fn plan(budgets: Vec<Budget>, runs: u32) -> Plan {
        Plan {
            scene: "sphere".into(),
            env: "studio".into(),
            material: String::new(),
            budgets,
            runs,
            seed: 1,
            cache: None,
        }
    }

    fn measured(view: &OpenedView, specs: &[&str], plan: &Plan, stop: &AtomicBool) -> Vec<Measurement> {
        let policy = ReferencePolicy::new(64, 1);
        let mut reference = Reference::render(view, policy, &AtomicBool::new(false), &|_| {}).unwrap();
        let order = RefCell::new(Vec::new());
        let mut record = |run: Run<'_>| -> std::result::Result<(), Never> {
            order.borrow_mut().push(run.measurement.sampler.clone());
            Ok(())
        };
        let measured = measure(view, &entries(view, specs), &mut reference, plan, (stop, &()), &mut record).unwrap();
        assert_eq!(order.into_inner(), measured.iter().map(|own| own.sampler.clone()).collect::<Vec<_>>());
        measured
    }

    #[test]
    fn every_run_is_measured_and_better_samplers_have_smaller_errors() {
        let view = ViewSettings::new("sphere", "studio", CameraSettings::of_size(48, 36)).open().unwrap();
        let budgets = vec![Budget::Samples(4), Budget::Samples(64)];
        let rows = measured(&view, &["mis", "patches"], &plan(budgets, 3), &AtomicBool::new(false));
        assert_eq!(rows.len(), 12);
        let mse = |sampler: &str, budget: &str| {
            let own = rows.iter().filter(|row| row.sampler == sampler && row.budget == budget).map(|row| row.mse);
            own.sum::<f64>() / 3.0
        };
        assert!(mse("patches", "4spp") < mse("mis", "4spp") && mse("mis", "64spp") < mse("mis", "4spp"));
        assert!(rows.iter().all(|row| (row.spp < TESTED || row.tile_p > 1e-4)
            && (row.mean_luminance / row.reference_luminance - 1.0).abs() < 0.1));
        // Pictures depend only on the seeds.
        let again = measured(&view, &["mis", "patches"], &plan(vec![Budget::Samples(4)], 1), &AtomicBool::new(false));
        assert_eq!(
            again.iter().map(|row| row.mean_luminance).collect::<Vec<_>>(),
            [rows[0].mean_luminance, rows[1].mean_luminance]
        );
    }

    #[test]
    fn a_biased_sampler_is_found_by_its_tiles() {
        let view = ViewSettings::new("sphere", "studio", CameraSettings::of_size(48, 36)).open().unwrap();
        let mut darker = view.clone();
        darker.set_light(0.0, glam::Vec3A::splat(0.9)).unwrap();
        let policy = ReferencePolicy::new(64, 1);
        let mut reference = Reference::render(&darker, policy, &AtomicBool::new(false), &|_| {}).unwrap();
        let plan = plan(vec![Budget::Samples(64)], 1);
        let mut record = |_: Run<'_>| Ok::<(), Never>(());
        let stop = AtomicBool::new(false);
        let rows =
            measure(&view, &entries(&view, &["patches"]), &mut reference, &plan, (&stop, &()), &mut record).unwrap();
        assert!(rows[0].tile_p < 1e-6, "{}", rows[0].tile_p);
    }

    #[test]
    fn budgets_of_time_are_met_and_a_stop_keeps_what_is_done() {
        let view = ViewSettings::new("sphere", "studio", CameraSettings::of_size(48, 36)).open().unwrap();
        let rows = measured(&view, &["mis"], &plan(vec![Budget::Seconds(0.02)], 2), &AtomicBool::new(false));
        assert!(rows.len() == 2 && rows[0].spp == rows[1].spp && rows[0].spp >= 1.0);
        assert!(measured(&view, &["mis"], &plan(vec![Budget::Samples(4)], 2), &AtomicBool::new(true)).is_empty());
    }
}
