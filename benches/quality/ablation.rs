//! What each part of the model is worth: the paper's table, and the two modes.

use std::sync::Arc;

use headtail_model::{EncoderConfig, HeadConfig, Mode};
use headtail_render::{
    environment::Environment,
    head::WithoutTail,
    sampler::{BrdfSampler, EmitterSampler, EnvironmentLight, OneSampleMis, ProductSampler},
    tail::TailKind,
};
use headtail_train::{FitConfig, Loss, Material, Preset};

use crate::{
    Fallible,
    measure::{Conditions, measure, quadratures},
    samplers::{Qualities, train},
};

/// The variants, each with what it adds to the one before it (the last one changes the mode of the third).
///
/// All are trained alike: the fast preset's batches and steps, forward KL, no learned share, K = 32 bins, and a learning rate that suits
/// the larger networks (at the preset's 1.6e-2 the one with an encoder ended at three times the KL of its neighbours).
fn variants(material: Material) -> [(&'static str, FitConfig); 5] {
    let fast = Preset::fast_for(material).config().for_material(material);
    let plain = HeadConfig { bins: 32, share: false, encoder: None, mode: Mode::Coupled, ..fast.head };
    let tail = FitConfig { loss: Loss::ForwardKl, entropic: 0.0, learning_rate: 4e-3, head: plain, ..fast };
    let encoder = Some(EncoderConfig { hidden: 64, output: 64 });
    let encoded = FitConfig { head: HeadConfig { encoder, ..plain }, ..tail };
    let entropic = FitConfig { entropic: 1e-4, ..encoded };
    let autoregressive = FitConfig { head: HeadConfig { mode: Mode::Autoregressive, ..encoded.head }, ..encoded };
    [
        ("naive", FitConfig { naive: true, ..tail }),
        ("with tail", tail),
        ("+ encoder", encoded),
        ("+ entropic", entropic),
        ("+ encoder, autoregressive", autoregressive),
    ]
}

/// Every variant on one map, after one-sample MIS and the tail alone.
pub fn measure_map(material: Material, environment: &Arc<Environment>) -> Fallible<Qualities> {
    let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
    let conditions = Conditions::of(material);
    let points = quadratures(conditions, &light);
    let emitter = EmitterSampler::new(light.clone());
    let mut qualities = vec![
        ("mis", measure(conditions, &points, &OneSampleMis::new(emitter.clone(), BrdfSampler))),
        ("tail only", measure(conditions, &points, &emitter)),
    ];
    for (name, config) in variants(material) {
        let (head, seconds) = train(&config, &light)?;
        println!("{}, {name}: trained for {seconds:.1} s", environment.name());
        let quality = if config.naive {
            measure(conditions, &points, &WithoutTail(head))
        } else {
            measure(conditions, &points, &ProductSampler::new(light.clone(), head))
        };
        qualities.push((name, quality));
    }
    Ok(qualities)
}
