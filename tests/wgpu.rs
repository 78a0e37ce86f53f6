//! Compares the backend wgpu with the f64 reference and the host:
//! `cargo test --release --workspace --features wgpu --test wgpu`.
//!
//! Without a graphics adapter, not even a software one, the tests say so and count as ignored.

use headtail_render::{
    environment::Environment,
    tail::{Tail, TailKind},
};
use headtail_train::{Backend, BackendTrial, CosineTarget, FitConfig, Mode};
use libtest_mimic::{Arguments, Failed, Trial};

/// Compares a few training steps on the host and on wgpu.
fn agrees(mode: Mode) -> Result<(), Failed> {
    let environment = Environment::open("studio")?;
    let (width, height) = (environment.width(), environment.height());
    let tail = Tail::new(TailKind::Hierarchical, width, height, &environment.luminance())?;
    let target = CosineTarget::new(&tail);
    // The paper's learning rate: Adam's first steps depend on the gradient's sign only, so high rates amplify
    // rounding.
    let mut config = FitConfig { conditions: 8, strata: 4, learning_rate: 1e-3, ..FitConfig::default() };
    config.head.mode = mode;
    let trial = BackendTrial { config, steps: 3 };
    let host = trial.run(Backend::default(), &target, &[], &|_| {})?;
    let row = trial.run(Backend::Wgpu, &target, &host.losses, &|_| {})?;
    // Sums of some thousand f32 terms; every gradient must agree to 1e-4.
    if row.gradient_error >= 1e-4 || row.largest_loss_difference >= 1e-3 || !row.final_loss.is_finite() {
        return Err(format!("{row:?}").into());
    }
    Ok(())
}

fn main() {
    let arguments = Arguments { test_threads: Some(1), ..Arguments::from_args() };
    let adapter = Backend::Wgpu.device();
    if let Err(reason) = &adapter {
        eprintln!("skipped: {reason}");
    }
    let trial = |mode: Mode| {
        let name = format!("gradient_and_losses_are_the_hosts::{}", format!("{mode:?}").to_lowercase());
        Trial::test(name, move || agrees(mode)).with_ignored_flag(adapter.is_err())
    };
    let trials = [Mode::Coupled, Mode::Autoregressive].map(trial);
    libtest_mimic::run(&arguments, trials.into()).exit();
}
