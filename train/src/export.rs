//! From a trained head to the renderer's, and to the exported file.

use headtail_model::{EncoderConfig, Head, Mode, NamedTensor};
use headtail_render::{
    environment::Environment,
    export::{ExportedSampler, Intermediate, TrainingSummary},
    head::{self as native, Condition},
    tail::TailKind,
};

use crate::{FitConfig, Result, Summary};

/// The native head with the weights of a trained one.
///
/// # Errors
/// A weight is not finite, or the head is larger than native inference allows.
pub fn native_head(head: &Head) -> Result<native::Head> {
    let config = head.config();
    let weights = head.weights();
    let layer = |name: String| -> Result<native::Linear> {
        let find = |kind: &str| -> &NamedTensor {
            let name = format!("{name}.{kind}");
            weights.iter().find(|weight| weight.name == name).expect("every layer of a head has a weight and a bias")
        };
        let (weight, bias) = (find("weight"), find("bias"));
        Ok(native::Linear::new(&name, weight.shape[1], weight.shape[0], &weight.values, bias.values.clone())?)
    };
    let layers = |part: &str, count: usize| -> Result<Vec<native::Linear>> {
        (0..count).map(|index| layer(format!("{part}.linear{index}"))).collect()
    };
    let encoder_layers = config.encoder.map_or(0, |EncoderConfig { .. }| 2);
    let mode = match config.mode {
        Mode::Coupled => native::Mode::Coupled,
        Mode::Autoregressive => native::Mode::Autoregressive,
    };
    let networks = [layers("layer0", config.hidden_layers + 1)?, layers("layer1", config.hidden_layers + 1)?];
    let encoder = layers("encoder", encoder_layers)?;
    Ok(native::Head::new(Condition::Normal, mode, config.leaky_slope, encoder, networks)?)
}

/// The exported sampler of a trained head. With `with_time` the file says how long the training took, and two runs of the
/// same command then differ in that number.
///
/// # Errors
/// See [`native_head`].
pub fn exported_sampler(
    head: &Head,
    config: &FitConfig,
    summary: &Summary,
    kind: TailKind,
    environment: &Environment,
    with_time: bool,
) -> Result<ExportedSampler> {
    let training = TrainingSummary {
        steps: summary.steps as u64,
        seed: config.seed,
        loss: config.loss.to_string(),
        backend: config.backend.to_string(),
        final_kl: summary.divergence.kl,
        relative_variance: summary.divergence.relative_variance,
        seconds: with_time.then_some(summary.seconds),
    };
    Ok(ExportedSampler::new(Intermediate::Head(native_head(head)?), kind, environment, Some(training))?)
}
