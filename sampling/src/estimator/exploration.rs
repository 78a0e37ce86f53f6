//! Shadow rays that are sent to learn from: many from each point, and for their answers alone.

use super::Contributions;
use crate::{
    columns::Arena,
    patches::SkyRays,
    points::{Dimension, Points},
    tile::Rows,
    timings::{Stage, timed},
};

/// Adds `rays` directions for each row, in proportion to what is reflected of the patches of a sky; what they add to an estimate is of no account.
///
/// A further ray from a point costs a third of a point with its camera ray and its masses, and says as much of the cell that the point is in.
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
