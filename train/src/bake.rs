//! The learned bake: a head's density over Y, tabulated over a grid of normals.

use std::f32::consts::PI;

use glam::{Vec2, Vec3A};
use headtail_render::{
    bake::{BakedTable, CellDirections, CellGrid, CellPoints, NormalGrid, StageProgress},
    head::{Condition, Head},
    tail::Tail,
};
use rayon::prelude::*;

use crate::{Error, Result};

/// Points along each side of a cell at which the head is evaluated.
const POINTS: usize = 3;
/// The fraction of its time spent on densities.
const DENSITIES: f64 = 0.8;

/// Tabulates a head that is conditioned on the normal.
///
/// A cell holds the root mean square of the density over it. A normal's table is weighted by the irradiance
/// at the normal, the mean of `max(0, n . t(y))` over Y: between two normals, the brighter one then counts
/// more, as in the target itself.
///
/// Where a direction would have a large weight, the mass of its cell is raised ([`CellDirections::raise`]).
///
/// A head with a learned mixture weight is tabulated as its mixture with BRDF sampling, for which it was
/// trained: the table is used alone.
///
/// # Errors
/// [`Error::NotBakeable`] for a head with another condition; see also [`BakedTable::new`] and
/// [`BakedTable::require_memory`].
pub fn learned_bake(head: &Head, tail: &Tail, normals: NormalGrid, cells: CellGrid) -> Result<BakedTable> {
    learned_bake_watched(head, tail, normals, cells, &|_| {})
}

/// Runs [`learned_bake`] and calls `watch` now and then with the fraction done, from any thread.
///
/// # Errors
/// As [`learned_bake`].
pub fn learned_bake_watched(
    head: &Head,
    tail: &Tail,
    normals: NormalGrid,
    cells: CellGrid,
    watch: &(dyn Fn(f64) + Sync),
) -> Result<BakedTable> {
    if head.condition() != Condition::Normal {
        return Err(Error::NotBakeable);
    }
    BakedTable::require_memory(normals, cells)?;
    let points = CellPoints::new(tail, cells, POINTS);
    let positions: Vec<_> = points.positions().flatten().copied().collect();
    let cosine = head.has_mixture_weight().then(|| PulledBackCosine::new(tail, &positions));
    let points_of_cell = positions.len() / cells.cells();
    let mut masses = vec![0.0; normals.nodes() * cells.cells()];
    let progress = StageProgress::new(watch, (0.0, DENSITIES), normals.nodes());
    masses.par_chunks_exact_mut(cells.cells()).enumerate().for_each(|(node, masses)| {
        let normal = normals.normal(node);
        let head = head.at(&normal.to_array()).expect("its condition is the normal");
        let densities: Vec<f32> = head.invert(&positions).into_iter().map(|(_, density)| density).collect();
        for (mass, densities) in masses.iter_mut().zip(densities.chunks_exact(points_of_cell)) {
            *mass = (densities.iter().map(|q| q * q).sum::<f32>() / densities.len() as f32).sqrt();
        }
        if let Some(cosine) = &cosine {
            let mixture_weight = head.mixture_weight();
            let densities: Vec<f32> = cosine.densities(normal).collect();
            for (mass, densities) in masses.iter_mut().zip(densities.chunks_exact(points_of_cell)) {
                // The mean, not the root mean square: where the map is dark, the cosine's density over Y is
                // large, and a mixture need not follow it.
                let mean = densities.iter().sum::<f32>() / densities.len() as f32;
                *mass = mixture_weight * *mass + (1.0 - mixture_weight) * mean;
            }
        }
        let (mut light, mut count) = (0.0, 0.0);
        for directions in points.directions() {
            light += directions.iter().map(|&wi| normal.dot(wi).max(0.0)).sum::<f32>();
            count += directions.len() as f32;
        }
        for mass in masses {
            *mass *= light / count;
        }
        progress.step();
    });
    CellDirections::new(tail, cells).raise(normals, &mut masses, (DENSITIES, watch));
    Ok(BakedTable::new(normals, cells, masses)?)
}

/// The density over Y of cosine sampling at fixed points.
struct PulledBackCosine {
    /// Each point's direction, and the pdf of that direction when Y is uniform.
    points: Vec<(Vec3A, f32)>,
}

impl PulledBackCosine {
    fn new(tail: &Tail, positions: &[Vec2]) -> Self {
        Self { points: tail.forward_directions(positions).map(|(_, wi, pdf)| (wi, pdf)).collect() }
    }

    /// Returns densities in the order of the points; 0 where there is no light.
    fn densities(&self, normal: Vec3A) -> impl Iterator<Item = f32> {
        self.points.iter().map(move |&(wi, pdf)| if pdf > 0.0 { normal.dot(wi).max(0.0) / PI / pdf } else { 0.0 })
    }
}
