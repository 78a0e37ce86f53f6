//! One direction from one sampler.

use std::sync::Arc;

use super::{Contributions, Estimator, contribute};
use crate::{
    columns::Arena,
    environment::Environment,
    points::{Dimension, Points},
    sampler::{Covering, Draws, Sampler, prepared},
    tile::Rows,
    timings::{Stage, timed},
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
        propose_one(&self.sampler, &self.environment, at, points, out, arena);
    }
}

/// One direction for each row from a sampler that covers the whole integrand.
pub(super) fn propose_one(
    sampler: &dyn Sampler,
    environment: &Environment,
    at: &Rows<'_>,
    points: &Points,
    out: &mut Contributions,
    arena: &Arena,
) {
    let mut columns = arena.columns::<6>(at.strips());
    let [u, v, x, y, z, pdf] = columns.get_mut();
    points.draw(Dimension::Light(0), at, [&mut *u, &mut *v]);
    timed(Stage::Sampling, || {
        prepared(sampler, at, arena, |state| {
            sampler.sample(at, state, [u, v], Draws { wi: [&mut *x, &mut *y, &mut *z], pdf: &mut *pdf }, arena);
        });
    });
    timed(Stage::Shading, || {
        for pdf in pdf.as_flattened_mut() {
            *pdf = if *pdf > 0.0 { 1.0 / *pdf } else { 0.0 };
        }
        contribute(at, environment, [x, y, z], pdf, out, arena);
    });
}
