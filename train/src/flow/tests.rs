use headtail_model::{FlowConfig, FlowForm};
use headtail_render::{environment::built_in, tail::TailKind};

use super::*;
use crate::test_support::{assert_same, train_until};
use crate::{Backend, CheckpointFolder, GradientForm};

const SHAPE: FlowConfig = FlowConfig {
    form: FlowForm::Coupled,
    bins: 8,
    couplings: 3,
    hidden: 16,
    residual_blocks: 1,
    octaves: 3,
    leaky_slope: 0.01,
};

fn small() -> FitConfig {
    let flow = FlowSettings { steps: 60, strata: 24, cells: 64, shape: SHAPE, ..FlowSettings::default() };
    FitConfig { flow, ..FitConfig::default() }
}

fn exact(name: &str) -> Tail {
    let map = built_in(name).unwrap();
    Tail::new(TailKind::Hierarchical, map.width(), map.height(), &map.luminance()).unwrap()
}

fn quiet(
    config: &FitConfig,
    exact: &Tail,
    checkpoints: Option<&CheckpointFolder>,
    stop_at: usize,
) -> Result<FittedFlow> {
    train_until(stop_at, checkpoints, |run| fit_flow(config, exact, run))
}

#[test]
fn the_fused_gradient_matches_the_graph() {
    let exact = exact("window");
    let device = Backend::default().device().unwrap();
    for shape in [
        SHAPE,
        FlowConfig { couplings: 2, residual_blocks: 0, octaves: 1, ..SHAPE },
        FlowConfig { form: FlowForm::Triangular, ..SHAPE },
        FlowConfig { couplings: 4, residual_blocks: 2, hidden: 20, ..SHAPE },
    ] {
        let flow = Flow::new(shape, 2, &device).unwrap();
        let mut stream = Stream::new(5, Purpose::Test, 0);
        let weights: Vec<f32> = flow.flat_weights().iter().map(|w| w + 0.2 * (stream.uniform() - 0.5)).collect();
        let points = draw(&exact, &FlowSettings { strata: 17, uniform: 0.0, ..small().flow }, 1, 1);
        let gradient = |gradient| {
            let mut source = FlowGradient::new(&FitConfig { gradient, ..small() }, &flow, &device).unwrap();
            source.gradient(&weights, &points).unwrap()
        };
        let (fused, graph) = (gradient(GradientForm::Fused), gradient(GradientForm::InGraph));
        assert_same(&graph, &fused, 1e-3, &format!("{shape:?}"));
    }
}

#[test]
fn a_flow_approximates_the_light_and_its_table_the_flow() {
    let shape = FlowConfig { form: FlowForm::Triangular, couplings: 2, ..SHAPE };
    let config = FitConfig { flow: FlowSettings { steps: 300, shape, ..small().flow }, ..small() };
    let fitted = quiet(&config, &exact("window"), None, 0).unwrap();
    let FlowSummary { kl, table_kl, initial_kl, skipped, .. } = fitted.summary;
    assert!(kl < 0.3 * initial_kl && skipped == 0, "{:?}", fitted.summary);
    assert!(table_kl < kl + 0.1, "{:?}", fitted.summary);
    assert_eq!(fitted.tail.kind(), TailKind::Flow);
}

/// A tabulated flow equals the flow at the nodes, in both directions.
#[test]
fn the_table_inverts_the_density_direction() {
    let device = Backend::default().device().unwrap();
    let flow = Flow::new(SHAPE, 2, &device).unwrap();
    let mut stream = Stream::new(5, Purpose::Test, 0);
    let weights: Vec<f32> = flow.flat_weights().iter().map(|w| w + 0.1 * (stream.uniform() - 0.5)).collect();
    let flow = flow.with_flat_weights(&weights, &device);
    let (map, repair) = tabulate(&flow, 128).unwrap();
    assert_eq!(repair, Repair::default());
    let nodes = map.nodes();
    let x: Vec<f32> = nodes.iter().flat_map(|node| [node.x.rem_euclid(1.0), node.y]).collect();
    let x = burn::prelude::TensorData::new(x, [nodes.len(), 2]);
    let (y, log) = flow.inverse(&burn::prelude::Tensor::from_data(x, &device));
    let (y, log) = (y.try_into_vec_as::<f32>().unwrap(), log.try_into_vec_as::<f32>().unwrap());
    let (mut worst, mut jacobian) = (0.0_f32, 0.0_f32);
    for (k, y) in y.chunks_exact(2).enumerate() {
        let across = (y[0] - (k % 128) as f32 / 128.0).abs();
        worst = worst.max(across.min(1.0 - across)).max((y[1] - (k / 128) as f32 / 128.0).abs());
        let inside = Vec2::new((k % 128) as f32 + 0.5, (k / 128) as f32 + 0.5) / 128.0;
        if k % 97 == 0 && k / 128 > 2 && k / 128 < 125 {
            jacobian = jacobian.max((map.forward(inside).1.ln() + log[k]).abs());
        }
    }
    assert!(worst < 1e-4, "{worst}");
    // Half a cell apart.
    assert!(jacobian < 0.5, "{jacobian}");
}

/// Holds for arbitrary weights.
#[test]
fn tables_of_triangular_flows_need_no_repair() {
    let device = Backend::default().device().unwrap();
    let shape = FlowConfig { form: FlowForm::Triangular, couplings: 4, ..SHAPE };
    let flow = Flow::new(shape, 2, &device).unwrap();
    let mut stream = Stream::new(6, Purpose::Test, 0);
    let weights: Vec<f32> = flow.flat_weights().iter().map(|w| w + 0.8 * (stream.uniform() - 0.5)).collect();
    let (_, repair) = tabulate(&flow.with_flat_weights(&weights, &device), 64).unwrap();
    assert_eq!(repair, Repair::default());
}

#[test]
fn a_resumed_run_is_bit_identical_to_an_uninterrupted_one() {
    let (folder, exact) = (tempfile::tempdir().unwrap(), exact("studio"));
    let whole = quiet(&small(), &exact, None, 0).unwrap().flow.flat_weights();
    let checkpoints =
        CheckpointFolder { folder: folder.path().into(), every: 7, resume: true, target: "studio".into() };
    for stop_at in [13, 20] {
        quiet(&small(), &exact, Some(&checkpoints), stop_at).unwrap();
    }
    assert_eq!(quiet(&small(), &exact, Some(&checkpoints), 0).unwrap().flow.flat_weights(), whole);
}

#[test]
fn backends_agree_to_rounding() {
    let exact = exact("window");
    let train = |backend, gradient| {
        let flow = FlowSettings { steps: 15, ..small().flow };
        quiet(&FitConfig { flow, backend, gradient, ..small() }, &exact, None, 0).map(|fitted| fitted.summary.kl)
    };
    let reference = train(Backend::default(), GradientForm::Fused).unwrap();
    for backend in [Backend::Ndarray, Backend::Flex] {
        let other = match train(backend, GradientForm::InGraph) {
            Err(Error::BackendNotCompiled { .. }) => continue,
            other => other.unwrap(),
        };
        // Weights are not compared one by one: Adam moves a weight by a learning rate for any size of its
        // gradient, and rounding determines the smallest.
        assert!((reference - other).abs() < 2e-2, "{backend}: {reference} {other}");
    }
}

#[test]
fn a_target_ends_the_fit_early() {
    let flow = FlowSettings { steps: 400, kl_target: 1.0, ..small().flow };
    let summary = quiet(&FitConfig { flow, ..small() }, &exact("window"), None, 0).unwrap().summary;
    assert!(summary.steps < 400 && summary.kl <= 1.0, "{summary:?}");
}

#[test]
fn a_resumed_run_meets_its_target_at_the_same_step() {
    let exact = exact("window");
    let run = |kl_target, checkpoints: Option<&CheckpointFolder>, stop_at| {
        let flow = FlowSettings { steps: 400, kl_target, ..small().flow };
        let fitted = quiet(&FitConfig { flow, ..small() }, &exact, checkpoints, stop_at).unwrap();
        (fitted.summary.steps, fitted.summary.kl, fitted.flow.flat_weights())
    };
    // A target met between two measurements, also at the step before the second.
    let (steps, kl, _) = run(1.0, None, 0);
    let target = kl + 0.05;
    let whole = run(target, None, 0);
    assert_eq!(whole.0, steps);
    let folder = tempfile::tempdir().unwrap();
    let checkpoints =
        CheckpointFolder { folder: folder.path().into(), every: 0, resume: true, target: "window".into() };
    run(target, Some(&checkpoints), steps - 1);
    assert_eq!(run(target, Some(&checkpoints), 0), whole);
}
