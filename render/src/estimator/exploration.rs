//! Shadow rays that are sent to learn from: many from each point, and for their answers alone.

use glam::Vec3A;

use super::Contributions;
use crate::{
    columns::Arena,
    points::{Dimension, Points},
    sampler::{Draws, Sampler, prepared},
    tile::Rows,
    timings::{Stage, timed},
};

/// Adds `rays` directions for each row that a sampler draws and that its surface reflects; what they add to an estimate is of no account.
///
/// A further ray from a point costs a third of a point with its camera ray and its masses, and says as much of the cell that the point is in.
pub(super) fn explore(
    sampler: &dyn Sampler,
    at: &Rows<'_>,
    points: &Points,
    rays: u32,
    out: &mut Contributions,
    arena: &Arena,
) {
    let mut columns = arena.columns::<9>(at.strips());
    let [u, v, x, y, z, pdf, red, green, blue] = columns.get_mut();
    timed(Stage::Sampling, || {
        prepared(sampler, at, arena, |state| {
            for index in 0..rays {
                points.draw(Dimension::Candidate { technique: 0, index, of: rays }, at, [&mut *u, &mut *v]);
                sampler.sample(at, state, [u, v], Draws { wi: [&mut *x, &mut *y, &mut *z], pdf: &mut *pdf }, arena);
                // What a surface does not reflect is below it.
                at.brdf_cosine([x, y, z], [&mut *red, &mut *green, &mut *blue], arena);
                let [x, y, z, pdf, red, green, blue] =
                    [&*x, &*y, &*z, &*pdf, &*red, &*green, &*blue].map(<[_]>::as_flattened);
                for place in 0..at.len() {
                    if pdf[place] > 0.0 && red[place] + green[place] + blue[place] > 0.0 {
                        out.push(place, Vec3A::new(x[place], y[place], z[place]), Vec3A::ZERO);
                    }
                }
            }
        });
    });
}
