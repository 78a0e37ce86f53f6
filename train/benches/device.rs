//! A training step on a graphics device, part by part, and points per second by how many points pass through
//! the networks together: `cargo bench -p headtail-train --features gpu --bench device -- [CONDITIONS [STEPS]]`.
//!
//! The head and the batch are those of the paper's microfacet head, the flow that of the paper's flow tail; targets of the
//! head are drawn on the device.

use std::time::Instant;

use headtail_model::{Flow, FlowConfig, Head};
use headtail_render::{
    environment::Environment,
    tail::{Tail, TailKind},
};
use headtail_train::{
    Backend, FlowSize, GradientSource, Preset, Result, TrainingState, Viewpoints, build_target,
    device::{DeviceFlow, DeviceGradient, Gpu, KernelTime},
};

fn main() -> Result<()> {
    let mut numbers = std::env::args().filter_map(|text| text.parse().ok());
    let [conditions, steps] = [256, 50].map(|default: usize| numbers.next().unwrap_or(default));
    let tail = Tail::of_environment(TailKind::Hierarchical, &Environment::open("studio")?)?;
    time_heads(&tail, conditions, steps)?;
    time_flows(conditions, steps)
}

/// Repeats `take`, which returns how many steps it took, after a first step, which compiles the shaders. Returns the
/// seconds of `steps` steps.
fn seconds_of(steps: usize, mut take: impl FnMut(usize) -> Result<usize>) -> Result<f64> {
    take(1)?;
    let (start, mut taken) = (Instant::now(), 0);
    while taken < steps {
        taken += take(steps - taken)?;
    }
    Ok(start.elapsed().as_secs_f64())
}

fn time_heads(tail: &Tail, conditions: usize, steps: usize) -> Result<()> {
    let mut config = Preset::PaperGgx.config();
    config.conditions = conditions;
    let target = build_target(&config, tail, Viewpoints::Sphere)?;
    let head = Head::new(config.head, config.seed, &Backend::default().device()?)?;
    let weights = head.flat_weights();
    let points = conditions * config.batch_shape().samples();
    println!("head: {} weights, {conditions} conditions, {points} points", weights.len());
    for together in
        [1 << 14, 1 << 15, 1 << 16, 1 << 17, 1 << 18].into_iter().filter(|&size| size == 1 << 14 || size < 2 * points)
    {
        let mut device = DeviceGradient::new(Gpu::open()?, &head)?.in_pieces_of(together);
        let mut state = TrainingState::new(&config, weights.clone());
        let take = |most| Ok(device.take_steps(&config, &*target, &mut state, most)?.len());
        let rate = (points * steps) as f64 / seconds_of(steps, take)? / 1e6;
        println!("\n{together} points together: {rate:.2} M points/s on {}", device.device());
        print(&device.profile()?);
    }
    Ok(())
}

/// Steps of as many points as the preset has, and of more.
fn time_flows(conditions: usize, steps: usize) -> Result<()> {
    for strata in [64, 256].into_iter().filter(|&strata| strata <= conditions) {
        let mut config = Preset::PaperCosine.config();
        config.flow = FlowSize::Paper.settings();
        config.flow.strata = strata;
        let config = config.flow.optimizer(&config);
        let flow = Flow::new(FlowConfig::PAPER, config.seed, &Backend::default().device()?)?;
        let points: Vec<f32> = (1..=2 * config.flow.points()).map(|k| (k as f32 * 0.618_034).fract()).collect();
        let mut device = DeviceFlow::new(Gpu::open()?, &flow)?;
        let mut state = TrainingState::new(&config, flow.flat_weights());
        let take = |most| Ok(device.take_steps(&config, &mut state, most, &|_| points.clone())?.len());
        let rate = (config.flow.points() * steps) as f64 / seconds_of(steps, take)? / 1e6;
        println!("\nflow: {} weights, {} points: {rate:.2} M points/s", flow.weight_count(), config.flow.points());
        print(&device.profile()?);
    }
    Ok(())
}

fn print(times: &[KernelTime]) {
    println!("{:<28} {:>6} {:>10} {:>10} {:>10}", "shader", "runs", "us", "TFLOP/s", "GB/s");
    for KernelTime { name, dispatches, microseconds, operations, bytes } in times {
        let [teraflops, gigabytes] = [operations / microseconds / 1e6, bytes / microseconds / 1e3];
        println!("{name:<28} {dispatches:>6} {microseconds:>10.1} {teraflops:>10.2} {gigabytes:>10.1}");
    }
    let total: f64 = times.iter().map(|time| time.microseconds).sum();
    println!("{:<28} {:>6} {total:>10.1}", "all", "");
}
