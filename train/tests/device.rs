//! Gradients on a graphics device match the fused ones: `cargo test --release -p headtail-train --features gpu`.
//!
//! Without a graphics adapter, not even a software one, the tests say so and count as ignored.

#[path = "../../render/tests/networks/mod.rs"]
mod networks;

use std::{
    path::Path,
    sync::atomic::{AtomicBool, Ordering},
};

use headtail_model::{Condition, EncoderConfig, Flow, FlowConfig, FlowForm, Head, HeadConfig, Mode};
use headtail_render::{
    brdf::neural::write_networks,
    environment::Environment,
    random::Purpose,
    scene::{MaterialSpec, Scene},
    tail::{Tail, TailKind},
};
use headtail_train::{
    Backend, Batch, Checkpoints, CosineTarget, FitConfig, FlowSettings, GradientForm, GradientSource, Loss, Objective,
    Preset, Progress, Run, StateFile, StepGradient, TrainingState, Viewpoints, build_target, condition_of,
    config::{Over, Points},
    device::{DeviceFlow, DeviceGradient, Gpu},
    fit_flow, fit_with,
    fused::{FusedFlow, FusedGradient},
    integrand::BatchShape,
    state,
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
    let mut device = DeviceGradient::new(Gpu::open()?, &head)?.in_pieces_of(8 * batch.samples);
    let mut fused = FusedGradient::new(&head);
    for _ in 0..2 {
        let expected = fused.gradient(&weights, objective, &batch)?.ok_or("there is light")?;
        let found = device.gradient(&weights, objective, &batch)?.ok_or("there is light")?;
        same(&expected, &found)?;
        weights.iter_mut().for_each(|weight| *weight *= 0.9);
    }
    Ok(())
}

/// Compares two steps of a flow with the fused form, in several pieces, the last one smaller.
fn flows_agree(shape: FlowConfig) -> Outcome {
    let flow = Flow::new(shape, 2, &Backend::default().device()?)?;
    let moved = |(k, weight): (usize, f32)| weight + 0.1 * ((k * 7919 % 101) as f32 / 50.0 - 1.0);
    let mut weights: Vec<f32> = flow.flat_weights().into_iter().enumerate().map(moved).collect();
    let points: Vec<f32> = (1..=2 * 301).map(|k| (k as f32 * 0.618_034).fract()).collect();
    let mut device = DeviceFlow::new(Gpu::open()?, &flow)?.in_pieces_of(128);
    let mut fused = FusedFlow::new(&flow);
    for _ in 0..2 {
        same(&fused.gradient(&weights, &points), &device.gradient(&weights, &points)?)?;
        weights.iter_mut().for_each(|weight| *weight *= 0.9);
    }
    Ok(())
}

/// The losses of ten steps of a flow are those of the fused form.
fn same_losses_of_a_flow() -> Outcome {
    let exact = Tail::of_environment(TailKind::Hierarchical, &Environment::open("window")?)?;
    let losses = |gradient| {
        let shape = FlowConfig { form: FlowForm::Coupled, bins: 8, couplings: 3, hidden: 16, ..FlowConfig::SMALL };
        // A target that is not met, so that steps are grouped by measurements.
        let flow = FlowSettings { steps: 10, strata: 12, cells: 4, kl_target: 1e-9, shape, ..FlowSettings::default() };
        let config = FitConfig { flow, ..short_run(gradient) };
        let (mut losses, interrupt) = (vec![0.0], AtomicBool::new(false));
        let mut progress = |now: &Progress| {
            losses.push(now.loss);
            Ok(())
        };
        let run = Run { progress: &mut progress, interrupt: &interrupt, checkpoints: None, warn: &mut |_| {} };
        fit_flow(&config, &exact, run)?;
        Ok::<_, Failed>(losses)
    };
    same_losses(&losses(GradientForm::Fused)?, &losses(GradientForm::Device)?)
}

fn same_bytes_in_every_run() -> Outcome {
    let (head, weights) = head(HeadConfig::COSINE, 0.1);
    let batch = batch(Condition::Normal, 40);
    let step = || DeviceGradient::new(Gpu::open()?, &head)?.gradient(&weights, Loss::LogChiSquare.into(), &batch);
    if step()? != step()? {
        return Err("two runs differ".into());
    }
    Ok(())
}

const MATERIALS: [&str; 3] = ["lambert", "ggx:alpha=0.3", "ggx:alpha=0.1..0.9"];

/// Draws the batch of a step on the host and on the device, and fails if more than a fraction of the numbers of a list
/// are `apart`, relative to the larger of the host's and 0.01.
fn same_batches(
    (name, kind): (&str, TailKind),
    material: &str,
    change: impl Fn(&mut FitConfig),
    (apart, fraction): (f32, f32),
) -> Outcome {
    let tail = Tail::of_environment(kind, &Environment::open(name)?)?;
    let mut config = Preset::FastGgx.config();
    config.material = material.parse()?;
    config.head.condition = condition_of(&config.material);
    (config.conditions, config.strata, config.brdf_samples) = (64, 12, 100);
    change(&mut config);
    let viewpoints = viewpoints_of(&config.material)?;
    same_batch(&config, &tail, viewpoints, (apart, fraction))
        .map_err(|reason| format!("{name}, {material}, {reason:?}").into())
}

/// Neural materials are seen on a cloth, beside diffuse surfaces.
fn viewpoints_of(material: &MaterialSpec) -> Result<Viewpoints, Failed> {
    let MaterialSpec::Neural(_) = material else { return Ok(Viewpoints::Sphere) };
    let cloth = Scene::open("cloth")?;
    let (bounds, camera) = (cloth.bounds(), cloth.camera());
    Ok(Viewpoints::of_scene(&material.dress(cloth, &bounds)?, &camera, 64, 48, 1)?)
}

/// As [`same_batches`], for one tail.
fn same_batch(config: &FitConfig, tail: &Tail, viewpoints: Viewpoints, (apart, fraction): (f32, f32)) -> Outcome {
    let target = build_target(config, tail, viewpoints)?;
    let expected = Batch::draw(&*target, config.batch_shape(), config.seed, Purpose::Batch, 5)?;
    let head = Head::new(config.head, 0, &Backend::default().device()?)?;
    let found =
        DeviceGradient::new(Gpu::open()?, &head)?.batch(config, &*target, 5)?.ok_or("devices draw the target")?;
    let lists = |batch: &Batch| {
        let Batch { points, densities, weights, brdf, tails, .. } = batch;
        [points, densities, weights, brdf, tails].map(Vec::clone)
    };
    for (list, (a, b)) in lists(&expected).iter().zip(&lists(&found)).enumerate() {
        let is_near = |(a, b): &(&f32, &f32)| (*a - *b).abs() <= apart * a.abs().max(1e-2);
        let far = a.len() - a.iter().zip(b).filter(is_near).count();
        if far as f32 > fraction * a.len() as f32 || a.len() != b.len() {
            return Err(format!("list {list}: {far} of {}", a.len()).into());
        }
    }
    Ok(())
}

const MAPS: [(&str, TailKind); 3] =
    [("studio", TailKind::Hierarchical), ("sunset", TailKind::Hierarchical), ("window", TailKind::RowColumn)];

/// Batches that the device draws are those of the host, except for points that rounding moves across a border of
/// a texel or of a quadrant: there densities differ by as much as neighbouring texels.
fn same_targets_as_the_host() -> Outcome {
    for map in MAPS {
        for material in MATERIALS {
            for naive in [false, true] {
                same_batches(map, material, |config| config.naive = naive, (1e-4, 1e-3))?;
            }
        }
    }
    Ok(())
}

/// As [`same_targets_as_the_host`], with the borders of three levels of patches. Rounding of a point is stretched as
/// much as a patch is, where patches hardly draw.
fn same_targets_over_patches_as_the_host() -> Outcome {
    for (map, over) in [(MAPS[0], Over::FinePatches), (MAPS[1], Over::Patches)] {
        for material in MATERIALS {
            same_batches(map, material, |config| config.over = over, (1e-3, 2e-3))?;
        }
    }
    Ok(())
}

/// As [`same_targets_as_the_host`], where networks reflect, over patches and from tables, too.
fn same_targets_of_networks_as_the_host() -> Outcome {
    let folder = tempfile::tempdir()?;
    let measured = folder.path().join("measured.safetensors");
    let forms = [("mirror", networks::MIRROR), ("odd", networks::ODD)];
    write_networks(&measured, &forms.map(|(name, form)| (name.to_owned(), form.network())))?;
    let of = |names: &str| format!("nbrdf:{}#{names}", measured.display());
    for material in [of("mirror,odd"), of("odd"), "neural:../checkpoints/satin.safetensors".into()] {
        same_batches(MAPS[0], &material, |_| {}, (1e-3, 2e-3))?;
        same_batches(MAPS[1], &material, |config| config.over = Over::FinePatches, (1e-3, 4e-3))?;
        let tabulated = |config: &mut FitConfig| (config.points, config.conditions) = (Points::Tabulated, 20);
        same_batches(MAPS[2], &material, tabulated, (2e-3, 1e-2))?;
    }
    Ok(())
}

/// Running sums are rounded to 6e-8 of a row: of cells with a tenth of the mean probability of their row, by 1.2e-3 of
/// their own, on the host as on the device. The conditions are more than a device without memory of its own tabulates
/// together.
fn same_tabulated_targets_as_the_host() -> Outcome {
    for (map, material, naive) in
        [(MAPS[0], MATERIALS[0], false), (MAPS[0], MATERIALS[2], true), (MAPS[2], MATERIALS[1], false)]
    {
        let change = |config: &mut FitConfig| {
            (config.points, config.naive, config.conditions) = (Points::Tabulated, naive, 20);
        };
        same_batches(map, material, change, (2e-3, 1e-2))?;
    }
    Ok(())
}

/// Over a tail that is not exact: from tables, which are the target, and by strata and BRDF samples, where the light counts, too.
/// Cells of a flow overlap here and there, and the host takes the density at the first one that a point of X is in.
fn same_targets_over_a_flow_as_the_host() -> Outcome {
    let exact = Tail::of_environment(TailKind::Hierarchical, &Environment::open("studio")?)?;
    let mut config = FitConfig { points: Points::Tabulated, tail: TailKind::Flow, ..short_run(GradientForm::Fused) };
    (config.flow.steps, config.flow.cells) = (20, 64);
    let interrupt = AtomicBool::new(false);
    let run = Run { progress: &mut |_: &Progress| Ok(()), interrupt: &interrupt, checkpoints: None, warn: &mut |_| {} };
    let tail = fit_flow(&config, &exact, run)?.tail;
    same_batch(&config, &tail, Viewpoints::Sphere, (2e-3, 1e-2))?;
    for naive in [false, true] {
        let strata = FitConfig { points: Points::Strata, naive, strata: 12, brdf_samples: 100, ..config.clone() };
        same_batch(&strata, &tail, Viewpoints::Sphere, (1e-3, 5e-3))?;
    }
    Ok(())
}

/// A run of ten steps, with a norm that clips most gradients.
fn short_run(gradient: GradientForm) -> FitConfig {
    FitConfig { gradient, steps: 10, conditions: 8, strata: 4, clip_norm: 0.5, ..FitConfig::default() }
}

/// Fails unless the losses of two runs of [`short_run`] agree.
fn same_losses(expected: &[f32], found: &[f32]) -> Outcome {
    // The first is that of no step.
    let apart = |(a, b): (&f32, &f32)| (a - b).abs();
    let largest = expected[1..].iter().zip(&found[1..]).map(apart).fold(0.0, f32::max);
    if !(largest < 1e-3 && expected.len() == 11 && found.len() == 11) {
        return Err(format!("{expected:?} and {found:?}").into());
    }
    Ok(())
}

/// Trains on light of a map, with checkpoints if a file is given, and returns the head's weights and all losses.
fn train(config: &FitConfig, file: Option<(&Path, usize)>, stop_after: usize) -> Result<(Vec<f32>, Vec<f32>), Failed> {
    let tail = Tail::of_environment(TailKind::Hierarchical, &Environment::open("studio")?)?;
    let (mut losses, interrupt) = (Vec::new(), AtomicBool::new(false));
    let file = file.map(|(path, every)| StateFile { path, every, target: "studio".into(), done: &[] });
    let run = Run {
        progress: &mut |now| {
            losses.push(now.loss);
            interrupt.store(now.step >= stop_after, Ordering::Relaxed);
            Ok(())
        },
        interrupt: &interrupt,
        checkpoints: file.as_ref().map(|file| file as &dyn Checkpoints),
        warn: &mut |_| {},
    };
    let fitted = fit_with(config, &CosineTarget::new(&tail), run)?;
    Ok((fitted.head.flat_weights(), losses))
}

/// Ten steps of training have the losses of the fused form.
fn same_losses_as_the_fused_form() -> Outcome {
    let losses = |form| train(&short_run(form), None, 10).map(|(_, losses)| losses);
    same_losses(&losses(GradientForm::Fused)?, &losses(GradientForm::Device)?)
}

/// Steps are taken together up to a validation, which must not change them.
fn same_bytes_however_steps_are_grouped() -> Outcome {
    let config = short_run(GradientForm::Device);
    let losses = |validate_every| {
        let (_, losses) = train(&FitConfig { validate_every, ..config.clone() }, None, 10)?;
        Ok::<_, Failed>(losses.into_iter().map(f32::to_bits).collect::<Vec<_>>())
    };
    let expected = losses(0)?;
    for validate_every in [1, 3] {
        if losses(validate_every)? != expected {
            return Err(format!("validated every {validate_every} steps").into());
        }
    }
    Ok(())
}

/// A run that the host begins is finished by the device, and the other way round.
fn a_run_moves_between_host_and_device() -> Outcome {
    let (_, expected) = train(&short_run(GradientForm::Fused), None, 10)?;
    let folder = tempfile::tempdir()?;
    for [first, second] in [[GradientForm::Fused, GradientForm::Device], [GradientForm::Device, GradientForm::Fused]] {
        let path = folder.path().join(first.to_string());
        let (_, mut losses) = train(&short_run(first), Some((&path, 4)), 4)?;
        // The interrupted run's last loss is reported twice.
        losses.truncate(5);
        losses.extend(train(&short_run(second), Some((&path, 4)), 10)?.1.split_off(1));
        same_losses(&expected, &losses)?;
    }
    Ok(())
}

/// Weights that are not finite are left as they are, and the run ends.
fn steps_that_are_not_finite_are_skipped() -> Outcome {
    let tail = Tail::of_environment(TailKind::Hierarchical, &Environment::open("studio")?)?;
    let config = short_run(GradientForm::Device);
    let (head, mut weights) = head(config.head, 0.1);
    weights.fill(f32::NAN);
    let mut state = TrainingState::new(&config, weights.clone());
    let outcomes =
        DeviceGradient::new(Gpu::open()?, &head)?.take_steps(&config, &CosineTarget::new(&tail), &mut state, 3)?;
    let moments = &state.parameters.optimizer;
    let is_same = |(a, b): (&f32, &f32)| a.to_bits() == b.to_bits();
    let are_same = state.parameters.weights.iter().zip(&weights).all(is_same);
    let skipped = outcomes.iter().filter(|outcome| matches!(outcome, state::Outcome::Skipped(_))).count();
    if !(are_same
        && !outcomes.is_empty()
        && skipped == outcomes.len()
        && moments.moves == 0
        && moments.first_moments.iter().all(|&m| m == 0.0))
    {
        return Err(format!("{outcomes:?}, {} moves, weights kept: {are_same}", moments.moves).into());
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
    match DeviceGradient::new(Gpu::open()?, &head)?.gradient(&weights, Loss::LogChiSquare.into(), &batch) {
        Err(error) if error.to_string().contains("strata") => Ok(()),
        other => Err(format!("{:?}", other.map(|found| found.map(|found| found.loss))).into()),
    }
}

fn no_gradient_without_light() -> Outcome {
    let (head, weights) = head(HeadConfig::COSINE, 0.1);
    let mut batch = batch(Condition::Normal, 3);
    batch.densities.fill(0.0);
    match DeviceGradient::new(Gpu::open()?, &head)?.gradient(&weights, Loss::LogChiSquare.into(), &batch)? {
        None => Ok(()),
        Some(_) => Err("there is no light".into()),
    }
}

fn main() {
    let arguments = Arguments { test_threads: Some(2), ..Arguments::from_args() };
    let adapter = Head::new(HeadConfig::COSINE, 0, &Backend::default().device().unwrap())
        .map_err(headtail_train::Error::from)
        .and_then(|head| DeviceGradient::new(Gpu::open()?, &head));
    match &adapter {
        Ok(device) => println!("adapter: {}", device.device()),
        Err(reason) => eprintln!("skipped: {reason}"),
    }
    let encoder = Some(EncoderConfig { hidden: 8, output: 5 });
    let mut trials = vec![
        Trial::test("same_bytes_in_every_run", same_bytes_in_every_run),
        Trial::test("same_losses_of_a_flow", same_losses_of_a_flow),
        Trial::test("no_gradient_without_light", no_gradient_without_light),
        Trial::test("too_many_points_of_a_condition_are_refused", too_many_points_of_a_condition_are_refused),
        Trial::test("same_targets_as_the_host", same_targets_as_the_host),
        Trial::test("same_targets_over_patches_as_the_host", same_targets_over_patches_as_the_host),
        Trial::test("same_targets_of_networks_as_the_host", same_targets_of_networks_as_the_host),
        Trial::test("same_tabulated_targets_as_the_host", same_tabulated_targets_as_the_host),
        Trial::test("same_targets_over_a_flow_as_the_host", same_targets_over_a_flow_as_the_host),
        Trial::test("same_losses_as_the_fused_form", same_losses_as_the_fused_form),
        Trial::test("same_bytes_however_steps_are_grouped", same_bytes_however_steps_are_grouped),
        Trial::test("a_run_moves_between_host_and_device", a_run_moves_between_host_and_device),
        Trial::test("steps_that_are_not_finite_are_skipped", steps_that_are_not_finite_are_skipped),
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
    for (name, shape) in [
        ("coupled", FlowConfig { form: FlowForm::Coupled, bins: 8, couplings: 4, hidden: 20, ..FlowConfig::SMALL }),
        ("triangular", FlowConfig { bins: 16, octaves: 3, ..FlowConfig::SMALL }),
        ("no_residual_block", FlowConfig { residual_blocks: 0, octaves: 1, bins: 8, ..FlowConfig::SMALL }),
        ("paper", FlowConfig { bins: 32, couplings: 3, hidden: 40, ..FlowConfig::PAPER }),
    ] {
        trials.push(Trial::test(format!("flow_matches_the_fused_gradient::{name}"), move || flows_agree(shape)));
    }
    let trials = trials.into_iter().map(|trial| trial.with_ignored_flag(adapter.is_err())).collect();
    libtest_mimic::run(&arguments, trials).exit();
}
