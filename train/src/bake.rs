//! The learned bake: a head's density over Y, tabulated over a grid of normals.

use headtail_render::{
    bake::{BakedTable, CellGrid, CellPoints, NormalGrid},
    head::Head,
    tail::Tail,
};

use crate::Result;

/// Points along each side of a cell at which the head is evaluated.
const POINTS: usize = 3;

/// Tabulates a head that is conditioned on the normal.
///
/// A cell holds the root mean square of the density over it. A normal's table is weighted by the light that the normal sees,
/// the mean of `max(0, n . t(y))` over Y: between two normals the one that sees more light then counts for more, as in the
/// target itself.
///
/// # Errors
/// See [`BakedTable::new`].
pub fn learned_bake(head: &Head, tail: &Tail, normals: NormalGrid, cells: CellGrid) -> Result<BakedTable> {
    let points = CellPoints::new(tail, cells, POINTS);
    Ok(BakedTable::fill(normals, cells, |normal, masses| {
        let prepared = head.prepare_normal(normal);
        let (mut light, mut count) = (0.0, 0.0);
        for ((mass, positions), directions) in masses.iter_mut().zip(points.positions()).zip(points.directions()) {
            let squares: f32 = positions.iter().map(|&y| head.inverse_at(&prepared, y).1.powi(2)).sum();
            *mass = (squares / positions.len() as f32).sqrt();
            light += directions.iter().map(|&wi| normal.dot(wi).max(0.0)).sum::<f32>();
            count += directions.len() as f32;
        }
        for mass in masses {
            *mass *= light / count;
        }
    })?)
}
