use std::sync::Arc;

use glam::Vec2;

use super::*;
use crate::{
    random::{Purpose, Stream},
    sampler::AtPoint,
    spec::SamplerSpec,
};

fn patches() -> (Arc<Environment>, Arc<dyn Sampler>) {
    let map = Arc::new(Environment::open("studio").unwrap());
    let sampler = SamplerSpec::patches().build_sampler(&map).unwrap();
    (map, sampler)
}

fn directions(count: usize, seed: u64) -> Vec<[f32; 3]> {
    let mut random = Stream::new(seed, Purpose::Test, 0);
    (0..count).map(|_| random.direction().into()).collect()
}

#[test]
fn list_draws_equal_draws_of_single_points() {
    let (map, sampler) = patches();
    // More than two tiles, the last one not full.
    let count = 2 * TILE + 37;
    let (n, u) = (directions(count, 1), directions(count, 2));
    let u: Vec<[f32; 2]> = u.iter().map(|[x, y, _]| [0.499 * x + 0.5, 0.499 * y + 0.5]).collect();
    let at =
        PointList { p: &[], n: &n, wo: &[], surface: SurfaceList::Glossy { alpha: &[0.3], f0: &vec![0.5; count] } };
    let (mut wi, mut pdfs, mut light) = (vec![[0.0; 3]; count], vec![0.0; count], vec![[0.0; 3]; count]);
    let out = DrawList { wi: &mut wi, pdf: &mut pdfs, radiance: Some((&map, &mut light)) };
    sample(&*sampler, &at, Numbers::Given(&u), out).unwrap();
    let mut again = vec![0.0; count];
    let drawn: Vec<usize> = (0..count).filter(|&k| pdfs[k] > 0.0).collect();
    assert!(drawn.len() > count / 2);
    let unit: Vec<[f32; 3]> = (0..count).map(|k| if pdfs[k] > 0.0 { wi[k] } else { n[k] }).collect();
    pdf(&*sampler, &at, &unit, &mut again).unwrap();
    for &k in drawn.iter().step_by(53) {
        let alone = AtPoint::new(&*sampler, &at.point(k).unwrap()).sample(Vec2::from_array(u[k])).unwrap();
        assert_eq!((alone.wi.to_array(), alone.pdf), (wi[k], pdfs[k]), "{k}");
        assert_eq!(map.radiance(alone.wi).to_array(), light[k]);
        // The pdf of the rounded direction differs, which narrow patches amplify.
        assert!((again[k] / pdfs[k] - 1.0).abs() < 1e-2, "{k}: {} {}", again[k], pdfs[k]);
    }
}

#[test]
fn prepared_points_draw_and_evaluate_the_same() {
    let (map, sampler) = patches();
    let count = TILE + 37;
    let (n, p, wi) = (directions(count, 1), directions(count, 2), directions(count, 3));
    let (roughness, metallic) = (vec![0.4; count], [0.5]);
    let gltf =
        SurfaceList::MetallicRoughness { base_color: &[[0.9, 0.5, 0.1]], metallic: &metallic, roughness: &roughness };
    for surface in [SurfaceList::Diffuse, SurfaceList::Glossy { alpha: &[0.2], f0: &[0.8] }, gltf] {
        let at = PointList { p: &p, n: &n, wo: &[], surface };
        let prepared = PreparedPoints::new(sampler.clone(), &at, count).unwrap();
        assert_eq!(prepared.count(), count);
        let drawn = |draw: &dyn Fn(DrawList<'_>) -> Result<()>| {
            let (mut wi, mut pdf, mut light) = (vec![[0.0; 3]; count], vec![0.0; count], vec![[0.0; 3]; count]);
            draw(DrawList { wi: &mut wi, pdf: &mut pdf, radiance: Some((&map, &mut light)) }).unwrap();
            (wi, pdf, light)
        };
        for seed in [1, 2] {
            let once = drawn(&|out| sample(&*sampler, &at, Numbers::Seed(seed), out));
            assert!(once == drawn(&|out| prepared.sample(Numbers::Seed(seed), out)));
            assert!(once.1.iter().filter(|&&pdf| pdf > 0.0).count() > count / 2);
        }
        let (mut once, mut again) = (vec![0.0; count], vec![0.0; count]);
        pdf(&*sampler, &at, &wi, &mut once).unwrap();
        prepared.pdf(&wi, &mut again).unwrap();
        assert!(once == again && once.iter().any(|&pdf| pdf > 0.0));
        let fault = prepared.pdf(&wi[1..], &mut again[1..]).unwrap_err().to_string();
        assert!(fault.contains("pdf") && fault.contains("are needed"), "{fault}");
    }
}

#[test]
fn seeded_numbers_depend_only_on_seed_and_index() {
    let (_, sampler) = patches();
    let at = PointList { p: &[], n: &[[0.0, 1.0, 0.0]], wo: &[], surface: SurfaceList::Diffuse };
    let draw = |count: usize, seed: u64| {
        let (mut wi, mut pdfs) = (vec![[0.0; 3]; count], vec![0.0; count]);
        let out = DrawList { wi: &mut wi, pdf: &mut pdfs, radiance: None };
        sample(&*sampler, &at, Numbers::Seed(seed), out).unwrap();
        (wi, pdfs)
    };
    let (long, short) = (draw(3 * TILE, 7), draw(TILE + 5, 7));
    assert_eq!((&long.0[..TILE + 5], &long.1[..TILE + 5]), (&short.0[..], &short.1[..]));
    assert_ne!(draw(TILE, 8).1, draw(TILE, 7).1);
}

#[test]
fn errors_name_the_first_invalid_row() {
    let (map, sampler) = patches();
    let count = 3 * TILE;
    let good = vec![[0.0, 1.0, 0.0]; count];
    let refused = |n: &[[f32; 3]], alpha: &[f32], u: &[[f32; 2]], rows: usize| {
        let at = PointList { p: &[], n, wo: &[], surface: SurfaceList::Glossy { alpha, f0: &[1.0] } };
        let (mut wi, mut pdfs, mut light) = (vec![[0.0; 3]; rows], vec![0.0; count], vec![[0.0; 3]; count]);
        let out = DrawList { wi: &mut wi, pdf: &mut pdfs, radiance: Some((&map, &mut light)) };
        sample(&*sampler, &at, Numbers::Given(u), out).unwrap_err().to_string()
    };
    let u = vec![[0.5; 2]; count];
    let with = |place: usize, value: [f32; 3]| {
        let mut list = good.clone();
        (list[place], list[count - 1]) = (value, [f32::NAN; 3]);
        list
    };
    assert!(refused(&good[1..], &[0.3], &u, count).contains("n: has 3071 rows; 3072, or 1 for all"));
    assert!(refused(&good, &[], &u, count).contains("alpha: has 0 rows"));
    assert!(refused(&good, &[0.3], &u[2..], count).contains("u: has 3070 rows"));
    assert!(refused(&good, &[0.3], &u, 1).contains("wi: has 1 rows"));
    for value in [[0.0; 3], [0.0, 2.0, 0.0], [f32::NAN; 3], [f32::INFINITY, 0.0, 0.0]] {
        assert!(refused(&with(1500, value), &[0.3], &u, count).contains("n: row 1500 is"));
    }
    for alpha in [0.0, -1.0, 1.5, f32::NAN] {
        assert!(refused(&good, &[alpha], &u, count).contains("alpha: row 0 is"), "{alpha}");
    }
    for number in [1.0, -1e-9, f32::NAN] {
        let mut u = u.clone();
        u[1100][1] = number;
        assert!(refused(&good, &[0.3], &u, count).contains("u: row 1100 is (0.5,"), "{number}");
    }
}
