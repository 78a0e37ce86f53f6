//! Two-sample multiple importance sampling.

use std::sync::Arc;

use super::{Contributions, Estimator, contribute, split::check_directions};
use crate::{
    columns::Arena,
    environment::Environment,
    error::Result,
    points::{Dimension, Points},
    sampler::{Coverage, Covering, Draws, Sampler, prepared},
    simd::Lanes,
    tile::Rows,
    timings::{Stage, timed},
};

/// Two-sample MIS with the power heuristic, beta = 2 (Veach 1997, section 9.2.3): one direction, and at most one shadow ray, from
/// each of two samplers, or the mean of several such pairs.
#[derive(Clone, Debug)]
pub struct TwoSampleMis<A, B> {
    first: A,
    second: B,
    pairs: u32,
    environment: Arc<Environment>,
}

impl<A: Sampler, B: Sampler> TwoSampleMis<A, B> {
    /// Combines two samplers.
    ///
    /// # Errors
    /// Neither covers the integrand.
    pub fn new(first: A, second: B, environment: Arc<Environment>) -> Result<Self> {
        if first.coverage() == Coverage::Everything {
            return Ok(Self { first, second, pairs: 1, environment });
        }
        Ok(Self { first, second: Covering::new(second)?.into_inner(), pairs: 1, environment })
    }

    /// Averages `pairs` pairs for each shading point, which is prepared once.
    ///
    /// # Errors
    /// `pairs` is not in 1 to [`Split::MOST`](super::Split::MOST).
    pub fn with_pairs(self, pairs: u32) -> Result<Self> {
        Ok(Self { pairs: check_directions(pairs)?, ..self })
    }

    /// Draws from `own`, with the weight of the power heuristic over the pdf of `other`.
    fn half(
        &self,
        at: &Rows<'_>,
        [own, other]: [(&dyn Sampler, &[Lanes]); 2],
        (points, dimension): (&Points, Dimension),
        out: &mut Contributions,
        arena: &Arena,
    ) {
        let mut columns = arena.columns::<7>(at.strips());
        let [u, v, x, y, z, pdf, others] = columns.get_mut();
        points.draw(dimension, at, [&mut *u, &mut *v]);
        timed(Stage::Sampling, || {
            own.0.sample(at, own.1, [u, v], Draws { wi: [&mut *x, &mut *y, &mut *z], pdf: &mut *pdf }, arena);
        });
        timed(Stage::Pdf, || other.0.pdf(at, other.1, [x, y, z], others, arena));
        let fraction = 1.0 / self.pairs as f32;
        timed(Stage::Shading, || {
            for (pdf, other) in pdf.as_flattened_mut().iter_mut().zip(others.as_flattened()) {
                // p^2 / (p^2 + q^2) / p, written so that a large p does not overflow.
                let ratio = other / *pdf;
                *pdf = if *pdf > 0.0 { fraction / (*pdf * (1.0 + ratio * ratio)) } else { 0.0 };
            }
            contribute(at, &self.environment, [x, y, z], pdf, out, arena);
        });
    }
}

impl<A: Sampler, B: Sampler> Estimator for TwoSampleMis<A, B> {
    fn propose(&self, at: &Rows<'_>, points: &Points, out: &mut Contributions, arena: &Arena) {
        prepared(&self.first, at, arena, |first| {
            prepared(&self.second, at, arena, |second| {
                let (first, second) = ((&self.first as &dyn Sampler, first), (&self.second as &dyn Sampler, second));
                for index in 0..self.pairs {
                    let dimension = |technique: u32| Dimension::of_several(technique, index, self.pairs);
                    self.half(at, [first, second], (points, dimension(0)), out, arena);
                    self.half(at, [second, first], (points, dimension(1)), out, arena);
                }
            });
        });
    }
}
