//! Randomly mutated files and texts: each is accepted or rejected with an error, in bounded memory and
//! without a panic.
//!
//! Inputs are a function of their index, so that failures can be reproduced: the message states the index,
//! and the input is left in a file. `HEADTAIL_FUZZ_INPUTS` sets the number of inputs per reader (2000 by
//! default), `HEADTAIL_FUZZ_FIRST` the first index.

mod corpus;
mod memory;
mod mutation;

use std::{
    collections::HashMap,
    fs,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    time::Instant,
};

use headtail_render::{
    brdf::{NeuralTexture, neural::read_networks},
    export::ExportedSampler,
    image::{Photograph, read_radiance, text_attributes},
    portals,
    rival::RivalFile,
    scene::{FspyProject, MaterialSpec, Scene, UpAxis},
    spec::SamplerSpec,
    tensor_file,
    visibility::SceneVisibility,
};
use headtail_train::{CheckpointFolder, Checkpoints, ConfigBuilder, Preset, state::TrainingState};
use mutation::Mutation;

#[global_allocator]
static ALLOCATOR: memory::Counting = memory::Counting;

/// Memory limit per input. Inputs have at most 64 KiB and compress by at most 1000:1; a picture of the
/// largest size would take 1.6 GB.
const MOST_BYTES: usize = 256 << 20;

const SEED: u64 = 0xf022;

fn number_of(variable: &str, default: u64) -> u64 {
    std::env::var(variable).map_or(default, |text| text.parse().expect(variable))
}

/// Runs a reader on its inputs. `read` returns whether an input was accepted.
fn fuzz(name: &str, inputs: &[Vec<u8>], read: impl Fn(&Path, &[u8]) -> bool) {
    let folder = tempfile::tempdir_in(if Path::new("/dev/shm").is_dir() { "/dev/shm" } else { "." }).unwrap();
    let path = folder.path().join(name);
    let refused = inputs.iter().filter(|input| {
        fs::write(&path, input).unwrap();
        !read(&path, input)
    });
    // Some inputs of the corpus are invalid on purpose.
    let refused = refused.count();
    assert!(2 * refused <= inputs.len(), "{name}: {refused} of {} inputs of the corpus are refused", inputs.len());
    let (count, first) = (number_of("HEADTAIL_FUZZ_INPUTS", 2000), number_of("HEADTAIL_FUZZ_FIRST", 0));
    let (start, mut taken, mut peak) = (Instant::now(), 0_u64, 0);
    for number in first..first + count {
        let bytes = Mutation::new(SEED, number).of(inputs);
        fs::write(&path, &bytes).unwrap();
        peak = peak.max(memory::peak_of(MOST_BYTES, || match catch_unwind(AssertUnwindSafe(|| read(&path, &bytes))) {
            Ok(is_taken) => taken += u64::from(is_taken),
            Err(_) => {
                let kept = keep(name, number, &bytes);
                panic!("{name}: input {number} makes the reader panic; it is in {}", kept.display());
            }
        }));
    }
    let seconds = start.elapsed().as_secs_f64();
    println!("{name}: {count} inputs from {first}, {taken} taken, {:.1} MB at most, {seconds:.0} s", peak as f64 / 1e6);
}

fn keep(name: &str, number: u64, bytes: &[u8]) -> PathBuf {
    let path = std::env::temp_dir().join(format!("headtail-fuzz-{name}-{number}"));
    fs::write(&path, bytes).unwrap();
    path
}

// One test, since the allocator counts for the whole process.
#[test]
fn readers_neither_panic_nor_exceed_memory_limits() {
    let only = std::env::var("HEADTAIL_FUZZ_ONLY").unwrap_or_default();
    let is_wanted = |name: &str| name.contains(&only);
    let image = |path: &Path, _: &[u8]| {
        let taken = read_radiance(path).is_ok();
        // The header can be valid even if pixels are not.
        let _ = text_attributes(path);
        taken
    };
    let made = tempfile::tempdir().unwrap();
    let (samplers, checkpoint, weights) = corpus::trained(made.path());
    if is_wanted("hdr") {
        fuzz("hdr", &corpus::radiance(), image);
    }
    if is_wanted("exr") {
        fuzz("exr", &corpus::openexr(), image);
    }
    if is_wanted("photo") {
        fuzz("photo", &corpus::photographs(), |path, _| Photograph::read(path).is_ok());
    }
    if is_wanted("gltf") {
        let [glb, rare, loose, gltf] = <[Vec<u8>; 4]>::try_from(corpus::gltf()).unwrap();
        fuzz("gltf.glb", &[glb, rare, loose], |path, _| Scene::load(path).is_ok());
        // The buffer is too short for the accessors, so the original is rejected.
        fuzz("gltf.gltf", &[gltf], |path, bytes| Scene::load(path).is_ok() || bytes.starts_with(b"{\"asset"));
    }
    if is_wanted("sampler") {
        fuzz("sampler", &samplers, |path, _| ExportedSampler::read(path).is_ok());
    }
    if is_wanted("visibility") {
        fuzz("visibility", &[corpus::visibility(made.path())], |path, _| SceneVisibility::read(path).is_ok());
    }
    if is_wanted("portals") {
        fuzz("portals.json", &[corpus::portals()], |path, _| portals::read(path).is_ok());
    }
    if is_wanted("nbrdf") {
        let read = |path: &Path, _: &[u8]| {
            fs::write(path.with_extension("names.txt"), "a\nb\n").unwrap();
            read_networks(path).is_ok()
        };
        fuzz("nbrdf.f32", &[corpus::measured()], read);
    }
    if is_wanted("rival") {
        fuzz("rival", &corpus::rivals(made.path()), |path, _| RivalFile::read(path).is_ok());
    }
    if is_wanted("neural") {
        let corpus = [corpus::neural_texture(made.path())];
        fuzz("neural", &corpus, |path, _| NeuralTexture::read(path).is_ok());
    }
    if is_wanted("fspy") {
        let read = |path: &Path, _: &[u8]| {
            FspyProject::read(path, UpAxis::Z).is_ok_and(|project| project.photograph().is_ok())
        };
        fuzz("fspy", &corpus::fspy(), read);
    }
    if is_wanted("toml") {
        let read = |path: &Path, bytes: &[u8]| {
            let mut builder = ConfigBuilder::new(Preset::FastCosine);
            let is_file = builder.file(path).is_ok();
            let lines = std::str::from_utf8(bytes).unwrap_or_default().lines();
            let _ = lines.filter(|line| builder.assignment(line).is_ok()).count();
            is_file && builder.build().is_ok_and(|config| config.validate().is_ok() || config.steps > 0)
        };
        fuzz("toml", &corpus::toml(), read);
    }
    if is_wanted("spec") {
        let read = |_: &Path, bytes: &[u8]| {
            let text = String::from_utf8_lossy(bytes);
            let sampler = text.parse::<SamplerSpec>();
            // Accepted specs are printed in a form that parses to the same.
            if let Ok(spec) = &sampler {
                assert!(spec.to_string().parse::<SamplerSpec>().is_ok_and(|again| again == *spec), "{text}");
            }
            sampler.is_ok() || text.parse::<MaterialSpec>().is_ok()
        };
        fuzz("spec", &corpus::specs(), read);
    }
    if is_wanted("checkpoint") {
        fuzz_checkpoints(made.path(), &checkpoint, weights);
    }
}

/// Checkpoints end with a checksum. Most inputs get a new one, so that later checks are reached; the header
/// is also mutated alone.
fn fuzz_checkpoints(made: &Path, checkpoint: &[u8], weights: usize) {
    const ENTRY: &str = "headtail_state";
    let config = corpus::config();
    let settings: serde_json::Value = serde_json::from_str(&serde_json::to_string(&config).unwrap()).unwrap();
    let blank = TrainingState::new(&config, vec![0.0; weights]);
    let folder = CheckpointFolder { folder: made.join("fuzzed"), every: 1, resume: true, target: "target".into() };
    let goes_on = |state: &[u8], is_summed: bool| {
        let sum = if is_summed { blake3::hash(state).to_hex().to_string() } else { "x".into() };
        drop(fs::remove_dir_all(&folder.folder));
        fs::create_dir_all(&folder.folder).unwrap();
        fs::write(folder.folder.join("step-000000002"), [state, sum.as_bytes()].concat()).unwrap();
        folder.open(&settings, &blank, &mut |_| {}).is_ok_and(|found| found.is_some())
    };
    let state = &checkpoint[..checkpoint.len() - 2 * blake3::OUT_LEN];
    fuzz("checkpoint.state", &[state.to_vec()], |_, bytes| goes_on(bytes, bytes.len() % 8 != 7) || bytes == state);
    let (metadata, tensors) = tensor_file::open(state).unwrap();
    let header = metadata.metadata().as_ref().unwrap()[ENTRY].clone().into_bytes();
    fuzz("checkpoint.header", &[header], |_, bytes| {
        let header = HashMap::from([(ENTRY.to_owned(), String::from_utf8_lossy(bytes).into_owned())]);
        goes_on(&safetensors::serialize(tensors.iter(), Some(header)).unwrap(), true)
    });
}
