//! The contest: measures candidates, drops those that are behind, and decides what is prepared.

use std::{
    path::PathBuf,
    sync::atomic::{self, AtomicBool},
};

use anyhow::{Context, Result};
use headtail_eval::{Budget, IndependentRuns, OpenedView, TimingBaseline, covered};
use headtail_render::{
    estimator::Estimator,
    file,
    path_text::text_of,
    points::{PointSet, Points},
    spec::SamplerSpec,
    statistics::RatioInterval,
};

use super::{
    arguments::Arguments,
    candidates::{Candidate, HeadMaterial, Recipe, draws_one, forms, plain, tables},
    choice::{CandidateSummary, Choice, choose, least},
    lineup::{BuiltSampler, build},
    score::{at_time, cannot_be_better, is_out, mean, ratio},
    stages::{Stage, Stages},
};
use crate::{
    arguments::ViewArguments,
    output::make_folder,
    terminal::{detail, note},
};

/// A candidate that was prepared and measured.
pub struct Entry {
    /// Name.
    pub name: String,
    /// Preparation.
    pub recipe: Recipe,
    pub(super) built: BuiltSampler,
    /// Trial pictures.
    pub measurement: IndependentRuns,
    /// Whether it is still in the contest.
    pub is_in: bool,
    /// Whether it was ready in time.
    is_allowed: bool,
}

/// The contest and its settings.
pub struct Contest<'a> {
    pub(super) arguments: &'a Arguments,
    pub(super) view: &'a ViewArguments,
    pub(super) opened: &'a OpenedView,
    pub(super) material: HeadMaterial,
    covered: Vec<bool>,
    pub(super) baseline: TimingBaseline,
    pub(super) stages: Stages,
    /// Candidates that were measured.
    pub entries: Vec<Entry>,
    /// Why heads were not trained; `None` if they were.
    pub(super) untrained: Option<String>,
    /// Heads whose training failed, each with the reason.
    pub left_out: Vec<(Recipe, String)>,
}

/// Samples per pixel of every trial picture: a power of two, for which low-discrepancy points are best. A
/// number that fits into a time would make errors depend on other load on the machine.
const SAMPLES: u32 = 16;
/// Trial pictures after each round.
const ROUNDS: [usize; 5] = [2, 4, 8, 16, 32];
/// Rounds before candidates with preparation are chosen: for those without preparation, and for tables.
const FIRST_ROUNDS: usize = 2;
const SECOND_ROUNDS: usize = 3;
/// Largest factor between the errors of tables of neighbouring sizes.
const TABLES_DIFFER: f64 = 8.0;
/// Minimum factor between the preparation times of a table and the next one.
const TABLES_GROW: f64 = 2.0;
/// A further table is tried only if the error fell at least by this factor.
const TABLES_GAIN: f64 = 0.9;
/// The contest is decided when no candidate can be better than the best by more than this factor.
const ENOUGH: f64 = 1.08;
/// Largest gain of other samplers over the same file.
const FORMS_GAIN: f64 = 3.0;

impl<'a> Contest<'a> {
    /// Returns a contest without candidates.
    pub fn new(
        arguments: &'a Arguments,
        view: &'a ViewArguments,
        opened: &'a OpenedView,
        material: HeadMaterial,
    ) -> Result<Self> {
        let mis = SamplerSpec::mis().build(&opened.environment)?;
        let points = Points::new(PointSet::Sobol, 0);
        let never = AtomicBool::new(false);
        let rendering = opened.render(&*mis, Budget::Samples(SAMPLES), points, &never, &|_| {});
        let covered = covered(&rendering.coverage)?;
        let baseline = TimingBaseline::new(opened, mis, SAMPLES / 4);
        let (stages, entries, untrained, left_out) = (Stages::new(), Vec::new(), None, Vec::new());
        Ok(Self { arguments, view, opened, material, covered, baseline, stages, entries, untrained, left_out })
    }

    /// Measures all candidates until the choice is clear.
    ///
    /// # Errors
    /// If a candidate cannot be prepared.
    pub fn run(&mut self, stop: &AtomicBool) -> Result<()> {
        self.begin(Stage::Plain);
        for candidate in plain() {
            self.enter(candidate, stop)?;
        }
        self.rounds(FIRST_ROUNDS, stop);
        // The baseline for further sources may have been dropped in favour of one with several directions.
        self.best_of_one().into_iter().for_each(|index| self.measure(index));
        self.begin(Stage::Product);
        let perfect = if self.arguments.exhaustive { 0.0 } else { self.perfect_ratio()? };
        self.begin(Stage::Tables);
        if self.opened.is_diffuse() {
            self.tabulate(perfect, stop)?;
            self.add_forms(|recipe| matches!(recipe, Recipe::Direct(..)), stop)?;
        }
        self.begin(Stage::Beside);
        self.rounds(SECOND_ROUNDS, stop);
        self.begin(Stage::Heads);
        self.train(perfect, stop)?;
        self.add_forms(Recipe::is_of_head, stop)?;
        self.begin(Stage::Last);
        self.rounds(ROUNDS.len(), stop);
        Ok(())
    }

    fn begin(&mut self, stage: Stage) {
        let left = self.entries.iter().filter(|entry| entry.is_in).count();
        detail!("autosize: {}: {left} of {} candidates are left", stage.name(), self.entries.len());
        self.stages.begin(stage, left);
    }

    /// Prepares tables in order of size, as long as a perfect one of the next size would win.
    fn tabulate(&mut self, perfect: f64, stop: &AtomicBool) -> Result<()> {
        let mut before = f64::INFINITY;
        let candidates = tables();
        let count = candidates.len();
        for (number, candidate) in candidates.into_iter().enumerate() {
            self.stages.within(number as f64 / count as f64);
            if stop.load(atomic::Ordering::Relaxed) {
                return Ok(());
            }
            let Some(index) = self.enter(candidate, stop)? else { continue };
            self.measure(index);
            if self.is_hopeless(index, TABLES_DIFFER) {
                break;
            }
            let entry = &self.entries[index];
            let (error, prepared) = (mean(&entry.measurement.errors()), TABLES_GROW * entry.built.prepared);
            let is_enough = error > TABLES_GAIN * before
                || self.is_out_of_reach(self.sample_seconds(&entry.measurement), perfect, prepared);
            if is_enough && !self.arguments.exhaustive {
                break;
            }
            before = error;
        }
        Ok(())
    }

    /// Adds the other samplers over the best file of a kind, unless it is so far behind that none can win.
    fn add_forms(&mut self, is_of_kind: impl Fn(&Recipe) -> bool, stop: &AtomicBool) -> Result<()> {
        let Some(index) = self.least_of(|entry| entry.is_allowed && is_of_kind(&entry.recipe)) else { return Ok(()) };
        if stop.load(atomic::Ordering::Relaxed) || self.is_hopeless(index, FORMS_GAIN) {
            return Ok(());
        }
        let Entry { name, recipe, built, .. } = &self.entries[index];
        forms(name, recipe, &built.spec).into_iter().try_for_each(|form| self.enter(form, stop).map(|_| ()))
    }

    /// Renders the first pictures of a candidate.
    pub(super) fn measure(&mut self, index: usize) {
        let entry = &mut self.entries[index];
        let pictures = ROUNDS[FIRST_ROUNDS - 1];
        entry.measurement.extend(self.opened, &*entry.built.estimator, Some(&self.baseline), pictures, &self.covered);
    }

    /// Whether a candidate is so far behind those of one direction that others of its family, whose errors
    /// differ by at most the factor `differ`, need not be tried.
    fn is_hopeless(&self, index: usize, differ: f64) -> bool {
        let Some(best) = self.best_of_one() else { return false };
        !self.arguments.exhaustive && mean(&self.scores(index)) > differ * mean(&self.scores(best))
    }

    /// Prepares a candidate. `None` for a head whose training fails under this map, which is skipped with a
    /// note.
    ///
    /// # Errors
    /// If anything else fails.
    pub fn enter(&mut self, candidate: Candidate, stop: &AtomicBool) -> Result<Option<usize>> {
        let folder = self.arguments.out.join("candidates");
        make_folder(&folder)?;
        let built = build(&candidate, &self.view.env, self.opened, &self.material, &folder, stop);
        let mut built = match built {
            Err(error) if comes_to_nothing(&error) => {
                let sentence = format!("{} is left out: {error:#}", candidate.name);
                note!("{sentence}");
                self.left_out.push((candidate.recipe, sentence));
                return Ok(None);
            }
            built => built.with_context(|| candidate.name.clone())?,
        };
        let Candidate { name, recipe } = candidate;
        // The table of a head also needs its training, and a form everything that its file needed.
        built.prepared += self.base(&recipe).map_or(0.0, |base| base.built.prepared);
        let is_allowed = built.prepared <= self.arguments.prepare_seconds || !recipe.is_prepared();
        let measurement = IndependentRuns::new(SAMPLES);
        self.entries.push(Entry { name, recipe, built, measurement, is_in: is_allowed, is_allowed });
        Ok(Some(self.entries.len() - 1))
    }

    /// Renders rounds of increasing numbers of pictures; drops candidates that are behind after each. Ends
    /// early once none can be much better than the best.
    fn rounds(&mut self, count: usize, stop: &AtomicBool) {
        let mut done = 0;
        let all = ROUNDS[count - 1] as f64;
        for &pictures in &ROUNDS[..count] {
            // One picture of each in turn, so that a temporary slowdown of the machine affects all.
            for picture in done..pictures {
                self.stages.within(picture as f64 / all);
                for entry in self.entries.iter_mut().filter(|entry| entry.is_in) {
                    if stop.load(atomic::Ordering::Relaxed) {
                        return;
                    }
                    entry.measurement.extend(
                        self.opened,
                        &*entry.built.estimator,
                        Some(&self.baseline),
                        picture + 1,
                        &self.covered,
                    );
                }
            }
            done = pictures;
            if !self.arguments.exhaustive {
                self.drop_those_behind();
                if self.is_decided() {
                    return;
                }
            }
        }
    }

    /// Whether all remaining candidates are measured and none can be better than the best by more than
    /// [`ENOUGH`].
    fn is_decided(&self) -> bool {
        let Some(best) = self.best() else { return false };
        let leader = self.scores(best);
        let others = (0..self.entries.len()).filter(|&index| index != best && self.entries[index].is_in);
        let mut ratios = others.map(|index| ratio(&self.scores(index), &leader));
        ratios.all(|ratio| cannot_be_better(ratio, ENOUGH))
    }

    fn drop_those_behind(&mut self) {
        let Some(best) = self.best() else { return };
        let leader = self.scores(best);
        for index in 0..self.entries.len() {
            let out = index != best && is_out(ratio(&self.scores(index), &leader));
            self.entries[index].is_in &= !out;
        }
    }

    /// Returns the expected error of each picture at the end of the time.
    pub fn scores(&self, index: usize) -> Vec<f64> {
        let entry = &self.entries[index];
        let seconds = self.baseline.sample_seconds * f64::from(entry.measurement.samples);
        let (prepared, total) = (entry.built.prepared, self.arguments.render_seconds);
        // Each error is paired with its own time, so that intervals include the variation of times.
        let pictures = entry.measurement.errors().into_iter().zip(entry.measurement.time_ratios());
        pictures.map(|(error, ratio)| at_time(error, ratio * seconds, prepared, total)).collect()
    }

    /// Returns the seconds of one sample per pixel.
    pub fn sample_seconds(&self, measurement: &IndependentRuns) -> f64 {
        measurement.time_ratio() * self.baseline.sample_seconds
    }

    /// Returns the index of the entry with the lowest error.
    pub fn best(&self) -> Option<usize> {
        self.least_of(|entry| entry.is_in)
    }

    /// Returns the best entry that draws one direction, dropped or not. Several directions gain about equally
    /// much with every sampler, so a further source must win against these.
    pub(super) fn best_of_one(&self) -> Option<usize> {
        self.least_of(|entry| entry.is_allowed && draws_one(&entry.built.spec))
    }

    fn least_of(&self, is: impl Fn(&Entry) -> bool) -> Option<usize> {
        least((0..self.entries.len()).filter(|&index| is(&self.entries[index])), |index| mean(&self.scores(index)))
    }

    /// Returns the winner, and the cheapest candidate within 5 % of it.
    ///
    /// # Errors
    /// If nothing could be measured.
    pub fn choose(&self) -> Result<Choice> {
        let summary = |(index, entry): (usize, &Entry)| CandidateSummary {
            scores: self.scores(index),
            is_allowed: entry.is_allowed,
            is_in: entry.is_in,
            is_prepared: entry.recipe.is_prepared(),
            bytes: entry.built.bytes,
        };
        let summaries: Vec<CandidateSummary> = self.entries.iter().enumerate().map(summary).collect();
        choose(&summaries).context("no candidate could be measured")
    }

    /// Renders the first pictures of a sampler outside the contest.
    pub fn trial(&self, estimator: &dyn Estimator) -> IndependentRuns {
        let mut measurement = IndependentRuns::new(SAMPLES);
        measurement.extend(self.opened, estimator, Some(&self.baseline), ROUNDS[0], &self.covered);
        measurement
    }

    /// Returns the score of an entry relative to the winner's, over paired pictures.
    pub fn behind(&self, index: usize, winner: usize) -> Option<RatioInterval> {
        ratio(&self.scores(index), &self.scores(winner))
    }

    /// Returns the path of a chosen sampler: its file, or the text that names it.
    pub fn place(&self, role: &str, entry: &Entry) -> PathBuf {
        match entry.built.spec.path() {
            Some(_) => self.arguments.out.join(format!("{role}.safetensors")),
            None => self.arguments.out.join(role),
        }
    }

    /// Writes the SPEC for `--sampler`, and copies the file.
    pub fn write_choice(&self, role: &str, entry: &Entry) -> Result<()> {
        let spec = &entry.built.spec;
        let mut text = spec.to_string();
        if let Some((_, path)) = spec.path() {
            let copy = self.place(role, entry);
            let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
            file::replace(&copy, &bytes)?;
            text = text.replace(&*text_of(path), &text_of(&copy));
        }
        Ok(file::replace(&self.arguments.out.join(role), (text + "\n").as_bytes())?)
    }

    /// Returns the reason why no head was trained further.
    pub fn why_not(&self) -> String {
        self.untrained.clone().unwrap_or_else(|| "trained heads and tables were measured, and are behind".into())
    }

    /// Returns the entry that a recipe is based on.
    pub fn base(&self, recipe: &Recipe) -> Option<&Entry> {
        let base = recipe.base()?;
        self.entries.iter().find(|entry| entry.recipe == base)
    }

    /// Returns the preparation of an entry in seconds, and its file's bytes.
    pub fn cost(&self, index: usize) -> (f64, u64) {
        (self.entries[index].built.prepared, self.entries[index].built.bytes)
    }

    /// Returns the SPEC for `--sampler`.
    pub fn spec(&self, index: usize) -> String {
        self.entries[index].built.spec.to_string()
    }
}

/// Whether an error means that the training failed, rather than that a file or a setting is wrong.
fn comes_to_nothing(error: &anyhow::Error) -> bool {
    use headtail_train::Error::{Diverged, NoTable};
    matches!(error.downcast_ref(), Some(Diverged { .. } | NoTable { .. }))
}
