//! A sampler at one shading point: a tile of copies of the point, derived for every sampler alike.

use glam::{Vec2, Vec3A};

use super::{Draws, Sampler};
use crate::{
    brdf::BrdfTable,
    columns::strips,
    one_point::OnePoint,
    simd::{LANES, Lanes},
    tile::ShadingPoint,
};

/// State of more numbers than this is kept for few copies of the point.
const LARGE_STATE: usize = 1 << 12;

/// A sampled direction towards the environment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Direction {
    /// Unit direction.
    pub wi: Vec3A,
    /// Solid-angle pdf of `wi`, positive and finite.
    pub pdf: f32,
}

/// A sampler, prepared for one shading point. For embedders and tests; a renderer of many points calls [`Sampler`].
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

    /// Prepares a sampler for a point with a BRDF of a table.
    pub fn of_table(sampler: &'a dyn Sampler, at: &ShadingPoint, brdfs: &BrdfTable) -> Self {
        let copies = if sampler.columns() > LARGE_STATE { LANES } else { 16 * LANES };
        let point = OnePoint::of_table(at, copies, brdfs);
        let mut state = vec![[0.0; LANES]; sampler.columns() * strips(copies)];
        sampler.prepare(&point.tile().rows(), &mut state, &point.arena);
        Self { sampler, point, state }
    }

    /// Draws a direction for each uniform point of `[0, 1)^2`; `None` is no sample.
    pub fn sample_many(&self, u: &[Vec2]) -> Vec<Option<Direction>> {
        let draw = |u: [&[Lanes]; 2], [x, y, z, pdf]: [&mut [Lanes]; 4]| {
            let out = Draws { wi: [x, y, z], pdf };
            self.sampler.sample(&self.point.tile().rows(), &self.state, u, out, &self.point.arena);
        };
        let direction = |[x, y, z, pdf]: [f32; 4]| (pdf > 0.0).then_some(Direction { wi: Vec3A::new(x, y, z), pdf });
        self.point.map(u, draw).map(direction).collect()
    }

    /// The solid-angle pdfs of unit directions.
    pub fn pdf_many(&self, wi: &[Vec3A]) -> Vec<f32> {
        let pdf = |wi: [&[Lanes]; 3], [out]: [&mut [Lanes]; 1]| {
            self.sampler.pdf(&self.point.tile().rows(), &self.state, wi, out, &self.point.arena);
        };
        self.point.map(wi, pdf).map(|[pdf]| pdf).collect()
    }

    /// Draws one direction.
    pub fn sample(&self, u: Vec2) -> Option<Direction> {
        self.sample_many(&[u])[0]
    }

    /// The pdf of one direction.
    pub fn pdf(&self, wi: Vec3A) -> f32 {
        self.pdf_many(&[wi])[0]
    }

    /// See [`Sampler::share`].
    pub fn share(&self) -> f32 {
        let rows = self.point.tile().rows();
        let mut shares = vec![[0.0; LANES]; rows.strips()];
        self.sampler.share(&rows, &mut shares, &self.point.arena);
        shares[0][0]
    }

    /// The shading point, ready for BRDFs.
    pub fn point(&self) -> &OnePoint {
        &self.point
    }
}
