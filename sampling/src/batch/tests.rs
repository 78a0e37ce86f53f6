use std::sync::Arc;

use glam::{Vec2, Vec3};

use super::*;
use crate::{
    brdf::{
        BrdfTable, Surface,
        neural_texture::{Seen, tests::random_material},
    },
    one_point::OnePoint,
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

#[test]
fn neural_materials_are_those_of_single_points() {
    let (_, sampler) = patches();
    let texture = Arc::new(random_material(1, 8));
    let material = FittedMaterial::neural(texture.clone());
    let (table, brdf) = BrdfTable::default().with(texture.clone());
    let count = 200;
    let (n, wi, along) = (directions(count, 1), directions(count, 2), directions(count, 3));
    let above = |place: usize, w: [f32; 3]| {
        let [n, w] = [n[place], w].map(Vec3::from);
        (w + 1.01 * n).normalize().to_array()
    };
    let wo: Vec<[f32; 3]> = directions(count, 4).iter().enumerate().map(|(k, &w)| above(k, w)).collect();
    let hand = |place: usize| if place.is_multiple_of(2) { 1.0 } else { -1.0 };
    let tangent: Vec<[f32; 4]> =
        along.iter().enumerate().map(|(k, [x, y, z])| [3.0 * x, 3.0 * y, 3.0 * z, hand(k)]).collect();
    let uv: Vec<[f32; 2]> = along.iter().map(|[x, y, _]| [5.0 * x, 5.0 * y]).collect();
    let surface = SurfaceList::Fitted { material: &material, uv: &uv, tangent: &tangent, footprint: &[0.1] };
    let at = PointList { p: &[], n: &n, wo: &wo, surface };
    let mut values = vec![[0.0; 3]; count];
    brdf_cosine(&at, &wi, &mut values).unwrap();
    let (mut drawn, mut pdfs) = (vec![[0.0; 3]; count], vec![0.0; count]);
    let out = DrawList { wi: &mut drawn, pdf: &mut pdfs, radiance: None };
    sample(&*sampler, &at, Numbers::Seed(3), out).unwrap();
    assert!(pdfs.iter().filter(|&&pdf| pdf > 0.0).count() > count / 2);
    let mut lit = 0;
    for place in 0..count {
        // The tangent frame by Gram and Schmidt, with v along the second axis.
        let [normal, view, u] = [n[place], wo[place], along[place]].map(Vec3::from);
        let s = (u - normal * normal.dot(u)).normalize();
        let t = hand(place) * normal.cross(s);
        let frame = crate::frame::Frame::from_normal(normal);
        let seen = Seen {
            uv: uv[place].into(),
            width: 0.1,
            wo: Vec3::new(view.dot(s), view.dot(t), view.dot(normal)),
            tangent: [s.dot(frame.s), s.dot(frame.t), hand(place)],
        };
        let own = Surface { brdf, parameters: texture.parameters(&seen) };
        let point = ShadingPoint { surface: own, ..at.point(place).unwrap() };
        let value = OnePoint::of_table(&point, 1, &table).brdf_cosines(&[wi[place].into()])[0];
        let near = (value - Vec3A::from(values[place])).abs().max_element() <= 1e-3 * value.max_element();
        assert!(near, "{place}: {value} {:?}", values[place]);
        lit += usize::from(value.y > 0.0);
    }
    assert!(lit > count / 4);
}

#[test]
fn errors_of_neural_materials_name_what_is_wrong() {
    let material = FittedMaterial::neural(Arc::new(random_material(2, 8)));
    let (up, right) = ([0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 1.0]);
    let refused = |wo: &[[f32; 3]], uv: &[[f32; 2]], tangent: &[[f32; 4]], footprint: &[f32]| {
        let surface = SurfaceList::Fitted { material: &material, uv, tangent, footprint };
        let at = PointList { p: &[], n: &[up], wo, surface };
        brdf_cosine(&at, &[up; 2], &mut [[0.0; 3]; 2]).map_err(|error| error.to_string())
    };
    assert_eq!(refused(&[up], &[[0.0; 2]], &[right], &[]), Ok(()));
    // What is far away, or does not span the surface, is valid.
    assert_eq!(refused(&[up], &[[1e38; 2]], &[[0.0, 1e38, 0.0, -1.0]], &[1e38]), Ok(()));
    let faults = [
        (refused(&[], &[[0.0; 2]], &[right], &[]), "wo: is needed"),
        (refused(&[up], &[], &[right], &[]), "uv: has 0 rows"),
        (refused(&[up], &[[0.0; 2]], &[], &[]), "tangent: has 0 rows"),
        (refused(&[up], &[[0.0; 2]], &[right; 3], &[]), "tangent: has 3 rows"),
        (refused(&[up], &[[0.0, f32::NAN]], &[right], &[]), "uv: row 0 is (0, NaN)"),
        (refused(&[up], &[[0.0; 2]], &[[1.0, 0.0, 0.0, 0.5]], &[]), "tangent: row 0 is (1, 0, 0, 0.5)"),
        (refused(&[up], &[[0.0; 2]], &[right], &[-1.0]), "footprint: row 0 is -1"),
    ];
    for (fault, reason) in faults {
        let error = fault.unwrap_err();
        assert!(error.contains(reason), "{error}, not {reason}");
    }
    for (name, reason) in [
        ("lambert", "is neither nbrdf:FILE#NAME nor neural:FILE"),
        ("neural:", "is neither"),
        ("nbrdf:#a", "name a file"),
        ("neural:missing.safetensors", "missing.safetensors"),
    ] {
        let error = FittedMaterial::open(name).unwrap_err().to_string();
        assert!(error.contains(reason), "{error}, not {reason}");
    }
}
