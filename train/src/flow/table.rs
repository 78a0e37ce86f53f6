//! A flow as a table.

use std::sync::Arc;

use glam::Vec2;
use headtail_model::{Flow, coupling::Coordinate};
use headtail_render::tail::{Repair, WarpMap};
use rayon::prelude::*;

use super::invert::invert;
use crate::{Error, Result, fused::FusedFlow};

/// Tabulates the sampling direction y -> x at the corners of `cells x cells` cells.
///
/// The azimuth is lifted to the line through all layers, so that a cell that spans dark sky is distinguished
/// from one that wraps around the other way.
///
/// # Errors
/// [`Error::NoTable`]: the number of cells is out of range, a weight is not finite, or the flow rotates rows
/// by more than a table can represent.
pub fn tabulate(flow: &Flow, cells: usize) -> Result<(WarpMap, Repair)> {
    let (weights, fused) = (flow.flat_weights(), FusedFlow::new(flow));
    let count = cells * (cells + 1);
    let mut u: Vec<f64> = (0..count).map(|k| (k % cells) as f64 / cells as f64).collect();
    let mut v: Vec<f64> = (0..count).map(|k| (k / cells) as f64 / cells as f64).collect();
    for coupling in (0..flow.config().couplings).rev() {
        let target = flow.config().target(coupling);
        let (own, other) = match target {
            Coordinate::Elevation => (&mut v, &u),
            Coordinate::Azimuth => (&mut u, &v),
        };
        let see = |&x: &f64| match target {
            _ if !flow.config().sees_other(target) => 0.0,
            Coordinate::Elevation => (x - x.floor()) as f32,
            Coordinate::Azimuth => x as f32,
        };
        let seen: Vec<f32> = other.iter().map(see).collect();
        let logits = fused.logits(&weights, coupling, &seen);
        let splines = logits.par_chunks_exact(flow.config().logits());
        own.par_iter_mut().zip(splines).for_each(|(own, logits)| *own = invert(target.topology(), logits, *own));
    }
    let turns = (u.iter().sum::<f64>() / count as f64 - 0.5).round();
    let mut nodes: Vec<Vec2> = u.iter().zip(&v).map(|(u, v)| Vec2::new((u - turns) as f32, *v as f32)).collect();
    // The ends of an interval spline are fixed, up to rounding.
    nodes[..cells].iter_mut().for_each(|node| node.y = 0.0);
    nodes[cells * cells..].iter_mut().for_each(|node| node.y = 1.0);
    WarpMap::repaired(cells, nodes).map_err(|reason| Error::NoTable { reason: Arc::new(reason) })
}
