//! Neural BRDFs: the network against its definition in f64, its fitted sampling, and its files.

mod networks;

use std::{fs, path::Path, path::PathBuf};

use glam::{DQuat, Vec2, Vec3, Vec3A};
use headtail_render::{
    brdf::{
        BrdfTable, MAX_PARAMETERS, Surface,
        neural::{INPUTS, Network, NeuralBrdf, OUTPUTS, VIEWS, read_networks, write_networks},
    },
    head::Linear,
    latlong,
    one_point::OnePoint,
    random::{Purpose, Stream},
    scene::{MaterialSpec, Scene},
    statistics::{Moments, SphereChiSquare, sidak},
    tile::ShadingPoint,
};
use networks::{MATTE, MIRROR, ODD};
use rayon::prelude::*;

/// Probability that any test of a group rejects a correct BRDF.
const SIGNIFICANCE: f64 = 0.01;

/// Returns the file of real materials, if present.
fn real() -> Option<PathBuf> {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.ancestors().map(|folder| folder.join("shared/data/nbrdf/nbrdf_all.f32")).find(|file| file.is_file())
}

/// Returns synthetic networks and, if present, some real ones.
fn tested() -> Vec<(String, Network)> {
    let mut all: Vec<(String, Network)> =
        [("mirror", MIRROR), ("matte", MATTE), ("odd", ODD)].map(|(name, form)| (name.into(), form.network())).into();
    match real() {
        Some(file) => all.extend(read_networks(&file).unwrap().into_iter().step_by(19)),
        None => println!("shared/data/nbrdf is not there: this test used made-up networks only"),
    }
    all
}

/// Returns a pair of directions above the horizon: independent, or nearly mirrored.
fn pair(random: &mut Stream, near: bool) -> [Vec3; 2] {
    let mut above = || {
        let w = Vec3::from(random.direction());
        (w * w.z.signum() + 0.02 * Vec3::Z).normalize()
    };
    let (wo, wi) = (above(), above());
    if near { [wo, (Vec3::new(-wo.x, -wo.y, wo.z) + 0.1 * wi).normalize()] } else { [wo, wi] }
}

/// Returns `f_r cos` by the definition, with a bound of the f32 error.
///
/// Each layer of n inputs adds up to (n + 2) roundings of the sum of moduli to the errors of its inputs. The
/// first inputs have errors of about 4 roundings, and of 4 more over the sine of the half vector's angle, by
/// which its azimuth is divided.
fn oracle(network: &Network, [wo, wi]: [Vec3; 2]) -> ([f64; OUTPUTS], [f64; OUTPUTS]) {
    const ROUNDING: f64 = 6e-8;
    let (wo, wi) = (wo.as_dvec3().normalize(), wi.as_dvec3().normalize());
    let h = (wo + wi).normalize();
    let (theta, phi) = (h.truncate().length().atan2(h.z), h.y.atan2(h.x));
    let d = DQuat::from_rotation_y(-theta) * (DQuat::from_rotation_z(-phi) * wi);
    let mut x = vec![theta.sin(), 0.0, theta.cos(), d.x, d.y, d.z];
    let mut errors = vec![8.0 * ROUNDING * (1.0 + 1.0 / theta.sin()); INPUTS];
    for (index, layer) in network.layers().iter().enumerate() {
        let rows = layer.weight().chunks_exact(layer.inputs()).zip(layer.bias());
        let row = |(weights, bias): (&[f32], &f32)| {
            let products = || weights.iter().zip(&x).map(|(w, x)| f64::from(*w) * x);
            let passed: f64 = weights.iter().zip(&errors).map(|(w, e)| f64::from(w.abs()) * e).sum();
            let moduli = products().map(f64::abs).sum::<f64>() + f64::from(bias.abs());
            let value = products().sum::<f64>() + f64::from(*bias);
            let value = if index < 2 { value.max(0.0) } else { value };
            (value, passed + (layer.inputs() + 2) as f64 * ROUNDING * moduli)
        };
        (x, errors) = rows.map(row).unzip();
    }
    let value = |k: usize| (x[k].exp() - 1.0).max(0.0) * wi.z;
    // exp adds 2e-7, the subtraction of 1 two roundings, and the cosine a few.
    let error = |k: usize| (x[k].exp() * (errors[k].exp_m1() + 4e-7) + 4.0 * ROUNDING * value(k)) * 1.01;
    (std::array::from_fn(value), std::array::from_fn(error))
}

#[test]
fn networks_match_their_definition() {
    for (name, network) in tested() {
        let mut random = Stream::new(1, Purpose::Test, 0);
        let pairs: Vec<[Vec3; 2]> = (0..2000).map(|k| pair(&mut random, k % 2 == 0)).collect();
        for (pair, value) in pairs.iter().zip(network.of_pairs(&pairs)) {
            let (expected, errors) = oracle(&network, *pair);
            for ((value, expected), error) in value.to_array().into_iter().zip(expected).zip(errors) {
                let off = (f64::from(value) - expected).abs();
                assert!(
                    off <= error,
                    "{name}, {pair:?}: {value}, by definition {expected}, off by {off:e} of {error:e}"
                );
            }
        }
        // The bound is for roundings of one sign, and loose for narrow peaks. Roundings of both signs leave 1
        // % of it or less: the summed error is at most that fraction of the summed reflection, per channel.
        let [mut off, mut reflected] = [[0.0; OUTPUTS]; 2];
        for (pair, value) in pairs.iter().zip(network.of_pairs(&pairs)) {
            let (expected, _) = oracle(&network, *pair);
            for (k, value) in value.to_array().into_iter().enumerate() {
                off[k] += (f64::from(value) - expected[k]).abs();
                reflected[k] += expected[k];
            }
        }
        for (off, reflected) in off.into_iter().zip(reflected) {
            println!("{name}: {:.1e}", off / reflected);
            assert!(off < 1e-5 * reflected, "{name}: off by {off:e} of {reflected}");
        }
    }
}

#[test]
fn values_are_invariant_under_rotation_of_the_surface() {
    let table = networks::table(&[&ODD]);
    let mut random = Stream::new(2, Purpose::Test, 0);
    let network = ODD.network();
    for k in 0..500 {
        let [wo, wi] = pair(&mut random, k % 2 == 0);
        let turn = glam::Quat::from_rotation_arc(Vec3::Z, random.direction().into());
        let point = point(&table, 0, turn * Vec3::Z, turn * wo);
        let turned = Vec3::from(point.brdf_cosines(&[(turn * wi).into()])[0]);
        let expected = network.of_pairs(&[[wo, wi]])[0];
        // Rotated directions have an error of a few roundings, and the azimuth of the half vector of these
        // over its sine (almost always at least 1e-2).
        assert!((turned - expected).abs().max_element() <= 2e-4 * expected.max_element(), "{turned} {expected}");
    }
}

#[test]
fn values_are_finite_below_the_horizon_and_in_mirror_directions() {
    let network = MIRROR.network();
    let up = Vec3::new(0.6, 0.0, 0.8);
    for (wo, wi) in [(up, -up), (-up, up), (-up, -up), (Vec3::X, up), (up, Vec3::X)] {
        assert_eq!(network.of_pairs(&[[wo, wi]])[0], Vec3::ZERO, "{wo} {wi}");
    }
    // The half vector is the normal: the peak, times the cosine.
    for wo in [Vec3::Z, up, Vec3::new(1.0, 0.0, 1e-3).normalize()] {
        let value = network.of_pairs(&[[wo, Vec3::new(-wo.x, 0.0, wo.z)]])[0];
        let expected = ((0.05_f32 + 3.0 + 0.3 * (1.0 - wo.z)).exp() - 1.0) * wo.z;
        assert!((value.x - expected).abs() <= 1e-5 * expected, "{wo}: {value}, expected {expected}");
    }
}

/// Returns copies of a point with one of the BRDFs of a table.
fn point(table: &BrdfTable, which: u32, n: Vec3, wo: Vec3) -> OnePoint {
    let surface = Surface { brdf: BrdfTable::METALLIC_ROUGHNESS + 1 + which, parameters: [0.0; MAX_PARAMETERS] };
    let n = n.into();
    ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo: wo.into(), surface }.one_of(table)
}

/// Returns points with all networks, seen at several cosines.
fn points() -> Vec<(String, OnePoint)> {
    let all = tested();
    let table = all.iter().fold(BrdfTable::default(), |table, (name, network)| {
        table.with(std::sync::Arc::new(NeuralBrdf::new(name, network.clone()).unwrap())).0
    });
    let mut random = Stream::new(3, Purpose::Test, 0);
    let mut points = Vec::new();
    for (which, (name, _)) in all.iter().enumerate() {
        for cos in [1.0_f32, 0.6, 0.2, 0.03] {
            let n = Vec3::from(random.direction());
            let wo = (cos * n + (1.0 - cos * cos).sqrt() * n.any_orthonormal_vector()).normalize();
            points.push((format!("{name} at {cos}"), point(&table, which as u32, n, wo)));
        }
    }
    points
}

fn uniforms(random: &mut Stream, count: usize) -> Vec<Vec2> {
    (0..count).map(|_| random.uniform2()).collect()
}

#[test]
fn directions_are_drawn_with_the_claimed_density() {
    let points = points();
    let tests = points.len();
    let failures: Vec<String> = points
        .into_par_iter()
        .filter_map(|(name, point)| {
            // The quadrature resolves lobes that are wider than its sub-cells, 0.02 rad.
            let narrow = point.lobe_width() < 0.1;
            (!narrow)
                .then(|| draws_follow_pdf(&point, tests))
                .filter(|failures| !failures.is_empty())
                .map(|f| format!("{name}: {}", f.join("; ")))
        })
        .collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Returns the failures of a chi-square test on the sphere and of the integral of the pdf.
fn draws_follow_pdf(point: &OnePoint, tests: usize) -> Vec<String> {
    let (rows, subcells, samples) = (51, 3, 200_000);
    // The fraction of accepted draws has a standard deviation of at most 1.2e-3.
    let test = SphereChiSquare { rows, subcells, samples, tests, mass_tolerance: 6e-3, ..SphereChiSquare::default() };
    let draw = |random: &mut Stream, count: usize| {
        point.sample_brdf(&uniforms(random, count)).into_iter().map(|sample| Some(sample?.0)).collect()
    };
    test.run(draw, |w| means_over(point, w, rows * subcells)).failures
}

/// Returns the means of the pdf over sub-cells around directions, by 8 x 8 points each.
fn means_over(point: &OnePoint, w: &[Vec3A], rows: usize) -> Vec<f32> {
    const SIDE: usize = 8;
    let extent = Vec2::new(0.5, 1.0) / rows as f32;
    let place = |centre: Vec2, k: usize| {
        let inside = Vec2::new((k % SIDE) as f32 + 0.5, (k / SIDE) as f32 + 0.5) / SIDE as f32 - 0.5;
        centre + inside * extent
    };
    let points: Vec<Vec2> =
        w.iter().flat_map(|&w| (0..SIDE * SIDE).map(move |k| place(latlong::square(w), k))).collect();
    let pdfs = point.brdf_pdfs(&points.iter().map(|&x| latlong::direction(x)).collect::<Vec<_>>());
    let mean = |(points, pdfs): (&[Vec2], &[f32])| {
        let weights = points.iter().map(|x| latlong::sin_theta(x.y));
        let sum: f32 = weights.clone().zip(pdfs).map(|(weight, pdf)| weight * pdf).sum();
        sum / weights.sum::<f32>()
    };
    points.chunks_exact(SIDE * SIDE).zip(pdfs.chunks_exact(SIDE * SIDE)).map(mean).collect()
}

#[test]
fn the_pdf_of_a_sampled_direction_equals_the_returned_pdf() {
    for (name, point) in points() {
        let drawn = point.sample_brdf(&uniforms(&mut Stream::new(4, Purpose::Test, 0), 3000));
        let (wi, pdfs): (Vec<Vec3A>, Vec<f32>) = drawn.into_iter().flatten().unzip();
        // The same arithmetic.
        assert!(point.brdf_pdfs(&wi) == pdfs, "{name}");
    }
}

/// Under a white sky, sampled and uniform directions have equal means.
#[test]
fn drawn_and_uniform_directions_reflect_the_same() {
    let points: Vec<_> = points().into_iter().filter(|(_, point)| point.lobe_width() > 0.02).collect();
    let z = (-2.0 * sidak(SIGNIFICANCE, points.len()).ln()).sqrt();
    let failures: Vec<String> = points
        .into_par_iter()
        .filter_map(|(name, point)| {
            let mut random = Stream::new(5, Purpose::Test, 0);
            let green = |wi: &[Vec3A]| point.brdf_cosines(wi).into_iter().map(|value| f64::from(value.y));
            let draws = point.sample_brdf(&uniforms(&mut random, 100_000));
            let (wi, pdfs): (Vec<Vec3A>, Vec<f32>) = draws.iter().flatten().copied().unzip();
            let mut drawn: Vec<f64> = green(&wi).zip(pdfs).map(|(value, pdf)| value / f64::from(pdf)).collect();
            drawn.resize(draws.len(), 0.0);
            let normal = point.tile().point(0).ns;
            let upper = |wi: Vec3A| if wi.dot(normal) < 0.0 { -wi } else { wi };
            let directions: Vec<Vec3A> = (0..1_000_000).map(|_| upper(random.direction())).collect();
            let uniform: Vec<f64> = green(&directions).map(|value| value * std::f64::consts::TAU).collect();
            let [a, b] = [&drawn, &uniform].map(|values| Moments::of(values).unwrap());
            let error = (a.variance / a.count as f64 + b.variance / b.count as f64).sqrt();
            // A normal variable exceeds z standard deviations with probability at most exp(-z^2 / 2).
            ((a.mean - b.mean).abs() > z * error).then(|| format!("{name}: {} and {}, off by {error}", a.mean, b.mean))
        })
        .collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// An estimate under a white sky has a small relative variance, below that of a cosine lobe.
#[test]
fn fitted_lobes_approximate_the_material() {
    for (name, network) in tested() {
        let brdf = NeuralBrdf::new(&name, network).unwrap();
        let check = brdf.check();
        assert!((0.0..1.5).contains(&check.own_variance), "{name}: {check}");
        assert!(check.albedos.len() == VIEWS.len() && check.largest_albedo() > 0.0, "{name}: {check}");
    }
    let check = |form: &networks::Form| *NeuralBrdf::new("form", form.network()).unwrap().check();
    // Neither depends on the difference vector's azimuth, so both are reciprocal up to rounding.
    assert!(check(&MIRROR).reciprocity_error < 1e-4 && check(&MATTE).reciprocity_error < 1e-4);
    assert!(check(&ODD).reciprocity_error > 1e-3, "{}", check(&ODD));
    assert!(check(&MIRROR).alpha < check(&MATTE).alpha);
    // exp(4) - 1 without the cosine, at normal incidence: more than all of the light.
    let shining = networks::Form { base: 4.0, ..MATTE };
    assert!(check(&shining).largest_albedo() > 1.0 && check(&shining).to_string().contains("more than it receives"));
}

/// Writes names and networks to files of either kind.
fn file(folder: &Path) -> PathBuf {
    let path = folder.join("materials.safetensors");
    let all = [("a/mirror", MIRROR), ("odd", ODD)].map(|(name, form)| (name.to_owned(), form.network()));
    write_networks(&path, &all).unwrap();
    path
}

fn numbers(network: &Network) -> Vec<f32> {
    network.layers().iter().flat_map(|layer| layer.weight().iter().chain(layer.bias()).copied()).collect()
}

#[test]
fn files_hold_what_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(folder.path());
    let read = read_networks(&path).unwrap();
    let names: Vec<&str> = read.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["a/mirror", "odd"]);
    assert_eq!(numbers(&read[1].1), numbers(&ODD.network()));
    let again = folder.path().join("again.safetensors");
    write_networks(&again, &read).unwrap();
    assert_eq!(fs::read(&path).unwrap(), fs::read(&again).unwrap());
}

/// Raw rows are `[in][out]`: x is multiplied from the left.
#[test]
fn raw_rows_are_read_as_they_are_documented() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("raw.f32");
    let network = ODD.network();
    let mut row = Vec::new();
    for layer in network.layers() {
        for input in 0..layer.inputs() {
            row.extend((0..layer.outputs()).map(|output| layer.weight()[output * layer.inputs() + input]));
        }
        row.extend_from_slice(layer.bias());
    }
    assert_eq!(row.len(), 675);
    let bytes: Vec<u8> = row.iter().chain(&row).flat_map(|number| number.to_le_bytes()).collect();
    fs::write(&path, bytes).unwrap();
    fs::write(folder.path().join("raw.names.txt"), "one\ntwo\n").unwrap();
    let read = read_networks(&path).unwrap();
    assert_eq!((read.len(), read[0].0.as_str(), read[1].0.as_str()), (2, "one", "two"));
    assert_eq!(numbers(&read[1].1), numbers(&network));
}

/// Returns the error of a material's specification in a small scene.
fn refused(spec: &str) -> String {
    let scene = Scene::built_in("plane").unwrap();
    let bounds = scene.bounds();
    let dressed = spec.parse::<MaterialSpec>().and_then(|spec| spec.dress(scene, &bounds));
    dressed.map(|scene| scene.name().to_owned()).unwrap_err().to_string()
}

#[test]
fn hostile_files_are_rejected_with_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(folder.path());
    let good = fs::read(&path).unwrap();
    let at = |name: &str| folder.path().join(name);
    let spec = |name: &str| format!("nbrdf:{}", at(name).display());
    let says = |spec: &str, word: &str| {
        let reason = refused(spec);
        assert!(reason.contains(word) && !reason.contains('\n'), "{spec}: {reason}");
    };
    says(&spec("materials.safetensors"), "there are 2; choose some");
    says(&spec("materials.safetensors#steel"), "'steel'");
    says(&spec("missing.safetensors"), "missing.safetensors");
    says(&spec("materials.png"), "neither .safetensors nor .f32");
    // Truncated anywhere, or with any byte damaged: an error or materials, never a panic.
    for length in (0..good.len()).step_by(97) {
        fs::write(at("cut.safetensors"), &good[..length]).unwrap();
        assert!(read_networks(&at("cut.safetensors")).is_err(), "cut at {length}");
    }
    let mut random = Stream::new(6, Purpose::Test, 0);
    for k in 0..400 {
        let mut bytes = good.clone();
        let place = (random.uniform() * bytes.len().min(2000) as f32) as usize;
        bytes[place] = (random.uniform() * 256.0) as u8;
        fs::write(at("damaged.safetensors"), &bytes).unwrap();
        let networks = read_networks(&at("damaged.safetensors")).unwrap_or_default();
        // A fit takes 0.1 s.
        if k % 50 == 0 {
            networks.into_iter().for_each(|(name, network)| drop(NeuralBrdf::new(&name, network)));
        }
    }
    // A header whose size exceeds the file.
    let mut bytes = good.clone();
    bytes[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    fs::write(at("header.safetensors"), &bytes).unwrap();
    says(&spec("header.safetensors#odd"), "not a file of materials");
    let replaced = |from: &str, to: &str, word: &str| {
        let text: Vec<u8> = good.clone();
        let found = text.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
        let bytes = [&text[..found], to.as_bytes(), &text[found + from.len()..]].concat();
        fs::write(at("other.safetensors"), bytes).unwrap();
        says(&spec("other.safetensors#odd"), word);
    };
    replaced("format_version\\\":1", "format_version\\\":2", "format_version: is 2");
    replaced("neural-brdf", "neural-brde", "'neural-brde'");
    replaced("headtail-materials", "headtail-materialz", "is missing");
    replaced("a/mirror", "a/mirrox", "is missing");
}

#[test]
fn absurd_networks_are_refused() {
    let with = |change: &dyn Fn(&mut Vec<f32>, &mut Vec<f32>)| {
        let mut layers = MIRROR.network().layers().clone();
        let last = &layers[2];
        let (mut weight, mut bias) = (last.weight().to_vec(), last.bias().to_vec());
        change(&mut weight, &mut bias);
        layers[2] = Linear::new("last", last.inputs(), last.outputs(), &weight, bias)?;
        NeuralBrdf::new("odd one", Network::new("odd one", layers)?).map(|brdf| brdf.name().to_owned())
    };
    let says = |result: headtail_render::Result<String>, word: &str| {
        let reason = result.unwrap_err().to_string();
        assert!(reason.contains(word), "{reason}");
    };
    assert!(with(&|_, _| ()).is_ok());
    says(with(&|weight, _| weight[0] = f32::NAN), "not finite");
    says(with(&|weight, _| weight[0] = 60.0), "more than any surface");
    says(with(&|_, bias| bias[1] = 100.0), "more than any surface");
    says(with(&|weight, _| weight.fill(3e38)), "its weights allow");
    // Black is a surface.
    let black = with(&|weight, bias| {
        weight.fill(0.0);
        bias.fill(0.0);
    });
    assert!(black.is_ok());
}
