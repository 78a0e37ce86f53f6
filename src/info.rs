//! `headtail info`: describes a file, or the program and the machine.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::Args;
use headtail_render::{
    brdf::{NeuralTexture, neural},
    environment::{Environment, MapSpec},
    export::{ExportedSampler, Intermediate},
    image::{Picture, read_picture, text_attributes},
    remark::Remark,
    rival::{RivalFile, RivalKind},
    scene::{FspyProject, Scene, UpAxis},
    simd::instruction_set,
    spec::SamplerSpec,
    visibility::SceneVisibility,
};
use headtail_train::state_file::describe;
use serde_json::{Map, Value, json};

use crate::terminal::{out, print_json};

/// Describe a file, or the program and this machine.
/// A sampler, map, picture, scene, material, precomputed visibility, checkpoint or fSpy project; without a file: features of this build, threads, instruction set and graphics adapters.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail info
  headtail info out/room/sampler.safetensors
  headtail info room.hdr --json
  headtail info out/temple.exr")]
pub struct Arguments {
    /// File to describe.
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// Print a JSON object.
    #[arg(long)]
    json: bool,
}

/// Names and values, in the order in which they are shown.
type Facts = Vec<(String, Value)>;

/// Prints the description.
pub fn run(arguments: &Arguments) -> Result<()> {
    let facts = arguments.file.as_ref().map_or_else(|| Ok(machine()), |file| facts(file))?;
    if arguments.json {
        return print_json(&facts.into_iter().collect::<Map<String, Value>>());
    }
    let width = facts.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    for (name, value) in &facts {
        let text = match value {
            Value::String(text) => text.clone(),
            Value::Array(lines) if lines.iter().all(Value::is_string) => {
                lines.iter().filter_map(Value::as_str).collect::<Vec<_>>().join("\n")
            }
            value => value.to_string(),
        };
        out!("{name:width$}  {}", text.trim_end().replace('\n', &format!("\n{:width$}  ", "")));
    }
    Ok(())
}

/// Describes the program and what it can use here.
fn machine() -> Facts {
    let features = [("flex", cfg!(feature = "flex")), ("gpu", cfg!(feature = "gpu")), ("wgpu", cfg!(feature = "wgpu"))];
    let features: Vec<&str> = features.into_iter().filter_map(|(name, is_there)| is_there.then_some(name)).collect();
    vec![
        fact("version", env!("CARGO_PKG_VERSION")),
        fact("features", features),
        fact("threads", rayon::current_num_threads()),
        fact("instruction_set", instruction_set().unwrap_or("portable")),
        fact("adapters", adapters()),
    ]
}

/// Names the graphics adapters; the first one is that of `--device gpu`.
#[cfg(feature = "gpu")]
fn adapters() -> Vec<String> {
    headtail_gpu::Gpu::adapters()
}

#[cfg(not(feature = "gpu"))]
fn adapters() -> Vec<String> {
    vec!["not looked for: build with --features gpu".into()]
}

fn facts(path: &Path) -> Result<Facts> {
    if path.is_dir() {
        bail!("{}: it is a folder: name one of its files", path.display());
    }
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).unwrap_or_default();
    match &*extension {
        "glb" | "gltf" => scene(path),
        "fspy" => project(path),
        "hdr" | "exr" | "pic" | "rgbe" => picture(path),
        _ => {
            // Other extensions. If no reader accepts the file, the error of the sampler reader is the most
            // helpful.
            let others = [picture, visibility, neural_material, trained_for_materials, measured_materials, training];
            others.into_iter().find_map(|read| read(path).ok()).map_or_else(|| sampler(path), Ok)
        }
    }
}

fn fact(name: &str, value: impl Into<Value>) -> (String, Value) {
    (name.to_owned(), value.into())
}

fn sampler(path: &Path) -> Result<Facts> {
    let exported = ExportedSampler::read(path)?;
    let kind = match &exported.intermediate {
        Intermediate::Head(_) if exported.patches.is_some() => "a trained head over patches of sky",
        Intermediate::Head(_) => "a trained head",
        Intermediate::Bake(_) => "a table of a trained head",
        Intermediate::DirectBake(_) => "a table of light x cosine",
    };
    let spec = SamplerSpec::of_exported(&exported, path.to_owned());
    let mut facts = vec![fact("file", kind), fact("render with", format!("--sampler {spec}"))];
    if let Intermediate::Head(head) = &exported.intermediate {
        let layers = head.layers();
        let weights: usize = layers.iter().map(|(_, layer)| (layer.inputs() + 1) * layer.outputs()).sum();
        facts.push(fact("condition", serde_json::to_value(head.condition())?));
        facts.push(fact("layers", layers.len()));
        facts.push(fact("weights", weights));
        facts.push(fact("learned mixture weight", head.has_mixture_weight()));
    }
    let (width, height, _) = &exported.luminance;
    if let Some(detail) = exported.patches {
        facts.push(fact("patches", serde_json::to_value(detail)?));
    }
    facts.push(fact("tail", exported.tail.kind().name()));
    facts.push(fact("environment", format!("{} ({width} x {height})", exported.environment)));
    facts.push(fact("environment hash", exported.environment_hash.clone()));
    if let Some(training) = &exported.training {
        facts.push(fact("training", serde_json::to_value(training)?));
    }
    facts.extend(exported.run.map(|run| fact("settings", run)));
    Ok(facts)
}

fn picture(path: &Path) -> Result<Facts> {
    let Picture { image, layout, mut remarks, repair, is_converted } = read_picture(path, None)?;
    let attributes = text_attributes(path).unwrap_or_default();
    let kind = if is_converted { "a picture, converted to linear Rec.709" } else { "a linear picture" };
    let mut facts = vec![fact("file", kind), fact("size", format!("{} x {}", image.width, image.height))];
    let finite = image.pixels.iter().flatten().filter(|value| value.is_finite());
    let (least, most) = finite.fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), &value| (a.min(value), b.max(value)));
    facts.push(fact("values", format!("{least} to {most}")));
    if let Some(layout) = layout {
        facts.push(fact("layout", layout.to_string()));
    }
    let is_rendering = attributes.iter().any(|(name, _)| name == "headtail.version");
    if layout.is_some() || !is_rendering && image.width == 2 * image.height {
        facts[0].1 =
            if layout.is_some() { "an environment map" } else { "a lat-long map or a picture of 2 : 1" }.into();
        let environment = Environment::load(path, &MapSpec::default())?;
        facts.push(fact("hash", environment.hash()));
        facts.extend(remarks_of(environment.remarks()));
    } else {
        remarks.extend(repair.remarks_of_photograph());
        facts.extend(remarks_of(&remarks));
    }
    facts.extend(attributes.into_iter().map(|(name, value)| (name, value.into())));
    Ok(facts)
}

/// Returns the notes and the warnings about a file, one per line.
fn remarks_of(remarks: &[Remark]) -> impl Iterator<Item = (String, Value)> {
    let texts = |warnings: bool| -> Vec<&str> {
        remarks.iter().filter(|remark| remark.is_warning() == warnings).map(Remark::text).collect()
    };
    let facts = [("notes", texts(false)), ("warnings", texts(true))];
    facts.into_iter().filter(|(_, texts)| !texts.is_empty()).map(|(name, texts)| fact(name, texts.join("\n")))
}

fn visibility(path: &Path) -> Result<Facts> {
    let visibility = SceneVisibility::read(path)?;
    let facts = [
        fact("file", "learned visibility of a scene"),
        fact("render with", format!("--sampler patches+vis:{}", path.display())),
        fact("cells", visibility.cells()),
        fact("shadow rays", visibility.rays()),
        fact("environment", visibility.environment.clone()),
        fact("environment hash", visibility.environment_hash.clone()),
        fact("scene hash", visibility.scene_hash),
    ];
    Ok(facts.into_iter().chain(seconds("seconds of learning", visibility.seconds)).collect())
}

fn trained_for_materials(path: &Path) -> Result<Facts> {
    let file = RivalFile::read(path)?;
    let family = if file.kind == RivalKind::Reparam { "reparam" } else { "neusample" };
    let names: Vec<&String> = file.rivals.iter().map(|(name, ..)| name).collect();
    let facts = [
        fact("file", "samplers that were trained for materials"),
        fact("render with", format!("--sampler {family}:{}", path.display())),
        fact("materials", json!(names)),
    ];
    Ok(facts.into_iter().chain(seconds("seconds of training", file.seconds)).collect())
}

/// Returns the time that making the file took, if it is recorded.
fn seconds(name: &str, seconds: Option<f64>) -> Option<(String, Value)> {
    seconds.map(|seconds| fact(name, seconds))
}

fn neural_material(path: &Path) -> Result<Facts> {
    let material = NeuralTexture::read(path)?;
    let described = material.description();
    let facts = [
        fact("file", "a neural material over texture coordinates"),
        fact("render with", format!("--material neural:{}", path.display())),
        fact("fitted to", described.name.clone()),
        fact("steps", described.steps),
    ];
    let measured = described.psnr.map(|psnr| fact("dB against it", psnr));
    Ok(facts.into_iter().chain(measured).chain(seconds("seconds of training", described.seconds)).collect())
}

fn measured_materials(path: &Path) -> Result<Facts> {
    let names: Vec<String> = neural::read_networks(path)?.into_iter().map(|(name, _)| name).collect();
    let use_as = format!("--material nbrdf:{}#{}", path.display(), names[0]);
    Ok(vec![fact("file", "measured materials as networks"), fact("render with", use_as), fact("names", json!(names))])
}

fn scene(path: &Path) -> Result<Facts> {
    let scene = Scene::load(path)?;
    let [x, y, z] = scene.bounds().extent().to_array();
    let names: Vec<&str> = scene.mesh_names().into_iter().collect();
    let cameras: Vec<&str> = scene.camera_names().collect();
    let facts = vec![
        fact("file", "a glTF 2.0 scene"),
        fact("triangles", scene.triangle_count()),
        fact("size in metres", format!("{x} x {y} x {z}")),
        fact("surfaces", if scene.is_diffuse() { "diffuse" } else { "diffuse and glossy" }),
        fact("meshes", json!(names)),
        fact("cameras", json!(cameras)),
        fact("hash", scene.content_hash()),
    ];
    Ok(facts.into_iter().chain(remarks_of(scene.remarks())).collect())
}

fn project(path: &Path) -> Result<Facts> {
    let project = FspyProject::read(path, UpAxis::Z)?;
    let [x, y, z] = project.camera.look_from().to_array();
    Ok(vec![
        fact("file", "a project of fSpy"),
        fact("size", format!("{} x {}", project.width, project.height)),
        fact("camera at", format!("{x}, {y}, {z}")),
        fact("vertical field of view", project.camera.vertical_fov()),
        fact("picture", format!("{} bytes", project.image.len())),
    ])
}

fn training(path: &Path) -> Result<Facts> {
    Ok([fact("file", "a checkpoint of a training")].into_iter().chain(describe(path)?).collect())
}
