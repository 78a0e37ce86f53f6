//! The tail of a configuration.

use std::sync::Arc;

use headtail_render::{
    environment::Environment,
    tail::{Tail, TailKind},
};

use crate::{FitConfig, FittedFlow, FlowSummary, Result, Run, fit_flow};

/// Builds the tail of a configuration for a map; a flow tail is fitted, within `run`.
///
/// # Errors
/// As [`fit_flow`].
pub fn fit_tail(
    config: &FitConfig,
    environment: &Environment,
    run: Run<'_>,
) -> Result<(Arc<Tail>, Option<FlowSummary>)> {
    if config.tail != TailKind::Flow {
        return Ok((Arc::new(Tail::of_environment(config.tail, environment)?), None));
    }
    let exact = Tail::of_environment(TailKind::Hierarchical, environment)?;
    let FittedFlow { tail, summary, .. } = fit_flow(config, &exact, run)?;
    Ok((Arc::new(tail), Some(summary)))
}
