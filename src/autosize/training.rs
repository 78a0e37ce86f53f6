//! Chooses which heads are trained, and for how long: those that would win if they were perfect; the best
//! half of them for longer.

use std::sync::atomic::{self, AtomicBool};

use anyhow::Result;
use headtail_eval::IndependentRuns;
use headtail_render::{estimator::Estimator, spec::SamplerSpec};

use super::{
    candidates::{HEADS, HeadShape, Recipe, STEPS, baked, head},
    contest::{Contest, Entry},
    lineup::untrained,
    score::{at_time, mean},
};
use crate::{
    arguments::{CameraArguments, ViewArguments},
    terminal::detail,
};

/// Steps of a head that take about as long as the fit of a flow tail.
const FLOW_STEPS: f64 = 1500.0;
/// Largest gain in the error of a picture from 4x as many steps of a head: shadows bound it, and a factor of
/// 1.2 was measured.
const LONGER_GAINS: f64 = 1.3;
/// Approximate factor between MSE x time of heads of different shapes.
const SHAPES_DIFFER: f64 = 1.15;
/// Factor by which the measured error of the exact product is reduced: it is measured on few pixels.
const PERFECT_SLACK: f64 = 0.7;

impl Contest<'_> {
    /// Trains heads, shortest first, if a perfect one of their speed would win.
    pub(super) fn train(&mut self, perfect: f64, stop: &AtomicBool) -> Result<()> {
        let is_first = |shape: &&HeadShape| self.fits(shape) && (self.arguments.exhaustive || shape.varies.is_none());
        let mut open: Vec<&'static HeadShape> = HEADS.iter().filter(is_first).collect();
        for (rung, &steps) in STEPS.iter().enumerate() {
            let Some(entered) = self.train_for(rung, &open, perfect, stop)? else { return Ok(()) };
            if entered.is_empty() {
                self.untrained = Some("even a perfect head, at the time that its samples take, would be behind".into());
                return Ok(());
            }
            let Some(&next) = STEPS.get(rung + 1) else { break };
            let factor = next as f64 / steps as f64;
            let mut hopeful: Vec<usize> =
                entered.iter().copied().filter(|&index| self.can_win(index, factor, perfect)).collect();
            hopeful.sort_by(|&a, &b| mean(&self.scores(a)).total_cmp(&mean(&self.scores(b))));
            // Successive halving: half of the shapes advance.
            if !self.arguments.exhaustive {
                hopeful.truncate(hopeful.len().div_ceil(2));
            }
            open.clear();
            // A head and its table are one shape.
            for shape in hopeful.iter().filter_map(|&index| self.shape(index)) {
                if !open.contains(&shape) {
                    open.push(shape);
                }
            }
            if open.is_empty() {
                self.untrained.get_or_insert_with(|| {
                    format!("after {steps} steps no head could still win, however well it were trained further")
                });
                break;
            }
            if rung == 0 && !self.arguments.exhaustive {
                // Variants of an advancing shape are tried beside it from the second rung on.
                let varied = HEADS.iter().filter(|shape| self.fits(shape)).filter(|shape| {
                    let base = hopeful.iter().find(|&&index| self.shape(index).map(|base| base.name) == shape.varies);
                    // A flow tail has to be fitted first.
                    let more = if shape.is_flow { factor + FLOW_STEPS / steps as f64 } else { factor };
                    base.is_some_and(|&base| self.can_win(base, more, perfect))
                });
                open.extend(varied);
            }
        }
        Ok(())
    }

    /// Whether a shape can gain on these surfaces.
    fn fits(&self, shape: &HeadShape) -> bool {
        !shape.over_patches || !self.material.0.is_lambert()
    }

    /// Trains these shapes for the steps of a rung, measures them and their tables, and returns the entries.
    /// `None` if the rest need not be tried.
    fn train_for(
        &mut self,
        rung: usize,
        shapes: &[&'static HeadShape],
        perfect: f64,
        stop: &AtomicBool,
    ) -> Result<Option<Vec<usize>>> {
        let (steps, is_short) = (STEPS[rung], !self.arguments.exhaustive);
        let mut entered = Vec::new();
        // Heads over patches and those over the tail differ by more than their shapes.
        let mut hopeless: Vec<bool> = Vec::new();
        for (number, &shape) in shapes.iter().enumerate() {
            self.stages.within((rung as f64 + number as f64 / shapes.len() as f64) / STEPS.len() as f64);
            if hopeless.contains(&shape.over_patches) {
                continue;
            }
            if stop.load(atomic::Ordering::Relaxed) {
                return Ok(None);
            }
            let has_flow = |recipe: &Recipe| matches!(recipe, Recipe::Head(known, _) if known.is_flow);
            let is_behind = |entry: &Entry| has_flow(&entry.recipe) && !entry.is_in;
            let is_left_out = || self.left_out.iter().any(|(recipe, _)| has_flow(recipe));
            if shape.is_flow && (self.entries.iter().any(is_behind) || is_left_out()) {
                // The fit of the flow alone took too long, did not pay, or failed.
                continue;
            }
            if is_short && rung == 0 && self.is_too_slow(shape, perfect, stop)? {
                continue;
            }
            let Some(index) = self.enter(head(shape, steps), stop)? else { continue };
            entered.push(index);
            // Even if it took too long: its score is reported.
            self.measure(index);
            if is_short && rung == 0 && !self.can_gain(index, LONGER_GAINS * SHAPES_DIFFER, 1.0, perfect) {
                self.untrained = Some(format!("a head of {steps} steps is so far behind that others were not trained"));
                hopeless.push(shape.over_patches);
                if shapes.iter().all(|shape| hopeless.contains(&shape.over_patches)) {
                    return Ok(None);
                }
            }
            if self.arguments.exhaustive && self.material.0.is_lambert() {
                entered.extend(self.enter(baked(shape, steps), stop)?);
            }
        }
        if is_short && self.material.0.is_lambert() {
            entered.extend(self.bake_best(&entered, steps, stop)?);
        }
        entered.iter().for_each(|&index| self.measure(index));
        Ok(Some(entered))
    }

    /// Whether a head of this shape would be behind even if it were perfect; its time per sample is that of
    /// an untrained one.
    fn is_too_slow(&self, shape: &HeadShape, perfect: f64, stop: &AtomicBool) -> Result<bool> {
        let built = untrained(shape, &self.view.env, self.opened, &self.material, &self.arguments.out, stop)?;
        let measurement = self.trial(&*built.estimator);
        Ok(self.is_out_of_reach(self.sample_seconds(&measurement), perfect, built.prepared))
    }

    /// Bakes the head with the lowest error, if a table of its error at the speed of other tables would win.
    fn bake_best(&mut self, heads: &[usize], steps: usize, stop: &AtomicBool) -> Result<Option<usize>> {
        let error = |index: usize| mean(&self.entries[index].measurement.errors());
        let Some(&least) = heads.iter().min_by(|&&a, &&b| error(a).total_cmp(&error(b))) else { return Ok(None) };
        let (Some(best), Some(shape)) = (self.best_of_one(), self.shape(least)) else { return Ok(None) };
        let tables = self.entries.iter().filter(|entry| matches!(entry.recipe, Recipe::Direct(..)));
        let times = tables.map(|table| self.sample_seconds(&table.measurement));
        let time = times.fold(self.sample_seconds(&self.entries[least].measurement), f64::min);
        if self.is_out_of_reach(time, error(least) / error(best), self.entries[least].built.prepared) {
            return Ok(None);
        }
        self.enter(baked(shape, steps), stop)
    }

    /// Whether a head could win after `factor` times its preparation.
    fn can_win(&self, index: usize, factor: f64, perfect: f64) -> bool {
        let prepared = factor * self.entries[index].built.prepared;
        let limit = self.arguments.prepare_seconds.min(self.arguments.render_seconds);
        prepared < limit && self.can_gain(index, LONGER_GAINS, factor, perfect)
    }

    /// Whether a head would win after `factor` times its preparation, with an error lower by the factor
    /// `gain`, but at least that of the exact product.
    fn can_gain(&self, index: usize, gain: f64, factor: f64, perfect: f64) -> bool {
        let Some(best) = self.best_of_one() else { return true };
        let entry = &self.entries[index];
        let ratio = mean(&entry.measurement.errors()) / mean(&self.entries[best].measurement.errors()) / gain;
        let seconds = self.sample_seconds(&entry.measurement);
        !self.is_out_of_reach(seconds, ratio.max(perfect), factor * entry.built.prepared)
    }

    fn shape(&self, index: usize) -> Option<&'static HeadShape> {
        match self.entries[index].recipe {
            Recipe::Head(shape, _) | Recipe::Baked(shape, _) => Some(shape),
            Recipe::Plain(_) | Recipe::Direct(..) | Recipe::Form(..) => None,
        }
    }

    /// Whether a sampler of one direction with this time per sample and preparation would be behind even with
    /// the error of the exact product.
    pub(super) fn is_out_of_reach(&self, sample_seconds: f64, perfect: f64, prepared: f64) -> bool {
        let Some(best) = self.best_of_one() else { return false };
        let measurement = &self.entries[best].measurement;
        let equal_samples = perfect * mean(&measurement.errors()) * f64::from(measurement.samples);
        let least = at_time(equal_samples, sample_seconds, prepared, self.arguments.render_seconds);
        !self.arguments.exhaustive && least > mean(&self.scores(best))
    }

    /// Returns the error of the exact product relative to that of the best sampler of one direction so far,
    /// at equal samples: the possible gain of a better density. The exact product takes milliseconds per
    /// sample, so a small picture is used.
    pub(super) fn perfect_ratio(&self) -> Result<f64> {
        const SIDE: u32 = 20;
        const PICTURES: usize = 2;
        let Some(best) = self.best_of_one() else { return Ok(0.0) };
        let view = ViewArguments { camera: CameraArguments::of_size(SIDE, SIDE * 3 / 4), ..self.view.clone() };
        let opened = view.open()?;
        let everywhere = vec![true; (SIDE * SIDE * 3 / 4) as usize];
        let error = |estimator: &dyn Estimator| {
            let mut measurement = IndependentRuns::new(1);
            measurement.extend(&opened, estimator, None, PICTURES, &everywhere);
            mean(&measurement.errors())
        };
        let oracle = SamplerSpec::oracle().build(&opened.environment)?;
        let ratio = error(&*oracle) / error(&*self.entries[best].built.estimator);
        detail!("autosize: the exact product has {ratio:.2} times the error of {}", self.entries[best].name);
        Ok((PERFECT_SLACK * ratio).min(1.0))
    }
}
