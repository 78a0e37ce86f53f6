//! One direction from one sampler.

use std::sync::Arc;

use super::{Contributions, Estimator, split::propose_mean};
use crate::{
    columns::Arena,
    environment::Environment,
    points::Points,
    sampler::{Covering, Sampler},
    tile::Rows,
};

/// One direction from one sampler: `f cos L V / pdf`.
#[derive(Clone, Debug)]
pub struct SingleSample<S> {
    sampler: Covering<S>,
    environment: Arc<Environment>,
}

impl<S: Sampler> SingleSample<S> {
    /// An estimator of a sampler that covers the whole integrand.
    pub fn new(sampler: Covering<S>, environment: Arc<Environment>) -> Self {
        Self { sampler, environment }
    }
}

impl<S: Sampler> Estimator for SingleSample<S> {
    fn propose(&self, at: &Rows<'_>, points: &Points, out: &mut Contributions, arena: &Arena) {
        propose_mean(1, &self.sampler, &self.environment, at, points, out, arena);
    }
}
