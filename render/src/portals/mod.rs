//! Portals: rectangles through which the light of an environment enters a room.
//!
//! Many renderers direct samples of an environment through rectangles that users place at windows and doors.
//! They are found from rays alone: on the plane of an opening, the rays that leave the room fill the smallest
//! area. Planes parallel to large surfaces are searched greedily for the rectangle that maximises `e^2 / a`, of
//! `a` rays that cross it and `e` that also reach the environment; the rays through it are removed, and the
//! search goes on with the rest. With fewer rays scores hardly rise, so that only the planes that were the best
//! ones before are scored again.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | portals; the greedy search |
//! | `rays.rs` | rays from the surfaces of a room |
//! | `plane.rs` | planes, and rectangles on them |
//! | `projection.rs` | rays as lines over the planes of one normal |
//! | `grid.rs` | the rectangles in which the rays cross a plane |

mod grid;
mod plane;
mod projection;
mod rays;
#[cfg(test)]
mod tests;

use rayon::prelude::*;

use self::{
    grid::Grid,
    plane::{Plane, Rectangle, normals},
    projection::Projection,
    rays::RoomRays,
};
pub use headtail_sampling::portals::*;

use crate::{
    error::{Error, Result},
    scene::{Camera, Ray, Scene},
};

/// The portals of a room.
#[derive(Clone, Debug, PartialEq)]
pub struct Portals {
    /// Most light first.
    pub portals: Vec<Portal>,
    /// Fraction of the rays that reach the environment.
    pub openness: f32,
}

/// Openness above which a scene is not a room.
const OPEN: f32 = 0.4;

/// Rays of different seeds find the portals and measure their coverage.
const SEARCH: u64 = 1;
const COVERAGE: u64 = 2;
/// Portals of a room at most.
const MOST: usize = 16;
/// Fraction of the rays reaching the environment below which a rectangle is not proposed.
const LEAST: f32 = 0.004;
/// Positions of planes of one normal, then of the refinement around the best one.
const STEPS: usize = 80;
const FINE_STEPS: usize = 32;
/// Planes that are scored again at once; more of them than threads.
const BATCH: usize = 8;

impl Portals {
    /// Finds the portals of the room that a camera is in. Rays follow diffuse paths from the visible surfaces.
    /// The result is the same on any number of threads.
    ///
    /// # Errors
    /// [`Error::Argument`] if more than 40 % of the rays reach the environment (the scene is not a room), or none.
    pub fn find(scene: &Scene, camera: &Camera) -> Result<Self> {
        let rays = RoomRays::trace(scene, camera, SEARCH, 1);
        let openness = rays.openness();
        let refused = |reason: String| Err(Error::argument(format!("portals of {}", scene.name()), reason));
        if openness > OPEN {
            let percent = 100.0 * openness;
            return refused(format!(
                "{percent:.1} % of the rays from the visible surfaces reach the environment; portals are for rooms"
            ));
        }
        let portals = search(scene, &rays.thinned());
        if portals.is_empty() {
            return refused("no ray from the visible surfaces reaches the environment".to_owned());
        }
        Ok(Self { portals, openness })
    }

    /// Returns the fraction of the rays reaching the environment that pass through the portals, from rays that
    /// these were not found with; 1 of `step` paths is traced.
    pub fn coverage(&self, scene: &Scene, camera: &Camera, step: usize) -> f32 {
        let rays = RoomRays::trace(scene, camera, COVERAGE, step).open;
        let is_covered = |ray: &&Ray| self.portals.iter().any(|portal| portal.is_crossed(ray.origin, ray.direction));
        rays.iter().filter(is_covered).count() as f32 / (rays.len() as f32).max(1.0)
    }
}

/// Estimates [`Portals::openness`] from 1 of `step` paths.
pub fn openness(scene: &Scene, camera: &Camera, step: usize) -> f32 {
    RoomRays::trace(scene, camera, SEARCH, step).openness()
}

/// Returns the portals that rays leave a room through.
fn search(scene: &Scene, rays: &RoomRays) -> Vec<Portal> {
    let least = LEAST * rays.open.len() as f32;
    let mut projections: Vec<Projection> =
        normals(scene).into_iter().map(|(normal, up)| Projection::new(scene, [normal, up], rays)).collect();
    let mut candidates: Vec<Candidate> = (0..projections.len() * STEPS).map(Candidate::unknown).collect();
    candidates.par_iter_mut().for_each(|candidate| candidate.score_on(&projections, rays));
    let (mut remaining, mut portals) = (vec![true; rays.open.len()], Vec::new());
    let mut count = remaining.len();
    while portals.len() < MOST && count as f32 > least {
        let Some(portal) = best(&projections, &mut candidates, rays) else { break };
        let before = count;
        for (remains, ray) in remaining.iter_mut().zip(&rays.open) {
            *remains &= !portal.is_crossed(ray.origin, ray.direction);
        }
        count = remaining.iter().filter(|&&remains| remains).count();
        if (before - count) as f32 <= least {
            break;
        }
        projections.par_iter_mut().for_each(|own| own.keep(&remaining));
        candidates.iter_mut().for_each(|candidate| candidate.is_current = false);
        portals.push(portal);
    }
    portals
}

/// A plane and its best rectangle.
struct Candidate {
    number: usize,
    score: f32,
    rectangle: Option<Rectangle>,
    /// Whether no rays were removed since it was scored.
    is_current: bool,
}

impl Candidate {
    fn unknown(number: usize) -> Self {
        Self { number, score: 0.0, rectangle: None, is_current: false }
    }

    fn plane(&self, projections: &[Projection]) -> Plane {
        projections[self.number / STEPS].plane(self.number % STEPS, STEPS)
    }

    fn score_on(&mut self, projections: &[Projection], rays: &RoomRays) {
        let projection = &projections[self.number / STEPS];
        let best = Grid::new(projection, self.plane(projections), rays.weights).best();
        let (score, rectangle) = best.map_or((0.0, None), |(score, rectangle)| (score, Some(rectangle)));
        *self = Self { score, rectangle, is_current: true, ..*self };
    }
}

/// Returns the rectangle of the highest score on all planes.
fn best(projections: &[Projection], candidates: &mut [Candidate], rays: &RoomRays) -> Option<Portal> {
    // Equal scores are told apart by the number, so that the result does not depend on threads.
    let by_score = |a: &Candidate, b: &Candidate| b.score.total_cmp(&a.score).then(a.number.cmp(&b.number));
    candidates.sort_by(by_score);
    while !candidates.first()?.is_current {
        let outdated = candidates.iter_mut().filter(|candidate| !candidate.is_current);
        let batch: Vec<&mut Candidate> = outdated.take(BATCH).collect();
        batch.into_par_iter().for_each(|candidate| candidate.score_on(projections, rays));
        candidates.sort_by(by_score);
    }
    let (rectangle, projection) = (candidates[0].rectangle?, &projections[candidates[0].number / STEPS]);
    // Between the neighbouring positions, the rays are closest together on the plane of the opening. Where it is
    // deep, rays from its sides cross the outer plane alone.
    let fine: Vec<Plane> = candidates[0].plane(projections).around(FINE_STEPS).collect();
    let fitted = fine.par_iter().enumerate().filter_map(|(number, plane)| {
        let (fitted, crossings) = projection.fitted(&rectangle, *plane)?;
        Some((crossings * crossings / fitted.area(), number, fitted))
    });
    let (_, number, fitted) = fitted.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))?;
    Some(projection.portal(&fine[number], &fitted.with_margin()))
}
