//! Several directions from one sampler.

use std::sync::Arc;

use super::{Contributions, Estimator, contribute};
use crate::{
    columns::Arena,
    environment::Environment,
    error::{Error, Result},
    points::{Dimension, Points},
    sampler::{Covering, Draws, Sampler, prepared},
    tile::Rows,
    timings::{Stage, timed},
};

/// The mean of several directions from one sampler: camera ray, hit and what the sampler prepares for a shading point are paid once (splitting, Veach
/// 1997, section 10.2.1). The directions of all samples of a pixel are points of one sequence.
#[derive(Clone, Debug)]
pub struct Split<S> {
    sampler: Covering<S>,
    directions: u32,
    environment: Arc<Environment>,
}

impl<S: Sampler> Split<S> {
    /// Most directions.
    pub const MOST: u32 = 64;

    /// An estimator with so many directions of a sampler that covers the whole integrand.
    ///
    /// # Errors
    /// There must be 1 to [`Self::MOST`] directions.
    pub fn new(sampler: Covering<S>, directions: u32, environment: Arc<Environment>) -> Result<Self> {
        if !(1..=Self::MOST).contains(&directions) {
            return Err(Error::argument("split", format!("{directions} directions: choose 1 to {}", Self::MOST)));
        }
        Ok(Self { sampler, directions, environment })
    }
}

impl<S: Sampler> Estimator for Split<S> {
    fn propose(&self, at: &Rows<'_>, points: &Points, out: &mut Contributions, arena: &Arena) {
        let mut columns = arena.columns::<6>(at.strips());
        let [u, v, x, y, z, pdf] = columns.get_mut();
        prepared(&self.sampler, at, arena, |state| {
            for index in 0..self.directions {
                let dimension = Dimension::Candidate { technique: 0, index, of: self.directions };
                points.draw(dimension, at, [&mut *u, &mut *v]);
                timed(Stage::Sampling, || {
                    let out = Draws { wi: [&mut *x, &mut *y, &mut *z], pdf: &mut *pdf };
                    self.sampler.sample(at, state, [&*u, &*v], out, arena);
                });
                timed(Stage::Shading, || {
                    let share = 1.0 / self.directions as f32;
                    for pdf in pdf.as_flattened_mut() {
                        *pdf = if *pdf > 0.0 { share / *pdf } else { 0.0 };
                    }
                    contribute(at, &self.environment, [&*x, &*y, &*z], pdf, out, arena);
                });
            }
        });
    }
}
