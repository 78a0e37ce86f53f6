//! Files with flow tails.

use super::*;

#[test]
fn flow_tails_survive_a_file() {
    let folder = Folder::new();
    let map = Arc::new(headtail_render::environment::built_in("sunset").unwrap());
    let node = |k: usize| {
        let y = Vec2::new((k % 16) as f32, (k / 16) as f32) / 16.0;
        Vec2::new(y.x + 0.05 * (6.0 * y.y).sin(), y.y)
    };
    let nodes: Vec<Vec2> = (0..16 * 17).map(node).collect();
    let warp = WarpMap::new(16, &nodes).unwrap();
    let flow = Arc::new(Tail::flow(warp, map.width(), map.height(), &map.luminance()).unwrap());
    let head = Intermediate::Head(head(Mode::Coupled, false));
    let sampler = ExportedSampler::of_tail(head, flow, &map, Some(training()));
    let path = folder.path("flow");
    sampler.write(&path).unwrap();
    let read = ExportedSampler::read(&path).unwrap();
    assert_eq!((read.description(), read.description().format_version), (sampler.description(), 2));
    assert_eq!((draws(&read, 200), &read.luminance), (draws(&sampler, 200), &sampler.luminance));
    read.check_environment(&map).unwrap();
    for spec in ["head", "head+mis", "ris:4:head"] {
        let spec: SamplerSpec = format!("{spec}:{}", path.display()).parse().unwrap();
        spec.build(&map).unwrap();
    }
    // A table that is not injective.
    let mut bytes = std::fs::read(&path).unwrap();
    let node = 0.05_f32 * (6.0 * (3.0 / 16.0_f32)).sin();
    let found = bytes.windows(4).position(|four| four == node.to_le_bytes()).unwrap();
    bytes[found..found + 4].copy_from_slice(&0.9_f32.to_le_bytes());
    let path = folder.path("folded");
    std::fs::write(&path, &bytes).unwrap();
    let error = ExportedSampler::read(&path).unwrap_err().to_string();
    assert!(error.contains("folded") && error.contains("tail.map"), "{error}");
}
