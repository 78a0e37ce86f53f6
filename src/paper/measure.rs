//! Renderings of samplers against a reference, as rows of the report.

use anyhow::Result;
use headtail_render::{
    brdf::BrdfTable,
    environment::Environment,
    estimator::Estimator,
    image::Image,
    integrator::{self, Rendering},
    scene::Scene,
    spec::SamplerSpec,
    statistics::ErrorMetrics,
    tile::ShadingPoint,
};
use std::sync::Arc;

use super::{Workshop, data::View};
use crate::{
    compare::select,
    exposure,
    report::{Row, RunName},
};

const METALLIC_ROUGHNESS: u32 = BrdfTable::METALLIC_ROUGHNESS;

/// A sampler with its name.
pub struct Entry {
    /// The name in charts and captions.
    pub name: String,
    /// What renders.
    pub estimator: Box<dyn Estimator>,
}

/// A view under a map with its reference.
pub struct Bench<'a> {
    workshop: &'a Workshop,
    view: &'a View,
    environment: Arc<Environment>,
    /// The reference.
    pub reference: Image,
    /// `[height * width]` pixels that surfaces cover entirely.
    pub measured: Vec<bool>,
    /// Stops that show the reference well.
    pub exposure: f32,
}

impl<'a> Bench<'a> {
    /// Renders the reference by patches.
    pub fn new(workshop: &'a Workshop, view: &'a View, environment: Arc<Environment>) -> Result<Self> {
        let estimator = SamplerSpec::patches().build(&environment)?;
        let blank = Image::black(1, 1);
        let mut bench = Self { workshop, view, environment, reference: blank, measured: Vec::new(), exposure: 0.0 };
        let rendering = bench.render(&*estimator, workshop.effort.reference_spp, 1 << 20);
        workshop.check()?;
        bench.measured = rendering.coverage.iter().map(|&coverage| coverage == 1.0).collect();
        bench.reference = rendering.composite();
        bench.exposure = exposure::of_image(&bench.reference, &bench.measured);
        Ok(bench)
    }

    /// One rendering.
    pub fn render(&self, estimator: &dyn Estimator, spp: u32, seed: u64) -> Rendering {
        let (width, height) = (self.workshop.effort.width, self.workshop.effort.width * 3 / 4);
        let view = integrator::View {
            scene: &self.view.scene,
            camera: &self.view.camera,
            environment: &self.environment,
            width,
            height,
            unshadowed: false,
            depth: 1,
        };
        self.workshop.render(view, estimator, spp, seed)
    }

    /// All runs at the numbers of samples, and the first picture of each sampler at `shown`.
    pub fn measure(&self, entries: &[Entry], spp: &[u32], shown: u32) -> Result<(Vec<Row>, Vec<Image>)> {
        let (mut rows, mut images) = (Vec::new(), Vec::new());
        let reference = select(&self.reference, &self.measured);
        for &spp in spp {
            for run in 0..self.workshop.effort.runs {
                for entry in entries {
                    self.workshop.check()?;
                    let seed = 1 + u64::from(run);
                    let rendering = self.render(&*entry.estimator, spp, seed);
                    let image = rendering.composite();
                    let name = RunName {
                        scene: &self.view.name,
                        env: self.environment.name(),
                        sampler: &entry.name,
                        budget: &format!("{spp}spp"),
                        run,
                        seed,
                    };
                    rows.push(Row::measured(&name, &rendering, &select(&image, &self.measured), &reference)?);
                    if run == 0 && spp == shown {
                        images.push(image);
                    }
                }
            }
        }
        Ok((rows, images))
    }
}

/// What a sampler makes of the time that others take.
pub struct EqualTime {
    /// Samples per pixel.
    pub spp: u32,
    /// Mean seconds of a rendering.
    pub seconds: f64,
    /// Mean MSE.
    pub mse: f64,
    /// The first run's picture.
    pub image: Image,
}

impl Bench<'_> {
    /// All samplers in the time that the slowest of them takes for `least` samples per pixel. Times of a sample are the least of `rows` at `timed` samples:
    /// whatever else the machine does makes them longer.
    pub fn equal_time(&self, entries: &[Entry], rows: &[Row], timed: u32, least: u32) -> Result<Vec<EqualTime>> {
        let fastest = |entry: &Entry| {
            let own = rows.iter().filter(|row| row.sampler == entry.name && row.spp == f64::from(timed));
            own.map(|row| row.seconds).fold(f64::INFINITY, f64::min)
        };
        let seconds: Vec<f64> = entries.iter().map(fastest).collect();
        let slowest = seconds.iter().copied().fold(0.0, f64::max);
        let reference = select(&self.reference, &self.measured);
        let mut results = Vec::new();
        for (entry, seconds) in entries.iter().zip(seconds) {
            let spp = (f64::from(least) * slowest / seconds).round().max(1.0) as u32;
            let runs = self.workshop.effort.runs;
            let mut result = EqualTime { spp, seconds: 0.0, mse: 0.0, image: Image::black(1, 1) };
            for run in 0..runs {
                self.workshop.check()?;
                let rendering = self.render(&*entry.estimator, spp, 1 + u64::from(run));
                let image = rendering.composite();
                result.mse += ErrorMetrics::of(&select(&image, &self.measured), &reference)?.mse / f64::from(runs);
                result.seconds += rendering.seconds / f64::from(runs);
                if run == 0 {
                    result.image = image;
                }
            }
            results.push(result);
        }
        Ok(results)
    }

    /// What the middle of a pixel shows.
    pub fn surface_of(&self, pixel: usize) -> Option<ShadingPoint> {
        let (width, height) = (self.reference.width, self.reference.height);
        let (x, y) = ((pixel % width) as f32 + 0.5, (pixel / width) as f32 + 0.5);
        self.view.scene.intersect(&self.view.camera.ray(x, y, width, height))
    }

    /// `[height * width]` measured pixels whose surface has a BRDF of its own, no analytic one; all measured pixels where there are none.
    pub fn special(&self) -> Vec<bool> {
        let is_special = |k: usize| {
            self.measured[k] && self.surface_of(k).is_some_and(|point| point.surface.brdf > METALLIC_ROUGHNESS)
        };
        let special: Vec<bool> = (0..self.measured.len()).map(is_special).collect();
        if special.contains(&true) { special } else { self.measured.clone() }
    }

    /// The one of the chosen pixels that is nearest to a place.
    pub fn nearest(&self, chosen: &[bool], x: usize, y: usize) -> Option<usize> {
        let width = self.reference.width;
        let distance = |k: &usize| (k % width).abs_diff(x).pow(2) + (k / width).abs_diff(y).pow(2);
        (0..chosen.len()).filter(|&k| chosen[k]).min_by_key(distance)
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.view.scene
    }
}

/// Mean MSE and time of a sampler at a number of samples.
pub fn mean(rows: &[Row], sampler: &str, spp: u32) -> (f64, f64) {
    let own: Vec<&Row> = rows.iter().filter(|row| row.sampler == sampler && row.spp == f64::from(spp)).collect();
    let count = own.len().max(1) as f64;
    (own.iter().map(|row| row.mse).sum::<f64>() / count, own.iter().map(|row| row.seconds).sum::<f64>() / count)
}
