//! Conversion of a trained head to the renderer's head and to the exported file.

use std::sync::Arc;

use glam::Vec2;
use headtail_model::{EncoderConfig, Head, NamedTensor};
use headtail_render::{
    environment::Environment,
    export::{ExportedSampler, Intermediate, TrainingSummary},
    head as native,
    tail::{FlowTail, Tail, WarpMap},
};

use crate::{FitConfig, Result, Summary};

/// Returns the native head with the weights of a trained one.
///
/// # Errors
/// A weight is not finite, the head is larger than native inference allows, or it has no native form.
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
    let networks = [layers("layer0", config.hidden_layers + 1)?, layers("layer1", config.hidden_layers + 1)?];
    let encoder = layers("encoder", encoder_layers)?;
    let mixture_weight = layers("selection", if config.share { 2 } else { 0 })?;
    Ok(native::Head::new(config.condition, config.mode, config.leaky_slope, encoder, networks)?
        .with_mixture_weight(mixture_weight)?)
}

/// Returns the exported sampler of a trained head. With `with_time` the file records the training time, so
/// two runs of the same command differ in that number. A head trained without a tail is exported over the
/// identity.
///
/// # Errors
/// See [`native_head`].
pub fn exported_sampler(
    head: &Head,
    config: &FitConfig,
    summary: &Summary,
    environment: &Environment,
    tail: &Arc<Tail>,
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
        tabulated_seconds: None,
    };
    let tail = if config.naive { Arc::new(identity(tail)?) } else { tail.clone() };
    let head = Intermediate::Head(native_head(head)?);
    let exported = ExportedSampler::of_tail(head, tail, environment, Some(training));
    Ok(match config.over.detail() {
        Some(detail) => exported.over_patches(detail),
        None => exported,
    })
}

/// Returns the identity of X as a tail, with the light of another one: the smallest table.
fn identity(of: &Tail) -> Result<Tail> {
    const CELLS: usize = 4;
    let node = |k: usize| Vec2::new((k % CELLS) as f32, (k / CELLS) as f32) / CELLS as f32;
    let nodes: Vec<Vec2> = (0..CELLS * (CELLS + 1)).map(node).collect();
    Ok(Tail::Flow(FlowTail::new(WarpMap::new(CELLS, &nodes)?, of.light().clone())))
}

#[cfg(test)]
mod tests {
    use burn::prelude::{Tensor, TensorData};
    use headtail_model::{HeadConfig, Mode};
    use headtail_render::{
        random::{Purpose, Stream},
        tail::TailWarp,
    };

    use super::*;
    use crate::{
        Backend,
        test_support::{random_head, studio},
    };

    /// Corners and turns of the small table are powers of two, so that only rounding remains.
    #[test]
    fn a_head_without_tail_is_exported_over_the_identity() {
        let same = identity(&studio()).unwrap();
        let mut stream = Stream::new(7, Purpose::Test, 0);
        let y: Vec<Vec2> = (0..1000).map(|_| stream.uniform2()).collect();
        for (y, (x, density)) in y.iter().zip(same.forward_points(&y)) {
            assert!(x.abs_diff_eq(*y, 1e-6) && (density - 1.0).abs() < 1e-5, "{y} {x} {density}");
        }
    }

    #[test]
    fn the_native_head_equals_the_trained_one_in_both_directions() {
        let device = Backend::default().device().unwrap();
        let encoder = Some(EncoderConfig { hidden: 8, output: 5 });
        for mode in [Mode::Coupled, Mode::Autoregressive] {
            for config in [
                HeadConfig { mode, ..HeadConfig::COSINE },
                HeadConfig { mode, encoder, bins: 8, ..HeadConfig::COSINE },
                HeadConfig { mode, encoder, condition: headtail_model::Condition::Ggx, ..HeadConfig::COSINE },
                HeadConfig { mode, share: true, ..HeadConfig::MICROFACET },
                HeadConfig { mode, encoder, condition: headtail_model::Condition::Family, ..HeadConfig::COSINE },
            ] {
                let head = random_head(config, &device);
                let native = native_head(&head).unwrap();
                let mut stream = Stream::new(6, Purpose::Test, 0);
                for _ in 0..200 {
                    let (normal, wo, point) = (stream.direction(), stream.direction(), stream.uniform2());
                    let width = 0.1 + 0.9 * stream.uniform();
                    let condition = if native.condition() == headtail_model::Condition::Family {
                        let latent = [(); 6].map(|()| 2.0 * stream.uniform() - 1.0);
                        headtail_model::Condition::encode_family(wo.into(), normal.into(), &latent)
                    } else {
                        native.condition().encode(wo.into(), normal.into(), width)
                    };
                    let condition = &condition[..native.condition().length()];
                    let c = TensorData::new(condition.to_vec(), [1, condition.len()]);
                    let c = Tensor::<2>::from_data(c, &device);
                    let x = Tensor::<3>::from_data(TensorData::new(point.to_array().to_vec(), [1, 1, 2]), &device);
                    let at = native.at(condition).unwrap();
                    if let Some(logit) = head.mixture_weight_logits(c.clone()) {
                        let expected = headtail_model::head::mixture_weight_of_logit(logit.into_scalar::<f32>());
                        assert!((at.mixture_weight() - expected).abs() < 1e-6);
                    }
                    for ((there, log), (native_there, density)) in [
                        (head.inverse(&x, c.clone()), at.invert(&[point])[0]),
                        (head.sample(&x, c), at.sample(&[point])[0]),
                    ] {
                        let there = there.try_into_vec_as::<f32>().unwrap();
                        let apart = (Vec2::new(there[0], there[1]) - native_there).abs();
                        let log = log.into_scalar::<f32>();
                        // Sums in a different order, 1e-7 each over 64 terms, magnified by slopes of up to
                        // 10.
                        assert!(apart.x.min(1.0 - apart.x) < 1e-5 && apart.y < 1e-5, "{there:?} {native_there}");
                        assert!((log - density.ln()).abs() < 1e-4, "{log} {}", density.ln());
                    }
                }
            }
        }
    }
}
