//! Several directions from one sampler.

use std::sync::Arc;

use super::{Contributions, Estimator, contribute};
use crate::{
    columns::Arena,
    environment::Environment,
    error::{Error, Result},
    points::{Dimension, Points},
    sampler::{BrdfSampler, Covering, Draws, Sampler},
    tile::Rows,
    timings::{Stage, timed},
};

/// The mean of several directions from one sampler: the camera ray, the hit and the sampler's preparation for
/// a shading point are paid once (splitting, Veach 1997, section 10.2.1). The directions of all samples of a
/// pixel are points of one sequence.
#[derive(Clone, Debug)]
pub struct Split<S> {
    sampler: Covering<S>,
    directions: u32,
    environment: Arc<Environment>,
}

impl<S: Sampler> Split<S> {
    /// Largest number of directions.
    pub const MOST: u32 = 64;

    /// An estimator with `directions` directions of a sampler that covers the whole integrand.
    ///
    /// # Errors
    /// `directions` is not in 1 to [`Self::MOST`].
    pub fn new(sampler: Covering<S>, directions: u32, environment: Arc<Environment>) -> Result<Self> {
        Ok(Self { sampler, directions: check_directions(directions)?, environment })
    }
}

impl<S: Sampler> Estimator for Split<S> {
    fn propose(&self, at: &Rows<'_>, points: &Points, out: &mut Contributions, arena: &Arena) {
        propose_mean(self.directions, &self.sampler, &self.environment, at, points, out, arena);
    }
}

/// Proposes `directions` directions for each row from a sampler that covers the whole integrand, each
/// weighted by 1 / `directions`.
pub(super) fn propose_mean(
    directions: u32,
    sampler: &dyn Sampler,
    environment: &Environment,
    at: &Rows<'_>,
    points: &Points,
    out: &mut Contributions,
    arena: &Arena,
) {
    let mut columns = arena.columns::<6>(at.strips());
    let [u, v, x, y, z, pdf] = columns.get_mut();
    let mut state = arena.columns::<1>(sampler.columns() * at.strips());
    timed(Stage::Sampling, || sampler.prepare(at, state.get_mut()[0], arena));
    for index in 0..directions {
        points.draw(Dimension::of_several(0, index, directions), at, [&mut *u, &mut *v]);
        timed(Stage::Sampling, || {
            let out = Draws { wi: [&mut *x, &mut *y, &mut *z], pdf: &mut *pdf };
            sampler.sample(at, state.get()[0], [&*u, &*v], out, arena);
        });
        timed(Stage::Shading, || {
            let fraction = 1.0 / directions as f32;
            for pdf in pdf.as_flattened_mut() {
                *pdf = if *pdf > 0.0 { fraction / *pdf } else { 0.0 };
            }
            contribute(at, environment, [&*x, &*y, &*z], pdf, out, arena);
        });
    }
}

/// Returns `directions`, or an error unless it is 1 to [`Split::MOST`].
pub(super) fn check_directions(directions: u32) -> Result<u32> {
    let most = Split::<BrdfSampler>::MOST;
    if !(1..=most).contains(&directions) {
        return Err(Error::argument("split", format!("{directions} directions: choose 1 to {most}")));
    }
    Ok(directions)
}
