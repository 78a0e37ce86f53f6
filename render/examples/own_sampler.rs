//! A custom sampler: `cargo run --release -p headtail-render --example own_sampler` prints three equal means.

use glam::{Vec2, Vec3, Vec3A};
use headtail_render::*;
use std::{f32::consts::PI, sync::Arc};

/// Samples half of the directions uniformly over the sphere, half in proportion to the cosine to +Y.
pub struct SkySampler;

/// Returns the solid-angle pdf of a direction with this height (its Y).
fn density(height: f32) -> f32 {
    0.5 * (0.25 / PI) + 0.5 * (height.max(0.0) / PI)
}

impl Sampler for SkySampler {
    fn sample(&self, _at: &Rows<'_>, _state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, _arena: &Arena) {
        let ([x, y, z], pdf) = (out.wi.map(<[Lanes]>::as_flattened_mut), out.pdf.as_flattened_mut());
        for (k, (&u, &v)) in u[0].as_flattened().iter().zip(u[1].as_flattened()).enumerate() {
            let height = if u < 0.5 { 1.0 - 4.0 * u } else { (2.0 * u - 1.0).sqrt() };
            let (radius, (sin, cos)) = ((1.0 - height * height).max(0.0).sqrt(), (2.0 * PI * v).sin_cos());
            (x[k], y[k], z[k], pdf[k]) = (radius * cos, height, radius * sin, density(height));
        }
    }

    fn pdf(&self, _at: &Rows<'_>, _state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], _arena: &Arena) {
        out.as_flattened_mut().iter_mut().zip(wi[1].as_flattened()).for_each(|(out, &y)| *out = density(y));
    }

    fn coverage(&self) -> Coverage {
        Coverage::Everything
    }
}

/// Builds estimators of the sampler alone, in a mixture with BRDF sampling, and in RIS with BRDF sampling.
pub fn estimators(map: &Arc<Environment>) -> Result<[(&'static str, Box<dyn Estimator>); 3]> {
    let alone = SingleSample::new(Covering::new(SkySampler)?, map.clone());
    let mixture = SingleSample::new(Covering::new(OneSampleMis::new(SkySampler, BrdfSampler))?, map.clone());
    let ris = Ris::new(Covering::new(SkySampler)?, Covering::new(BrdfSampler)?, 4, map.clone())?;
    Ok([("alone", Box::new(alone)), ("mixture", Box::new(mixture)), ("ris:4", Box::new(ris))])
}

/// Estimates the mean unshadowed luminance that the points of a tile reflect, with one sample.
pub fn estimate(estimator: &dyn Estimator, tile: &Tile, sample: u32) -> f64 {
    let (mut contributions, points) = (Contributions::default(), Points::new(PointSet::Sobol, 1).at_sample(sample));
    estimator.propose(&tile.rows(), &points, &mut contributions, &Arena::default());
    contributions.radiance().iter().map(|&value| f64::from(luminance(value))).sum::<f64>() / tile.len() as f64
}

fn main() -> Result<()> {
    let (map, surface) = (Arc::new(Environment::open("window")?), Lambert { albedo: Vec3::ONE }.into());
    let point = |n: Vec3A| ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo: n, surface };
    let normal = |k: usize| Vec2::from_angle(k as f32).extend(0.5).normalize().into();
    let tile = Tile::of(&std::array::from_fn::<_, 256, _>(|k| point(normal(k))));
    for (name, estimator) in estimators(&map)? {
        println!("{name:8} {:.2}", (0..10_000).map(|k| estimate(&*estimator, &tile, k)).sum::<f64>() / 10_000.0);
    }
    Ok(())
}
