//! A training step on a graphics device, part by part, and points per second by how many points pass through
//! the networks together: `cargo bench -p headtail-train --features gpu --bench device -- [CONDITIONS [STEPS]]`.
//!
//! The head and the batch are those of the paper's microfacet head; targets are drawn on the device.

use std::time::Instant;

use headtail_model::Head;
use headtail_render::{
    environment::Environment,
    tail::{Tail, TailKind},
};
use headtail_train::{
    Backend, GradientSource, Preset, Result, TrainingState, Viewpoints, build_target,
    device::{DeviceGradient, KernelTime},
};

fn main() -> Result<()> {
    let mut numbers = std::env::args().filter_map(|text| text.parse().ok());
    let [conditions, steps] = [256, 50].map(|default: usize| numbers.next().unwrap_or(default));
    let mut config = Preset::PaperGgx.config();
    config.conditions = conditions;
    let tail = Tail::of_environment(TailKind::Hierarchical, &Environment::open("studio")?)?;
    let target = build_target(&config, &tail, Viewpoints::Sphere)?;
    let head = Head::new(config.head, config.seed, &Backend::default().device()?)?;
    let weights = head.flat_weights();
    let points = conditions * config.batch_shape().samples();
    println!("{} weights, {conditions} conditions, {points} points", weights.len());
    for together in
        [1 << 14, 1 << 15, 1 << 16, 1 << 17, 1 << 18].into_iter().filter(|&size| size == 1 << 14 || size < 2 * points)
    {
        let mut device = DeviceGradient::new(&head)?.in_pieces_of(together);
        let mut state = TrainingState::new(&config, weights.clone());
        // Compiles the shaders.
        device.take_steps(&config, &*target, &mut state, 1)?;
        let (start, mut taken) = (Instant::now(), 0);
        while taken < steps {
            taken += device.take_steps(&config, &*target, &mut state, steps - taken)?.len();
        }
        let seconds = start.elapsed().as_secs_f64();
        println!(
            "\n{together} points together: {:.2} M points/s on {}",
            (points * steps) as f64 / seconds / 1e6,
            device.device()
        );
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
