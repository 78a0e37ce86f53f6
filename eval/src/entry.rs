//! Samplers that are ready to render, for the measuring loop.

use std::{sync::atomic::AtomicBool, time::Instant};

use headtail_render::{
    estimator::Estimator,
    spec::{SamplerSpec, Source},
};

use crate::{
    Budget, GraphicsDevice, OpenedView, Renderer, Result,
    auto::{Choice, choose},
};

/// A sampler that is ready to render.
pub struct Entry {
    /// Name in measurements.
    pub name: String,
    /// One estimator for all budgets, or the choice of `auto` for each.
    built: Vec<Built>,
}

/// A renderer with its sampler, and the seconds of its preparation: its files, and the work before the first sample.
struct Built {
    /// The budget that it was chosen for; `None` for all.
    budget: Option<Budget>,
    renderer: Box<dyn Renderer>,
    seconds: f64,
}

impl Entry {
    /// Wraps an estimator whose preparation is not counted.
    pub fn new(name: impl Into<String>, estimator: Box<dyn Estimator>) -> Self {
        Self::prepared(name, estimator, 0.0)
    }

    /// Wraps an estimator and the seconds of its preparation.
    pub fn prepared(name: impl Into<String>, estimator: Box<dyn Estimator>, preparation: f64) -> Self {
        Self {
            name: name.into(),
            built: vec![Built { budget: None, renderer: Box::new(estimator), seconds: preparation }],
        }
    }

    /// Opens a sampler by its SPEC, on a graphics device if one is given; `auto` is chosen for each budget, by the
    /// integrator on the CPU. `preparation` is the time of its files in seconds.
    ///
    /// # Errors
    /// If it cannot be prepared.
    pub fn open(
        name: impl Into<String>,
        spec: &SamplerSpec,
        preparation: f64,
        (view, device): (&OpenedView, Option<&GraphicsDevice>),
        (budgets, stop): (&[Budget], &AtomicBool),
    ) -> Result<Self> {
        let start = Instant::now();
        if *spec.source() == Source::Auto {
            let choice = |&budget: &Budget| {
                let start = Instant::now();
                let Choice { estimator, spec, .. } = choose(view, budget, stop)?;
                let renderer = device.map_or_else(|| Ok(Box::new(estimator) as _), |device| device.renderer(&spec))?;
                Ok(Built { budget: Some(budget), renderer, seconds: start.elapsed().as_secs_f64() })
            };
            return Ok(Self { name: name.into(), built: budgets.iter().map(choice).collect::<Result<_>>()? });
        }
        let renderer = match device {
            Some(device) => device.renderer(spec)?,
            None => Box::new(view.estimator(spec)?),
        };
        let seconds = preparation + start.elapsed().as_secs_f64();
        Ok(Self { name: name.into(), built: vec![Built { budget: None, renderer, seconds }] })
    }

    /// Returns the longest preparation for any budget, in seconds.
    pub fn preparation(&self) -> f64 {
        self.built.iter().map(|built| built.seconds).fold(0.0, f64::max)
    }

    /// Returns whether `auto` chose the estimator with the help of a clock, as for budgets of seconds.
    pub(crate) fn is_chosen_by_clock(&self, budget: Budget) -> bool {
        budget.seconds().is_some() && self.built.iter().any(|built| built.budget == Some(budget))
    }

    /// Returns the renderer for a budget and the seconds of its preparation.
    pub(crate) fn at(&self, budget: Budget) -> (&dyn Renderer, f64) {
        let built = self.built.iter().find(|built| built.budget.is_none_or(|own| own == budget));
        let built = built.expect("a renderer for every budget that the entry was opened with");
        (&*built.renderer, built.seconds)
    }
}
