//! What renders pictures: the integrator with an estimator, or a graphics device.

use std::sync::atomic::AtomicBool;

use headtail_render::{
    estimator::Estimator,
    integrator::{self, Part, Rendering, View},
    points::Points,
};

use crate::{Budget, Result};

/// Renders pictures with one sampler.
pub trait Renderer {
    /// Renders a part of a view, as [`integrator::render_part`] does.
    ///
    /// # Errors
    /// If a device fails.
    fn render_part(
        &self,
        view: (View<'_>, Part),
        budget: Budget,
        points: Points,
        stop: &AtomicBool,
        progress: &dyn Fn(f64),
    ) -> Result<Rendering>;
}

/// The integrator on the CPU.
impl Renderer for Box<dyn Estimator> {
    fn render_part(
        &self,
        (view, part): (View<'_>, Part),
        budget: Budget,
        points: Points,
        stop: &AtomicBool,
        progress: &dyn Fn(f64),
    ) -> Result<Rendering> {
        Ok(integrator::render_part(view, part, &**self, budget.into(), points, stop, progress))
    }
}
