//! Which heads are trained, and how far: those that would win if they were perfect, the likeliest half of them further.

use std::sync::atomic::{self, AtomicBool};

use anyhow::Result;
use headtail_render::{environment::without_compact_emitters, estimator::Estimator, spec::SamplerSpec};
use headtail_train::Material;

use super::{
    candidates::{HEADS, HeadShape, Recipe, STEPS, baked, head},
    contest::{Contest, Entry, mean},
    lineup::untrained,
    measurement::Measurement,
    score::at_time,
};
use crate::arguments::{CameraArguments, ViewArguments};

/// By how much the errors of heads of different shapes differ at most.
const HEADS_DIFFER: f64 = 3.0;
/// What a head gains at most by four times as many steps: less than this is known of any map.
const LONGER_GAINS: f64 = 1.5;
/// The error of the exact product is taken to be this much lower than it was measured to be on a few pixels.
const PERFECT_SLACK: f64 = 0.7;
/// About so many steps of a head cost as much as the fit of a flow tail.
const FLOW_STEPS: f64 = 1500.0;

impl Contest<'_> {
    /// Trains heads, shortest first, where a perfect one of their speed would win.
    pub(super) fn train(&mut self, perfect: f64, stop: &AtomicBool) -> Result<()> {
        let mut open = self.shapes(perfect, stop)?;
        if open.is_empty() {
            self.untrained = Some("even a perfect head, at the time that its samples take, would be behind".into());
            return Ok(());
        }
        for (rung, &steps) in STEPS.iter().enumerate() {
            let Some(entered) = self.train_for(steps, &open, stop)? else { return Ok(()) };
            let Some(&next) = STEPS.get(rung + 1) else { break };
            let factor = next as f64 / steps as f64;
            let mut hopeful: Vec<usize> =
                entered.iter().copied().filter(|&index| self.can_win(index, factor, perfect)).collect();
            hopeful.sort_by(|&a, &b| mean(&self.scores(a)).total_cmp(&mean(&self.scores(b))));
            // Halving: half of the shapes go on.
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
                // What varies a shape that gets on is tried beside it from here on.
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

    /// The shapes to begin with: of the exhaustive contest all, else those that vary no other and would win if they were perfect.
    fn shapes(&self, perfect: f64, stop: &AtomicBool) -> Result<Vec<&'static HeadShape>> {
        let mut open = Vec::new();
        for shape in HEADS.iter().filter(|shape| self.fits(shape)) {
            let is_tried = self.arguments.exhaustive
                || shape.varies.is_none() && {
                    let ready =
                        untrained(shape, &self.view.env, self.opened, self.material, &self.arguments.out, stop)?;
                    let measurement = self.trial(&*ready.estimator);
                    !self.is_out_of_reach(self.sample_seconds(&measurement), perfect, ready.prepared)
                };
            if is_tried {
                open.push(shape);
            }
        }
        Ok(open)
    }

    /// Whether a shape is different from others on this map.
    fn fits(&self, shape: &HeadShape) -> bool {
        let map = &self.opened.environment;
        !shape.name.contains("compact")
            || without_compact_emitters(map.width(), map.height(), &map.luminance()).is_some()
    }

    /// Trains these shapes and measures them; the entries of heads and of their tables. `None` once the rest need not be tried.
    fn train_for(
        &mut self,
        steps: usize,
        shapes: &[&'static HeadShape],
        stop: &AtomicBool,
    ) -> Result<Option<Vec<usize>>> {
        let mut entered = Vec::new();
        for &shape in shapes {
            if stop.load(atomic::Ordering::Relaxed) {
                return Ok(None);
            }
            let has_flow = |entry: &Entry| matches!(entry.recipe, Recipe::Head(known, _) if known.is_flow);
            if shape.is_flow && self.entries.iter().any(|entry| has_flow(entry) && !entry.is_in) {
                // The fit of the flow alone took too long, or did not pay.
                continue;
            }
            let index = self.enter(head(shape, steps), stop)?;
            entered.push(index);
            if shape.varies.is_none() && self.is_hopeless(index, HEADS_DIFFER) {
                self.untrained = Some(format!("a head of {steps} steps is so far behind that others were not trained"));
                return Ok(None);
            }
            if self.material.0 == Material::Lambert {
                entered.push(self.enter(baked(shape, steps), stop)?);
            }
        }
        for &index in &entered {
            // Of those that took too long, too: their score says what they are behind.
            self.is_hopeless(index, f64::INFINITY);
        }
        Ok(Some(entered))
    }

    /// Whether a head could win after `factor` times as much preparation: if it gained as much as heads do by longer training, and had no less error
    /// than the exact product.
    fn can_win(&self, index: usize, factor: f64, perfect: f64) -> bool {
        let Some(best) = self.best() else { return true };
        let entry = &self.entries[index];
        let prepared = factor * entry.ready.prepared;
        let limit = self.arguments.prepare_seconds.min(self.arguments.render_seconds);
        let gained = mean(&entry.measurement.errors()) / mean(&self.entries[best].measurement.errors()) / LONGER_GAINS;
        prepared < limit
            && !self.is_out_of_reach(self.sample_seconds(&entry.measurement), gained.max(perfect), prepared)
    }

    fn shape(&self, index: usize) -> Option<&'static HeadShape> {
        match self.entries[index].recipe {
            Recipe::Head(shape, _) | Recipe::Baked(shape, _) => Some(shape),
            Recipe::Plain(_) | Recipe::Direct(..) => None,
        }
    }

    /// Whether a sampler of this speed and preparation would be behind even with the error of the exact product.
    pub(super) fn is_out_of_reach(&self, sample_seconds: f64, perfect: f64, prepared: f64) -> bool {
        let Some(best) = self.best() else { return false };
        let measurement = &self.entries[best].measurement;
        let equal_samples = perfect * mean(&measurement.errors()) * f64::from(measurement.spp);
        let least = at_time(equal_samples, sample_seconds, prepared, self.arguments.render_seconds);
        !self.arguments.exhaustive && least > mean(&self.scores(best))
    }

    /// The error of the exact product over that of the best sampler so far, at equal samples and of few points: what is left to gain by a better
    /// density. The exact product takes milliseconds for each sample, so it is asked on a small picture.
    pub(super) fn perfect_share(&self) -> Result<f64> {
        const SIDE: u32 = 20;
        const PICTURES: usize = 2;
        let Some(best) = self.best() else { return Ok(0.0) };
        let view = ViewArguments { camera: CameraArguments::of_size(SIDE, SIDE * 3 / 4), ..self.view.clone() };
        let opened = view.open()?;
        let everywhere = vec![true; (SIDE * SIDE * 3 / 4) as usize];
        let error = |estimator: &dyn Estimator| {
            let mut measurement = Measurement::new(1);
            measurement.extend_untimed(&opened, estimator, PICTURES, &everywhere);
            mean(&measurement.errors())
        };
        let oracle = SamplerSpec::oracle().build(&opened.environment)?;
        let share = error(&*oracle) / error(&*self.entries[best].ready.estimator);
        Ok((PERFECT_SLACK * share).min(1.0))
    }
}
