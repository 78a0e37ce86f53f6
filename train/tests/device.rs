//! Gradients on a graphics device match the fused ones: `cargo test --release -p headtail-train --features gpu`.
//!
//! Without a graphics adapter, not even a software one, the tests say so and count as ignored.

use std::sync::atomic::AtomicBool;

use headtail_model::{Condition, EncoderConfig, Head, HeadConfig, Mode};
use headtail_render::{
    environment::Environment,
    random::Purpose,
    tail::{Tail, TailKind},
};
use headtail_train::{
    Backend, Batch, CosineTarget, FitConfig, GradientForm, GradientSource, Loss, Objective, Preset, Progress,
    StepGradient, Viewpoints, build_target, condition_of, device::DeviceGradient, fit, fused::FusedGradient,
    integrand::BatchShape,
};
use libtest_mimic::{Arguments, Failed, Trial};

type Outcome = Result<(), Failed>;

/// Returns a batch of random conditions; the first has no light, and the others have mixtures with BRDF
/// sampling.
fn batch(condition: Condition, conditions: usize) -> Batch {
    let map = Environment::open("studio").unwrap();
    let tail = Tail::of_environment(TailKind::Hierarchical, &map).unwrap();
    let shape = BatchShape { conditions, strata: 4, brdf_samples: 9 };
    let mut batch = Batch::draw(&CosineTarget::new(&tail), shape, 0, Purpose::Test, 0).unwrap();
    batch.densities[..25].fill(0.0);
    let length = condition.length();
    batch.conditions = (0..conditions * length).map(|k| ((k * 7919) % 101) as f32 / 50.0 - 1.0).collect();
    batch.condition_length = length;
    for (k, brdf) in batch.brdf.iter_mut().enumerate() {
        *brdf = (k % 5) as f32 * 0.7;
    }
    batch
}

/// Returns a head, and weights other than the initial ones, whose last layers are zero.
fn head(config: HeadConfig, scale: f32) -> (Head, Vec<f32>) {
    let head = Head::new(config, 3, &Backend::default().device().unwrap()).unwrap();
    let moved = |(k, weight): (usize, f32)| weight + scale * ((k * 7919 % 101) as f32 / 50.0 - 1.0);
    let weights = head.flat_weights().into_iter().enumerate().map(moved).collect();
    (head, weights)
}

/// Fails unless losses and all entries of the gradient are equal to 1e-4, relative to the largest entry.
fn same(expected: &StepGradient, found: &StepGradient) -> Outcome {
    let largest = expected.d_weight.iter().fold(0.0_f32, |largest, d| largest.max(d.abs()));
    for (place, (a, b)) in expected.d_weight.iter().zip(&found.d_weight).enumerate() {
        let is_same = (a - b).abs() <= 1e-4 * largest;
        if !is_same {
            return Err(format!("weight {place}: {a} and {b}, the largest is {largest}").into());
        }
    }
    let is_same = (expected.loss - found.loss).abs() <= 1e-4 * expected.loss.abs().max(1.0);
    if !is_same {
        return Err(format!("losses {} and {}", expected.loss, found.loss).into());
    }
    Ok(())
}

/// Compares two steps of a head with the fused form; the second uses the buffers of the first.
fn agrees(config: HeadConfig, objective: Objective, conditions: usize) -> Outcome {
    // Large logits make narrow bins, which magnify rounding.
    let (head, mut weights) = head(config, if config.bins > 8 { 0.05 } else { 0.2 });
    let batch = batch(config.condition, conditions);
    // Several pieces, the last one smaller.
    let mut device = DeviceGradient::new(&head)?.in_pieces_of(8 * batch.samples);
    let mut fused = FusedGradient::new(&head);
    for _ in 0..2 {
        let expected = fused.gradient(&weights, objective, &batch)?.ok_or("there is light")?;
        let found = device.gradient(&weights, objective, &batch)?.ok_or("there is light")?;
        same(&expected, &found)?;
        weights.iter_mut().for_each(|weight| *weight *= 0.9);
    }
    Ok(())
}

fn same_bytes_in_every_run() -> Outcome {
    let (head, weights) = head(HeadConfig::COSINE, 0.1);
    let batch = batch(Condition::Normal, 40);
    let step = || DeviceGradient::new(&head)?.gradient(&weights, Loss::LogChiSquare.into(), &batch);
    if step()? != step()? {
        return Err("two runs differ".into());
    }
    Ok(())
}

/// Batches that the device draws are those of the host, except for points that rounding moves across a border of
/// a texel or of a quadrant: there densities differ by as much as neighbouring texels.
fn same_targets_as_the_host() -> Outcome {
    for (name, kind) in
        [("studio", TailKind::Hierarchical), ("sunset", TailKind::Hierarchical), ("window", TailKind::RowColumn)]
    {
        let tail = Tail::of_environment(kind, &Environment::open(name)?)?;
        for material in ["lambert", "ggx:alpha=0.3", "ggx:alpha=0.1..0.9"] {
            let mut config = Preset::FastGgx.config();
            config.material = material.parse()?;
            config.head.condition = condition_of(&config.material);
            (config.conditions, config.strata, config.brdf_samples) = (64, 12, 100);
            let target = build_target(&config, &tail, Viewpoints::Sphere)?;
            let expected = Batch::draw(&*target, config.batch_shape(), config.seed, Purpose::Batch, 5)?;
            let head = Head::new(config.head, 0, &Backend::default().device()?)?;
            let found =
                DeviceGradient::new(&head)?.batch(&config, &*target, 5)?.ok_or("the target is in closed form")?;
            let lists = |batch: &Batch| {
                let Batch { points, densities, weights, brdf, tails, .. } = batch;
                [points, densities, weights, brdf, tails].map(Vec::clone)
            };
            for (list, (a, b)) in lists(&expected).iter().zip(&lists(&found)).enumerate() {
                let apart = |(a, b): &(&f32, &f32)| (*a - *b).abs() > 1e-4 * a.abs().max(1e-2);
                let far = a.iter().zip(b).filter(apart).count();
                if far * 1000 > a.len() || a.len() != b.len() {
                    return Err(format!("{name}, {material}, list {list}: {far} of {}", a.len()).into());
                }
            }
        }
    }
    Ok(())
}

/// Ten steps of training have the losses of the fused form.
fn same_losses_as_the_fused_form() -> Outcome {
    let map = Environment::open("studio")?;
    let tail = Tail::of_environment(TailKind::Hierarchical, &map)?;
    let losses = |gradient| -> Result<Vec<f32>, Failed> {
        let mut losses = Vec::new();
        let config = FitConfig { gradient, steps: 10, conditions: 8, strata: 4, ..FitConfig::default() };
        let mut progress = |now: &Progress| losses.push(now.loss);
        fit(&config, &CosineTarget::new(&tail), &mut progress, &AtomicBool::new(false))?;
        Ok(losses)
    };
    let (expected, found) = (losses(GradientForm::Fused)?, losses(GradientForm::Device)?);
    // The first is that of no step.
    let apart = |(a, b): (&f32, &f32)| (a - b).abs();
    let largest = expected[1..].iter().zip(&found[1..]).map(apart).fold(0.0, f32::max);
    if !(largest < 1e-3 && expected.len() == 11) {
        return Err(format!("{expected:?} and {found:?}").into());
    }
    Ok(())
}

/// 8 million points of one condition need 8 GB in one buffer, which no adapter gives.
fn too_many_points_of_a_condition_are_refused() -> Outcome {
    let (head, weights) = head(HeadConfig::COSINE, 0.1);
    let samples = 1 << 23;
    let list = || vec![1.0; samples];
    let batch = Batch {
        condition_length: 3,
        samples,
        conditions: vec![0.0, 1.0, 0.0],
        points: vec![0.5; 2 * samples],
        densities: list(),
        weights: list(),
        brdf: list(),
        tails: list(),
        mixture_weight_logits: vec![0.0],
    };
    match DeviceGradient::new(&head)?.gradient(&weights, Loss::LogChiSquare.into(), &batch) {
        Err(error) if error.to_string().contains("strata") => Ok(()),
        other => Err(format!("{:?}", other.map(|found| found.map(|found| found.loss))).into()),
    }
}

fn no_gradient_without_light() -> Outcome {
    let (head, weights) = head(HeadConfig::COSINE, 0.1);
    let mut batch = batch(Condition::Normal, 3);
    batch.densities.fill(0.0);
    match DeviceGradient::new(&head)?.gradient(&weights, Loss::LogChiSquare.into(), &batch)? {
        None => Ok(()),
        Some(_) => Err("there is no light".into()),
    }
}

fn main() {
    let arguments = Arguments { test_threads: Some(2), ..Arguments::from_args() };
    let adapter = Head::new(HeadConfig::COSINE, 0, &Backend::default().device().unwrap())
        .map_err(headtail_train::Error::from)
        .and_then(|head| DeviceGradient::new(&head));
    match &adapter {
        Ok(device) => println!("adapter: {}", device.device()),
        Err(reason) => eprintln!("skipped: {reason}"),
    }
    let encoder = Some(EncoderConfig { hidden: 8, output: 5 });
    let mut trials = vec![
        Trial::test("same_bytes_in_every_run", same_bytes_in_every_run),
        Trial::test("no_gradient_without_light", no_gradient_without_light),
        Trial::test("too_many_points_of_a_condition_are_refused", too_many_points_of_a_condition_are_refused),
        Trial::test("same_targets_as_the_host", same_targets_as_the_host),
        Trial::test("same_losses_as_the_fused_form", same_losses_as_the_fused_form),
    ];
    for mode in [Mode::Coupled, Mode::Autoregressive] {
        for (name, loss, entropic, config) in [
            ("cosine", Loss::ForwardKl, 0.0, HeadConfig { mode, ..HeadConfig::COSINE }),
            (
                "encoder_and_mixture",
                Loss::LogChiSquare,
                1e-2,
                HeadConfig { mode, encoder, bins: 8, share: true, ..HeadConfig::COSINE },
            ),
            (
                "one_layer",
                Loss::ChiSquare,
                0.0,
                HeadConfig { mode, hidden: 24, hidden_layers: 1, ..HeadConfig::MICROFACET },
            ),
            (
                "three_layers",
                Loss::ReverseKl,
                1e-2,
                HeadConfig { mode, hidden_layers: 3, share: true, ..HeadConfig::MICROFACET },
            ),
            ("wide", Loss::LogChiSquare, 0.0, HeadConfig { mode, hidden: 200, bins: 50, ..HeadConfig::MICROFACET }),
        ] {
            let name = format!("matches_the_fused_gradient::{name}::{}", format!("{mode:?}").to_lowercase());
            trials.push(Trial::test(name, move || agrees(config, Objective { loss, entropic }, 21)));
        }
    }
    let trials = trials.into_iter().map(|trial| trial.with_ignored_flag(adapter.is_err())).collect();
    libtest_mimic::run(&arguments, trials).exit();
}
