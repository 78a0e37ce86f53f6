//! Measures samplers: the only crate that times renderings or computes their error.
//!
//! [`measure`] renders samplers of one view at budgets of samples or seconds and compares the pictures with a [`Reference`]; commands,
//! sweeps and the Python package call it. An [`Experiment`] is a table of views, samplers and budgets; [`Store`] keeps one
//! [`Measurement`] per (view, sampler, budget, run), and [`summary`] turns them into ratios with intervals.
//!
//! | file | concept |
//! | --- | --- |
//! | `view.rs` | scene, camera and map of a picture, and the points of its samples |
//! | `budget.rs`, `clock.rs` | samples or seconds; wall-clock and processor time |
//! | `renderer.rs`, `device.rs` | what renders: the CPU or a graphics device |
//! | `auto.rs` | the choice of a sampler for a view |
//! | `reference.rs` | converged pictures, their noise and their cache |
//! | `engine.rs`, `entry.rs`, `calibration.rs` | the measuring loop; its samplers; how many samples fit into a time |
//! | `measurement.rs` | one record per run |
//! | `independent_runs.rs`, `timing_baseline.rs` | variance without a reference, and times as ratios to a baseline |
//! | `direction_statistics.rs`, `quadrature.rs` | divergences and weights of a sampler at single shading points |
//! | `preparation.rs` | the time to make a sampler's files |
//! | `sample_time.rs` | the time of one light estimate |
//! | `experiment.rs`, `artifact.rs`, `runner.rs`, `store.rs` | experiments, the files that their samplers need, and their data |
//! | `verification.rs`, `retiming.rs` | whether changed sources render what was measured; their times |
//! | `conformance/` | a kit that checks other implementations of the samplers |
//! | `recording.rs` | commands whose output is data |
//! | `summary/` | ratios, bootstrap intervals, error at equal time |
//! | `bin/results/` | measures experiments and builds pages from their data |

mod artifact;
mod auto;
mod budget;
mod calibration;
mod clock;
pub mod conformance;
mod device;
mod direction_statistics;
mod engine;
mod entry;
mod error;
mod experiment;
mod independent_runs;
mod measurement;
mod preparation;
mod quadrature;
mod recording;
mod reference;
mod renderer;
mod retiming;
mod runner;
mod sample_time;
#[cfg(test)]
mod sources;
mod store;
pub mod summary;
mod timing_baseline;
mod verification;
mod view;

pub use artifact::Artifact;
pub use auto::{Choice, Trial, choose, need_no_pilot};
pub use budget::Budget;
pub use device::GraphicsDevice;
pub use direction_statistics::{DirectionBench, DirectionEffort, DirectionStatistics, variance_ratio};
pub use engine::{Plan, Run, Watch, measure};
pub use entry::Entry;
pub use error::{Error, Result};
pub use experiment::{BudgetEntry, Experiment, MapEntry, MaterialEntry, SamplerEntry, SceneEntry, ViewKey};
pub use independent_runs::IndependentRuns;
pub use measurement::{
    Environment as MeasurementEnvironment, Measurement, device_source_hash, machine, mean_luminance, source_hash,
};
pub use preparation::FilePreparation;
pub use recording::{Output, RecordedCommand, Recording};
pub use reference::{Noise, Reference, ReferencePolicy, covered, select};
pub use renderer::Renderer;
pub use retiming::{Retiming, retime};
pub use runner::{Outcome, RunOptions, run};
pub use sample_time::nanoseconds_per_sample;
pub use store::{Record, Store, VerifiedSources};
pub use timing_baseline::TimingBaseline;
pub use verification::{RAYS, Verification, verify};
pub use view::{CameraSettings, OpenedView, ViewSettings, part_text};
