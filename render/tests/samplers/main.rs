//! Tests that every sampler draws from its pdf, covers the integrand, and estimates the same light as all
//! others.
//!
//! Each property is a function that returns the failure (`checks`), so that deliberately broken samplers
//! (`faulty`) are tested with the same functions. All use the columns of the renderer, in tiles of copies of
//! one point; `mixed_tiles` compares these with tiles of different points. Seeds are fixed, so that results
//! are equal on all machines of the same arithmetic.

mod checks;
mod conditioned;
mod faulty;
mod glossy;
#[path = "../layers/mod.rs"]
mod layers;
mod mixed_tiles;
#[path = "../networks/mod.rs"]
mod networks;
mod textured;
mod truth;
mod worlds;

use std::sync::{Arc, LazyLock};

use checks::*;
use glam::{Vec2, Vec3, Vec3A};
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    brdf::{BrdfTable, Lambert},
    columns::Arena,
    estimator::Estimator,
    head::{Condition, Head, Mode},
    random::{Purpose, Stream},
    sampler::*,
    statistics::Moments,
    tile::{ShadingPoint, Tile},
};
use rayon::prelude::*;
use worlds::*;

/// Probability that any test of a group rejects a correct sampler.
const SIGNIFICANCE: f64 = 0.01;

/// The analytic BRDFs, two grey networks, and the neural materials of [`textured`].
static BRDFS: LazyLock<BrdfTable> = LazyLock::new(|| {
    let table = networks::table(&[&networks::MIRROR, &networks::MATTE]);
    textured::FABRICS.iter().fold(table, |table, fabric| table.with(fabric.clone()).0)
});

/// Runs a check for every sampler of every world, over `count` normals each that vary between cases, so that
/// every kind of sampler is tested with every normal.
fn for_all(count: usize, check: impl Fn(&World, &Case, &ShadingPoint, usize) -> Verdict + Sync) {
    let tasks: Vec<_> = WORLDS
        .iter()
        .enumerate()
        .flat_map(|(w, world)| {
            let normals = world.normals();
            world.cases.iter().enumerate().flat_map(move |(c, case)| {
                let normals = normals.clone();
                // 4 and 3 are coprime to the 11 normals: all of them occur.
                (0..count).map(move |k| (world, case, normals[(4 * w + 3 * c + 2 * k) % normals.len()]))
            })
        })
        .collect();
    let failures: Vec<String> = tasks
        .par_iter()
        .filter_map(|(world, case, normal)| {
            let verdict = check(world, case, &shading_point(*normal), tasks.len());
            verdict.err().map(|reason| format!("{} / {}, normal {normal}: {reason}", world.name, case.name))
        })
        .collect();
    assert!(failures.is_empty(), "{} of {}:\n{}", failures.len(), tasks.len(), failures.join("\n"));
}

#[test]
fn directions_are_drawn_with_the_claimed_density() {
    for_all(1, |world, case, at, tests| {
        // The row-column tail shears the rows of the map that cross a sun: within 0.5 degrees of elevation,
        // an edge of a cell of Y moves by 90 degrees in azimuth, and dim cells get too few points. The
        // oracle, whose cells are the narrowest, needs 12 points (p-values: 1e-24 with 2, 6e-5 with 4, 0.3
        // with 12, 0.4 with 16).
        let probes = match (&*world.name, case.name) {
            ("sunset / row-column", "oracle") => 12,
            ("sunset / row-column", _) => 6,
            // The sun is at the horizon of a downward-facing surface. Weights of patches differ by a factor
            // of 50 there, and two points across miss 2 % of the draws.
            ("sunset / hierarchical", "head over weighted patches") => 12,
            // Below the horizon only slivers of patches are left, and two points across miss lamps and the sun.
            (_, "patches and cosine") => 6,
            _ => 2,
        };
        draws_follow_pdf(&AtPoint::new(&*case.sampler, at), case.through_tail.then_some(&world.dense), probes, tests)
    });
}

#[test]
fn the_pdf_of_a_direction_equals_the_returned_pdf() {
    for_all(2, |_, case, at, _| pdf_of_samples_agrees(&AtPoint::new(&*case.sampler, at), 5_000));
}

#[test]
fn samplers_cover_all_reflected_light() {
    for_all(3, |world, case, at, _| {
        let says = case.sampler.coverage() == Coverage::Everything;
        if says != case.covers {
            return Err(format!("it says that it covers {:?}", case.sampler.coverage()));
        }
        if case.covers { pdf_covers(&AtPoint::new(&*case.sampler, at), world) } else { Ok(()) }
    });
}

#[test]
fn all_samplers_estimate_the_same_light() {
    for_all(3, |world, case, at, tests| {
        // Half of the light in 1e-5 of the sphere: the mean of cosine sampling is far from normally distributed.
        let hopeless = case.name == "cosine" && world.name.starts_with("sunset");
        if !case.covers || hopeless {
            return Ok(());
        }
        let bound = AtPoint::new(&*case.sampler, at);
        mean_of_sampler(&bound, world, world.quadrature.reflected(at.ns), 30_000, tests)
    });
}

#[test]
fn resampling_two_sample_mis_and_splitting_estimate_the_same_light() {
    let tasks: Vec<_> =
        WORLDS.iter().flat_map(|world| (0..11).step_by(4).map(move |k| (world, world.normals()[k]))).collect();
    let failures: Vec<String> = tasks
        .par_iter()
        .flat_map_iter(|(world, normal)| {
            let emitter = || EmitterSampler::new(world.light.clone());
            let grid = (NormalGrid::new(16, 32).unwrap(), CellGrid::new(8, 8).unwrap());
            let table =
                ProductSampler::new(world.light.clone(), direct_bake(world.light.tail(), grid.0, grid.1).unwrap());
            let estimators: Vec<(&str, Box<dyn Estimator>)> = vec![
                ("ris:1", ris(emitter(), 1, world)),
                ("ris:4", ris(emitter(), 4, world)),
                ("ris:16", ris(emitter(), 16, world)),
                ("ris:5 of a table", ris(table.clone(), 5, world)),
                ("mis2", mis2(emitter(), world)),
                ("split:3", split(emitter(), 3, world)),
                ("mis2 of a table", mis2(table, world)),
            ];
            let at = shading_point(*normal);
            let truth = world.quadrature.reflected(*normal);
            let tests = 7 * tasks.len();
            estimators.into_iter().filter_map(move |(name, estimator)| {
                let verdict = mean_is(truth, &estimates(&*estimator, &at, 20_000, 8), tests);
                verdict.err().map(|reason| format!("{} / {name}, normal {}: {reason}", world.name, at.ns))
            })
        })
        .collect();
    assert!(failures.is_empty(), "{} failed:\n{}", failures.len(), failures.join("\n"));
}
