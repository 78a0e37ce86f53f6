//! Training of head warps: targets in the intermediate square Y, losses, the training loop and export.
//!
//! With an exact tail, the density to learn is `q*(y|c)`, proportional to BRDF x cosine seen through the
//! tail: it contains no environment factor (see [`integrand`]). [`fit()`] is the entry point.
//!
//! | file | concept |
//! | --- | --- |
//! | `config.rs`, `preset.rs` | the settings of a run; presets |
//! | `config_file.rs` | TOML files and single values over a preset |
//! | `material.rs` | the condition of a head for a material |
//! | `integrand/`, `build_target.rs` | targets in Y; the target of a configuration |
//! | `flow/`, `fit_tail.rs` | fitting a flow tail; the tail of a configuration |
//! | `loss/` | losses in closed form, and in burn's graph |
//! | `step_gradient.rs`, `gradient.rs` | the trait `GradientSource`; its forms |
//! | `fused/`, `device/`, `in_graph.rs` | gradients in SIMD lanes; by shaders on a GPU; in burn's graph |
//! | `device_absent.rs` | in place of `device/` in a build without graphics devices |
//! | `reference.rs` | the loss in f64, for tests |
//! | `trainer.rs`, `state.rs`, `optimizer.rs` | the training loop, its state, AdamW |
//! | `fit.rs` | training heads |
//! | `setback.rs` | resetting to the best validation after a setback |
//! | `state_file.rs`, `checkpoint.rs` | the file of a state; folders of checkpoints |
//! | `validation.rs` | KL, chi-square divergence and relative variance on a fixed set |
//! | `metrics.rs`, `tensorboard.rs` | `metrics.jsonl`; event files |
//! | `picture.rs` | pictures of densities |
//! | `export.rs`, `bake.rs` | from a burn head to the exported file; the learned bake |
//! | `backend.rs`, `backend_trial.rs`, `peak_memory.rs` | burn's backends; comparing them |
//! | `neural_texture/`, `rival/` | fitting neural materials; training rivals |

pub mod backend;
pub mod backend_trial;
pub mod bake;
mod build_target;
pub mod checkpoint;
pub mod config;
pub mod config_file;
#[cfg(feature = "gpu")]
pub mod device;
#[cfg(not(feature = "gpu"))]
#[path = "device_absent.rs"]
mod device;
pub mod error;
pub mod export;
pub mod fit;
mod fit_tail;
pub mod flow;
pub mod fused;
pub mod gradient;
pub mod in_graph;
pub mod integrand;
pub mod loss;
pub mod material;
pub mod metrics;
pub mod neural_texture;
pub mod optimizer;
pub mod peak_memory;
pub mod picture;
pub mod preset;
pub mod reference;
pub mod rival;
pub mod setback;
pub mod state;
pub mod state_file;
pub mod step_gradient;
pub mod tensorboard;
#[cfg(test)]
mod test_support;
pub mod trainer;
pub mod validation;

pub use backend::Backend;
pub use backend_trial::{BackendTrial, TrialRow};
pub use bake::{learned_bake, learned_bake_watched};
pub use build_target::build_target;
pub use checkpoint::CheckpointFolder;
pub use config::FitConfig;
pub use config_file::ConfigBuilder;
pub use error::{Error, Result};
pub use export::{exported_sampler, native_head};
pub use fit::{Fitted, Summary, fit, fit_with};
pub use fit_tail::fit_tail;
pub use flow::{FittedFlow, FlowSettings, FlowSize, FlowSummary, fit_flow};
pub use gradient::GradientForm;
pub use headtail_model::Mode;
pub use integrand::{Batch, CosineTarget, Target, Viewpoints};
pub use loss::{Loss, Objective};
pub use material::condition_of;
pub use metrics::MetricsFile;
pub use picture::{DensityPair, density_pairs};
pub use preset::Preset;
pub use state::TrainingState;
pub use state_file::StateFile;
pub use step_gradient::{GradientSource, StepGradient};
pub use tensorboard::TensorBoard;
pub use trainer::{Checkpoints, Progress, Run};
pub use validation::Divergence;
