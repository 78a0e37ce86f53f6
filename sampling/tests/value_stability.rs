//! Directions and pdfs of the samplers that need no file, for fixed random numbers: any change of them
//! changes every image.
//!
//! `values.csv` stores them. After an intended change, `HEADTAIL_PIN=1 cargo test -p headtail-sampling --test
//! value_stability` rewrites it.

use std::{fmt::Write, fs, path::Path, sync::Arc};

use glam::{Vec2, Vec3, Vec3A};
use headtail_sampling::{
    brdf::{Ggx, Lambert, Surface},
    environment::built_in,
    portals::{Portal, PortalSampler},
    random::{Purpose, Stream},
    sampler::{AtPoint, BrdfSampler, EnvironmentLight, OneSampleMis, Sampler},
    spec::{SamplerSpec, forms},
    tail::TailKind,
    tile::ShadingPoint,
};

/// Number of draws per sampler and surface.
const DRAWS: usize = 6;

/// Tolerances of directions and pdfs. Directions have errors of about 1e-7 from rounding and from the order
/// of sums over the map's texels, which differ between instruction sets: up to 1e-5 after the division by the
/// mass of a cell. Slopes of pdfs are up to 10 per unit.
const TOLERANCES: [f32; 2] = [1e-4, 1e-3];

/// One draw: sampler, surface and number, then the direction and its pdf.
type Row = (String, [f32; 4]);

fn rows() -> Vec<Row> {
    let environment = Arc::new(built_in("studio").unwrap());
    let surfaces: [(&str, Surface); 2] =
        [("diffuse", Lambert { albedo: Vec3::splat(0.5) }.into()), ("glossy", Ggx::new(0.3, Vec3::ONE).into())];
    let mut rows = Vec::new();
    let named = forms::forms().filter(|form| form.purpose != forms::Purpose::Study).filter_map(|form| {
        let spec = form.form.parse::<SamplerSpec>().ok().filter(SamplerSpec::has_pdf)?;
        Some((form.form, spec.build_sampler(&environment).ok()?))
    });
    let window = |x: f32| Portal {
        center: Vec3A::new(x, 1.5, 0.4),
        normal: Vec3A::new(-x.signum(), 0.0, 0.0),
        up: Vec3A::Y,
        width: 1.5,
        height: 1.0,
    };
    let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical).unwrap();
    let portals = PortalSampler::new(&[window(2.0), window(-1.2)], &environment).beside_emitter(light);
    let portals: Arc<dyn Sampler> = Arc::new(OneSampleMis::new(portals, BrdfSampler));
    for (form, sampler) in named.chain([("portals+mis", portals)]) {
        for (name, surface) in surfaces {
            let ns = Vec3A::new(0.3, 0.8, 0.2).normalize();
            let wo = Vec3A::new(-0.2, 0.7, 0.6).normalize();
            let at = AtPoint::new(&*sampler, &ShadingPoint { p: Vec3A::ZERO, ng: ns, ns, wo, surface });
            let mut random = Stream::new(1, Purpose::Test, 0);
            let u: Vec<Vec2> = (0..DRAWS).map(|_| random.uniform2()).collect();
            for (k, drawn) in at.sample_many(&u).into_iter().enumerate() {
                let numbers = drawn.map_or([0.0; 4], |drawn| drawn.wi.extend(drawn.pdf).to_array());
                rows.push((format!("{form},{name},{k}"), numbers));
            }
        }
    }
    rows
}

#[test]
fn directions_and_pdfs_match_pinned_values() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/values.csv");
    let rows = rows();
    if std::env::var_os("HEADTAIL_PIN").is_some() {
        let mut text = String::from("sampler,surface,draw,x,y,z,pdf\n");
        for (key, [x, y, z, pdf]) in &rows {
            writeln!(text, "{key},{x:.6},{y:.6},{z:.6},{pdf:.6e}").unwrap();
        }
        fs::write(&path, text).unwrap();
    }
    let pinned = fs::read_to_string(&path).unwrap();
    let mut lines = pinned.lines().skip(1);
    for (key, numbers) in &rows {
        let line = lines.next().unwrap_or_else(|| panic!("{key} is not in values.csv"));
        let rest = line.strip_prefix(key).unwrap_or_else(|| panic!("{key} is not where values.csv has {line}"));
        let expected: Vec<f32> = rest.split(',').skip(1).map(|number| number.parse().unwrap()).collect();
        for (k, (own, expected)) in numbers.iter().zip(expected).enumerate() {
            let [direction, pdf] = TOLERANCES;
            let tolerance = if k < 3 { direction } else { pdf * expected };
            assert!((own - expected).abs() <= tolerance, "{key}: {numbers:?}, but values.csv has {line}");
        }
    }
    assert_eq!(lines.next(), None, "values.csv has a sampler that is gone");
}
