//! The runs of a comparison: in which order, what is measured of each, and what is written after it.

use std::{
    path::Path,
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use anyhow::Result;
use headtail_render::{
    color::luminance,
    image::{Image, write_exr},
    integrator::{Budget, Rendering, render},
    points::Points,
    statistics::{ErrorMetrics, RELATIVE_EPSILON, ttuv},
};

use super::Entry;
use crate::{
    arguments::OpenedView,
    progress,
    render::{attributes, quietly},
    report::{Comparison, RenderedImage, Report, Row, State},
};

/// A comparison at work.
pub struct Work<'a> {
    opened: &'a OpenedView,
    entries: &'a [Entry],
    /// With their names.
    budgets: &'a [(String, Budget)],
    stop: &'a AtomicBool,
    folder: &'a Path,
    /// The measured pixels of the reference as an image of one row.
    reference: Image,
    report: Report,
    /// What is done so far.
    pub comparison: Comparison,
}

impl<'a> Work<'a> {
    /// Prepares the runs of `comparison`, which has none yet; results go to an existing `folder`.
    pub fn new(
        opened: &'a OpenedView,
        entries: &'a [Entry],
        budgets: &'a [(String, Budget)],
        stop: &'a AtomicBool,
        folder: &'a Path,
        comparison: Comparison,
    ) -> Self {
        let reference = select(&comparison.reference, &comparison.measured);
        Self { opened, entries, budgets, stop, folder, reference, report: Report::new(folder), comparison }
    }

    /// Does all runs, or those that are done when the stop flag is set; a run that is being rendered then is finished.
    ///
    /// The first run of every sampler at every budget comes before the second of any, so an interrupted comparison has about
    /// as many runs of each, and a machine that slows down for a while slows all samplers down.
    ///
    /// # Errors
    /// If results cannot be written; those of the runs before stay.
    pub fn run_all(&mut self, runs: u32, seed: u64) -> Result<()> {
        let (entries, budgets) = (self.entries, self.budgets);
        let bar = progress::bar((budgets.len() * entries.len()) as u64 * u64::from(runs), "comparing");
        let mut taken: Vec<Vec<Budget>> = Vec::new();
        for run in 0..runs {
            for (index, (name, asked)) in budgets.iter().enumerate() {
                if run == 0 {
                    let calibrated: Option<Vec<Budget>> =
                        entries.iter().map(|entry| self.calibrated(entry, *asked, seed, &bar)).collect();
                    let Some(calibrated) = calibrated else { return Ok(()) };
                    taken.push(calibrated);
                }
                for (entry, &taken) in entries.iter().zip(&taken[index]) {
                    if self.stop.load(Ordering::Relaxed) {
                        bar.finish_and_clear();
                        return Ok(());
                    }
                    bar.set_message(format!("{} {name}", entry.label));
                    // In a budget of time, the number of samples depends on the machine, and points should not.
                    let points = self.opened.points(*asked, seed + u64::from(run));
                    self.run(entry, name, taken, run, points)?;
                    bar.inc(1);
                }
            }
        }
        bar.finish_and_clear();
        Ok(())
    }

    /// Writes the files for good.
    ///
    /// # Errors
    /// If there are no runs, or a file cannot be written.
    pub fn finish(&mut self, state: State) -> Result<()> {
        self.comparison.state = state;
        self.report.finish(&self.comparison)
    }

    /// One run: the picture, its row in the table, and all that is written of it.
    fn run(&mut self, entry: &Entry, budget_name: &str, budget: Budget, run: u32, points: Points) -> Result<()> {
        let rendering = quietly(self.opened.view(), &*entry.estimator, budget, points);
        let row = self.row(entry, budget_name, run, points.seed(), &rendering)?;
        self.comparison.rows.push(row);
        self.report.update_table(&self.comparison)?;
        if run == 0 {
            let image = rendering.composite();
            let stem = format!("{}_{budget_name}", file_name(&entry.label));
            let attributes = attributes(&entry.label, &rendering, points.seed());
            write_exr(&self.folder.join(format!("{stem}.exr")), &image, &attributes)?;
            let errors = error_image(&image, &self.comparison.reference, &self.comparison.measured);
            write_exr(&self.folder.join(format!("{stem}_error.exr")), &errors, &attributes)?;
            let (sampler, budget) = (entry.label.clone(), budget_name.to_owned());
            self.comparison.images.push(RenderedImage { sampler, budget, image });
        }
        self.report.update_page(&self.comparison)
    }

    /// The row of a run, measured over the covered pixels.
    fn row(&self, entry: &Entry, budget: &str, run: u32, seed: u64, rendering: &Rendering) -> Result<Row> {
        let pixels = select(&rendering.surfaces, &self.comparison.measured);
        let metrics = ErrorMetrics::of(&pixels, &self.reference)?;
        Ok(Row {
            scene: self.comparison.scene.clone(),
            env: self.comparison.env.clone(),
            sampler: entry.label.clone(),
            budget: budget.to_owned(),
            run: Some(run),
            spp: f64::from(rendering.spp),
            rays_per_sample: rendering.rays_per_sample,
            seconds: rendering.seconds,
            mse: metrics.mse,
            relmse: metrics.relmse,
            relmse_trimmed: metrics.relmse_trimmed,
            ttuv: ttuv(metrics.mse, rendering.seconds),
            mean_luminance: mean_luminance(&pixels),
            max_weight: f64::from(rendering.max_weight),
            seed,
            version: self.comparison.version.clone(),
            points: rendering.points.to_string(),
        })
    }

    /// The budget in samples. Of one in time: a short rendering says about how many samples fit, one with that many sets it
    /// right. `None` if the stop flag is set meanwhile.
    ///
    /// All runs of a sampler then take the same number of samples, which does not depend on what else the machine does.
    fn calibrated(&self, entry: &Entry, budget: Budget, seed: u64, bar: &progress::Bar) -> Option<Budget> {
        let Budget::Time(limit) = budget else { return Some(budget) };
        bar.set_message(format!("{}: samples that fit into {} s", entry.label, limit.as_secs_f64()));
        let seconds = limit.as_secs_f64();
        let points = self.opened.points(budget, seed);
        let mut trial = Budget::Time(Duration::from_secs_f64(0.25 * seconds));
        // A long rendering is faster per sample than a short one: passes are longer.
        for _ in 0..2 {
            if self.stop.load(Ordering::Relaxed) {
                return None;
            }
            let rendering = render(self.opened.view(), &*entry.estimator, trial, points, self.stop, &|_| {});
            let spp = f64::from(rendering.spp) * seconds / rendering.seconds;
            trial = Budget::Spp((spp.round() as u32).max(1));
        }
        (!self.stop.load(Ordering::Relaxed)).then_some(trial)
    }
}

/// Squared error of each pixel and channel over the squared reference (plus the same small number as in relMSE); black where
/// nothing is measured.
fn error_image(image: &Image, reference: &Image, covered: &[bool]) -> Image {
    let error = |((x, r), covered): ((&[f32; 3], &[f32; 3]), &bool)| {
        let of = |c: usize| (x[c] - r[c]).powi(2) / (r[c] * r[c] + RELATIVE_EPSILON as f32);
        if *covered { [of(0), of(1), of(2)] } else { [0.0; 3] }
    };
    Image { pixels: image.pixels.iter().zip(&reference.pixels).zip(covered).map(error).collect(), ..*image }
}

/// The chosen pixels as an image of one row.
pub fn select(image: &Image, chosen: &[bool]) -> Image {
    let pixels: Vec<_> =
        image.pixels.iter().zip(chosen).filter(|(_, chosen)| **chosen).map(|(pixel, _)| *pixel).collect();
    Image { width: pixels.len(), height: 1, pixels }
}

fn mean_luminance(image: &Image) -> f64 {
    let sum: f64 = image.pixels.iter().map(|&pixel| f64::from(luminance(pixel.into()))).sum();
    sum / image.pixels.len() as f64
}

/// A sampler's label as part of a file name: of a path, the file and its folder are kept.
fn file_name(label: &str) -> String {
    let (name, argument) = label.split_once(':').unwrap_or((label, ""));
    let path = Path::new(argument).with_extension("");
    let folder = path.parent().and_then(Path::file_name);
    let parts = [Some(name.as_ref()), folder, path.file_name()];
    let joined: Vec<_> = parts.into_iter().flatten().map(|part| part.to_string_lossy()).collect();
    joined.join("-").chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_become_plain_file_names() {
        assert_eq!(file_name("ris:4"), "ris-4");
        assert_eq!(file_name("head:a/b c/sampler.safetensors"), "head-b_c-sampler");
        assert_eq!(file_name("mis-comp"), "mis-comp");
    }
}
