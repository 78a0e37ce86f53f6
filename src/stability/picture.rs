//! Pictures of a target and of the samplers' densities, on one logarithmic scale.

use std::sync::Arc;

use crate::report::{chart::Scale, picture::data_address};
use anyhow::Result;
use glam::{Vec2, Vec3A};
use headtail_render::{
    color::luminance,
    environment::Environment,
    latlong,
    sampler::{AtPoint, Sampler},
    tile::ShadingPoint,
};
use serde::{Deserialize, Serialize};

const WIDTH: usize = 160;
const HEIGHT: usize = 80;
/// Decades below the brightest value.
const DECADES: f64 = 6.0;

/// Densities over solid angle at one shading point, as lat-long pictures.
#[derive(Serialize, Deserialize)]
pub struct Pictures {
    /// Names and densities, the target first.
    densities: Vec<(String, Vec<f32>)>,
}

impl Pictures {
    /// Pictures of a point, with the density of its target.
    pub fn new(at: &ShadingPoint, environment: &Arc<Environment>) -> Self {
        let directions = each_pixel();
        let reflected = at.one().brdf_cosines(&directions).into_iter().zip(directions);
        let target: Vec<f64> = reflected.map(|(f, wi)| f64::from(luminance(f * environment.radiance(wi)))).collect();
        let solid_angle =
            |k: usize| f64::from(latlong::sin_theta((k / WIDTH) as f32 / HEIGHT as f32 + 0.5 / HEIGHT as f32));
        let pixel = 2.0 * std::f64::consts::PI.powi(2) / (WIDTH * HEIGHT) as f64;
        let total: f64 = target.iter().enumerate().map(|(k, f)| f * solid_angle(k) * pixel).sum();
        let target = target.into_iter().map(|f| (f / total.max(f64::MIN_POSITIVE)) as f32).collect();
        Self { densities: vec![("target".to_owned(), target)] }
    }

    /// Adds a sampler's density at the same point.
    pub fn add(&mut self, method: &str, sampler: &dyn Sampler, at: &ShadingPoint) {
        self.densities.push((method.to_owned(), AtPoint::new(sampler, at).pdf_many(&each_pixel())));
    }

    /// Encodes all densities on the target's scale: names and `data:` addresses.
    pub fn encode(&self) -> Result<Vec<(&str, String)>> {
        let target = self.densities.first().map_or(&[][..], |(_, target)| target);
        let top = target.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
        let scale = Scale { top: f64::from(top), decades: DECADES };
        let mut encoded = Vec::new();
        for (name, values) in &self.densities {
            encoded.push((&**name, data_address(&scale.png(values, WIDTH)?)));
        }
        Ok(encoded)
    }
}

/// The directions of the pixels' centres.
fn each_pixel() -> Vec<Vec3A> {
    let at = |k: usize| {
        Vec2::new((k % WIDTH) as f32 + 0.5, (k / WIDTH) as f32 + 0.5) / Vec2::new(WIDTH as f32, HEIGHT as f32)
    };
    (0..WIDTH * HEIGHT).map(|k| latlong::direction(at(k))).collect()
}
