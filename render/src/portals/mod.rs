//! Portals: rectangles through which the light of an environment enters a room.
//!
//! Many renderers direct samples of an environment through rectangles that users place at windows and doors.
//! They are found from rays alone: on the plane of an opening, the rays that leave the room fill the smallest
//! area. Planes parallel to large surfaces are searched greedily for the rectangle that maximises `e^2 / a`, of
//! `a` rays that cross it and `e` that also reach the environment; the rays through it are removed, and the
//! search goes on with the rest.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | portals; the greedy search |
//! | `rays.rs` | rays from the surfaces of a room |
//! | `plane.rs` | planes, and rectangles on them |
//! | `grid.rs` | the rectangles in which the rays cross a plane |

mod grid;
mod plane;
mod rays;
#[cfg(test)]
mod tests;

use rayon::prelude::*;

use self::{
    grid::Grid,
    plane::{Axes, Plane, Rectangle},
    rays::RoomRays,
};
pub use headtail_sampling::portals::*;

use crate::scene::{Camera, Scene};

/// The portals of a room.
#[derive(Clone, Debug, PartialEq)]
pub struct Portals {
    /// Most light first.
    pub portals: Vec<Portal>,
    /// Fraction of the rays reaching the environment that pass through the portals, from rays that the portals
    /// were not found with.
    pub coverage: f32,
    /// Fraction of the rays that reach the environment.
    pub openness: f32,
}

/// Rays of different seeds find the portals and measure their coverage.
const SEARCH: u64 = 1;
const COVERAGE: u64 = 2;
/// Portals of a room at most.
const MOST: usize = 16;
/// Fraction of the rays reaching the environment below which a rectangle is not proposed.
const LEAST: f32 = 0.004;
/// Positions of planes of one normal, then of the refinement around the best one.
const STEPS: usize = 160;
const FINE_STEPS: usize = 32;

impl Portals {
    /// Finds the portals of the room that a camera is in. Rays follow diffuse paths from the visible surfaces.
    /// The result is the same on any number of threads.
    pub fn find(scene: &Scene, camera: &Camera) -> Self {
        let rays = RoomRays::trace(scene, camera, SEARCH);
        let openness = rays.openness();
        let axes = Axes::of(scene);
        let mut remaining = rays.thinned();
        let total = remaining.open.len() as f32;
        let mut portals = Vec::new();
        while portals.len() < MOST && remaining.open.len() as f32 > LEAST * total {
            let Some(portal) = best(scene, &axes, &remaining) else { break };
            let before = remaining.open.len();
            remaining.open.retain(|ray| !portal.is_crossed(ray.origin, ray.direction));
            if (before - remaining.open.len()) as f32 <= LEAST * total {
                break;
            }
            portals.push(portal);
        }
        let others = RoomRays::trace(scene, camera, COVERAGE).open;
        let is_covered =
            |ray: &&crate::scene::Ray| portals.iter().any(|portal| portal.is_crossed(ray.origin, ray.direction));
        let coverage = others.iter().filter(is_covered).count() as f32 / (others.len() as f32).max(1.0);
        Self { portals, coverage, openness }
    }
}

/// Returns the rectangle of the highest score on all planes.
fn best(scene: &Scene, axes: &Axes, rays: &RoomRays) -> Option<Portal> {
    let planes: Vec<Plane> = axes.planes(scene, STEPS).collect();
    let (plane, rectangle) = highest(&planes, rays)?;
    // Between the neighbouring positions, the rays are closest together on the plane of the opening. Where it is
    // deep, rays from its sides cross the outer plane alone.
    let fine: Vec<Plane> = plane.around(FINE_STEPS).collect();
    let fitted = fine.par_iter().enumerate().filter_map(|(number, plane)| {
        let (fitted, crossings) = rectangle.fitted(plane, rays)?;
        Some((crossings * crossings / fitted.area(), number, fitted))
    });
    let (_, number, fitted) = fitted.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))?;
    Some(fine[number].portal(&fitted.with_margin()))
}

/// Returns the rectangle of the highest score, and its plane.
fn highest(planes: &[Plane], rays: &RoomRays) -> Option<(Plane, Rectangle)> {
    let scored = planes.par_iter().enumerate().filter_map(|(number, plane)| {
        let (score, rectangle) = Grid::new(plane, rays).best()?;
        Some((score, number, rectangle))
    });
    // Equal scores are told apart by the number, so that the result does not depend on threads.
    let (_, number, rectangle) = scored.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))?;
    Some((planes[number], rectangle))
}
