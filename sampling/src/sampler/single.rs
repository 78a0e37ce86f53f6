//! A sampler at one shading point, as one strip of copies of the point; works for every sampler.

use glam::{Vec2, Vec3A};

use super::{Draws, Sampler};
use crate::{
    brdf::BrdfTable,
    one_point::OnePoint,
    simd::{LANES, Lanes},
    tile::ShadingPoint,
};

/// A sampled direction towards the environment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Direction {
    /// Unit direction.
    pub wi: Vec3A,
    /// Solid-angle pdf of `wi`, positive and finite.
    pub pdf: f32,
}

/// A sampler, prepared for one shading point: its state is computed once, for one strip of lanes, and serves
/// any number of samples and pdfs. For embedders and tests; a renderer of many points calls [`Sampler`].
///
/// ```
/// use std::sync::Arc;
///
/// use glam::{Vec2, Vec3, Vec3A};
/// use headtail_sampling::{brdf::Lambert, environment::built_in, sampler::AtPoint, spec::SamplerSpec, tile::ShadingPoint};
///
/// let sampler = SamplerSpec::patches().build_sampler(&Arc::new(built_in("studio").unwrap()))?;
/// let (up, surface) = (Vec3A::Y, Lambert { albedo: Vec3::ONE }.into());
/// let point = AtPoint::new(&sampler, &ShadingPoint { p: Vec3A::ZERO, ng: up, ns: up, wo: up, surface });
/// let drawn = point.sample(Vec2::new(0.3, 0.8)).unwrap();
/// assert!((point.pdf(drawn.wi) / drawn.pdf - 1.0).abs() < 1e-3);
/// # Ok::<(), headtail_sampling::Error>(())
/// ```
pub struct AtPoint<'a> {
    sampler: &'a dyn Sampler,
    point: OnePoint,
    state: Vec<Lanes>,
}

impl<'a> AtPoint<'a> {
    /// Prepares a sampler for a point with an analytic BRDF.
    pub fn new(sampler: &'a dyn Sampler, at: &ShadingPoint) -> Self {
        Self::of_table(sampler, at, &BrdfTable::default())
    }

    /// Prepares a sampler for a point with a BRDF from a table.
    pub fn of_table(sampler: &'a dyn Sampler, at: &ShadingPoint, brdfs: &BrdfTable) -> Self {
        let point = OnePoint::of_table(at, LANES, brdfs);
        let mut state = vec![[0.0; LANES]; sampler.columns()];
        sampler.prepare(&point.tile().rows(), &mut state, &point.arena);
        Self { sampler, point, state }
    }

    /// Draws a direction for each uniform point of `[0, 1)^2`; `None` for rejected samples.
    pub fn sample_many(&self, u: &[Vec2]) -> Vec<Option<Direction>> {
        let draw = |u: [&[Lanes]; 2], [x, y, z, pdf]: [&mut [Lanes]; 4]| {
            let out = Draws { wi: [x, y, z], pdf };
            self.sampler.sample(&self.point.tile().rows(), &self.state, u, out, &self.point.arena);
        };
        let direction = |[x, y, z, pdf]: [f32; 4]| (pdf > 0.0).then_some(Direction { wi: Vec3A::new(x, y, z), pdf });
        self.point.map(u, draw).map(direction).collect()
    }

    /// Returns the solid-angle pdfs of unit directions.
    pub fn pdf_many(&self, wi: &[Vec3A]) -> Vec<f32> {
        let pdf = |wi: [&[Lanes]; 3], [out]: [&mut [Lanes]; 1]| {
            self.sampler.pdf(&self.point.tile().rows(), &self.state, wi, out, &self.point.arena);
        };
        self.point.map(wi, pdf).map(|[pdf]| pdf).collect()
    }

    /// Draws a direction from a uniform point of `[0, 1)^2`; `None` if the sample is rejected.
    pub fn sample(&self, u: Vec2) -> Option<Direction> {
        let u = [[[u.x; LANES]], [[u.y; LANES]]];
        let ([mut x, mut y, mut z], mut pdf) = ([[[0.0; LANES]]; 3], [[0.0; LANES]]);
        let out = Draws { wi: [&mut x, &mut y, &mut z], pdf: &mut pdf };
        self.sampler.sample(
            &self.point.tile().rows(),
            &self.state,
            u.each_ref().map(|u| &u[..]),
            out,
            &self.point.arena,
        );
        let wi = Vec3A::new(x[0][0], y[0][0], z[0][0]);
        (pdf[0][0] > 0.0).then_some(Direction { wi, pdf: pdf[0][0] })
    }

    /// Returns the solid-angle pdf of a unit direction.
    pub fn pdf(&self, wi: Vec3A) -> f32 {
        let (wi, mut pdf) = (wi.to_array().map(|number| [[number; LANES]]), [[0.0; LANES]]);
        let wi = wi.each_ref().map(|column| &column[..]);
        self.sampler.pdf(&self.point.tile().rows(), &self.state, wi, &mut pdf, &self.point.arena);
        pdf[0][0]
    }

    /// See [`Sampler::mixture_weight`].
    pub fn mixture_weight(&self) -> f32 {
        let mut mixture_weight = [[0.0; LANES]];
        self.sampler.mixture_weight(&self.point.tile().rows(), &self.state, &mut mixture_weight, &self.point.arena);
        mixture_weight[0][0]
    }

    /// Returns the shading point, ready for BRDFs.
    pub fn point(&self) -> &OnePoint {
        &self.point
    }
}
