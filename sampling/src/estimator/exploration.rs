//! Shadow rays that visibility is learned from: several per shading point.

use super::Contributions;
use crate::{
    columns::Arena,
    patches::SkyRays,
    points::{Dimension, Points},
    tile::Rows,
    timings::{Stage, timed},
};

/// Adds `rays` rays for each row, in proportion to the reflected light of patches; their contributions are 0.
///
/// Another ray from the same point costs 1/3 of a new point (camera ray and masses), and is as informative
/// about the cell.
pub(super) fn explore(
    sky: &SkyRays,
    at: &Rows<'_>,
    points: &Points,
    rays: u32,
    out: &mut Contributions,
    arena: &Arena,
) {
    let mut columns = arena.columns::<2>(at.strips());
    points.draw(Dimension::Light(0), at, columns.get_mut());
    timed(Stage::Sampling, || {
        sky.send(at, rays, columns.get(), |place, wi, patch| out.push_ray(place, wi, patch), arena);
    });
}
