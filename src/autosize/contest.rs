//! The contest: who is measured how well, who is dropped, and who is trained at all.

use std::{
    cmp::Ordering,
    path::PathBuf,
    sync::atomic::{self, AtomicBool},
};

use anyhow::{Context, Result};
use headtail_render::{
    environment::without_compact_emitters,
    estimator::Estimator,
    file,
    integrator::Budget,
    points::{PointSet, Points},
    spec::SamplerSpec,
    statistics::RatioInterval,
};

use super::{
    Arguments,
    candidates::{Candidate, HeadMaterial, HeadShape, Recipe, STEPS, baked, heads, plain, tables},
    lineup::{Ready, ready},
    measurement::{Measurement, Yardstick},
    page,
    score::{at_time, is_out, ratio},
};
use crate::{
    arguments::{CameraArguments, OpenedView, ViewArguments, make_folder},
    render::quietly,
};

/// A candidate that was made ready and measured.
pub struct Entry {
    /// Its name.
    pub name: String,
    /// How it came about.
    pub recipe: Recipe,
    ready: Ready,
    /// Trial pictures.
    pub measurement: Measurement,
    /// Whether it is still in the contest.
    pub is_in: bool,
}

/// Who was chosen.
pub struct Choice {
    /// Index of the one with the least error.
    pub winner: usize,
    /// Index of the cheapest within 5 % of it.
    pub cheapest: usize,
}

/// Everything around the candidates.
pub struct Contest<'a> {
    arguments: &'a Arguments,
    view: &'a ViewArguments,
    opened: &'a OpenedView,
    material: HeadMaterial,
    covered: Vec<bool>,
    yardstick: Yardstick,
    /// Those that were measured.
    pub entries: Vec<Entry>,
    /// Why heads were not trained, if they were not.
    untrained: Option<String>,
}

/// Samples per pixel of every trial picture: a power of two, which is what low-discrepancy points are best at. With as many as fit into some time, errors would
/// depend on what else the machine does.
const SAMPLES: u32 = 16;
/// Trial pictures in each round.
const ROUNDS: [usize; 4] = [4, 8, 16, 32];
/// By how much the errors of tables of neighbouring sizes, and of heads of different shapes, differ at most.
const TABLES_DIFFER: f64 = 8.0;
const HEADS_DIFFER: f64 = 4.0;
/// Within this share of the winner, the cheapest is named.
const NEAR: f64 = 1.05;

impl<'a> Contest<'a> {
    /// Before the first candidate.
    pub fn new(
        arguments: &'a Arguments,
        view: &'a ViewArguments,
        opened: &'a OpenedView,
        material: HeadMaterial,
    ) -> Result<Self> {
        let mis = SamplerSpec::mis().build(&opened.environment)?;
        let points = Points::new(PointSet::Sobol, 0);
        let rendering = quietly(opened.view(), &*mis, Budget::Spp(SAMPLES), points);
        let covered: Vec<bool> = rendering.coverage.iter().map(|&share| share == 1.0).collect();
        anyhow::ensure!(covered.contains(&true), "no pixel is covered by a surface");
        let yardstick = Yardstick::new(opened, mis, SAMPLES / 4);
        let (entries, untrained) = (Vec::new(), None);
        Ok(Self { arguments, view, opened, material, covered, yardstick, entries, untrained })
    }

    /// Measures everything as far as it takes to decide.
    pub fn run(&mut self, stop: &AtomicBool) -> Result<()> {
        for candidate in plain() {
            self.enter(candidate, stop)?;
        }
        self.rounds(1, stop);
        if self.opened.is_diffuse() {
            for candidate in tables() {
                if stop.load(atomic::Ordering::Relaxed) {
                    return Ok(());
                }
                let index = self.enter(candidate, stop)?;
                if self.is_hopeless(index, TABLES_DIFFER) {
                    break;
                }
            }
        }
        self.rounds(ROUNDS.len() - 1, stop);
        self.train(stop)?;
        self.rounds(ROUNDS.len(), stop);
        Ok(())
    }

    /// Whether a candidate is so far behind that others of its family, which differ by no more than this factor, need not be tried.
    fn is_hopeless(&mut self, index: usize, differ: f64) -> bool {
        let entry = &mut self.entries[index];
        entry.measurement.extend(self.opened, &*entry.ready.estimator, &self.yardstick, ROUNDS[0], &self.covered);
        let Some(best) = self.best() else { return false };
        !self.arguments.exhaustive && mean(&self.scores(index)) > differ * mean(&self.scores(best))
    }

    /// Makes a candidate ready.
    fn enter(&mut self, candidate: Candidate, stop: &AtomicBool) -> Result<usize> {
        let folder = self.arguments.out.join("candidates");
        make_folder(&folder)?;
        let mut ready = ready(&candidate, &self.view.env, self.opened, self.material, &folder, stop)
            .with_context(|| candidate.name.clone())?;
        let Candidate { name, recipe } = candidate;
        if let Recipe::Baked(shape, steps) = recipe {
            // A table of a head takes the training, too.
            let head = self.entries.iter().find(|entry| entry.recipe == Recipe::Head(shape, steps));
            ready.prepared += head.map_or(0.0, |head| head.ready.prepared);
        }
        let is_in = ready.prepared <= self.arguments.prepare_seconds || !recipe.is_prepared();
        self.entries.push(Entry { name, recipe, ready, measurement: Measurement::new(SAMPLES), is_in });
        Ok(self.entries.len() - 1)
    }

    /// Rounds of more and more pictures; after each, those that are out are dropped.
    fn rounds(&mut self, count: usize, stop: &AtomicBool) {
        let mut done = 0;
        for &pictures in &ROUNDS[..count] {
            // One picture of each in turn: a machine that slows down for a while slows all down.
            for picture in done..pictures {
                for entry in self.entries.iter_mut().filter(|entry| entry.is_in) {
                    if stop.load(atomic::Ordering::Relaxed) {
                        return;
                    }
                    entry.measurement.extend(
                        self.opened,
                        &*entry.ready.estimator,
                        &self.yardstick,
                        picture + 1,
                        &self.covered,
                    );
                }
            }
            done = pictures;
            if !self.arguments.exhaustive {
                self.drop_those_behind();
            }
        }
    }

    fn drop_those_behind(&mut self) {
        let Some(best) = self.best() else { return };
        let leader = self.scores(best);
        for index in 0..self.entries.len() {
            let out = index != best && is_out(ratio(&self.scores(index), &leader));
            self.entries[index].is_in &= !out;
        }
    }

    /// Trains heads, shortest first, where a perfect one of their speed would win.
    fn train(&mut self, stop: &AtomicBool) -> Result<()> {
        let limit = self.arguments.prepare_seconds.min(self.arguments.render_seconds);
        let perfect = if self.arguments.exhaustive { 0.0 } else { self.perfect_share()? };
        let map = &self.opened.environment;
        let has_compact = without_compact_emitters(map.width(), map.height(), &map.luminance()).is_some();
        let (mut open, mut speeds) = (Vec::new(), Vec::new());
        for head in heads(STEPS[0]) {
            let Recipe::Head(shape, _) = head.recipe else { continue };
            if shape.name.contains("compact") && !has_compact {
                continue;
            }
            // Heads of one size and mode take the same time.
            let like = shape
                .name
                .split(' ')
                .take(2 + usize::from(shape.name.ends_with("autoregressive")))
                .collect::<Vec<_>>()
                .join(" ");
            let known = speeds.iter().find(|(name, _)| *name == like).map(|(_, could)| *could);
            let could = match known {
                Some(could) => could,
                None => self.arguments.exhaustive || self.could_win(shape, perfect, stop)?,
            };
            speeds.push((like, could));
            if could {
                open.push(head);
            }
        }
        if open.is_empty() {
            self.untrained = Some("even a perfect head, at the time that its samples take, would be behind".into());
            return Ok(());
        }
        for (rung, &steps) in STEPS.iter().enumerate() {
            let mut entered = Vec::new();
            for candidate in heads(steps).into_iter().filter(|head| open.iter().any(|open| same_shape(open, head))) {
                if stop.load(atomic::Ordering::Relaxed) {
                    return Ok(());
                }
                let index = self.enter(candidate, stop)?;
                entered.push(index);
                if self.is_hopeless(index, HEADS_DIFFER) {
                    self.untrained =
                        Some(format!("a head of {steps} steps is so far behind that others were not trained"));
                    break;
                }
                if let Recipe::Head(shape, steps) = self.entries[index].recipe
                    && self.material.0 == headtail_train::Material::Lambert
                {
                    entered.push(self.enter(baked(shape, steps), stop)?);
                }
            }
            for &index in &entered {
                let entry = &mut self.entries[index];
                entry.measurement.extend(
                    self.opened,
                    &*entry.ready.estimator,
                    &self.yardstick,
                    ROUNDS[0],
                    &self.covered,
                );
            }
            let Some(best) = self.best() else { return Ok(()) };
            let goal = if self.arguments.exhaustive { f64::INFINITY } else { mean(&self.scores(best)) };
            // The next rung costs as many times more as it has steps; what it can gain is bounded by a perfect head of this speed.
            let next = STEPS.get(rung + 1).map_or(f64::INFINITY, |next| *next as f64 / steps as f64);
            let can_win = |index: &usize| {
                let entry = &self.entries[*index];
                let prepared = next * entry.ready.prepared;
                prepared < limit && self.bound(self.sample_seconds(&entry.measurement), perfect, prepared) < goal
            };
            let mut hopeful: Vec<usize> = entered.into_iter().filter(can_win).collect();
            hopeful.sort_by(|&a, &b| mean(&self.scores(a)).total_cmp(&mean(&self.scores(b))));
            // Halving: half of the shapes go on.
            if !self.arguments.exhaustive {
                hopeful.truncate(hopeful.len().div_ceil(2));
            }
            if hopeful.is_empty() {
                self.untrained.get_or_insert_with(|| {
                    format!("after {steps} steps no head could still win, however well it were trained further")
                });
                break;
            }
            open = hopeful
                .iter()
                .map(|&index| Candidate {
                    name: self.entries[index].name.clone(),
                    recipe: self.entries[index].recipe.clone(),
                })
                .collect();
        }
        Ok(())
    }

    /// Whether a head of this shape would win if it were perfect: its time per sample is that of an untrained one.
    fn could_win(&self, shape: &'static HeadShape, perfect: f64, stop: &AtomicBool) -> Result<bool> {
        let folder = self.arguments.out.join("untrained");
        make_folder(&folder)?;
        let candidate = Candidate { name: shape.name.to_owned(), recipe: Recipe::Head(shape, 1) };
        let ready = ready(&candidate, &self.view.env, self.opened, self.material, &folder, stop)?;
        let mut measurement = Measurement::new(SAMPLES);
        measurement.extend(self.opened, &*ready.estimator, &self.yardstick, ROUNDS[0], &self.covered);
        let Some(best) = self.best() else { return Ok(true) };
        Ok(self.bound(self.sample_seconds(&measurement), perfect, ready.prepared) < mean(&self.scores(best)))
    }

    /// The error of the exact product over that of the best sampler so far, at equal samples and of few points: what is left to gain by a better
    /// density. The exact product takes milliseconds for each sample, so it is asked on a small picture.
    fn perfect_share(&self) -> Result<f64> {
        const SIDE: u32 = 20;
        const PICTURES: usize = 2;
        let Some(best) = self.best() else { return Ok(0.0) };
        let view = ViewArguments { camera: CameraArguments::of_size(SIDE, SIDE * 3 / 4), ..self.view.clone() };
        let opened = view.open()?;
        let everywhere = vec![true; (SIDE * SIDE * 3 / 4) as usize];
        let error = |estimator: &dyn Estimator| {
            let mut measurement = Measurement::new(1);
            measurement.extend(&opened, estimator, &self.yardstick, PICTURES, &everywhere);
            mean(&measurement.errors())
        };
        let oracle = SamplerSpec::oracle().build(&opened.environment)?;
        Ok((error(&*oracle) / error(&*self.entries[best].ready.estimator)).min(1.0))
    }

    /// The least score that a head of this speed can have.
    fn bound(&self, sample_seconds: f64, perfect: f64, prepared: f64) -> f64 {
        let Some(best) = self.best() else { return 0.0 };
        let best = &self.entries[best].measurement;
        let equal_samples = perfect * mean(&best.errors()) * f64::from(best.spp);
        at_time(equal_samples, sample_seconds, prepared, self.arguments.render_seconds)
    }

    /// The error of each picture, as it would be once the time is up.
    pub fn scores(&self, index: usize) -> Vec<f64> {
        let entry = &self.entries[index];
        let seconds = self.yardstick.sample_seconds * f64::from(entry.measurement.spp);
        let (prepared, total) = (entry.ready.prepared, self.arguments.render_seconds);
        // With the time of its own, so that intervals hold for times too.
        let pictures = entry.measurement.errors().into_iter().zip(entry.measurement.ratios());
        pictures.map(|(error, ratio)| at_time(error, ratio * seconds, prepared, total)).collect()
    }

    /// Seconds of a sample of every pixel.
    pub fn sample_seconds(&self, measurement: &Measurement) -> f64 {
        measurement.ratio() * self.yardstick.sample_seconds
    }

    /// Index of the entry with the least error.
    fn best(&self) -> Option<usize> {
        let known = (0..self.entries.len()).filter(|&index| self.entries[index].is_in);
        let scored = known.map(|index| (index, mean(&self.scores(index)))).filter(|(_, score)| score.is_finite());
        scored.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(index, _)| index)
    }

    /// The winner, and the cheapest within 5 % of it: with the least preparation, then the smallest file, then the order of the candidates.
    pub fn choose(&self) -> Result<Choice> {
        let winner = self.best().context("no candidate could be measured")?;
        let goal = NEAR * mean(&self.scores(winner));
        let near =
            (0..self.entries.len()).filter(|&index| self.entries[index].is_in && mean(&self.scores(index)) <= goal);
        let cost = |&index: &usize| {
            let entry = &self.entries[index];
            (entry.recipe.is_prepared(), entry.ready.bytes, index)
        };
        let cheapest = near.min_by(|a, b| cost(a).partial_cmp(&cost(b)).unwrap_or(Ordering::Equal)).unwrap_or(winner);
        Ok(Choice { winner, cheapest })
    }

    /// The score of an entry over the winner's, over paired pictures.
    pub fn behind(&self, index: usize, winner: usize) -> Option<RatioInterval> {
        ratio(&self.scores(index), &self.scores(winner))
    }

    /// Where a chosen sampler lies: its file, or the text that names it.
    pub fn place(&self, role: &str, entry: &Entry) -> PathBuf {
        match entry.ready.spec.path() {
            Some(_) => self.arguments.out.join(format!("{role}.safetensors")),
            None => self.arguments.out.join(role),
        }
    }

    /// Writes what `--sampler` takes, and copies the file.
    pub fn write_choice(&self, role: &str, entry: &Entry) -> Result<()> {
        let spec = &entry.ready.spec;
        let mut text = spec.to_string();
        if let Some((_, path)) = spec.path() {
            let copy = self.place(role, entry);
            let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
            file::replace(&copy, &bytes)?;
            text = text.replace(&path.display().to_string(), &copy.display().to_string());
        }
        Ok(file::replace(&self.arguments.out.join(role), (text + "\n").as_bytes())?)
    }

    /// Writes every figure and the page.
    pub fn write_records(&self, choice: &Choice, seconds: f64) -> Result<()> {
        let records = page::records(self, choice);
        let folder = &self.arguments.out;
        file::replace(&folder.join("autosize.json"), (serde_json::to_string_pretty(&records)? + "\n").as_bytes())?;
        let title = format!("{} under {}", self.opened.scene_name(), self.opened.environment.name());
        let times = (self.arguments.prepare_seconds, self.arguments.render_seconds, seconds);
        file::replace(&folder.join("autosize.html"), page::page(&title, times, &records, &self.why_not()).as_bytes())?;
        Ok(())
    }

    /// Why no head was trained further.
    pub fn why_not(&self) -> String {
        self.untrained.clone().unwrap_or_else(|| "trained heads and tables were measured, and are behind".into())
    }

    /// What a chosen entry took to be prepared, and its file's bytes.
    pub fn cost(&self, index: usize) -> (f64, u64) {
        (self.entries[index].ready.prepared, self.entries[index].ready.bytes)
    }

    /// As `--sampler` takes it.
    pub fn spec(&self, index: usize) -> String {
        self.entries[index].ready.spec.to_string()
    }
}

fn same_shape(a: &Candidate, b: &Candidate) -> bool {
    let shape = |candidate: &Candidate| match candidate.recipe {
        Recipe::Head(shape, _) | Recipe::Baked(shape, _) => Some(shape.name),
        _ => None,
    };
    shape(a) == shape(b)
}

fn mean(values: &[f64]) -> f64 {
    if values.is_empty() { f64::INFINITY } else { values.iter().sum::<f64>() / values.len() as f64 }
}
