//! Derivatives for training the reparameterised sampler: the points that directions come from, and how their
//! densities change with these points.

use super::{
    COSINE_WEIGHT, Reparameterised,
    encoding::Seen,
    reparam::{Start, mixture, size},
};
use crate::{
    brdf::neural_texture::FEATURES,
    columns::{strips, vectorized},
    simd::{self, LANES, Lanes, Simd},
};

/// The quantities on which the density of a direction depends, in the tangent frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Traced {
    /// The point that the search assigns to the direction.
    pub p: [f32; 2],
    /// `J^-T` times the gradient by `p` of the logarithm of the density at `p`: the decrease of the log
    /// density per unit of `F(p)`.
    pub pull: [f32; 2],
    /// The fraction of the density that does not come from the cosine lobe; 0 where no point was found.
    pub fraction: f32,
}

/// Number of inputs of a question: features, `wo`, `wi`.
const INPUTS: usize = FEATURES + 6;

impl Reparameterised {
    /// Traces directions `wi` back to points, each with its features and `wo`; all in the tangent frame and
    /// above the surface.
    pub fn trace(&self, questions: &[([f32; FEATURES], [f32; 3], [f32; 3])]) -> Vec<Traced> {
        let count = strips(questions.len());
        let mut input = vec![[[0.0; LANES]; INPUTS]; count];
        for k in 0..count * LANES {
            // Lanes without a question repeat the last one.
            let Some((features, wo, wi)) = questions.get(k).or(questions.last()) else { break };
            for (row, number) in features.iter().chain(wo).chain(wi).enumerate() {
                input[k / LANES][row][k % LANES] = *number;
            }
        }
        let mut output = vec![[[0.0; LANES]; 5]; count];
        trace(self, &input, &mut output);
        let traced = |k: usize| {
            let [px, py, x, y, fraction] = output[k / LANES].map(|row| row[k % LANES]);
            Traced { p: [px, py], pull: [x, y], fraction }
        };
        (0..questions.len()).map(traced).collect()
    }

    /// Returns the logarithm of the density of slopes at `p` up to a constant: `-2 ln(1 + p^2) - ln |det J|`.
    #[inline(always)]
    fn log_density<S: Simd>(&self, simd: S, start: &Start, p: &[Lanes; 2]) -> Lanes {
        let there = self.map(simd, start, p);
        let mut out = [0.0; LANES];
        for lane in 0..LANES {
            let squared = size(p[0][lane], p[1][lane]);
            let determinant = there.determinant(lane).abs();
            let determinant = if determinant > 1e-20 { determinant } else { 1e-20 };
            out[lane] = -4.0 * simd::ln(squared) - simd::ln(determinant);
        }
        out
    }

    /// Returns the gradient of [`Self::log_density`] by central differences.
    #[inline(always)]
    fn log_slopes<S: Simd>(&self, simd: S, start: &Start, p: &[Lanes; 2]) -> [Lanes; 2] {
        // Balances the error from rounding, 1e-6 / 2e-3, with that from the third derivative.
        const STEP: f32 = 2e-3;
        let mut slopes = [[0.0; LANES]; 2];
        for axis in 0..2 {
            let (mut before, mut after) = (*p, *p);
            for lane in 0..LANES {
                let step = STEP * size(p[0][lane], p[1][lane]);
                before[axis][lane] -= step;
                after[axis][lane] += step;
            }
            let (low, high) = (self.log_density(simd, start, &before), self.log_density(simd, start, &after));
            for lane in 0..LANES {
                slopes[axis][lane] = (high[lane] - low[lane]) / (after[axis][lane] - before[axis][lane]);
            }
        }
        slopes
    }
}

vectorized! {
    fn trace['a](
        simd, warp: &'a Reparameterised, input: &'a [[Lanes; INPUTS]], output: &'a mut [[Lanes; 5]],
    ) {
        for (input, output) in input.iter().zip(output) {
            let mut seen = Seen { features: [[0.0; LANES]; FEATURES], wo: [[0.0; LANES]; 3] };
            seen.features.copy_from_slice(&input[..FEATURES]);
            seen.wo.copy_from_slice(&input[FEATURES..FEATURES + 3]);
            let wi = [input[FEATURES + 3], input[FEATURES + 4], input[FEATURES + 5]];
            let start = warp.start(simd, &seen);
            let (p, density) = warp.search(simd, &start, &wi);
            let slopes = warp.log_slopes(simd, &start, &p);
            let there = warp.map(simd, &start, &p);
            (output[0], output[1]) = (p[0], p[1]);
            for lane in 0..LANES {
                let by = 1.0 / there.determinant(lane);
                let (x, y) = (slopes[0][lane], slopes[1][lane]);
                output[2][lane] = by * (there.by[1][1][lane] * x - there.by[0][1][lane] * y);
                output[3][lane] = by * (there.by[0][0][lane] * y - there.by[1][0][lane] * x);
                let own = (1.0 - COSINE_WEIGHT) * density[lane];
                output[4][lane] = own / mixture(density[lane], wi[2][lane]);
            }
        }
    }
}
