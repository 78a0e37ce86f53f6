//! Estimates the unshadowed light that a white diffuse surface reflects, with an exported sampler:
//! `cargo run --release -p headtail-render --example exported_sampler -- FILE MAP`.

use std::{error::Error, path::Path, sync::Arc};

use glam::Vec3A;
use headtail_render::brdf::{Brdf, Lambert};
use headtail_render::environment::Environment;
use headtail_render::export::{ExportedSampler, Intermediate};
use headtail_render::random::{Purpose, Stream};
use headtail_render::sampler::{
    BrdfSampler, CoversIntegrand, EnvironmentLight, OneSampleMis, ProductSampler, ShadingPoint,
};

fn main() -> Result<(), Box<dyn Error>> {
    let [file, map] = std::env::args().skip(1).collect::<Vec<_>>().try_into().map_err(|_| "usage: FILE MAP")?;
    let environment = Arc::new(Environment::open(&map)?);
    let exported = ExportedSampler::read(Path::new(&file))?;
    exported.check_environment(&environment)?;
    let light = EnvironmentLight::with_tail(environment.clone(), exported.tail);
    let brdf = Brdf::Lambert(Lambert { albedo: Vec3A::ONE });
    let at = ShadingPoint { p: Vec3A::ZERO, ng: Vec3A::Y, ns: Vec3A::Y, wo: Vec3A::Y, brdf };
    let radiance = match exported.intermediate {
        // It has learned how often to draw from BRDF sampling instead.
        Intermediate::Head(head) if head.has_selection() => {
            estimate(&OneSampleMis::new(ProductSampler::new(light, head), BrdfSampler::new(environment)), &at)
        }
        Intermediate::Head(head) => estimate(&ProductSampler::new(light, head), &at),
        Intermediate::Bake(table) | Intermediate::DirectBake(table) => {
            estimate(&ProductSampler::new(light, table), &at)
        }
    };
    println!("reflected radiance {radiance:.4}");
    Ok(())
}

/// Mean of 4096 estimates of the reflected radiance.
fn estimate(sampler: &impl CoversIntegrand, at: &ShadingPoint) -> Vec3A {
    let mut random = Stream::new(0, Purpose::Test, 0);
    let prepared = sampler.prepare(at); // once for each shading point
    let draw = |_| match sampler.sample(&prepared, at, random.uniform2()) {
        Some(drawn) => at.brdf_cosine(drawn.wi) * drawn.radiance / drawn.pdf, // times the visibility of drawn.wi
        None => Vec3A::ZERO,
    };
    (0..4096).map(draw).sum::<Vec3A>() / 4096.0
}
