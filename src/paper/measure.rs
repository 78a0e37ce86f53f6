//! Renders samplers against a reference.

use std::{collections::BTreeMap, sync::Arc};

use anyhow::{Context, Result};
pub use headtail_eval::Entry;
use headtail_eval::{Budget, Measurement, OpenedView, Plan, Reference, ReferencePolicy, Run, measure};
use headtail_render::{brdf::BrdfTable, environment::Environment, image::Image, scene::Scene, tile::ShadingPoint};

use super::{PaperContext, data::View};
use crate::exposure;

const METALLIC_ROUGHNESS: u32 = BrdfTable::METALLIC_ROUGHNESS;

/// A view under a map with its reference.
pub struct Bench<'a> {
    context: &'a PaperContext,
    name: String,
    view: OpenedView,
    measured_against: Reference,
    /// The reference.
    pub reference: Image,
    /// `[height * width]` pixels that surfaces cover entirely.
    pub measured: Vec<bool>,
    /// Exposure of the reference in stops.
    pub exposure: f32,
}

impl<'a> Bench<'a> {
    /// Renders the reference.
    pub fn new(context: &'a PaperContext, view: &View, environment: Arc<Environment>) -> Result<Self> {
        let size = (context.effort.width, context.effort.width * 3 / 4);
        let (name, view) = (view.name.clone(), OpenedView::new(view.scene.clone(), view.camera, environment, size));
        let policy = ReferencePolicy::new(context.effort.reference_spp, 0);
        let rendered = Reference::render(&view, policy, &context.stop, &|_| {});
        context.check()?;
        let measured_against = rendered?;
        let (reference, measured) = (measured_against.image.clone(), measured_against.covered.clone());
        let exposure = exposure::of_image(&reference, &measured);
        Ok(Self { context, name, view, measured_against, reference, measured, exposure })
    }

    /// Runs every sampler at each number of samples, and returns the first picture of each at `shown`.
    pub fn measure(&self, entries: &[Entry], spp: &[u32], shown: u32) -> Result<(Vec<Measurement>, Vec<Image>)> {
        let mut images = BTreeMap::new();
        let plan = Plan {
            scene: self.name.clone(),
            env: self.view.environment.name().to_owned(),
            material: String::new(),
            budgets: spp.iter().map(|&spp| Budget::Samples(spp)).collect(),
            runs: self.context.effort.runs,
            seed: 1,
            cache: None,
        };
        let mut keep = |run: Run<'_>| {
            if run.measurement.run == 0 && spp[run.budget] == shown {
                images.insert(run.sampler, run.rendering.composite());
            }
            anyhow::Ok(())
        };
        let mut reference = self.measured_against.clone();
        let stop = &*self.context.stop;
        let rows = measure(&self.view, entries, &mut reference, &plan, (stop, &()), &mut keep)?;
        self.context.check()?;
        Ok((rows, images.into_values().collect()))
    }
}

/// A sampler's result at equal time.
pub struct EqualTime {
    /// Samples per pixel.
    pub spp: u32,
    /// Mean MSE.
    pub mse: f64,
    /// The first run's picture.
    pub image: Image,
}

impl Bench<'_> {
    /// Renders all samplers in the time that the slowest takes for `least` samples per pixel. A sampler's
    /// time is the minimum over its `rows` at `timed` samples, since other load only makes runs longer.
    pub fn equal_time(
        &self,
        entries: &[Entry],
        rows: &[Measurement],
        timed: u32,
        least: u32,
    ) -> Result<Vec<EqualTime>> {
        let fastest = |entry: &Entry| {
            let own = rows.iter().filter(|row| row.sampler == entry.name && row.spp == f64::from(timed));
            own.map(|row| row.seconds).fold(f64::INFINITY, f64::min)
        };
        let seconds: Vec<f64> = entries.iter().map(fastest).collect();
        let slowest = seconds.iter().copied().fold(0.0, f64::max);
        let equal = |(entry, seconds): (&Entry, f64)| {
            let spp = (f64::from(least) * slowest / seconds).round().max(1.0) as u32;
            let (rows, images) = self.measure(std::slice::from_ref(entry), &[spp], spp)?;
            let image = images.into_iter().next().context("the first run has a picture")?;
            Ok(EqualTime { spp, mse: mean(&rows, &entry.name, spp).0, image })
        };
        entries.iter().zip(seconds).map(equal).collect()
    }

    /// Intersects the ray through a pixel's centre.
    pub fn surface_of(&self, pixel: usize) -> Option<ShadingPoint> {
        let (width, height) = (self.reference.width, self.reference.height);
        let (x, y) = ((pixel % width) as f32 + 0.5, (pixel / width) as f32 + 0.5);
        self.view.scene().intersect(&self.view.view().camera.ray(x, y, width, height))
    }

    /// `[height * width]` measured pixels whose BRDF is not analytic; all measured pixels if there are none.
    pub fn special(&self) -> Vec<bool> {
        let is_special = |k: usize| {
            self.measured[k] && self.surface_of(k).is_some_and(|point| point.surface.brdf > METALLIC_ROUGHNESS)
        };
        let special: Vec<bool> = (0..self.measured.len()).map(is_special).collect();
        if special.contains(&true) { special } else { self.measured.clone() }
    }

    /// Returns the chosen pixel nearest to `(x, y)`.
    pub fn nearest(&self, chosen: &[bool], x: usize, y: usize) -> Option<usize> {
        let width = self.reference.width;
        let distance = |k: &usize| (k % width).abs_diff(x).pow(2) + (k / width).abs_diff(y).pow(2);
        (0..chosen.len()).filter(|&k| chosen[k]).min_by_key(distance)
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        self.view.scene()
    }
}

/// Mean MSE and time of a sampler at a number of samples.
pub fn mean(rows: &[Measurement], sampler: &str, spp: u32) -> (f64, f64) {
    let own: Vec<&Measurement> =
        rows.iter().filter(|row| row.sampler == sampler && row.spp == f64::from(spp)).collect();
    let count = own.len().max(1) as f64;
    (own.iter().map(|row| row.mse).sum::<f64>() / count, own.iter().map(|row| row.seconds).sum::<f64>() / count)
}
