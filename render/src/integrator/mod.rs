//! Direct illumination: estimators over samplers, and the tiled integrator.

mod direct;
mod estimator;

pub use direct::{Budget, Rendering, View, render};
pub use estimator::{
    DirectEstimator, Estimate, ResampledEstimator, SingleSample, TwoSampleMis, Unshadowed, Visibility,
};
