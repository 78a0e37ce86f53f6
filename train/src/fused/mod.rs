//! The fast implementation of a step's gradient on a CPU: network, splines and their analytic derivatives in
//! one pass, without a tensor library.
//!
//! All matrices are `[features, columns]`, row-major, so that samples lie in SIMD lanes. Terms that depend
//! only on the condition (encoder, first layers, in autoregressive mode the whole elevation network) have one
//! column per condition. Groups of conditions pass through networks and splines forward and backward; only
//! matrix products use a library. The result equals that of [`crate::in_graph`] to rounding.
//!
//! | file | concept |
//! | --- | --- |
//! | `layout.rs` | where the layers of a head and of a flow are in their lists of weights |
//! | `conditions.rs` | computations per condition |
//! | `samples.rs`, `splines.rs` | computations per sample |
//! | `perceptron.rs`, `matrix.rs` | layers and matrix products, forward and backward |
//! | `flow.rs` | the likelihood of a flow tail |

mod conditions;
mod flow;
mod layout;
mod matrix;
mod perceptron;
mod samples;
mod splines;

use headtail_model::Head;
use headtail_render::simd::{self, Simd, Vectorized};
use rayon::prelude::*;

use crate::{GradientSource, Objective, Result, StepGradient, integrand::Batch};

use conditions::Conditions;
pub use flow::FusedFlow;
pub(crate) use layout::{FlowLayout, Layout};
pub(crate) use matrix::Matrix;
pub(crate) use perceptron::{BackwardScratch, Hidden, Layer};
use samples::{ConditionGroup, Samples, Scratch, Weights};

/// Returns the number of parts of a batch whose gradients are summed in order. It depends only on the batch,
/// so the sum does not depend on the number of threads. Large batches have enough parts for many cores.
fn parts(groups: usize) -> usize {
    (groups / 16).max(8)
}

/// Approximate number of samples in a group of conditions: a group has at least one whole condition.
const GROUP: usize = 128;

/// Computes gradients of heads of one shape.
pub struct FusedGradient {
    layout: Layout,
    parts: Vec<Part>,
}

/// Buffers of one part of a batch, reused between steps.
#[derive(Default)]
struct Part {
    loss: f32,
    gradient: Vec<f32>,
    conditions: Conditions,
    samples: Samples,
    scratch: Scratch,
}

impl FusedGradient {
    /// Creates buffers for heads of the shape of `head`.
    pub fn new(head: &Head) -> Self {
        let layout = Layout::new(*head.config());
        assert_eq!(layout.length, head.weight_count(), "the layout is that of the head's flat weights");
        Self { layout, parts: Vec::new() }
    }
}

impl GradientSource for FusedGradient {
    fn gradient(&mut self, weights: &[f32], objective: Objective, batch: &Batch) -> Result<Option<StepGradient>> {
        assert_eq!(weights.len(), self.layout.length, "one number for each weight");
        let lit = batch.lit_count();
        if lit == 0 {
            return Ok(None);
        }
        let count = batch.condition_count();
        let layout = &self.layout;
        let parts = parts(count);
        self.parts.resize_with(parts, Part::default);
        self.parts.par_iter_mut().enumerate().for_each(|(index, part)| {
            let range = index * count / parts..(index + 1) * count / parts;
            simd::dispatch(BatchPart { part, layout, weights, objective, batch, range, scale: 1.0 / lit as f32 });
        });
        let parts = self.parts.iter().map(|part| (part.loss, &part.gradient[..]));
        Ok(Some(StepGradient::sum(layout.length, parts)))
    }
}

/// One part of a batch.
struct BatchPart<'a> {
    part: &'a mut Part,
    layout: &'a Layout,
    weights: &'a [f32],
    objective: Objective,
    batch: &'a Batch,
    range: std::ops::Range<usize>,
    /// Factor of the sum of losses.
    scale: f32,
}

impl Vectorized for BatchPart<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        let Self { part, layout, weights, objective, batch, range, scale } = self;
        part.loss = 0.0;
        part.gradient.clear();
        part.gradient.resize(layout.length, 0.0);
        if range.is_empty() {
            return;
        }
        part.conditions.forward(layout, weights, batch, range.clone());
        let group_size = (GROUP / batch.samples).max(1);
        let networks = Weights { layout, values: weights };
        let mut first = range.start;
        while first < range.end {
            let last = (first + group_size).min(range.end);
            let group = ConditionGroup { first, count: last - first, column: first - range.start };
            part.samples.forward(networks, batch, &part.conditions, group);
            part.loss += part.samples.evaluate_loss(objective, batch, &mut part.conditions, group, scale);
            part.samples.backward(networks, &mut part.conditions, &mut part.scratch, &mut part.gradient);
            first = last;
        }
        part.conditions.backward(layout, weights, &mut part.gradient);
    }
}

#[cfg(test)]
mod tests {
    use headtail_model::{Condition, EncoderConfig, HeadConfig, Mode};
    use headtail_render::random::Purpose;

    use super::*;
    use crate::{
        Backend, CosineTarget, Loss,
        in_graph::in_graph,
        integrand::BatchShape,
        test_support::{assert_same, random_head, studio},
    };

    /// Returns a batch of random conditions; the first has no light, and the others have mixtures with BRDF
    /// sampling.
    fn batch(condition: Condition) -> Batch {
        let tail = studio();
        let shape = BatchShape { conditions: 21, strata: 4, brdf_samples: 9 };
        let mut batch = Batch::draw(&CosineTarget::new(&tail), shape, 0, Purpose::Test, 0).unwrap();
        batch.densities[..25].fill(0.0);
        let length = condition.length();
        batch.conditions = (0..21 * length).map(|k| ((k * 7919) % 101) as f32 / 50.0 - 1.0).collect();
        batch.condition_length = length;
        for (k, brdf) in batch.brdf.iter_mut().enumerate() {
            *brdf = (k % 5) as f32 * 0.7;
        }
        batch
    }

    #[test]
    fn the_fused_gradient_matches_the_graph() {
        let device = Backend::default().device().unwrap().autodiff();
        let encoder = Some(EncoderConfig { hidden: 8, output: 5 });
        for mode in [Mode::Coupled, Mode::Autoregressive] {
            for (loss, config) in [
                (Loss::ForwardKl, HeadConfig { mode, ..HeadConfig::COSINE }),
                (Loss::LogChiSquare, HeadConfig { mode, encoder, bins: 8, share: true, ..HeadConfig::COSINE }),
                (Loss::LogChiSquare, HeadConfig { mode, hidden: 24, hidden_layers: 1, ..HeadConfig::MICROFACET }),
                (Loss::ReverseKl, HeadConfig { mode, hidden_layers: 3, share: true, ..HeadConfig::MICROFACET }),
            ] {
                // Large logits make bins of 1e-3, which would magnify the reference's own rounding beyond the
                // bound.
                let scale = if config.bins > 8 { 0.1 } else { 1.0 };
                let head = random_head(config, &device);
                let weights: Vec<f32> = head.flat_weights().iter().map(|weight| scale * weight).collect();
                let head = head.with_flat_weights(&weights, &device);
                let batch = batch(config.condition);
                let objective = Objective { loss, entropic: 1e-2 };
                let expected = in_graph(&head, objective, &batch, &device).unwrap();
                let mut fused = FusedGradient::new(&head);
                // Twice, because buffers are reused.
                for _ in 0..2 {
                    let found = fused.gradient(&head.flat_weights(), objective, &batch).unwrap().unwrap();
                    assert_same(&expected, &found, 1e-5, &format!("{config:?} {loss:?}"));
                }
            }
        }
    }

    #[test]
    fn results_are_bit_identical_for_any_number_of_threads() {
        let head = random_head(HeadConfig::COSINE, &Backend::default().device().unwrap());
        let objective = Objective { loss: Loss::LogChiSquare, entropic: 0.0 };
        let gradient = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let batch = batch(Condition::Normal);
            pool.install(|| FusedGradient::new(&head).gradient(&head.flat_weights(), objective, &batch).unwrap())
        };
        assert_eq!(gradient(1), gradient(3));
    }

    #[test]
    fn a_batch_without_light_has_no_gradient() {
        let head = random_head(HeadConfig::COSINE, &Backend::default().device().unwrap());
        let mut batch = batch(Condition::Normal);
        batch.densities.fill(0.0);
        let objective = Objective { loss: Loss::LogChiSquare, entropic: 0.0 };
        assert_eq!(FusedGradient::new(&head).gradient(&head.flat_weights(), objective, &batch).unwrap(), None);
    }
}
