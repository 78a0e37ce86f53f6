//! Exported files: round trips are exact, and no file content makes the reader panic.

mod flow_tails;
#[path = "../layers/mod.rs"]
mod layers;
mod refused;

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
    sampler::{AtPoint, Direction, EnvironmentLight, ProductSampler, Sampler},
    spec::{FileKind, SamplerSpec},
    tail::{Tail, TailKind, TailWarp, WarpMap},
    tile::ShadingPoint,
};
use layers::random_layers;
use serde_json::{Value, json};

fn environment(name: &str, salt: usize) -> Arc<Environment> {
    let pixels = (0..16 * 9).map(|k| [((k * 7 + salt) % 11) as f32, 1.0, (k % 3) as f32]).collect();
    Arc::new(Environment::from_image(name, Image { width: 16, height: 9, pixels }).unwrap())
}

fn head(mode: Mode, encoder: bool) -> Head {
    head_of(Condition::Normal, mode, encoder, false)
}

/// Returns a head with random weights, of the size that its condition requires.
fn head_of(condition: Condition, mode: Mode, encoder: bool, mixture_weight: bool) -> Head {
    let mut random = Stream::new(5, Purpose::Weights, 0);
    let mut layers = |sizes: &[usize]| random_layers(sizes, &mut random, |_| [1.0; 2]);
    let encoder = if encoder { layers(&[condition.length(), 6, 5]) } else { Vec::new() };
    let seen = condition.length() + encoder.last().map_or(0, Linear::outputs);
    let features = if mode == Mode::Coupled { 2 } else { 0 };
    let networks = [layers(&[seen + features, 8, 8, 13]), layers(&[seen + 1, 8, 8, 13])];
    let mixture_weight = if mixture_weight { layers(&[seen, 4, 1]) } else { Vec::new() };
    Head::new(condition, mode, 0.01, encoder, networks).unwrap().with_mixture_weight(mixture_weight).unwrap()
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
        backend: "ndarray".into(),
        final_kl: 0.012_345_678_901_234_5,
        relative_variance: 0.1,
        seconds: None,
        tabulated_seconds: None,
    }
}

/// Returns samplers of every kind of content with either tail.
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

/// Returns a sampler's draws: directions and both pdfs, as bits; 16 at each of several points.
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

/// Returns heads for microfacet surfaces with selection networks.
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
fn patches_require_a_head_and_the_hierarchical_tail() {
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

/// A temporary folder of files.
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
        // Some file systems wait for the disk when a file is truncated and rewritten, so it is removed first.
        let _ = fs::remove_file(&path);
        fs::write(&path, bytes).unwrap();
        ExportedSampler::read(&path).map_err(|error| one_sentence(&error, &path))
    }

    /// Returns the error of a file that must be rejected.
    fn refused(&self, bytes: &[u8]) -> String {
        self.read(bytes).expect_err("the file is accepted")
    }
}

/// Checks that an error is one line that names the file, and returns it.
fn one_sentence(error: &Error, path: &Path) -> String {
    let text = error.to_string();
    assert!(text.starts_with(&path.display().to_string()), "the file is not named: {text}");
    assert!(!text.contains('\n') && text.len() < 1000, "not one sentence: {text}");
    text[path.display().to_string().len()..].to_owned()
}

/// A file split into the JSON header and the bytes after it.
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
fn read_samplers_draw_as_written_ones() {
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
