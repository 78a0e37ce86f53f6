//! Estimators over samplers, and the tiled integrator of direct light and of paths.

mod direct;
mod estimator;
mod path;
mod timings;

pub use direct::{Budget, Rendering, View, render};
pub use estimator::{
    DirectEstimator, Estimate, ResampledEstimator, SingleSample, TwoSampleMis, Unshadowed, Visibility,
};
pub use timings::{Stage, Timings};
