//! Direct illumination: estimators over samplers, and the tiled integrator.

mod estimator;

pub use estimator::{
    DirectEstimator, Estimate, ResampledEstimator, SingleSample, TwoSampleMis, Unshadowed, Visibility,
};
