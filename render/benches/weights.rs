//! The largest weights of samplers, as CSV: `cargo bench -p headtail-render --bench weights -- SCENES MAPS MATERIALS SAMPLERS [POINTS [DRAWS]]`, lists with
//! commas, that of materials with semicolons.
//!
//! A weight is light x BRDF x cosine / pdf, without shadows, in luminance, over its mean at the shading point: a picture has fireflies where it is large. Up to
//! POINTS (192) shading points of each view have DRAWS (512) independent draws each; their means are of eight times as many of Sobol's points and `patches`.
//! A row has the largest weight of all, the share of weights above 12, and the largest relative variance of a shading point. `MAP` in the name of a sampler is the
//! map's name without folders and endings, as in `direct:tables/MAP.safetensors`.

mod views;

use std::{error::Error, sync::Arc};

use headtail_render::{
    color::luminance,
    columns::Arena,
    environment::Environment,
    estimator::{Contributions, Estimator},
    points::{PointSet, Points},
    scene::Scene,
    spec::{Place, SamplerSpec},
    tile::{ShadingPoint, Tile},
};
use rayon::prelude::*;
use views::{dressed, stem};

/// What a weight of a sampler that is used alone should not exceed.
const BOUND: f64 = 12.0;
/// The grid of camera rays has so many for each shading point that is asked for, as some see the sky.
const RAYS: usize = 2;

fn main() -> Result<(), Box<dyn Error>> {
    // `cargo bench` adds a flag.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let [scenes, maps, materials, samplers, rest @ ..] = arguments.as_slice() else {
        println!("usage: SCENES MAPS MATERIALS SAMPLERS [POINTS [DRAWS]]");
        return Ok(());
    };
    let number = |place: usize, otherwise: usize| rest.get(place).map_or(Ok(otherwise), |number| number.parse());
    let (points, draws) = (number(0, 192)?, number(1, 512)?);
    println!("map,material,sampler,scene,largest_weight,share_above_{BOUND},largest_relative_variance");
    for map in maps.split(',') {
        let environment = Arc::new(Environment::open(map)?);
        let patches = SamplerSpec::patches().build(&environment)?;
        for scene_name in scenes.split(',') {
            for material in materials.split(';') {
                let scene = dressed(scene_name, material)?;
                let points = shading_points(&scene, points);
                let means = each(&points, &scene, |k, tile| {
                    let weights = weights(&*patches, &tile(8 * draws), Points::new(PointSet::Sobol, k));
                    weights.iter().sum::<f64>() / weights.len() as f64
                });
                for sampler in samplers.split(',') {
                    let spec: SamplerSpec = sampler.replace("MAP", stem(map)).parse()?;
                    let place = Place { scene: Some(&scene), ..Place::default() };
                    let estimator = spec.build_in(&environment, place)?;
                    let found = each(&points, &scene, |k, tile| {
                        let weights = weights(&*estimator, &tile(draws), Points::new(PointSet::Independent, k));
                        Found::of(&weights, means[k as usize])
                    });
                    let all = found.into_iter().fold(Found::default(), Found::joined);
                    println!(
                        "{},{material},{sampler},{},{:.2},{:.1e},{:.3}",
                        stem(map),
                        stem(scene_name),
                        all.largest,
                        all.above / all.count,
                        all.variance
                    );
                }
            }
        }
    }
    Ok(())
}

/// What the camera sees through a grid of rays.
fn shading_points(scene: &Scene, count: usize) -> Vec<ShadingPoint> {
    let height = (0.75 * (RAYS * count) as f64).sqrt().ceil() as usize;
    let (width, camera) = (height * 4 / 3, scene.camera());
    let ray = |k: usize| camera.ray((k % width) as f32 + 0.5, (k / width) as f32 + 0.5, width, height);
    let hits: Vec<ShadingPoint> = (0..width * height).filter_map(|k| scene.intersect(&ray(k))).collect();
    let step = hits.len().div_ceil(count).max(1);
    hits.into_iter().step_by(step).collect()
}

/// Work for every shading point, with its number and tiles of copies of it.
fn each<T: Send>(
    points: &[ShadingPoint],
    scene: &Scene,
    work: impl Fn(u64, &dyn Fn(usize) -> Tile) -> T + Sync,
) -> Vec<T> {
    let one = |(k, point): (usize, &ShadingPoint)| {
        work(k as u64, &|copies| Tile::of_table(&vec![*point; copies], scene.brdfs()))
    };
    points.par_iter().enumerate().map(one).collect()
}

/// The estimates of all rows of a tile, without shadows.
fn weights(estimator: &dyn Estimator, tile: &Tile, points: Points) -> Vec<f64> {
    let (arena, mut drawn) = (Arena::default(), Contributions::default());
    estimator.propose(&tile.rows(), &points, &mut drawn, &arena);
    let mut weights = vec![0.0; tile.len()];
    for (&place, &radiance) in drawn.places().iter().zip(drawn.radiance()) {
        weights[usize::from(place)] += f64::from(luminance(radiance));
    }
    weights
}

/// What is found of one shading point, or of many.
#[derive(Clone, Copy, Default)]
struct Found {
    largest: f64,
    above: f64,
    count: f64,
    variance: f64,
}

impl Found {
    /// Nothing where no light is reflected.
    fn of(weights: &[f64], mean: f64) -> Self {
        if mean <= 0.0 {
            return Self::default();
        }
        let ratios = weights.iter().map(|weight| weight / mean);
        Self {
            largest: ratios.clone().fold(0.0, f64::max),
            above: ratios.clone().filter(|&ratio| ratio > BOUND).count() as f64,
            count: weights.len() as f64,
            variance: ratios.map(|ratio| (ratio - 1.0).powi(2)).sum::<f64>() / weights.len() as f64,
        }
    }

    fn joined(self, other: Self) -> Self {
        Self {
            largest: self.largest.max(other.largest),
            above: self.above + other.above,
            count: self.count + other.count,
            variance: self.variance.max(other.variance),
        }
    }
}
