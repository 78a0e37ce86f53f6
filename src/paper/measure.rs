//! Renderings of samplers against a reference, as rows of the report.

use anyhow::Result;
use headtail_render::{
    environment::Environment,
    estimator::Estimator,
    image::Image,
    integrator::{self, Budget, Rendering},
    points::{PointSet, Points},
    spec::SamplerSpec,
};
use std::sync::Arc;

use super::{Workshop, data::View};
use crate::{
    compare::select,
    render::quietly,
    report::{Row, RunName, picture},
};

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
        bench.exposure = picture::exposure(&bench.reference) + 0.5;
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
        quietly(view, estimator, Budget::Spp(spp), Points::new(PointSet::Sobol, seed))
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

/// Mean MSE and time of a sampler at a number of samples.
pub fn mean(rows: &[Row], sampler: &str, spp: u32) -> (f64, f64) {
    let own: Vec<&Row> = rows.iter().filter(|row| row.sampler == sampler && row.spp == f64::from(spp)).collect();
    let count = own.len().max(1) as f64;
    (own.iter().map(|row| row.mse).sum::<f64>() / count, own.iter().map(|row| row.seconds).sum::<f64>() / count)
}
