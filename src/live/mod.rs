//! `headtail live`: a page that renders a view with two samplers while one looks, by WebGPU.

use std::{io::Write, path::PathBuf};

use anyhow::{Context, Result, bail, ensure};
use base64::{Engine, engine::general_purpose::STANDARD};
use clap::Args;
use flate2::{Compression, write::GzEncoder};
use headtail_eval::{Budget, OpenedView};
use headtail_gpu::{BINDINGS, LitScene, Program, ViewWords, visibility_words};
use headtail_render::{
    file,
    integrator::View,
    points::{PointSet, Points},
    spec::{SamplerSpec, Visibility},
};
use maud::{Markup, PreEscaped, html};
use serde_json::{Value, json};

use crate::{
    arguments::{ViewArguments, samplers_help},
    compare::SamplerList,
    exposure,
    given::given,
    output::OutputFile,
    progress,
    report::shell::Page,
    terminal::{self, say, warning},
};

const SCRIPT: &str = include_str!("live.js");
const STYLE: &str = include_str!("live.css");
const DISPLAY: &str = include_str!("display.wgsl");
const ERROR: &str = include_str!("error.wgsl");
/// Samples of a lattice; later ones are those of another shift.
const SAMPLES: u32 = 64;
/// Samples per pixel that find the exposure.
const EXPOSED: u32 = 4;
/// WebGPU's least `maxStorageBufferBindingSize`, in bytes.
const WEBGPU_BINDING: usize = 134_217_728;

/// Write a page that renders a view live.
/// Two samplers side by side at equal time, by WebGPU: one file, without a server.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail live --scene temple --env sunset --samplers mis2-comp,split:4:patches --out out/temple.html
  headtail live --scene spot.glb --ground --env room.hdr --samplers mis,head+mis:out/room/sampler.safetensors --out out/spot.html

Drag on the picture to turn the camera, or use the arrow keys; the wheel, two fingers, + and - move it. The page has all that its pictures \
need, and its address keeps what is chosen. It needs a browser with WebGPU.")]
pub struct Arguments {
    #[command(flatten)]
    view: ViewArguments,
    #[arg(long, value_name = "SPEC,...", required = true, value_parser = given::<SamplerList>())]
    #[arg(help = "Samplers of directions, separated by commas; --help lists them", long_help = samplers_help("Samplers of directions that graphics devices have, separated by commas; the first two are shown first."))]
    samplers: Vec<SamplerList>,
    /// Page to write.
    #[arg(long, value_name = "FILE.html")]
    out: PathBuf,
}

/// Writes the page.
pub fn run(arguments: &Arguments) -> Result<()> {
    let is_page = arguments.out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("html"));
    ensure!(is_page, "--out {}: the file's name must end in .html", arguments.out.display());
    let specs: Vec<&SamplerSpec> = arguments.samplers.iter().flat_map(|list| &list.0).collect();
    let is_lattice = matches!(arguments.view.points, PointSet::Lattice { .. });
    ensure!(is_lattice, "--points {}: live pages have lattice points", arguments.view.points);
    let output = OutputFile::take(&arguments.out)?;
    let opened = arguments.view.open()?;
    let busy = progress::busy("page");
    let page = page(&opened, &specs)?;
    drop(busy);
    output.write(|path| file::replace(path, page.as_bytes()))?;
    say!("open {} ({:.1} MB)", arguments.out.display(), page.len() as f64 / 1e6);
    Ok(())
}

/// Returns the page of a view and its samplers.
fn page(opened: &OpenedView, specs: &[&SamplerSpec]) -> Result<String> {
    let scene = LitScene::new(opened.scene(), opened.environment.clone())?;
    let samplers = specs.iter().map(|spec| sampler(opened, &scene, spec)).collect::<Result<Vec<_>>>()?;
    let [geometry, surfaces, texels] =
        [words(scene.geometry().as_flattened()), scene.surfaces().to_vec(), words(scene.texels())];
    let largest = 4 * [geometry.len(), surfaces.len(), texels.len()].into_iter().max().unwrap_or(0);
    if largest > WEBGPU_BINDING {
        warning!(
            "a buffer has {largest} bytes, more than the {WEBGPU_BINDING} that every WebGPU device has: the page asks for more, and some \
             devices refuse"
        );
    }
    let content = json!({
        "bindings": BINDINGS.map(|binding| format!("{binding:?}")),
        "view": view(opened)?,
        "round": SAMPLES,
        "scene": { "Geometry": packed(&geometry)?, "Surfaces": packed(&surfaces)?, "Texels": packed(&texels)? },
        "samplers": samplers,
        "display": DISPLAY,
        "error": ERROR,
    });
    let View { width, height, .. } = opened.view();
    let kicker = "samplers live";
    let page = Page {
        kicker,
        title: format!("{} live", opened.scene_name()),
        heading: html! { (opened.scene_name()) " " span { "under " (opened.light_name()) } },
        facts: Vec::new(),
        command: &terminal::command(),
        version: env!("CARGO_PKG_VERSION"),
        style: STYLE,
        script: SCRIPT,
    };
    Ok(page.encode(&main(&content, (width, height), specs)))
}

/// Returns a sampler's program and the numbers of a round of its samples.
fn sampler(opened: &OpenedView, scene: &LitScene, spec: &SamplerSpec) -> Result<Value> {
    let program = opened.with_context(spec, |context| Program::new(scene, spec, context))??;
    let visibility = match spec.visibility() {
        Visibility::None => None,
        Visibility::File(_) => opened.learned_visibility(spec)?.flat_precomputed(),
        Visibility::Learned => bail!(
            "sampler '{spec}': learned visibility depends on the view, which turns; name a file of bake --visibility, or leave out +vis"
        ),
    };
    let points = Points::new(PointSet::Lattice { samples: SAMPLES }, 0);
    let view = opened.view();
    let numbers = ViewWords::new(&view, view.whole(), points, (0, SAMPLES), &program.groups);
    Ok(json!({
        "name": spec.to_string(),
        "source": program.source,
        "Floats": packed(&words(&program.floats))?,
        "Integers": packed(&program.integers)?,
        "Visibility": packed(&visibility_words(visibility.as_ref()))?,
        "numbers": packed(numbers.numbers())?,
    }))
}

/// Returns camera and size, and the exposure in stops.
fn view(opened: &OpenedView) -> Result<Value> {
    let View { camera, width, height, depth, unshadowed, .. } = opened.view();
    let patches = opened.estimator(&SamplerSpec::patches())?;
    let stop = std::sync::atomic::AtomicBool::new(false);
    let picture = opened.render(&*patches, Budget::Samples(EXPOSED), opened.points(0), &stop, &|_| {});
    let principal = camera.principal_point();
    Ok(json!({
        "width": width,
        "height": height,
        "depth": depth,
        "unshadowed": unshadowed,
        "from": camera.look_from().to_array(),
        "at": camera.look_at().to_array(),
        "halfHeight": camera.half_height(),
        "principal": [principal.x, principal.y],
        "parallel": camera.is_orthographic(),
        "stops": exposure::of_rendering(&picture),
    }))
}

/// Returns the main part of the page.
fn main(content: &Value, (width, height): (usize, usize), specs: &[&SamplerSpec]) -> Markup {
    // Within a script, "</" would end it.
    let content = content.to_string().replace("</", "<\\/");
    let second = 1.min(specs.len() - 1);
    html! {
        section {
            div.controls {
                label { "Left " select #live-left { (options(specs, 0)) } }
                label { "Right " select #live-right { (options(specs, second)) } }
                label { "Exposure " input #live-exposure type="range" min="-6" max="6" step="0.25" value="0"; output #live-stops { "0" } }
                button #live-pause type="button" { "Pause" }
                button #live-home type="button" { "First view" }
            }
            p.incomplete #live-message role="status" { "Compiling…" }
            div.stage #live-stage tabindex="0" role="group" aria-label="Pictures; drag or arrow keys turn the camera, + and - move it"
                style={ "aspect-ratio:" (width) "/" (height) ";--ratio:" (width as f64 / height as f64) } {
                canvas #live-canvas width=(width) height=(height) role="img" aria-label="The scene, rendered by the two samplers" {}
                div.divider #live-divider {}
                p.tag.tag-left #live-tag-left {}
                p.tag.tag-right #live-tag-right {}
            }
            input #live-cut type="range" min="0" max="100" step="0.5" value="50" aria-label="Position of the divider";
            p.note {
                "Drag the picture to turn the camera, and the divider to move it. Both samplers take turns so that each has the same time. The \
                 errors (MSE) are against a third picture by the sampler on the right with other seeds, made meanwhile, whose own noise they \
                 include."
            }
            p.note #live-adapter {}
            noscript { p.note { "Rendering needs JavaScript and WebGPU." } }
            script #live-content type="application/json" { (PreEscaped(content)) }
        }
    }
}

fn options(specs: &[&SamplerSpec], chosen: usize) -> Markup {
    html! {
        @for (index, spec) in specs.iter().enumerate() { option value=(index) selected[index == chosen] { (spec) } }
    }
}

fn words(numbers: &[f32]) -> Vec<u32> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

/// Returns words in little-endian order, compressed by gzip, in base64.
fn packed(words: &[u32]) -> Result<String> {
    let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(&bytes).context("compressing")?;
    Ok(STANDARD.encode(encoder.finish().context("compressing")?))
}
