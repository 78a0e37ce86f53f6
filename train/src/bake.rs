//! The learned bake: a head's density over Y, tabulated over a grid of normals.

use headtail_render::{
    bake::{BakedTable, CellGrid, CellPoints, NormalGrid},
    head::{Condition, Head},
    sampler::IntermediateDensity,
    tail::Tail,
};

use crate::{Error, Result};

/// Points along each side of a cell at which the head is evaluated.
const POINTS: usize = 3;

/// Tabulates a head that is conditioned on the normal.
///
/// A cell holds the root mean square of the density over it. A normal's table is weighted by the light that the normal sees,
/// the mean of `max(0, n . t(y))` over Y: between two normals the one that sees more light then counts for more, as in the
/// target itself.
///
/// # Errors
/// [`Error::NotBakeable`] for a head with another condition; see also [`BakedTable::new`].
pub fn learned_bake(head: &Head, tail: &Tail, normals: NormalGrid, cells: CellGrid) -> Result<BakedTable> {
    if head.condition() != Condition::Normal {
        return Err(Error::NotBakeable);
    }
    let points = CellPoints::new(tail, cells, POINTS);
    Ok(BakedTable::fill(normals, cells, |normal, masses| {
        let prepared = head.prepare_normal(normal);
        let positions = points.positions().flatten().copied().collect::<Vec<_>>();
        let mut densities = vec![0.0; positions.len()];
        head.density_prepared(&vec![&prepared; positions.len()], &positions, &mut densities);
        for (mass, densities) in masses.iter_mut().zip(densities.chunks_exact(positions.len() / cells.cells())) {
            *mass = (densities.iter().map(|q| q * q).sum::<f32>() / densities.len() as f32).sqrt();
        }
        let (mut light, mut count) = (0.0, 0.0);
        for directions in points.directions() {
            light += directions.iter().map(|&wi| normal.dot(wi).max(0.0)).sum::<f32>();
            count += directions.len() as f32;
        }
        for mass in masses {
            *mass *= light / count;
        }
    })?)
}
