//! Training of head warps: targets in the intermediate square Y, losses, the training loop and export.
//!
//! With an exact tail the density that a head has to learn is `q*(y|c)`, proportional to BRDF x cosine seen through the tail:
//! no environment factor is left (see [`integrand`]). [`fit()`] is the entry point.

pub mod backend;
pub mod backend_trial;
pub mod bake;
mod build_target;
pub mod checkpoint;
pub mod config;
pub mod config_file;
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
mod measured;
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
mod state_file;
pub mod step_gradient;
pub mod tensorboard;
#[cfg(test)]
mod test_support;
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
pub use fit::{Fitted, Progress, Run, Summary, fit, fit_with};
pub use fit_tail::fit_tail;
pub use flow::{FittedFlow, FlowSettings, FlowSize, FlowSummary, fit_flow};
pub use gradient::GradientForm;
pub use headtail_model::Mode;
pub use integrand::{Batch, CosineTarget, Target, Viewpoints};
pub use loss::{Loss, Objective};
pub use material::Material;
pub use measured::Measured;
pub use metrics::MetricsFile;
pub use picture::{DensityPair, density_pairs};
pub use preset::Preset;
pub use step_gradient::{GradientSource, StepGradient};
pub use tensorboard::TensorBoard;
pub use validation::Divergence;
