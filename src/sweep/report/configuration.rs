//! Configurations of a sweep whose trials are all done.

use serde::Serialize;

/// A configuration whose trials are all done.
#[derive(Serialize)]
pub(super) struct Configuration {
    pub(super) name: String,
    /// One per objective.
    pub(super) figures: Vec<f64>,
    /// Seconds of work of all its trials.
    pub(super) seconds: f64,
    /// Whether it is on the Pareto front: no other is at least as good in every objective and better in one.
    pub(super) front: bool,
    pub(super) trials: Vec<usize>,
}
