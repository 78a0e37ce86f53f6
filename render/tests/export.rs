//! Exported files: what is written is what is read, and nothing that a file may hold makes the reader panic.

use std::{fs, path::Path, path::PathBuf, sync::Arc};

use glam::{Vec2, Vec3, Vec3A};
use headtail_render::{
    Error,
    bake::{BakedTable, CellGrid, NormalGrid, direct_bake},
    brdf::Lambert,
    environment::Environment,
    export::{ExportedSampler, FORMAT_VERSION, Intermediate, TrainingSummary},
    head::{Condition, Head, Linear, Mode},
    image::Image,
    patches::{Detail, PatchSampler},
    random::{Purpose, Stream},
    sampler::{
        AtPoint, BrdfSampler, CompactEmitters, Covering, Direction, EmitterSampler, EnvironmentLight, OneSampleMis,
        ProductSampler, Sampler,
    },
    spec::{FileKind, SamplerSpec},
    statistics::{Moments, TTest, sidak},
    tail::{Tail, TailKind, TailWarp, WarpMap},
    tile::ShadingPoint,
};
use serde_json::{Value, json};

fn environment(name: &str, salt: usize) -> Arc<Environment> {
    let pixels = (0..16 * 9).map(|k| [((k * 7 + salt) % 11) as f32, 1.0, (k % 3) as f32]).collect();
    Arc::new(Environment::from_image(name, Image { width: 16, height: 9, pixels }).unwrap())
}

fn head(mode: Mode, encoder: bool) -> Head {
    head_of(Condition::Normal, mode, encoder, false)
}

/// A head with random weights, of the size that its condition asks for.
fn head_of(condition: Condition, mode: Mode, encoder: bool, selection: bool) -> Head {
    let mut random = Stream::new(5, Purpose::Weights, 0);
    let mut layers = |sizes: &[usize]| -> Vec<Linear> {
        let mut layer = |inputs: usize, outputs: usize| {
            let mut values = |count: usize| -> Vec<f32> { (0..count).map(|_| random.uniform() - 0.5).collect() };
            let weight = values(inputs * outputs);
            Linear::new("random", inputs, outputs, &weight, values(outputs)).unwrap()
        };
        sizes.windows(2).map(|pair| layer(pair[0], pair[1])).collect()
    };
    let encoder = if encoder { layers(&[condition.length(), 6, 5]) } else { Vec::new() };
    let seen = condition.length() + encoder.last().map_or(0, Linear::outputs);
    let features = if mode == Mode::Coupled { 2 } else { 0 };
    let networks = [layers(&[seen + features, 8, 8, 13]), layers(&[seen + 1, 8, 8, 13])];
    let selection = if selection { layers(&[seen, 4, 1]) } else { Vec::new() };
    Head::new(condition, mode, 0.01, encoder, networks).unwrap().with_selection(selection).unwrap()
}

fn table() -> BakedTable {
    BakedTable::fill(NormalGrid::new(4, 6).unwrap(), CellGrid::new(3, 5).unwrap(), |normal, masses| {
        masses.iter_mut().enumerate().for_each(|(k, mass)| *mass = k as f32 * (1.5 + normal.x));
    })
    .unwrap()
}

fn training() -> TrainingSummary {
    TrainingSummary {
        steps: 1000,
        seed: 7,
        loss: "log-chi-square".into(),
        backend: "flex".into(),
        final_kl: 0.012_345_678_901_234_5,
        relative_variance: 0.1,
        seconds: None,
        tabulated_seconds: None,
    }
}

/// Every kind of content with either tail.
fn samplers() -> Vec<ExportedSampler> {
    let map = environment("test map", 0);
    let mut samplers = Vec::new();
    for kind in [TailKind::RowColumn, TailKind::Hierarchical] {
        let mut add = |intermediate, training| {
            samplers.push(ExportedSampler::new(intermediate, kind, &map, training).unwrap());
        };
        for mode in [Mode::Coupled, Mode::Autoregressive] {
            add(Intermediate::Head(head(mode, false)), Some(training()));
            add(Intermediate::Head(head(mode, true)), Some(training()));
        }
        add(Intermediate::Bake(table()), Some(training()));
        let light = EnvironmentLight::new(map.clone(), kind).unwrap();
        let direct = direct_bake(light.tail(), NormalGrid::new(4, 6).unwrap(), CellGrid::new(4, 4).unwrap()).unwrap();
        add(Intermediate::DirectBake(direct), None);
    }
    for detail in [Detail::Leaves, Detail::Twigs] {
        let head = Intermediate::Head(head(Mode::Coupled, true));
        let sampler = ExportedSampler::new(head, TailKind::Hierarchical, &map, Some(training())).unwrap();
        samplers.push(sampler.over_patches(detail));
    }
    samplers
}

fn shading_point(normal: Vec3A) -> ShadingPoint {
    let surface = Lambert { albedo: Vec3::ONE }.into();
    ShadingPoint { p: Vec3A::ZERO, ng: normal, ns: normal, wo: normal, surface }
}

/// What a sampler draws: directions and both pdfs, as bits; 16 at each of several points.
fn draws(sampler: &ExportedSampler, count: usize) -> Vec<[u32; 5]> {
    fn of(sampler: &dyn Sampler, count: usize) -> Vec<[u32; 5]> {
        let draw = |k: u64| {
            let mut random = Stream::new(1, Purpose::Test, k);
            let at = AtPoint::new(sampler, &shading_point(random.direction()));
            let drawn = at.sample_many(&[(); 16].map(|()| random.uniform2()));
            let wi: Vec<Vec3A> = drawn.iter().map(|drawn| drawn.map_or(Vec3A::Y, |drawn| drawn.wi)).collect();
            let bits = |(drawn, pdf): (Option<Direction>, f32)| {
                drawn.map_or([0; 5], |drawn| {
                    let [x, y, z] = drawn.wi.to_array();
                    [x, y, z, drawn.pdf, pdf].map(f32::to_bits)
                })
            };
            drawn.into_iter().zip(at.pdf_many(&wi)).map(bits).collect::<Vec<_>>()
        };
        (0..count.div_ceil(16) as u64).flat_map(draw).take(count).collect()
    }
    let light = EnvironmentLight::with_tail(environment("test map", 0), sampler.tail.clone());
    match &sampler.intermediate {
        Intermediate::Head(head) if let Some(detail) = sampler.patches => {
            of(&PatchSampler::with_head(light, detail, head.clone()).unwrap(), count)
        }
        Intermediate::Head(head) => of(&ProductSampler::new(light, head.clone()), count),
        Intermediate::Bake(table) | Intermediate::DirectBake(table) => {
            of(&ProductSampler::new(light, table.clone()), count)
        }
    }
}

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

/// Heads for microfacet surfaces with their selection networks.
fn microfacet_samplers() -> Vec<ExportedSampler> {
    let map = environment("test map", 0);
    let kinds = [
        (Condition::Ggx, Mode::Coupled, TailKind::Hierarchical),
        (Condition::GgxRoughness, Mode::Autoregressive, TailKind::RowColumn),
    ];
    let sampler = |(condition, mode, kind)| {
        let head = head_of(condition, mode, true, true);
        ExportedSampler::new(Intermediate::Head(head), kind, &map, Some(training())).unwrap()
    };
    kinds.map(sampler).into()
}

#[test]
fn patches_are_between_a_head_and_the_hierarchical_tail_alone() {
    let folder = Folder::new();
    for sampler in samplers() {
        let is_head = matches!(sampler.intermediate, Intermediate::Head(_));
        let allowed = is_head && sampler.tail.kind() == TailKind::Hierarchical;
        let bytes = folder.bytes_of(&sampler);
        let with = |patches: &str| Parts::of(&bytes).describe(|description| description["patches"] = patches.into());
        assert_eq!(folder.read(&with("twigs")).is_ok(), allowed);
        if !allowed {
            assert!(folder.refused(&with("leaves")).contains("hierarchical"));
        }
        assert!(folder.refused(&with("petals")).contains("petals"));
        let description = sampler.description();
        assert_eq!(description.format_version == FORMAT_VERSION, sampler.patches.is_some());
    }
}

/// A folder of files that is removed in the end.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn bytes_of(&self, sampler: &ExportedSampler) -> Vec<u8> {
        let path = self.path("good.safetensors");
        sampler.write(&path).unwrap();
        fs::read(path).unwrap()
    }

    fn read(&self, bytes: &[u8]) -> Result<ExportedSampler, String> {
        let path = self.path("hostile.safetensors");
        // A new file each time: some file systems wait for the disk when one is truncated and written again.
        let _ = fs::remove_file(&path);
        fs::write(&path, bytes).unwrap();
        ExportedSampler::read(&path).map_err(|error| one_sentence(&error, &path))
    }

    /// The error of a file that must be refused.
    fn refused(&self, bytes: &[u8]) -> String {
        self.read(bytes).expect_err("the file is accepted")
    }
}

/// Checks the form of an error: one line that names the file.
fn one_sentence(error: &Error, path: &Path) -> String {
    let text = error.to_string();
    assert!(text.starts_with(&path.display().to_string()), "the file is not named: {text}");
    assert!(!text.contains('\n') && text.len() < 1000, "not one sentence: {text}");
    text[path.display().to_string().len()..].to_owned()
}

/// A file taken apart: the JSON header, and the bytes behind it.
struct Parts {
    header: Value,
    body: Vec<u8>,
}

impl Parts {
    fn of(bytes: &[u8]) -> Self {
        let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        Self { header: serde_json::from_slice(&bytes[8..8 + length]).unwrap(), body: bytes[8 + length..].to_vec() }
    }

    fn bytes(&self) -> Vec<u8> {
        let header = self.header.to_string();
        [&(header.len() as u64).to_le_bytes(), header.as_bytes(), &self.body].concat()
    }

    /// Changes the description.
    fn describe(mut self, change: impl FnOnce(&mut Value)) -> Vec<u8> {
        let text = self.header["__metadata__"]["headtail"].as_str().unwrap();
        let mut description: Value = serde_json::from_str(text).unwrap();
        change(&mut description);
        self.header["__metadata__"]["headtail"] = description.to_string().into();
        self.bytes()
    }

    /// Changes the entry of a tensor.
    fn entry(mut self, name: &str, change: impl FnOnce(&mut Value)) -> Vec<u8> {
        change(&mut self.header[name]);
        self.bytes()
    }

    /// Replaces all values of a tensor.
    fn values(mut self, name: &str, value: f32) -> Vec<u8> {
        let offsets = &self.header[name]["data_offsets"];
        let range = offsets[0].as_u64().unwrap() as usize..offsets[1].as_u64().unwrap() as usize;
        self.body[range].chunks_exact_mut(4).for_each(|bytes| bytes.copy_from_slice(&value.to_le_bytes()));
        self.bytes()
    }
}

#[test]
fn what_is_read_samples_like_what_was_written() {
    let folder = Folder::new();
    for sampler in samplers().into_iter().chain(microfacet_samplers()) {
        let bytes = folder.bytes_of(&sampler);
        let read = folder.read(&bytes).unwrap();
        assert_eq!(read.description(), sampler.description());
        assert_eq!(read.luminance, sampler.luminance);
        assert_eq!(draws(&read, 2000), draws(&sampler, 2000), "{:?}", sampler.description());
        assert_eq!(read.tail.forward(Vec2::new(0.3, 0.7)), sampler.tail.forward(Vec2::new(0.3, 0.7)));
        assert_eq!(folder.bytes_of(&read), bytes, "writing what was read gives the same bytes");
        assert_eq!(folder.bytes_of(&sampler), bytes, "writing twice gives the same bytes");
    }
}

#[test]
fn truncated_files_are_refused_at_every_length() {
    let folder = Folder::new();
    for sampler in [&samplers()[1], &samplers()[4]] {
        let bytes = folder.bytes_of(sampler);
        // Every length of the first bytes, then strides, then every length of the last ones.
        let lengths = (0..64).chain((64..bytes.len()).step_by(23)).chain(bytes.len() - 64..bytes.len());
        for length in lengths {
            folder.refused(&bytes[..length]);
        }
        folder.refused(&[&bytes[..], &[0; 4]].concat());
    }
}

#[test]
fn flipped_bytes_never_panic() {
    let folder = Folder::new();
    let mut accepted = 0;
    for sampler in [&samplers()[1], &samplers()[2], &samplers()[5], &samplers()[10]] {
        let bytes = folder.bytes_of(sampler);
        let header = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        let mut random = Stream::new(2, Purpose::Test, 0);
        for round in 0..1500 {
            let mut bytes = bytes.clone();
            // Two thirds of the mutations hit the header; a few hit several bytes.
            let (start, end) = if round % 3 < 2 { (0, header) } else { (header, bytes.len()) };
            for _ in 0..1 + round % 3 {
                let place = start + ((end - start) as f32 * random.uniform()) as usize;
                let flip = 1 + (255.0 * random.uniform()) as u8;
                bytes[place.min(end - 1)] ^= flip;
            }
            // What is accepted must draw without a panic, too.
            if let Ok(read) = folder.read(&bytes) {
                accepted += 1;
                draws(&read, 20);
            }
        }
    }
    assert!(accepted > 100, "{accepted}: mutations of weights are accepted, or nothing past the header was tested");
}

#[test]
fn the_settings_of_a_run_survive_a_file() {
    let folder = Folder::new();
    let sampler = samplers().swap_remove(0);
    let settings = "steps = 7\nenv = \"a \\\"room\\\".hdr\"\n";
    let with = sampler.clone().with_run(settings.into());
    assert_eq!((sampler.description().format_version, with.description().format_version), (1, 3));
    let path = folder.path("with settings");
    with.write(&path).unwrap();
    let read = ExportedSampler::read(&path).unwrap();
    assert_eq!(read.run.as_deref(), Some(settings));
    assert_eq!(draws(&read, 200), draws(&sampler, 200));
}

#[test]
fn wrong_descriptions_are_refused_by_name() {
    let folder = Folder::new();
    let head = folder.bytes_of(&samplers()[1]);
    let refused = |change: &dyn Fn(&mut Value)| folder.refused(&Parts::of(&head).describe(change));
    let expect = |error: &str, words: &[&str]| words.iter().for_each(|word| assert!(error.contains(word), "{error}"));

    expect(&refused(&|d| d["format_version"] = json!(5)), &["format_version", "is 5", "reads versions 1 to 4"]);
    expect(&refused(&|d| d["format_version"] = json!(-1)), &["format_version"]);
    expect(&refused(&|d| d["format_version"] = json!("1")), &["format_version"]);
    expect(&refused(&|d| drop(d.as_object_mut().unwrap().remove("format_version"))), &["format_version", "none"]);
    expect(&refused(&|d| d["visibility"] = json!(true)), &["visibility"]);
    expect(&refused(&|d| d["training"]["colour"] = json!(1)), &["colour"]);
    expect(&refused(&|d| d["intermediate"]["bins"] = json!(1)), &["bins"]);
    expect(&refused(&|d| d["tail"] = json!("spiral")), &["spiral"]);
    expect(&refused(&|d| d["condition"] = json!("visibility")), &["visibility"]);
    // Another condition has another length.
    expect(&refused(&|d| d["condition"] = json!("ggx")), &["encoder.linear0", "after 10"]);
    expect(&refused(&|d| d["intermediate"]["kind"] = json!("mixture")), &["mixture"]);
    expect(&refused(&|d| d["intermediate"]["mode"] = json!("both")), &["both"]);
    expect(&refused(&|d| d["intermediate"]["leaky_slope"] = json!(-0.5)), &["leaky_slope"]);
    expect(&refused(&|d| d["intermediate"]["leaky_slope"] = json!(1e300)), &["leaky_slope"]);
    expect(&refused(&|d| d["intermediate"]["encoder_layers"] = json!(usize::MAX)), &["encoder", "16"]);
    expect(&refused(&|d| d["intermediate"]["network_layers"] = json!(0)), &["layer0"]);
    expect(&refused(&|d| d["intermediate"]["network_layers"] = json!(4)), &["layer0.linear3.weight", "missing"]);
    // A layer that the description does not mention is an unknown tensor, not an ignored one.
    expect(&refused(&|d| d["intermediate"]["encoder_layers"] = json!(1)), &["layer0.linear0"]);
    expect(&refused(&|d| d["intermediate"] = json!({"kind": "bake"})), &["table.masses", "missing"]);
    // The other mode takes other inputs.
    expect(&refused(&|d| d["intermediate"]["mode"] = json!("autoregressive")), &["layer0.linear0"]);
    expect(&refused(&|d| *d = json!([1, 2])), &["format_version"]);

    let mut parts = Parts::of(&head);
    parts.header["__metadata__"]["headtail"] = "{".into();
    expect(&folder.refused(&parts.bytes()), &["metadata 'headtail'"]);
    parts.header.as_object_mut().unwrap().remove("__metadata__");
    expect(&folder.refused(&parts.bytes()), &["metadata 'headtail'", "missing"]);
}

#[test]
fn wrong_tensors_are_refused_by_name() {
    let folder = Folder::new();
    let head = folder.bytes_of(&samplers()[1]);
    let bake = folder.bytes_of(&samplers()[4]);
    let expect = |bytes: &[u8], words: &[&str]| {
        let error = folder.refused(bytes);
        words.iter().for_each(|word| assert!(error.contains(word), "{error}"));
    };
    let (weight, luminance) = ("layer1.linear1.weight", "tail.luminance");

    let mut parts = Parts::of(&head);
    let entry = parts.header.as_object_mut().unwrap().remove(weight).unwrap();
    parts.header["layer1.linear1.w"] = entry;
    expect(&parts.bytes(), &[weight, "missing"]);

    let mut parts = Parts::of(&head);
    let end = parts.body.len();
    parts.header["notes"] = json!({"dtype": "F32", "shape": [1], "data_offsets": [end, end + 4]});
    parts.body.extend([0; 4]);
    expect(&parts.bytes(), &["tensor 'notes'", "not known"]);

    for dtype in ["I32", "U32"] {
        expect(&Parts::of(&head).entry(weight, |e| e["dtype"] = json!(dtype)), &[weight, "f32"]);
        expect(&Parts::of(&head).entry(luminance, |e| e["dtype"] = json!(dtype)), &[luminance, "f32"]);
    }
    expect(&Parts::of(&head).entry(weight, |e| e["dtype"] = json!("F64")), &["header"]);
    expect(&Parts::of(&head).entry(weight, |e| e["shape"] = json!([64])), &[weight, "2 axes"]);
    expect(&Parts::of(&head).entry(weight, |e| e["shape"] = json!([8, 2, 4])), &[weight, "2 axes"]);
    expect(&Parts::of(&head).entry(weight, |e| e["shape"] = json!([4, 16])), &["layer1.linear1"]);
    expect(&Parts::of(&head).entry(weight, |e| e["shape"] = json!([64, 1])), &["layer1.linear1"]);
    expect(&Parts::of(&bake).entry("table.masses", |e| e["shape"] = json!([360])), &["table.masses", "4 axes"]);
    expect(&Parts::of(&bake).entry("table.masses", |e| e["shape"] = json!([1, 24, 3, 5])), &["normals", "1x24"]);
    expect(&Parts::of(&bake).entry("table.masses", |e| e["shape"] = json!([2, 2, 9, 10])), &["normals", "2x2"]);
    for shape in [json!([u64::MAX, 2]), json!([1_u64 << 32, 1_u64 << 32]), json!([0, 5]), json!([-1, 3]), json!([])] {
        expect(&Parts::of(&head).entry(weight, |e| e["shape"] = shape.clone()), &[""; 0]);
        expect(&Parts::of(&head).entry(luminance, |e| e["shape"] = shape.clone()), &[""; 0]);
    }
    for offsets in [json!([0, u64::MAX]), json!([u64::MAX, 0]), json!([8, 4]), json!([0]), json!("all")] {
        expect(&Parts::of(&head).entry(weight, |e| e["data_offsets"] = offsets.clone()), &["header"]);
    }
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        expect(&Parts::of(&head).values(weight, value), &["layer1.linear1", "not finite"]);
        expect(&Parts::of(&head).values("layer0.linear0.bias", value), &["layer0.linear0", "not finite"]);
        expect(&Parts::of(&head).values(luminance, value), &["luminance"]);
        expect(&Parts::of(&bake).values("table.masses", value), &["table"]);
    }
    expect(&Parts::of(&head).values(luminance, 0.0), &["luminance", "zero everywhere"]);
    expect(&Parts::of(&head).values(luminance, -1.0), &["luminance", "negative"]);
    expect(&Parts::of(&bake).values("table.masses", -1.0), &["table", "negative"]);
    // The length of the header itself.
    for length in [0, 1, 100_000_000_u64, u64::MAX] {
        expect(&[&length.to_le_bytes()[..], &head[8..]].concat(), &["header"]);
    }
}

#[test]
fn a_wrong_selection_network_is_refused_by_name() {
    let folder = Folder::new();
    let expect = |bytes: &[u8], words: &[&str]| {
        let error = folder.refused(bytes);
        words.iter().for_each(|word| assert!(error.contains(word), "{error}"));
    };
    for sampler in microfacet_samplers() {
        let bytes = folder.bytes_of(&sampler);
        let shaped = |name: &str, shape: Value| Parts::of(&bytes).entry(name, |entry| entry["shape"] = shape);
        // As many numbers in another shape: the condition, then the encoder's five outputs, to 4 and on to 1.
        let seen = Parts::of(&bytes).header["selection.linear0.weight"]["shape"][1].as_u64().unwrap();
        expect(&shaped("selection.linear0.weight", json!([seen, 4])), &["selection.linear0"]);
        expect(&shaped("selection.linear0.weight", json!([2, 2 * seen])), &["selection.linear0"]);
        expect(&shaped("selection.linear0.weight", json!([4 * seen])), &["selection.linear0.weight", "2 axes"]);
        expect(&shaped("selection.linear1.weight", json!([4, 1])), &["selection.linear1"]);
        expect(&shaped("selection.linear1.bias", json!([1, 1])), &["selection.linear1.bias", "1 axes"]);
        expect(&Parts::of(&bytes).values("selection.linear0.weight", f32::NAN), &["selection.linear0", "not finite"]);

        let layers =
            |count: usize| Parts::of(&bytes).describe(|d| d["intermediate"]["selection_layers"] = json!(count));
        expect(&layers(0), &["selection.linear", "not known"]);
        expect(&layers(1), &["selection"]);
        expect(&layers(3), &["selection.linear2.weight", "missing"]);
        expect(&layers(usize::MAX), &["selection", "16"]);
    }
    // Layers that fit each other, but not the head: those of the shorter condition.
    let [ggx, roughness] = [0, 1].map(|k| folder.bytes_of(&microfacet_samplers()[k]));
    let mut parts = Parts::of(&roughness);
    let other = Parts::of(&ggx);
    let range = |parts: &Parts, name: &str| {
        let offsets = &parts.header[name]["data_offsets"];
        offsets[0].as_u64().unwrap() as usize..offsets[1].as_u64().unwrap() as usize
    };
    let values = other.body[range(&other, "selection.linear0.weight")].to_vec();
    let own = range(&parts, "selection.linear0.weight");
    let cut = own.len() - values.len();
    parts.body.splice(own.clone(), values);
    parts.header["selection.linear0.weight"] = json!({
        "dtype": "F32", "shape": other.header["selection.linear0.weight"]["shape"],
        "data_offsets": [own.start, own.end - cut],
    });
    for (name, entry) in parts.header.as_object_mut().unwrap() {
        if name != "__metadata__" && entry["data_offsets"][0].as_u64().unwrap() as usize >= own.end {
            for k in 0..2 {
                entry["data_offsets"][k] = json!(entry["data_offsets"][k].as_u64().unwrap() as usize - cut);
            }
        }
    }
    expect(&parts.bytes(), &["selection", "17 numbers to one"]);
}

#[test]
fn extreme_weights_never_panic() {
    let folder = Folder::new();
    for sampler in [&samplers()[0], &samplers()[1], &samplers()[2], &samplers()[3]] {
        let bytes = folder.bytes_of(sampler);
        let names: Vec<String> = Parts::of(&bytes).header.as_object().unwrap().keys().cloned().collect();
        for name in names.iter().filter(|name| name.contains("linear")) {
            for value in [0.0, f32::MAX, -f32::MAX, 1e20, f32::MIN_POSITIVE, -1e3] {
                // Some make no density and are refused.
                if let Ok(read) = folder.read(&Parts::of(&bytes).values(name, value)) {
                    draws(&read, 50);
                }
            }
        }
    }
}

#[test]
fn what_is_no_sampler_file_is_refused() {
    let folder = Folder::new();
    assert!(folder.refused(b"").contains("no sampler written by headtail"));
    assert!(folder.refused(b"# a text file\nwith two lines\n").contains("no sampler written by headtail"));
    assert!(folder.refused(&[0; 4096]).contains("no sampler written by headtail"));
    assert!(folder.refused(&[0xFF; 4096]).contains("no sampler written by headtail"));
    // Nested JSON deep enough to exhaust a recursive parser's stack.
    let deep = format!("{{\"a\":{}", "[".repeat(200_000));
    assert!(folder.refused(&[&(deep.len() as u64).to_le_bytes(), deep.as_bytes()].concat()).contains("header"));
    for path in [folder.0.path().to_owned(), folder.path("not there.safetensors")] {
        one_sentence(&ExportedSampler::read(&path).expect_err("accepted"), &path);
    }
}

#[test]
fn a_map_that_is_not_the_sampler_s_is_refused() {
    let folder = Folder::new();
    let path = folder.path("head.safetensors");
    samplers()[0].write(&path).unwrap();
    let spec = SamplerSpec::file(FileKind::Head, path.clone());
    spec.build(&environment("test map", 0)).unwrap();
    let other = environment("other map", 1);
    let error = one_sentence(&spec.build(&other).err().expect("accepted"), &path);
    for word in ["test map", "other map", "bake it for this map"] {
        assert!(error.contains(word), "{error}");
    }
    // The hash is of the map; the tail is built from the luminance in the file, which must be that of the map: where it
    // is dark and the map is not, light would be lost without a word.
    let mut parts = Parts::of(&fs::read(&path).unwrap());
    let first = parts.header["tail.luminance"]["data_offsets"][0].as_u64().unwrap() as usize;
    parts.body[first + 160..first + 320].fill(0);
    fs::write(&path, parts.bytes()).unwrap();
    let error = one_sentence(&spec.build(&environment("test map", 0)).err().expect("accepted"), &path);
    assert!(error.contains("luminance"), "{error}");
}

#[test]
fn a_file_of_another_kind_is_refused_with_advice() {
    let folder = Folder::new();
    let map = environment("test map", 0);
    let path = |name: &str| folder.path(name);
    for (name, index) in [("head", 0), ("baked", 4), ("direct", 5)] {
        samplers()[index].write(&path(name)).unwrap();
    }
    let build = |kind: &str, name: &str| {
        let spec: SamplerSpec = format!("{kind}:{}", path(name).display()).parse().unwrap();
        spec.build(&map).map(drop).map_err(|error| one_sentence(&error, &path(name)))
    };
    for (kind, name, advice) in [
        ("baked", "head", "head:FILE"),
        ("direct", "head", "head:FILE"),
        ("head", "baked", "baked:FILE"),
        ("direct", "baked", "baked:FILE"),
        ("head", "direct", "direct:FILE"),
        ("baked", "direct", "direct:FILE"),
    ] {
        let error = build(kind, name).unwrap_err();
        assert!(error.contains(advice), "{kind}:{name}: {error}");
    }
    for kind in ["head", "baked", "direct"] {
        build(kind, kind).unwrap();
    }
}

#[test]
fn a_file_that_cannot_be_read_back_is_not_written() {
    let folder = Folder::new();
    let path = folder.path("diverged.safetensors");
    for broken in [f64::NAN, f64::INFINITY] {
        let mut sampler = samplers().swap_remove(0);
        sampler.training.as_mut().unwrap().final_kl = broken;
        let error = one_sentence(&sampler.write(&path).unwrap_err(), &path);
        assert!(error.contains("final_kl"), "{error}");
        assert!(!path.exists());
    }
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

#[test]
fn a_condition_of_the_wrong_length_is_an_error() {
    for condition in [Condition::Normal, Condition::Ggx, Condition::GgxRoughness] {
        let head = head_of(condition, Mode::Coupled, true, true);
        let right = condition.length();
        assert!(head.at(&vec![0.5; right]).is_ok());
        for length in [0, 1, right - 1, right + 1, 1000] {
            let error = head.at(&vec![0.5; length]).expect_err("accepted").to_string();
            let words = ["condition", &format!("{length} numbers"), &format!("takes {right}")];
            assert!(words.iter().all(|word| error.contains(word)) && !error.contains('\n'), "{error}");
        }
    }
}
