//! The light that a head is trained for: a tail, and the luminance that it was made from.

use std::sync::Arc;

use headtail_render::{
    environment::{Environment, without_compact_emitters},
    tail::{Tail, TailKind},
};

use crate::{FitConfig, FittedFlow, FlowSummary, Result, Run, fit_flow};

/// A tail and its luminance.
#[derive(Clone, Debug)]
pub struct TrainingLight {
    /// The tail.
    pub tail: Arc<Tail>,
    /// `[height * width]`: the map's luminance, or what is left of it without its compact emitters.
    pub luminance: Vec<f32>,
}

impl TrainingLight {
    /// The light of a map that a configuration asks for, under an exact tail.
    ///
    /// # Errors
    /// The tail cannot be built: see [`Tail::new`].
    pub fn new(config: &FitConfig, environment: &Environment) -> Result<Self> {
        let luminance = Self::luminance_of(config, environment);
        let tail = Tail::new(config.tail, environment.width(), environment.height(), &luminance)?;
        Ok(Self { tail: Arc::new(tail), luminance })
    }

    /// The light of a map that a configuration asks for; a flow tail is fitted first, within `run`.
    ///
    /// # Errors
    /// As [`TrainingLight::new`] and [`fit_flow`].
    pub fn fit(config: &FitConfig, environment: &Environment, run: Run<'_>) -> Result<(Self, Option<FlowSummary>)> {
        if config.tail != TailKind::Flow {
            return Ok((Self::new(config, environment)?, None));
        }
        let exact = Self::new(&FitConfig { tail: TailKind::Hierarchical, ..config.clone() }, environment)?;
        let FittedFlow { tail, summary, .. } = fit_flow(config, &exact.tail, run)?;
        Ok((Self { tail: Arc::new(tail), luminance: exact.luminance }, Some(summary)))
    }

    /// The luminance that the head has to serve.
    pub fn luminance_of(config: &FitConfig, environment: &Environment) -> Vec<f32> {
        let luminance = environment.luminance();
        let rest = config
            .compact_emitters
            .then(|| without_compact_emitters(environment.width(), environment.height(), &luminance));
        rest.flatten().unwrap_or(luminance)
    }
}
