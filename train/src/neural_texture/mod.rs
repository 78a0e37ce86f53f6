//! Fitting a neural material to samples of a bidirectional texture.
//!
//! Each step draws new samples from the source, which prevents overfitting. One light path per sample is
//! enough: the loss is a squared error with its own weights (`loss.rs`), whose gradient has the same mean for
//! any noise of the samples (Lehtinen et al. 2018). Lobes for sampling are fitted in the same steps, by
//! maximum likelihood under the samples, and do not propagate to the features.
//!
//! | file | concept |
//! | --- | --- |
//! | `settings.rs` | settings of a fit |
//! | `samples.rs` | samples of a bidirectional texture |
//! | `layout.rs` | weights as one list |
//! | `loss.rs` | the losses of material and lobes |
//! | `fused.rs`, `graph.rs` | a step's gradient in SIMD lanes; the same in burn, for tests |
//! | `picture.rs` | a material beside its source |

mod fused;
#[cfg(test)]
mod graph;
mod layout;
mod loss;
mod picture;
mod samples;
mod settings;

pub use layout::{LEAKY_SLOPE, Layout};
pub use picture::{DISTANCES, QUERIES, side_by_side};
pub use samples::{Decibels, Samples, error_over};
pub use settings::Settings;

use headtail_render::{
    brdf::neural_texture::{Description, FEATURES, NeuralTexture},
    fabric::Source,
};

use crate::{Result, Run, StepGradient, TrainingState, trainer::Trainer};
use fused::FusedGradient;

/// Peak learning rate of the networks; the texels use the optimiser's.
const NETWORK_RATE: f64 = 4e-3;

/// Fits a material with this name to a source, and returns it with the last state, whose mean loss is that of
/// weighted squared errors. A resumed run ends with bit-identical weights; the state of an interrupted run
/// has fewer steps.
///
/// # Errors
/// If a setting is out of range or the weights have diverged, and errors of `run`.
pub fn fit_material(
    settings: &Settings,
    name: &str,
    source: &dyn Source,
    run: Run<'_>,
) -> Result<(NeuralTexture, TrainingState)> {
    settings.check()?;
    let (config, layout) = (settings.optimizer(), Layout::new(settings.side));
    let (texels, all) = (FEATURES * layout.texels(), layout.weight_count());
    let groups = vec![(texels, config.learning_rate), (all - texels, NETWORK_RATE)];
    let state = TrainingState { groups, ..TrainingState::new(&config, layout.initial_weights(settings.seed)) };
    let trainer = Trainer::new(&config, settings, state, settings.batch, run)?;
    let mut fused = FusedGradient::new(layout.clone());
    let state = trainer.run(&mut |weights: &[f32], step: usize| -> Result<Option<StepGradient>> {
        let (loss, d_weight) = fused.gradient(weights, &Samples::draw(source, settings, step));
        Ok(Some(StepGradient { loss, d_weight }))
    })?;
    let mut description = Description::new(name, LEAKY_SLOPE);
    description.steps = state.step as u64;
    Ok((layout.material(&state.parameters.weights, description)?.rounded()?, state))
}

#[cfg(test)]
mod tests;
