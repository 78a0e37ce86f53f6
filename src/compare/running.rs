//! Runs of a comparison as files, written after each run.

use std::{cell::OnceCell, path::Path, sync::atomic::AtomicBool};

use anyhow::Result;
use headtail_eval::{Entry, Measurement, Noise, OpenedView, Plan, Reference, Run, Watch, measure};
use headtail_render::{
    image::{Image, write_exr},
    spec::SamplerSpec,
    statistics::RELATIVE_EPSILON,
};

use crate::terminal::warning;
use crate::{
    output::OutputFolder,
    progress,
    render::attributes,
    report::{Comparison, RenderedImage, Report, State},
};

/// A comparison in progress.
pub struct RunningComparison<'a> {
    opened: &'a OpenedView,
    entries: &'a [Entry],
    stop: &'a AtomicBool,
    output: &'a OutputFolder,
    /// Parts of file names, one per entry.
    stems: Vec<String>,
    noise: Option<Noise>,
    /// Description of the reference, without its noise.
    reference_note: String,
    report: Report,
    /// Results so far.
    pub comparison: Comparison,
}

impl<'a> RunningComparison<'a> {
    /// Prepares the runs of `comparison`, which has none yet; results are written to `output`, pictures under
    /// the names of `stems`.
    ///
    /// # Errors
    /// If the folder's record cannot be written.
    pub fn new(
        opened: &'a OpenedView,
        (entries, stems): (&'a [Entry], Vec<String>),
        stop: &'a AtomicBool,
        output: &'a OutputFolder,
        comparison: Comparison,
        noise: Option<Noise>,
    ) -> Result<Self> {
        let report = Report::new(output.path());
        for name in ["results.csv", "report.html"] {
            output.file(name)?;
        }
        let reference_note = comparison.reference_note.clone();
        Ok(Self { opened, entries, stop, output, stems, noise, reference_note, report, comparison })
    }

    /// Performs all runs, or those completed before the stop flag is set.
    ///
    /// # Errors
    /// If results cannot be written; those of earlier runs remain.
    pub fn run_all(&mut self, reference: &mut Reference, plan: &Plan) -> Result<()> {
        let (opened, entries, stop) = (self.opened, self.entries, self.stop);
        let (watch, samples) = (Bars::default(), reference.samples);
        let measured = measure(opened, entries, reference, plan, (stop, &watch), &mut |run| self.add(&run));
        watch.finish();
        let measured = measured?;
        // Refined after the first runs.
        if reference.samples != samples {
            write_exr(&self.output.file("reference.exr")?, &reference.image, &reference.attributes())?;
        }
        self.comparison.reference = reference.image.clone();
        self.reference_note = reference.note();
        self.noise = reference.noise;
        self.comparison.rows = measured;
        Ok(())
    }

    /// Writes the final files.
    ///
    /// # Errors
    /// If there are no runs, or a file cannot be written.
    pub fn finish(&mut self, state: State) -> Result<()> {
        self.comparison.state = state;
        self.say_noise();
        self.report.finish(&self.comparison)
    }

    /// Updates the description of the reference.
    fn say_noise(&mut self) {
        if let Some(noise) = self.noise {
            self.comparison.reference_note = format!("{} {}", self.reference_note, words(noise, &self.comparison.rows));
        }
    }

    /// Adds a run: its row in the table, and the picture if it is the first.
    fn add(&mut self, run: &Run<'_>) -> Result<()> {
        let Run { sampler, measurement, rendering, .. } = *run;
        self.comparison.rows.push(measurement.clone());
        self.report.update_table(&self.comparison)?;
        if measurement.run == 0 {
            self.say_noise();
            let image = rendering.composite();
            let [picture, error_picture] = names_of(&self.stems[sampler], &measurement.budget);
            let attributes = attributes(self.opened, &measurement.sampler, rendering, measurement.seed);
            write_exr(&self.output.file(&picture)?, &image, &attributes)?;
            let errors = error_image(&image, &self.comparison.reference, &self.comparison.measured);
            write_exr(&self.output.file(&error_picture)?, &errors, &attributes)?;
            let (sampler, budget) = (measurement.sampler.clone(), measurement.budget.clone());
            self.comparison.images.push(RenderedImage { sampler, budget, image });
        }
        self.report.update_page(&self.comparison)
    }
}

/// Describes the noise of the reference, and names the samplers and budgets whose mean error is smaller than
/// it.
fn words(noise: Noise, rows: &[Measurement]) -> String {
    let mut groups: Vec<(&str, &str, f64, usize)> = Vec::new();
    for row in rows {
        match groups.iter_mut().find(|group| (group.0, group.1) == (&*row.sampler, &*row.budget)) {
            Some(group) => (group.2, group.3) = (group.2 + row.mse, group.3 + 1),
            None => groups.push((&row.sampler, &row.budget, row.mse, 1)),
        }
    }
    let is_limited = |group: &&(&str, &str, f64, usize)| group.2 / (group.3 as f64) < noise.mse;
    let limited: Vec<String> =
        groups.iter().filter(is_limited).map(|(sampler, budget, ..)| format!("{sampler} at {budget}")).collect();
    let said = format!(
        "Its own mean squared error, from two independent halves, is {:.2e}, and is subtracted from all.",
        noise.mse
    );
    match limited.len() {
        0 => said,
        _ => format!(
            "{said} The ratios of {} are limited by it: their own error is smaller still; take more --reference-spp.",
            limited.join(", ")
        ),
    }
}

/// Progress bar of a measurement.
#[derive(Default)]
struct Bars(OnceCell<progress::Bar>);

impl Bars {
    fn finish(&self) {
        self.0.get().into_iter().for_each(progress::Bar::finish_and_clear);
    }
}

impl Watch for Bars {
    fn planned(&self, seconds: f64) {
        self.0.get_or_init(|| progress::announced_bar(seconds, "comparing"));
    }

    fn message(&self, text: &str) {
        self.0.get().into_iter().for_each(|bar| bar.set_message(text));
    }

    fn spent(&self, seconds: f64) {
        self.0.get().into_iter().for_each(|bar| bar.set_position(progress::thousandths(seconds)));
    }

    fn warning(&self, text: &str) {
        warning!("{text}");
    }
}

/// Squared error of each pixel and channel, relative to the squared reference (plus the same epsilon as in
/// relMSE); black outside the measured pixels.
fn error_image(image: &Image, reference: &Image, covered: &[bool]) -> Image {
    let error = |((x, r), covered): ((&[f32; 3], &[f32; 3]), &bool)| {
        let of = |c: usize| (x[c] - r[c]).powi(2) / (r[c] * r[c] + RELATIVE_EPSILON as f32);
        if *covered { [of(0), of(1), of(2)] } else { [0.0; 3] }
    };
    Image { pixels: image.pixels.iter().zip(&reference.pixels).zip(covered).map(error).collect(), ..*image }
}

/// Longer names are cut: file systems allow 255 bytes, some of which budget and extension need.
const LONGEST_NAME: usize = 120;

/// Returns distinct parts of file names for SPECs.
pub fn stems_of(specs: &[&SamplerSpec]) -> Vec<String> {
    let labels: Vec<String> = specs.iter().map(ToString::to_string).collect();
    let files = specs.iter().map(|spec| spec.path().map(|(_, file)| file));
    file_names(&labels.iter().map(String::as_str).zip(files).collect::<Vec<_>>())
}

/// Returns the names of a sampler's picture and of its errors.
pub fn names_of(stem: &str, budget: &str) -> [String; 2] {
    [format!("{stem}_{budget}.exr"), format!("{stem}_{budget}_error.exr")]
}

/// Returns distinct parts of file names for samplers: their labels, in which a file is named by its folder
/// and its stem. Labels that are cut, or equal up to case, get a hash.
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

/// Returns a label in letters, digits, `-` and `_`.
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
    fn samplers_have_distinct_file_names() {
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
