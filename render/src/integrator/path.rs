//! The steps of a path, for renderings and composites: camera rays, shadow rays and bounces.

use glam::Vec3A;

use crate::{
    columns::Arena,
    estimator::Contributions,
    morton::morton,
    points::{Dimension, Points},
    scene::{Camera, Ray, Scene},
    simd::{LANES, Lanes},
    tile::Tile,
};

/// First bounce with Russian roulette.
const ROULETTE_FROM: u32 = 3;

/// Maximum probability of survival, so that paths between white walls end.
const MOST_SURVIVAL: f32 = 0.95;

/// Angular spread in radians of rays after a bounce, for texture filtering: indirect light is blurred anyway,
/// and less detail means less noise.
pub(crate) const BOUNCE_SPREAD: f32 = 0.05;

/// Returns the key of a pixel's points.
pub(crate) fn key_of((x, y): (u16, u16)) -> u32 {
    morton(x, y)
}

/// Fills `rays` with one camera ray through each pixel of an image of `width x height`.
pub(crate) fn camera_rays(
    camera: &Camera,
    (width, height): (usize, usize),
    pixels: &[(u16, u16)],
    points: &Points,
    rays: &mut Vec<Ray>,
    arena: &Arena,
) {
    let mut jitter = arena.columns::<2>(pixels.len().div_ceil(LANES));
    points.draw_keyed(Dimension::Camera, pixels.len(), |place| key_of(pixels[place]), jitter.get_mut());
    let [across, down] = jitter.get().map(<[Lanes]>::as_flattened);
    rays.clear();
    rays.extend(
        pixels
            .iter()
            .zip(across)
            .zip(down)
            .map(|((&(x, y), across), down)| camera.ray(f32::from(x) + across, f32::from(y) + down, width, height)),
    );
}

/// Fills `rays` with the shadow rays of contributions to the points of a tile.
pub(crate) fn shadow_rays(scene: &Scene, tile: &Tile, contributions: &Contributions, rays: &mut Vec<Ray>) {
    rays.clear();
    rays.extend(contributions.places().iter().zip(contributions.wi()).map(|(&place, &wi)| {
        let (p, ng) = tile.position_and_normal(place as usize);
        scene.leaving(p, ng, wi)
    }));
}

/// Continues the paths at the points of a tile by BRDF sampling, as bounce number `bounce`.
///
/// `throughput` returns the new throughput of the path at a place, given the weight `f cos / pdf` of the
/// reflection; `go_on` receives the place, throughput and ray of each path that does not end.
pub(crate) fn bounce(
    scene: &Scene,
    tile: &Tile,
    (points, bounce): (&Points, u32),
    arena: &Arena,
    throughput: impl Fn(usize, Vec3A) -> Vec3A,
    mut go_on: impl FnMut(usize, Vec3A, Ray),
) {
    let at = tile.rows();
    let mut columns = arena.columns::<10>(at.strips());
    let [u, v, roulette, x, y, z, pdf, red, green, blue] = columns.get_mut();
    points.draw(Dimension::Path, &at, [&mut *u, &mut *v, &mut *roulette]);
    at.sample_brdf([u, v], [&mut *x, &mut *y, &mut *z], pdf, arena);
    at.brdf_cosine([x, y, z], [&mut *red, &mut *green, &mut *blue], arena);
    for place in 0..at.len() {
        let (strip, lane) = (place / LANES, place % LANES);
        let pdf = pdf[strip][lane];
        let f = Vec3A::new(red[strip][lane], green[strip][lane], blue[strip][lane]);
        let mut throughput = throughput(place, if pdf > 0.0 { f / pdf } else { Vec3A::ZERO });
        if bounce >= ROULETTE_FROM {
            let survival = throughput.max_element().min(MOST_SURVIVAL);
            throughput = if roulette[strip][lane] < survival { throughput / survival } else { Vec3A::ZERO };
        }
        if throughput.max_element() > 0.0 {
            let (p, ng) = tile.position_and_normal(place);
            go_on(place, throughput, scene.leaving(p, ng, Vec3A::new(x[strip][lane], y[strip][lane], z[strip][lane])));
        }
    }
}
