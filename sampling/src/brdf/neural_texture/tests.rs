use std::{path::Path, sync::Arc};

use glam::{Vec2, Vec3, Vec3A};

use super::*;
use crate::{
    brdf::{Brdf, BrdfTable, Surface},
    one_point::OnePoint,
    random::{Purpose, Stream},
    tile::ShadingPoint,
};

/// A material of random weights, with texels rounded as in a file.
pub(crate) fn random_material(seed: u64, side: usize) -> NeuralTexture {
    let mut random = Stream::new(seed, Purpose::Test, 0);
    let mut number = |scale: f32| scale * (2.0 * random.uniform() - 1.0);
    let texels = (0..Pyramid::texel_count(side)).map(|_| std::array::from_fn(|_| number(1.0))).collect();
    let mut layers = |sizes: &[usize]| -> Vec<Linear> {
        let layer = |size: &[usize]| {
            let weight: Vec<f32> = (0..size[0] * size[1]).map(|_| number(1.5 / (size[0] as f32).sqrt())).collect();
            let bias = (0..size[1]).map(|_| number(0.5)).collect();
            Linear::new("layer", size[0], size[1], &weight, bias).unwrap()
        };
        sizes.windows(2).map(layer).collect()
    };
    let networks = Networks {
        shift: layers(&SHIFT_SIZES),
        reflectance: layers(&REFLECTANCE_SIZES),
        mixture: layers(&MIXTURE_SIZES),
        leaky_slope: 0.01,
    };
    let pyramid = Pyramid::new(side, texels).unwrap();
    NeuralTexture::new(pyramid, networks, Description::new("random", 0.01)).unwrap().rounded().unwrap()
}

/// A shading point of a material with random normal, tangent, handedness, and view at most `degrees`
/// from the normal.
pub(crate) fn point(material: &NeuralTexture, brdf: u32, random: &mut Stream, degrees: f32) -> ShadingPoint {
    let n = random.direction();
    let angle = (degrees * random.uniform()).to_radians();
    let wo = (angle.cos() * n + angle.sin() * random.direction().reject_from_normalized(n).normalize()).normalize();
    let (sin, cos) = (6.3 * random.uniform()).sin_cos();
    let hand = if random.uniform() < 0.5 { -1.0 } else { 1.0 };
    let local = {
        let frame = crate::frame::Frame::from_normal(n.into());
        let tangent = cos * frame.s + sin * frame.t;
        let across = hand * Vec3::from(n).cross(tangent);
        Vec3::new(tangent.dot(wo.into()), across.dot(wo.into()), n.dot(wo))
    };
    let seen = Seen { uv: random.uniform2(), width: 0.02, wo: local, tangent: [cos, sin, hand] };
    let surface = Surface { brdf, parameters: material.parameters(&seen) };
    ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface }
}

#[test]
fn draws_match_their_density() {
    const POINTS: usize = 12;
    for seed in 0..POINTS as u64 {
        let material = Arc::new(random_material(seed, 8));
        let (table, brdf) = BrdfTable::default().with(material.clone());
        let mut random = Stream::new(seed, Purpose::Test, 1);
        let at = point(&material, brdf, &mut random, 85.0);
        let one = OnePoint::of_table(&at, 4096, &table);
        // Cells at the horizon are cut: their integral is off by a few tenths of a percent.
        let test = headtail_render::statistics::SphereChiSquare {
            rows: 25,
            subcells: 15,
            samples: 100_000,
            tests: POINTS,
            mass_tolerance: 1e-2,
            ..Default::default()
        };
        let draw = |random: &mut headtail_render::random::Stream, count: usize| {
            let u: Vec<Vec2> = (0..count).map(|_| random.uniform2()).collect();
            one.sample_brdf(&u).into_iter().map(|drawn| Some(drawn?.0)).collect()
        };
        test.run(draw, |w| one.brdf_pdfs(w)).assert_passed("neural_texture");
    }
}

#[test]
fn lobe_and_cosine_sampling_give_the_same_albedo() {
    for seed in 0..6 {
        let material = Arc::new(random_material(seed, 8));
        let (table, brdf) = BrdfTable::default().with(material.clone());
        let mut random = Stream::new(seed, Purpose::Test, 2);
        let at = point(&material, brdf, &mut random, 60.0);
        let one = OnePoint::of_table(&at, 4096, &table);
        let u: Vec<Vec2> = (0..200_000).map(|_| random.uniform2()).collect();
        let (wi, pdfs): (Vec<Vec3A>, Vec<f32>) = one.sample_brdf(&u).into_iter().flatten().unzip();
        let own = moments(one.brdf_cosines(&wi).iter().zip(pdfs).map(|(f, pdf)| f.y / pdf), u.len());
        let (n, cosines): (Vec3A, Vec<Vec3A>) = (at.ns, u.iter().map(|_| random.direction()).collect());
        let cosines: Vec<Vec3A> = cosines.iter().map(|&w| (n + w).normalize_or(n)).collect();
        let values = one.brdf_cosines(&cosines);
        let of_cosine = values.iter().zip(&cosines).map(|(f, w)| f.y * std::f32::consts::PI / n.dot(*w).max(1e-6));
        let of_cosine = moments(of_cosine, u.len());
        // Five standard errors of the difference.
        let allowed = 5.0 * (own.1 + of_cosine.1).sqrt();
        assert!((own.0 - of_cosine.0).abs() < allowed, "{seed}: {own:?} {of_cosine:?}");
    }
}

/// Mean over `count`, and its squared standard error; missing values count as 0.
fn moments(values: impl Iterator<Item = f32>, count: usize) -> (f64, f64) {
    let (mut sum, mut squares) = (0.0, 0.0);
    for value in values.map(f64::from) {
        (sum, squares) = (sum + value, squares + value * value);
    }
    let mean = sum / count as f64;
    (mean, (squares / count as f64 - mean * mean) / count as f64)
}

#[test]
fn extreme_points_give_finite_values() {
    let material = Arc::new(random_material(1, 4));
    let (table, brdf) = BrdfTable::default().with(material.clone());
    let mut random = Stream::new(1, Purpose::Test, 3);
    for uv in [Vec2::splat(1e30), Vec2::NAN, Vec2::new(-0.0, f32::INFINITY)] {
        for width in [0.0, f32::NAN, f32::INFINITY, -1.0] {
            let features = material.features(&Seen { uv, width, wo: Vec3::Z, tangent: [1.0, 0.0, 1.0] });
            assert!(features.iter().all(|feature| feature.is_finite()), "{uv} {width}: {features:?}");
        }
    }
    let below_one = 1.0 - f32::EPSILON / 2.0;
    let corners: Vec<Vec2> =
        [0.0, 1e-7, 0.5, below_one].iter().flat_map(|&x| [0.0, 0.3, below_one].map(|y| Vec2::new(x, y))).collect();
    for _ in 0..200 {
        let at = point(&material, brdf, &mut random, 90.0);
        let one = OnePoint::of_table(&at, 16, &table);
        for (wi, pdf) in one.sample_brdf(&corners).into_iter().flatten() {
            assert!(wi.is_normalized() && pdf > 0.0 && pdf.is_finite(), "{at:?} {wi} {pdf}");
            let value = one.brdf_cosines(&[wi])[0];
            assert!(value.is_finite() && value.min_element() >= 0.0, "{at:?}: {value}");
        }
    }
}

#[test]
fn lobe_widths_and_parameter_counts_are_consistent() {
    let material = Arc::new(random_material(3, 4));
    let (table, brdf) = BrdfTable::default().with(material.clone());
    let at = point(&material, brdf, &mut Stream::new(3, Purpose::Test, 4), 60.0);
    let one = OnePoint::of_table(&at, 16, &table);
    let width = one.lobe_width();
    assert!(width > WIDTHS[0] && width < WIDTHS[0] + WIDTHS[1], "{width}");
    assert_eq!(material.parameters(&Seen::default())[FEATURES..], Seen::default().tangent);
    assert_eq!(Brdf::parameters(&*material), FEATURES + 3);
}

#[test]
fn files_round_trip() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("material.safetensors");
    let mut material = random_material(5, 16);
    material.set_psnr(31.5);
    material.write(&path).unwrap();
    let read = NeuralTexture::read(&path).unwrap();
    assert_eq!(read.description(), material.description());
    assert_eq!(read.pyramid(), material.pyramid());
    assert_eq!(format!("{read:?}"), format!("{material:?}"));
    assert_ne!(format!("{read:?}"), format!("{:?}", random_material(6, 16)));
}

#[test]
fn damaged_files_are_rejected_with_the_field() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("material.safetensors");
    random_material(7, 4).write(&path).unwrap();
    let good = std::fs::read(&path).unwrap();
    let read = |bytes: &[u8]| NeuralTexture::from_bytes(Path::new("m"), bytes);
    let error = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
    assert!(error(b"").contains("not a neural material") && error(&good[..100]).contains("not a neural material"));
    let text = String::from_utf8_lossy(&good).into_owned();
    let altered = |from: &str, to: &str| {
        assert!(text.contains(from) && from.len() == to.len(), "{from}");
        let at = good.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
        let mut bytes = good.clone();
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
        error(&bytes)
    };
    for (from, to, word) in [
        ("\\\"format_version\\\":1", "\\\"format_version\\\":9", "format_version: is neural-texture 9"),
        ("neural-texture", "neural-textile", "neural-textile"),
        ("shift.linear0.bias", "shift.linear9.bias", "'shift.linear0.bias': is missing"),
        ("[16,10]", "[10,16]", "do not fit"),
        ("\\\"steps\\\"", "\\\"stepz\\\"", "unknown field"),
        ("[21,8]", "[8,21]", "[texels, 8] is expected"),
    ] {
        let message = altered(from, to);
        assert!(message.starts_with("m: ") && message.contains(word), "{from}: {message}");
    }
    // Infinite texels in half precision.
    let header = 8 + u64::from_le_bytes(good[..8].try_into().unwrap()) as usize;
    let half = half::f16::INFINITY.to_le_bytes();
    let mut messages = Vec::new();
    for at in (header..good.len() - 1).step_by(37) {
        let mut bytes = good.clone();
        bytes[at..at + 2].copy_from_slice(&half);
        messages.extend(read(&bytes).err().map(|error| error.to_string()));
    }
    assert!(messages.iter().any(|message| message.contains("not finite")), "{messages:?}");
    // Truncated files are rejected.
    for length in (0..good.len()).step_by(101) {
        assert!(read(&good[..length]).is_err(), "{length}");
    }
}
