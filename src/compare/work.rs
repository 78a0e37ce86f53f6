//! The runs of a comparison: in which order, what is measured of each, and what is written after it.

use std::{
    path::Path,
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use anyhow::Result;
use headtail_render::{
    image::{Image, write_exr},
    integrator::{Budget, Rendering},
    points::Points,
    statistics::{RELATIVE_EPSILON, ttuv},
};

use super::{Entry, noise::Noise};
use crate::terminal::warning;
use crate::{
    arguments::OpenedView,
    output::OutputFolder,
    progress,
    render::attributes,
    report::{Comparison, RenderedImage, Report, Row, RunName, State},
};

/// Renderings that set the samples of a time, at most.
const CALIBRATIONS: usize = 4;
/// By which factor a rendering's time may be off.
const TOLERANCE: f64 = 1.15;

/// The time of a sampler's sample is measured where a run has so many samples in all of its pixels, by a rendering of so long; else it is about so many
/// seconds.
const LONG_RUN: f64 = 1e6;
const TRIAL: Duration = Duration::from_millis(50);
const SAMPLE: f64 = 3e-7;

/// A comparison at work.
pub struct Work<'a> {
    opened: &'a OpenedView,
    entries: &'a [Entry],
    /// With their names.
    budgets: &'a [(String, Budget)],
    stop: &'a AtomicBool,
    output: &'a OutputFolder,
    /// Parts of file names, one for each entry.
    stems: Vec<String>,
    /// The measured pixels of the reference as an image of one row.
    reference: Image,
    noise: Option<Noise>,
    /// How the reference came about, without its noise.
    reference_note: String,
    report: Report,
    /// What is done so far.
    pub comparison: Comparison,
}

impl<'a> Work<'a> {
    /// Prepares the runs of `comparison`, which has none yet; results go to `output`.
    ///
    /// # Errors
    /// If the folder's record cannot be written.
    pub fn new(
        opened: &'a OpenedView,
        entries: &'a [Entry],
        budgets: &'a [(String, Budget)],
        stop: &'a AtomicBool,
        output: &'a OutputFolder,
        comparison: Comparison,
        noise: Option<Noise>,
    ) -> Result<Self> {
        let reference = select(&comparison.reference, &comparison.measured);
        let names: Vec<(&str, Option<&Path>)> =
            entries.iter().map(|entry| (&*entry.label, entry.file.as_deref())).collect();
        let stems = file_names(&names);
        let report = Report::new(output.path());
        for name in ["results.csv", "report.html"] {
            output.file(name)?;
        }
        let reference_note = comparison.reference_note.clone();
        Ok(Self { opened, entries, budgets, stop, output, stems, reference, noise, reference_note, report, comparison })
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
        let seconds = self.seconds_of_runs(seed);
        let all: f64 = seconds.iter().flatten().sum::<f64>() * f64::from(runs);
        let bar = progress::announced_bar(all, "comparing");
        let mut done = 0.0;
        let mut taken: Vec<Vec<Budget>> = Vec::new();
        for run in 0..runs {
            for (index, (name, asked)) in budgets.iter().enumerate() {
                if run == 0 {
                    let calibrated: Option<Vec<Budget>> =
                        entries.iter().map(|entry| self.calibrated(entry, *asked, seed, &bar)).collect();
                    let Some(calibrated) = calibrated else { return Ok(()) };
                    taken.push(calibrated);
                }
                for (number, (entry, &taken)) in entries.iter().zip(&taken[index]).enumerate() {
                    if self.stop.load(Ordering::Relaxed) {
                        bar.finish_and_clear();
                        return Ok(());
                    }
                    bar.set_message(format!("{} {name}", entry.label));
                    // In a budget of time, the number of samples depends on the machine, and points should not.
                    let points = self.opened.points(*asked, seed + u64::from(run));
                    let of_run = seconds[index][number];
                    let show = |share: f64| bar.set_position(progress::thousandths(done + share * of_run));
                    self.run(number, (name, taken), run, points, &show)?;
                    done += of_run;
                    bar.set_position(progress::thousandths(done));
                }
            }
        }
        bar.finish_and_clear();
        Ok(())
    }

    /// `[budget][entry]` about the seconds of a run, by a short rendering with each sampler; calibrating and writing come on top. Where all is soon done,
    /// samples count alike.
    fn seconds_of_runs(&self, seed: u64) -> Vec<Vec<f64>> {
        let pixels = self.opened.part().width * self.opened.part().height;
        let samples = |budget: &Budget| if let Budget::Spp(spp) = budget { f64::from(*spp) } else { 0.0 };
        let most = self.budgets.iter().map(|(_, budget)| samples(budget)).fold(0.0, f64::max);
        let is_long = most * pixels as f64 >= LONG_RUN;
        let sample = |entry: &Entry| {
            if !is_long || self.stop.load(Ordering::Relaxed) {
                return pixels as f64 * SAMPLE;
            }
            let points = self.opened.points(Budget::Time(TRIAL), seed);
            let trial = self.opened.render(&*entry.estimator, Budget::Time(TRIAL), points, self.stop, &|_| {});
            trial.seconds / f64::from(trial.spp.max(1))
        };
        let of_sample: Vec<f64> = self.entries.iter().map(sample).collect();
        let seconds = |budget: &Budget, of_sample: &f64| match budget {
            Budget::Spp(spp) => f64::from(*spp) * of_sample,
            Budget::Time(limit) => limit.as_secs_f64(),
        };
        self.budgets.iter().map(|(_, budget)| of_sample.iter().map(|of| seconds(budget, of)).collect()).collect()
    }

    /// Writes the files for good.
    ///
    /// # Errors
    /// If there are no runs, or a file cannot be written.
    pub fn finish(&mut self, state: State) -> Result<()> {
        self.comparison.state = state;
        self.say_noise();
        self.report.finish(&self.comparison)
    }

    /// Brings what is said of the reference up to date.
    fn say_noise(&mut self) {
        if let Some(noise) = self.noise {
            self.comparison.reference_note = format!("{} {}", self.reference_note, noise.words(&self.comparison.rows));
        }
    }

    /// One run: the picture, its row in the table, and all that is written of it.
    fn run(
        &mut self,
        number: usize,
        (budget_name, budget): (&str, Budget),
        run: u32,
        points: Points,
        progress: &dyn Fn(f64),
    ) -> Result<()> {
        let entry = &self.entries[number];
        // To the end, whatever the stop flag says: it is one run.
        let rendering = self.opened.render(&*entry.estimator, budget, points, &AtomicBool::new(false), progress);
        let row = self.row(entry, budget_name, run, points.seed(), &rendering)?;
        self.comparison.rows.push(row);
        self.report.update_table(&self.comparison)?;
        if run == 0 {
            self.say_noise();
            let image = rendering.composite();
            let stem = format!("{}_{budget_name}", self.stems[number]);
            let attributes = attributes(self.opened, &entry.label, &rendering, points.seed());
            write_exr(&self.output.file(&format!("{stem}.exr"))?, &image, &attributes)?;
            let errors = error_image(&image, &self.comparison.reference, &self.comparison.measured);
            write_exr(&self.output.file(&format!("{stem}_error.exr"))?, &errors, &attributes)?;
            let (sampler, budget) = (entry.label.clone(), budget_name.to_owned());
            self.comparison.images.push(RenderedImage { sampler, budget, image });
        }
        self.report.update_page(&self.comparison)
    }

    /// The row of a run, measured over the covered pixels.
    fn row(&self, entry: &Entry, budget: &str, run: u32, seed: u64, rendering: &Rendering) -> Result<Row> {
        let pixels = select(&rendering.surfaces, &self.comparison.measured);
        let (scene, env) = (&*self.comparison.scene, &*self.comparison.env);
        let name = RunName { scene, env, sampler: &entry.label, budget, run, seed };
        let row = Row::measured(&name, rendering, &pixels, &self.reference)?;
        let noise = self.noise.unwrap_or(Noise { mse: 0.0, relmse: 0.0 });
        let (mse, relmse) = (Noise::without(row.mse, noise.mse), Noise::without(row.relmse, noise.relmse));
        Ok(Row { mse, relmse, ttuv: ttuv(mse, rendering.seconds), ..row })
    }

    /// The budget in samples, [`calibrate`]d if it is one in time. `None` if the stop flag is set meanwhile.
    fn calibrated(&self, entry: &Entry, budget: Budget, seed: u64, bar: &progress::Bar) -> Option<Budget> {
        let Budget::Time(limit) = budget else { return Some(budget) };
        bar.set_message(format!("{}: samples that fit into {} s", entry.label, limit.as_secs_f64()));
        let seconds = limit.as_secs_f64();
        let points = self.opened.points(budget, seed);
        let render = |trial: Budget| {
            let rendering = self.opened.render(&*entry.estimator, trial, points, self.stop, &|_| {});
            (!self.stop.load(Ordering::Relaxed)).then_some((rendering.spp, rendering.seconds))
        };
        let Calibrated { spp, off } = calibrate(seconds, render)?;
        if let Some(taken) = off {
            warning!(
                "{}: renderings of {seconds} s take {taken:.2} s where they were to be equally long: the machine does other things, too; its \
                 equal-time ratios say little",
                entry.label
            );
        }
        Some(Budget::Spp(spp))
    }
}

/// How many samples fit into a time.
#[derive(Debug, PartialEq)]
struct Calibrated {
    spp: u32,
    /// Seconds of the last rendering, if even that was not as long as it was to be.
    off: Option<f64>,
}

/// How many samples per pixel fit into so many seconds: a short rendering says about how many, one with that many sets it right, and is repeated
/// while it is off. `render` answers the samples and seconds of a rendering, `None` if it was interrupted.
///
/// All runs of a sampler then take the same number of samples, which does not depend on what else the machine does.
fn calibrate(seconds: f64, mut render: impl FnMut(Budget) -> Option<(u32, f64)>) -> Option<Calibrated> {
    let mut trial = Budget::Time(Duration::from_secs_f64(0.25 * seconds));
    let mut found = Calibrated { spp: 1, off: None };
    // A long rendering is faster per sample than a short one: passes are longer. A machine that does other things, too, may be off again.
    for _ in 0..CALIBRATIONS {
        let (spp, taken) = render(trial)?;
        found.spp = (f64::from(spp) * seconds / taken).round().max(1.0) as u32;
        if matches!(trial, Budget::Spp(_)) {
            let is_right = taken <= seconds * TOLERANCE && seconds <= taken * TOLERANCE;
            found.off = (!is_right && found.spp > 1).then_some(taken);
            if found.off.is_none() {
                break;
            }
        }
        trial = Budget::Spp(found.spp);
    }
    Some(found)
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

/// Longer names are cut: file systems allow 255 bytes, of which budget and extension take some.
const LONGEST_NAME: usize = 120;

/// Samplers as parts of file names, different ones for different samplers: their labels, in which a file is named by its folder and itself. Those that
/// would be alike, also for a file system that ignores case, or that are cut get a hash of the label.
fn file_names(samplers: &[(&str, Option<&Path>)]) -> Vec<String> {
    let plain: Vec<String> = samplers.iter().map(|(label, file)| plain_name(label, *file)).collect();
    let is_unique = |name: &str| plain.iter().filter(|other| other.eq_ignore_ascii_case(name)).count() == 1;
    let with_hash = |(name, (label, _)): (&String, &(&str, Option<&Path>))| {
        if is_unique(name) && name.len() <= LONGEST_NAME {
            return name.clone();
        }
        let kept = &name[..name.len().min(LONGEST_NAME)];
        format!("{kept}-{}", &blake3::hash(label.as_bytes()).to_hex()[..8])
    };
    plain.iter().zip(samplers).map(with_hash).collect()
}

/// A label in letters, digits, `-` and `_`.
fn plain_name(label: &str, file: Option<&Path>) -> String {
    let short = file.map(|file| {
        let stem = file.with_extension("");
        let parts = [stem.parent().and_then(Path::file_name), stem.file_name()];
        let parts: Vec<_> = parts.into_iter().flatten().map(|part| part.to_string_lossy()).collect();
        (file.display().to_string(), parts.join("-"))
    });
    let label = short.map_or(label.to_owned(), |(path, name)| label.replace(&path, &name));
    label
        .chars()
        .map(|c| if c == ':' { '-' } else { c })
        .map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Calibrates on a machine whose renderings take these seconds for a sample, the last ones for all that follow; answers how many there were, too.
    fn calibrated(seconds_per_sample: &[f64]) -> (Calibrated, usize) {
        let mut renderings = 0;
        let found = calibrate(2.0, |trial| {
            let seconds = seconds_per_sample[renderings.min(seconds_per_sample.len() - 1)];
            renderings += 1;
            let spp = match trial {
                Budget::Spp(spp) => spp,
                Budget::Time(time) => (time.as_secs_f64() / seconds) as u32,
            };
            Some((spp, f64::from(spp) * seconds))
        });
        (found.unwrap(), renderings)
    }

    #[test]
    fn calibration_that_is_off_is_repeated_and_said() {
        let right = |spp| Calibrated { spp, off: None };
        assert_eq!(calibrated(&[0.01]), (right(200), 2));
        // The short rendering is slow for its samples, and the first long one is disturbed.
        assert_eq!(calibrated(&[0.02, 0.01]), (right(200), 3));
        assert_eq!(calibrated(&[0.01, 0.03, 0.01]), (right(200), 4));
        // A machine that never does the same twice.
        let (found, renderings) = calibrated(&[0.01, 0.02, 0.01, 0.02]);
        assert!(renderings == CALIBRATIONS && found.off.is_some_and(|taken| taken > 2.0 * TOLERANCE), "{found:?}");
        // A sample that takes longer than the time: there is no less than one.
        assert_eq!(calibrated(&[0.1, 5.0]).0, right(1));
        assert_eq!(calibrate(2.0, |_| None), None);
    }

    #[test]
    fn labels_become_plain_file_names() {
        let file = Path::new("a/b c/sampler.safetensors");
        let names = file_names(&[
            ("ris:4", None),
            ("head:a/b c/sampler.safetensors", Some(file)),
            ("mis-comp", None),
            ("ris:2:head:a/b c/sampler.safetensors", Some(file)),
        ]);
        assert_eq!(names, ["ris-4", "head-b_c-sampler", "mis-comp", "ris-2-head-b_c-sampler"]);
    }

    #[test]
    fn no_two_samplers_share_a_name() {
        let [a, b, c] = ["x/t/A.safetensors", "y/t/a.safetensors", "y/t/a.other"].map(Path::new);
        let labels: Vec<(String, Option<&Path>)> = [a, b, c]
            .iter()
            .flat_map(|file| {
                ["head", "ris:2:head", "ris:8:head"].map(|kind| (format!("{kind}:{}", file.display()), Some(*file)))
            })
            .collect();
        let labels: Vec<(&str, Option<&Path>)> = labels.iter().map(|(label, file)| (&**label, *file)).collect();
        let mut names: Vec<String> = file_names(&labels).iter().map(|name| name.to_ascii_lowercase()).collect();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), 9);
        let long = "a".repeat(300);
        assert!(file_names(&[(&long, None)])[0].len() < 140);
    }
}
