//! Files with compact emitters and with flow tails.

use super::*;

/// A map with a compact emitter, and samplers with the tail of the rest and with a flow tail.
fn samplers_of_version_2() -> (Arc<Environment>, [ExportedSampler; 2]) {
    let map = Arc::new(headtail_render::environment::built_in("sunset").unwrap());
    let (width, height, luminance) = (map.width(), map.height(), map.luminance());
    let rest = headtail_render::environment::without_compact_emitters(width, height, &luminance).unwrap();
    let of_rest = Arc::new(Tail::new(TailKind::Hierarchical, width, height, &rest).unwrap());
    let head = || Intermediate::Head(head(Mode::Coupled, false));
    let compact = ExportedSampler::of_tail(head(), of_rest, rest, &map, Some(training()));
    let node = |k: usize| {
        let y = Vec2::new((k % 16) as f32, (k / 16) as f32) / 16.0;
        Vec2::new(y.x + 0.05 * (6.0 * y.y).sin(), y.y)
    };
    let nodes: Vec<Vec2> = (0..16 * 17).map(node).collect();
    let warp = WarpMap::new(16, &nodes).unwrap();
    let flow = Arc::new(Tail::flow(warp, width, height, &luminance).unwrap());
    let flow = ExportedSampler::of_tail(head(), flow, luminance, &map, Some(training()));
    (map, [compact, flow])
}

#[test]
fn compact_emitters_and_flow_tails_survive_a_file() {
    let folder = Folder::new();
    let (map, samplers) = samplers_of_version_2();
    for (sampler, name) in samplers.iter().zip(["compact", "flow"]) {
        let path = folder.path(name);
        sampler.write(&path).unwrap();
        let read = ExportedSampler::read(&path).unwrap();
        assert_eq!((read.description(), read.description().format_version), (sampler.description(), 2));
        assert_eq!((draws(&read, 200), &read.luminance), (draws(sampler, 200), &sampler.luminance));
        read.check_environment(&map).unwrap();
        assert_eq!(read.compact_emitters, name == "compact");
        let emitters = CompactEmitters::new(&map, &read.luminance.2).map(|compact| compact.count());
        assert_eq!(emitters.ok(), (name == "compact").then_some(1));
        for spec in ["head", "head+mis", "ris:4:head"] {
            let spec: SamplerSpec = format!("{spec}:{}", path.display()).parse().unwrap();
            spec.build(&map).unwrap();
        }
    }
    let [compact, flow] = samplers;
    // Light that the map does not have.
    let (width, height, mut brighter) = compact.luminance.clone();
    brighter.iter_mut().for_each(|value| *value *= 1.5);
    let damaged = ExportedSampler { luminance: (width, height, brighter), ..compact };
    assert!(damaged.check_environment(&map).unwrap_err().to_string().contains("tail.luminance"));
    assert!(CompactEmitters::new(&map, &damaged.luminance.2).is_err());
    assert!(damaged.open(&map).is_err());
    // A table that is not one to one.
    let path = folder.path("folded");
    flow.write(&path).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let node = 0.05_f32 * (6.0 * (3.0 / 16.0_f32)).sin();
    let found = bytes.windows(4).position(|four| four == node.to_le_bytes()).unwrap();
    bytes[found..found + 4].copy_from_slice(&0.9_f32.to_le_bytes());
    std::fs::write(&path, &bytes).unwrap();
    let error = ExportedSampler::read(&path).unwrap_err().to_string();
    assert!(error.contains("folded") && error.contains("tail.map"), "{error}");
}

/// A map with one bright lamp on black and a grey strip.
fn lamp() -> Arc<Environment> {
    let (width, height) = (128, 64);
    let value = |column: usize, row: usize| match (column, row) {
        (60..63, 14..16) => 2000.0,
        (_, 28..34) => 0.5,
        _ => 0.0,
    };
    let pixels = (0..width * height).map(|k| [value(k % width, k / width); 3]).collect();
    Arc::new(Environment::from_image("lamp", Image { width, height, pixels }).unwrap())
}

/// Luminance that a white surface reflects without shadows, by a sampler alone.
fn reflected(sampler: &dyn Sampler, map: &Environment) -> Moments {
    let at = AtPoint::new(sampler, &shading_point(Vec3A::Y));
    let mut random = Stream::new(9, Purpose::Test, 0);
    let u: Vec<Vec2> = (0..100_000).map(|_| random.uniform2()).collect();
    let drawn = at.sample_many(&u);
    let wi: Vec<Vec3A> = drawn.iter().map(|drawn| drawn.map_or(Vec3A::NEG_Y, |drawn| drawn.wi)).collect();
    let values = drawn.iter().zip(&wi).zip(at.point().brdf_cosines(&wi)).map(|((drawn, &wi), reflected)| {
        drawn.map_or(0.0, |drawn| f64::from((reflected * map.radiance(wi)).y / drawn.pdf))
    });
    Moments::of(&values.collect::<Vec<_>>()).unwrap()
}

/// A file's sampler is only whole with the emitters that its tail leaves out: without them, nearly all of this light
/// would be lost without a word.
#[test]
fn a_file_opens_with_its_compact_emitters_or_not_at_all() {
    let folder = Folder::new();
    let map = lamp();
    let (width, height, luminance) = (map.width(), map.height(), map.luminance());
    let rest = headtail_render::environment::without_compact_emitters(width, height, &luminance).unwrap();
    let of_rest = Arc::new(Tail::new(TailKind::Hierarchical, width, height, &rest).unwrap());
    let whole = Arc::new(Tail::new(TailKind::Hierarchical, width, height, &luminance).unwrap());
    let table = |tail: &Tail| direct_bake(tail, NormalGrid::new(8, 16).unwrap(), CellGrid::new(8, 8).unwrap()).unwrap();
    let opened = |name: &str, intermediate, tail: &Arc<Tail>, luminance: &[f32], training| {
        let path = folder.path(name);
        ExportedSampler::of_tail(intermediate, tail.clone(), luminance.to_vec(), &map, training).write(&path).unwrap();
        ExportedSampler::read(&path).unwrap().open(&map).unwrap()
    };
    let coupled = || Intermediate::Head(head(Mode::Coupled, false));
    let selecting = Intermediate::Head(head_of(Condition::Normal, Mode::Coupled, true, true));
    let compact_direct = opened("table", Intermediate::DirectBake(table(&of_rest)), &of_rest, &rest, None);
    let direct = opened("direct", Intermediate::DirectBake(table(&whole)), &whole, &luminance, None);
    let light = EnvironmentLight::with_tail(map.clone(), whole);
    let mis = OneSampleMis::new(EmitterSampler::new(light), BrdfSampler);
    let all: [(&str, &dyn Sampler); 5] = [
        ("a head with compact emitters", &opened("head", coupled(), &of_rest, &rest, Some(training()))),
        ("a head with a share and compact emitters", &opened("share", selecting, &of_rest, &rest, Some(training()))),
        ("a table with compact emitters", &compact_direct),
        ("a table", &direct),
        ("mis", &mis),
    ];
    let means = all.map(|(name, sampler)| (name, reflected(sampler, &map)));
    for (k, (first, a)) in means.iter().enumerate() {
        assert!((a.variance / a.count as f64).sqrt() < 0.02 * a.mean, "{first}: {a:?} proves nothing");
        for (second, b) in &means[..k] {
            let p = TTest::welch(a, b).p_value;
            assert!(p >= sidak(0.01, 10), "{first} has {}, {second} {}, p = {p:.1e}", a.mean, b.mean);
        }
    }
    // What the example of an embedder could do wrong: draw by the tail of the rest alone.
    let light = EnvironmentLight::with_tail(map.clone(), of_rest.clone());
    let alone = ProductSampler::new(light.clone(), head(Mode::Coupled, false));
    let of_rest = reflected(&alone, &map).mean;
    assert!(of_rest < 0.1 * means[4].1.mean, "{of_rest}: the lamp is no test");
    for refused in [
        Covering::new(Arc::new(alone.clone()) as Arc<dyn Sampler>).err(),
        Covering::new(Arc::new(OneSampleMis::new(EmitterSampler::new(light), alone)) as Arc<dyn Sampler>).err(),
    ] {
        let error = refused.expect("accepted").to_string();
        assert!(error.contains("compact emitters") && error.contains("biased") && !error.contains('\n'), "{error}");
    }
}
