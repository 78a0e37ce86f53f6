use std::{path::Path, sync::Arc};

use glam::{Vec2, Vec3A};

use super::*;
use crate::{
    brdf::{
        BrdfTable,
        neural_texture::tests::{point, random_material},
    },
    one_point::OnePoint,
    random::{Purpose, Stream},
    sampler::{Draws, Sampler},
    tile::ShadingPoint,
};

/// Returns a sampler with random weights; `size` scales them.
fn random_rival(kind: RivalKind, seed: u64, size: f32) -> Rival {
    let mut random = Stream::new(seed, Purpose::Test, 7);
    let mut layer = |inputs: usize, outputs: usize| {
        let mut number = |scale: f32| size * scale * (2.0 * random.uniform() - 1.0);
        let weight: Vec<f32> = (0..inputs * outputs).map(|_| number(1.7 / (inputs as f32).sqrt())).collect();
        Linear::new("layer", inputs, outputs, &weight, (0..outputs).map(|_| number(0.3)).collect()).unwrap()
    };
    let networks = kind.networks().iter();
    let networks = networks.map(|(_, sizes)| sizes.windows(2).map(|size| layer(size[0], size[1])).collect());
    Rival::new(kind, networks.collect()).unwrap()
}

/// Returns a point of a material with random weights, and a sampler for it.
fn case(kind: RivalKind, seed: u64, size: f32) -> (OnePoint, RivalSampler) {
    let material = Arc::new(random_material(seed, 8));
    let sampler = RivalSampler::new(vec![(material.hash(), random_rival(kind, seed, size))]);
    let (table, brdf) = BrdfTable::default().with(material.clone());
    let mut random = Stream::new(seed, Purpose::Test, 8);
    let at: ShadingPoint = point(&material, brdf, &mut random, 80.0);
    (OnePoint::of_table(&at, 4096, &table), sampler)
}

fn draws(one: &OnePoint, sampler: &RivalSampler, u: &[Vec2]) -> Vec<Option<(Vec3A, f32)>> {
    one.map(u, |u, [x, y, z, pdf]: [&mut [Lanes]; 4]| {
        sampler.sample(&one.tile().rows(), &[], u, Draws { wi: [x, y, z], pdf }, &one.arena);
    })
    .map(|[x, y, z, pdf]| (pdf > 0.0).then_some((Vec3A::new(x, y, z), pdf)))
    .collect()
}

fn pdfs(one: &OnePoint, sampler: &RivalSampler, wi: &[Vec3A]) -> Vec<f32> {
    one.map(wi, |wi, [pdf]| sampler.pdf(&one.tile().rows(), &[], wi, pdf, &one.arena)).map(|[pdf]| pdf).collect()
}

/// Kinds, and the scale of weights of random samplers: larger weights have structure that the cells of the
/// test do not resolve.
const CASES: [(RivalKind, f32); 3] = [(RivalKind::Lobes, 1.5), (RivalKind::Flow, 0.7), (RivalKind::Reparam, 0.4)];
const SEEDS: u64 = 4;

#[test]
fn draws_follow_a_density_that_integrates_to_the_acceptance_rate() {
    for (kind, size) in CASES {
        for seed in 0..SEEDS {
            let (one, sampler) = case(kind, seed, size);
            // Cells at the horizon are cut: their integral is off by several 0.1 %.
            let test = headtail_render::statistics::SphereChiSquare {
                rows: 25,
                subcells: 15,
                samples: 100_000,
                tests: CASES.len() * SEEDS as usize,
                mass_tolerance: 1e-2,
                ..Default::default()
            };
            let draw = |random: &mut headtail_render::random::Stream, count: usize| {
                let u: Vec<Vec2> = (0..count).map(|_| random.uniform2()).collect();
                draws(&one, &sampler, &u).into_iter().map(|drawn| Some(drawn?.0)).collect()
            };
            test.run(draw, |w| pdfs(&one, &sampler, w)).assert_passed(&format!("rival {} {seed}", kind.name()));
        }
    }
}

#[test]
fn density_of_a_draw_matches_its_pdf() {
    for (kind, size) in CASES {
        for seed in 0..SEEDS {
            let (one, sampler) = case(kind, seed, size);
            let mut random = Stream::new(seed, Purpose::Test, 9);
            let u: Vec<Vec2> = (0..4096).map(|_| random.uniform2()).collect();
            let drawn: Vec<(Vec3A, f32)> = draws(&one, &sampler, &u).into_iter().flatten().collect();
            assert!(drawn.len() > 200, "{kind:?} {seed}: {}", drawn.len());
            let wi: Vec<Vec3A> = drawn.iter().map(|(wi, _)| *wi).collect();
            let worst = drawn.iter().zip(pdfs(&one, &sampler, &wi)).filter(|((_, own), there)| {
                // Directions are rounded to f32 in world axes: near the horizon and at steep splines that
                // changes densities.
                (own - there).abs() > 2e-2 * own.max(*there)
            });
            assert!(worst.count() * 200 <= drawn.len(), "{kind:?} {seed}");
        }
    }
}

#[test]
fn estimates_are_unbiased_where_the_network_folds() {
    // With large weights, the network maps several points to one direction: 10 % or more of its draws are
    // rejected.
    for (kind, size) in [(RivalKind::Lobes, 1.5), (RivalKind::Reparam, 0.4), (RivalKind::Reparam, 1.0)] {
        for seed in 0..SEEDS {
            let (one, sampler) = case(kind, seed, size);
            let n = one.tile().point(0).ns;
            let mut random = Stream::new(seed, Purpose::Test, 12);
            let u: Vec<Vec2> = (0..100_000).map(|_| random.uniform2()).collect();
            let drawn = draws(&one, &sampler, &u);
            let folds = drawn.iter().filter(|drawn| drawn.is_none()).count() > u.len() / 20;
            assert!(folds || kind == RivalKind::Lobes || size < 1.0, "{seed}: nothing folds");
            // The integral of cosine over pi is 1.
            let values =
                drawn.iter().flatten().map(|(wi, pdf)| f64::from(n.dot(*wi).max(0.0) / (std::f32::consts::PI * pdf)));
            let (sum, squares) = values.fold((0.0, 0.0), |(sum, squares), v| (sum + v, squares + v * v));
            let mean = sum / u.len() as f64;
            let error = ((squares / u.len() as f64 - mean * mean) / u.len() as f64).sqrt();
            // 12 tests: 5 standard errors fail once in 100,000 runs.
            assert!((mean - 1.0).abs() < 5.0 * error, "{kind:?} {size} {seed}: {mean} +- {error}");
        }
    }
}

#[test]
fn other_materials_use_brdf_sampling() {
    let (one, _) = case(RivalKind::Flow, 0, 1.0);
    let other = RivalSampler::new(vec![(blake3::hash(b"another"), random_rival(RivalKind::Flow, 0, 1.0))]);
    let mut random = Stream::new(0, Purpose::Test, 10);
    let u: Vec<Vec2> = (0..100).map(|_| random.uniform2()).collect();
    assert_eq!(draws(&one, &other, &u), one.sample_brdf(&u));
    assert!(other.check(&BrdfTable::default()).is_err());
}

#[test]
fn files_round_trip_and_damaged_files_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rival.safetensors");
    for kind in RivalKind::ALL {
        let rivals = vec![("cloth".to_owned(), blake3::hash(b"cloth"), random_rival(kind, 1, 1.0))];
        RivalFile { kind, rivals, seconds: None }.write(&path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let read = RivalFile::read(&path).unwrap();
        assert_eq!((read.kind, read.rivals[0].0.as_str(), read.rivals[0].1), (kind, "cloth", blake3::hash(b"cloth")));
        read.write(&path).unwrap();
        assert!(std::fs::read(&path).unwrap() == bytes);
        for cut in [0, 7, 8, 100, bytes.len() - 1] {
            assert!(RivalFile::from_bytes(Path::new("cut"), &bytes[..cut]).is_err(), "{cut}");
        }
        let mut random = Stream::new(3, Purpose::Test, 11);
        for _ in 0..300 {
            let mut damaged = bytes.clone();
            let at = (random.uniform() * damaged.len() as f32) as usize;
            damaged[at] = (256.0 * random.uniform()) as u8;
            // Weights may change, but any file that is read is a sampler of the right sizes.
            if let Err(error) = RivalFile::from_bytes(Path::new("damaged"), &damaged) {
                assert!(!error.to_string().contains('\n'));
            }
        }
    }
    let error = RivalSampler::open(&path, &[RivalKind::Flow]).unwrap_err().to_string();
    assert!(error.contains("'reparam'") && error.contains("flow"), "{error}");
}

/// Returns a file's bytes with changed metadata.
fn with_metadata(bytes: &[u8], change: impl FnOnce(&mut serde_json::Value)) -> Vec<u8> {
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let mut header: serde_json::Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
    let text = header["__metadata__"]["headtail-rival"].as_str().unwrap();
    let mut described: serde_json::Value = serde_json::from_str(text).unwrap();
    change(&mut described);
    header["__metadata__"]["headtail-rival"] = described.to_string().into();
    let header = header.to_string().into_bytes();
    [&(header.len() as u64).to_le_bytes()[..], &header, &bytes[8 + length..]].concat()
}

#[test]
fn invalid_metadata_is_rejected() {
    type Change<'a> = &'a dyn Fn(&mut serde_json::Value);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rival.safetensors");
    let kind = RivalKind::Lobes;
    let rival = |name: &str| (name.to_owned(), blake3::hash(name.as_bytes()), random_rival(kind, 1, 1.0));
    RivalFile { kind, rivals: vec![rival("cloth"), rival("wool")], seconds: Some(1.5) }.write(&path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let read = |change: Change<'_>| {
        RivalFile::from_bytes(Path::new("file"), &with_metadata(&bytes, change)).map_err(|error| error.to_string())
    };
    assert!(read(&|_| ()).is_ok());
    let wool = |described: &serde_json::Value| described["materials"][1].clone();
    let cases: [(Change<'_>, &str); 9] = [
        (&|d| d["format_version"] = 2.into(), "reads version 1"),
        (&|d| d["format_version"] = (-1).into(), "headtail-rival"),
        (&|d| d["kind"] = "flow".into(), "instead of"),
        (&|d| d["kind"] = "unheard-of".into(), "unknown variant"),
        (&|d| d["more"] = 1.into(), "unknown field"),
        (&|d| d["materials"] = serde_json::json!([]), "there are 0"),
        (&|d| d["materials"] = vec![wool(d); 257].into(), "there are 257"),
        (&|d| d["materials"][0] = wool(d), "twice"),
        (&|d| d["materials"][0]["identity"] = "f00".into(), "hexadecimal hash"),
    ];
    for (change, words) in cases {
        let error = read(change).unwrap_err();
        assert!(error.contains(words) && !error.contains('\n'), "{words}: {error}");
    }
}
