use std::path::Path;

use glam::{Affine3A, Vec2, Vec3, Vec3A};

use super::{Portal, PortalSampler, read, to_json};
use crate::{
    brdf::Lambert,
    environment::built_in,
    sampler::{AtPoint, Coverage, EmitterSampler, EnvironmentLight, Sampler},
    spec::SamplerSpec,
    tail::TailKind,
    tile::ShadingPoint,
};

fn portal(center: [f32; 3], normal: Vec3A, up: Vec3A, [width, height]: [f32; 2]) -> Portal {
    Portal { center: Vec3A::from_array(center), normal, up, width, height }
}

/// Two windows of one wall, and a skylight that is turned.
fn openings() -> [Portal; 3] {
    [
        portal([2.0, 1.5, -0.5], Vec3A::NEG_X, Vec3A::Y, [1.0, 1.2]),
        portal([2.3, 1.6, 0.2], Vec3A::NEG_X, Vec3A::Y, [0.8, 1.0]),
        portal([-0.5, 3.0, 0.8], Vec3A::NEG_Y, Vec3A::new(0.6, 0.0, 0.8), [1.0, 0.6]),
    ]
}

fn point(p: Vec3A, ns: Vec3A) -> ShadingPoint {
    ShadingPoint { p, ng: ns, ns, wo: ns, surface: Lambert { albedo: Vec3::splat(0.5) }.into() }
}

#[test]
fn the_pdf_integrates_to_1_over_the_portals_and_is_0_elsewhere() {
    let (openings, map) = (openings(), built_in("sunset").unwrap());
    let sampler = PortalSampler::new(&openings, &map);
    assert!(sampler.shares_image(0, 1) && !sampler.shares_image(0, 2));
    let p = Vec3A::new(0.3, 0.2, -0.1);
    let point = point(p, Vec3A::new(0.3, 0.9, 0.1).normalize());
    let at = AtPoint::new(&sampler, &point);
    // Every portal from points of its rectangle: cosine over squared distance converts area to solid angle.
    const SIDE: usize = 400;
    let mut integral = 0.0;
    for (number, portal) in openings.iter().enumerate() {
        let wi = |k: usize| {
            let [u, v] = [k % SIDE, k / SIDE].map(|k| (k as f32 + 0.5) / SIDE as f32 - 0.5);
            portal.center + u * portal.width * portal.right() + v * portal.height * portal.up - p
        };
        let rays: Vec<Vec3A> = (0..SIDE * SIDE).map(wi).collect();
        let directions: Vec<Vec3A> = rays.iter().map(|ray| ray.normalize()).collect();
        let area = portal.width * portal.height / (SIDE * SIDE) as f32;
        for ((ray, wi), pdf) in rays.iter().zip(&directions).zip(at.pdf_many(&directions)) {
            // Where portals overlap, each has its part of the pdf: count the direction once.
            let is_counted = openings[..number].iter().any(|before| before.is_crossed(p, *wi));
            let solid_angle = area * -wi.dot(portal.normal) / ray.length_squared();
            integral += if is_counted { 0.0 } else { f64::from(pdf * solid_angle) };
        }
    }
    // Borders of pixels are missed by half a cell of the quadrature.
    assert!((integral - 1.0).abs() < 2e-3, "{integral}");
    assert_eq!(at.pdf_many(&[Vec3A::NEG_X, Vec3A::NEG_Y, Vec3A::X]), [0.0; 3]);
}

#[test]
fn draws_pass_through_portals_above_the_horizon_with_their_pdf() {
    let (openings, map) = (openings(), built_in("studio").unwrap());
    let sampler = PortalSampler::new(&openings, &map);
    let u: Vec<Vec2> = (0..4096).map(|k| Vec2::new((k % 64) as f32 + 0.5, (k / 64) as f32 + 0.5) / 64.0).collect();
    // Towards the windows, away from them, and between the planes of the two.
    for (p, ns, passes) in [
        (Vec3A::ZERO, Vec3A::Y, [true, true, true]),
        (Vec3A::new(1.9, 1.0, 0.0), Vec3A::NEG_X, [false, false, true]),
        (Vec3A::new(2.2, 1.0, 0.0), Vec3A::X, [false, true, false]),
    ] {
        let point = point(p, ns);
        let at = AtPoint::new(&sampler, &point);
        let drawn: Vec<_> = at.sample_many(&u).into_iter().map(|drawn| drawn.expect("light")).collect();
        let wi: Vec<Vec3A> = drawn.iter().map(|drawn| drawn.wi).collect();
        let pdfs = at.pdf_many(&wi);
        // Rounding may move a direction across a border of pixels or of a portal.
        let moved = drawn.iter().zip(&pdfs).filter(|(drawn, pdf)| (**pdf / drawn.pdf - 1.0).abs() > 1e-4).count();
        assert!(moved < 8, "{moved} of 4096 at {p}");
        for (number, passes) in passes.into_iter().enumerate() {
            let through = wi.iter().filter(|wi| openings[number].is_crossed(p, **wi)).count();
            assert_eq!(through > 10, passes, "{through} through portal {number} from {p}");
        }
    }
}

#[test]
fn points_outside_the_room_draw_nothing_and_extreme_portals_are_finite() {
    let map = built_in("window").unwrap();
    let nowhere = |point: ShadingPoint, sampler: &PortalSampler| {
        let at = AtPoint::new(sampler, &point);
        assert!(at.sample_many(&[Vec2::splat(0.3)])[0].is_none());
        assert_eq!(at.pdf_many(&[Vec3A::X, Vec3A::Y]), [0.0, 0.0]);
    };
    let sampler = PortalSampler::new(&openings(), &map);
    nowhere(point(Vec3A::new(4.0, 5.0, 0.0), Vec3A::Y), &sampler);
    // On the plane of the window, and the skylight is below the horizon.
    nowhere(point(Vec3A::new(2.0, 1.5, -0.5), Vec3A::NEG_Y), &PortalSampler::new(&openings()[..1], &map));
    // Very thin, very wide and very distant portals have neither infinite pdfs nor panics.
    for size in [[1e-8, 1.0], [1e8, 1e8], [1e8, 1e-8]] {
        let one = portal([2.0, 1.5, 0.0], Vec3A::NEG_X, Vec3A::Y, size);
        let sampler = PortalSampler::new(&[one], &map);
        for x in [1.999_999, 1.0, -1e7] {
            let point = point(Vec3A::new(x, 1.4, 0.1), Vec3A::X);
            let at = AtPoint::new(&sampler, &point);
            let drawn = at.sample_many(&[Vec2::ZERO, Vec2::splat(0.5), Vec2::splat(1.0 - f32::EPSILON)]);
            assert!(drawn.iter().flatten().all(|drawn| drawn.wi.is_normalized() && drawn.pdf.is_finite()));
        }
    }
}

#[test]
fn emitter_sampling_has_an_eighth_of_the_samples_where_portals_are_seen_and_all_elsewhere() {
    let map = std::sync::Arc::new(built_in("sunset").unwrap());
    let light = EnvironmentLight::new(map.clone(), TailKind::Hierarchical).unwrap();
    let (portals, emitter) = (PortalSampler::new(&openings(), &map), EmitterSampler::new(light.clone()));
    let both = portals.clone().beside_emitter(light);
    let wi: Vec<Vec3A> =
        openings().iter().map(|portal| portal.center.normalize()).chain([Vec3A::X, Vec3A::Z]).collect();
    for (p, of_emitter) in [(Vec3A::ZERO, 0.125), (Vec3A::new(4.0, 5.0, 0.0), 1.0)] {
        let point = point(p, Vec3A::Y);
        let [portals, emitter, both] =
            [&portals as &dyn Sampler, &emitter, &both].map(|sampler| AtPoint::new(sampler, &point).pdf_many(&wi));
        for ((portals, emitter), both) in portals.iter().zip(&emitter).zip(&both) {
            let expected = (1.0 - of_emitter) * portals + of_emitter * emitter;
            assert!((both - expected).abs() <= 1e-6 * expected, "{both} {expected}");
        }
    }
}

#[test]
fn portals_survive_a_file_and_turn_with_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("portals.json");
    std::fs::write(&path, to_json(&openings())).unwrap();
    for (read, own) in read(&path).unwrap().iter().zip(&openings()) {
        assert!(read.center == own.center && (read.up - own.up).length() < 1e-6, "{read:?}");
        assert_eq!((read.width, read.height), (own.width, own.height));
    }
    let spec = |text: &str| format!("{text}:{}", path.display()).parse::<SamplerSpec>();
    assert!(spec("portals+vis").is_err());
    let map = std::sync::Arc::new(built_in("window").unwrap());
    for text in ["portals", "portals+mis"] {
        assert_eq!(spec(text).unwrap().build_sampler(&map).unwrap().coverage(), Coverage::Everything);
    }
    assert!(spec("mis2:portals").unwrap().build(&map).is_ok());
    let turned = openings()[0].moved(&Affine3A::from_rotation_y(std::f32::consts::FRAC_PI_2));
    assert!(
        (turned.center - Vec3A::new(-0.5, 1.5, -2.0)).length() < 1e-6 && (turned.normal - Vec3A::Z).length() < 1e-6
    );
}

#[test]
fn faulty_files_are_refused_by_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("portals.json");
    let refused = |text: &str, reason: &str| {
        std::fs::write(&path, text).unwrap();
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains(reason) && error.contains("portals.json"), "{error}");
    };
    let one = |field: &str, value: &str| {
        let of = |name: &str, own: &str| format!("\"{name}\": {}", if name == field { value } else { own });
        let fields = [
            of("center", "[0, 0, 0]"),
            of("normal", "[0, 0, 2]"),
            of("up", "[0, 1, 1]"),
            of("width", "1"),
            of("height", "2"),
        ];
        format!("{{\"portals\": [{{{}}}]}}", fields.join(", "))
    };
    refused("{", "EOF");
    refused("{\"portals\": []}", "has 0");
    refused(&one("center", "[0, 1e39, 0]"), "center");
    refused(&one("normal", "[0, 0, 0]"), "'normal' is not a direction");
    refused(&one("up", "[0, 0, -3]"), "parallel");
    refused(&one("width", "-1"), "not positive");
    refused(&one("height", "\"tall\""), "portals");
    std::fs::write(&path, one("", "")).unwrap();
    assert_eq!(read(&path).unwrap(), [portal([0.0; 3], Vec3A::Z, Vec3A::Y, [1.0, 2.0])]);
    assert!(read(Path::new("missing.json")).is_err());
}
