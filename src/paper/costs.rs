//! What samplers cost: training, size, time per sample.

use std::sync::Arc;

use anyhow::Result;
use headtail_render::{
    environment::Environment,
    estimator::Estimator,
    scene::MaterialSpec,
    spec::{FileKind, SamplerSpec},
};

use super::{
    PaperContext,
    figure::heading,
    fits::weights,
    measure::{Bench, Entry, mean},
    part::{Part, PartOutput},
    scenes::baked,
};
use crate::cost;
use crate::report::table::{Cell, Value};

/// Samples per pixel of the timings.
const SPP: u32 = 16;
/// The roughness of the microfacet head.
const GLOSSY: MaterialSpec = MaterialSpec::ggx(0.2, 0.8);

/// The section.
pub fn section(context: &PaperContext) -> (String, Vec<Part>) {
    let intro = format!(
        "<p class=\"note\">Training on this machine's processor; files hold the map's luminance besides weights. Times are of whole renderings at {SPP} samples per pixel, camera and \
         shadow rays included. <span class=\"paper\">The paper trains on an NVIDIA A100: 10,000 steps of 256k samples in 20 minutes for both applications (30 minutes for neural materials), less than 5 for the small cosine \
         head with its table, and less than 25 for the flow tail.</span></p>\n"
    );
    let effort = context.effort;
    let training = |material: &MaterialSpec| cost::training(&context.heads.config(material));
    let rendering = effort.rendering(effort.reference_spp.min(512) + effort.runs * 5 * SPP);
    let parts = vec![
        Part::new("models", training(&MaterialSpec::LAMBERT) + training(&GLOSSY), models),
        Part::new("diffuse", rendering, diffuse),
        Part::new("microfacets", rendering, glossy),
    ];
    (intro, parts)
}

fn models(context: &PaperContext) -> Result<PartOutput> {
    let environment = context.data.map(0)?;
    let cosine = context.heads.of(&environment, &MaterialSpec::LAMBERT)?;
    let glossy = context.heads.of(&environment, &GLOSSY)?;
    let size = |path: &std::path::Path| std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let kilobytes = |bytes: u64| Cell::from(Value::Amount((bytes / 1000) as f64));
    let missing = || Cell::from(Value::Missing);
    let mut output = PartOutput::default();
    let rows = vec![
        vec![
            Cell::text("cosine head"),
            Value::Amount(weights(&cosine.head) as f64).into(),
            missing(),
            Value::Duration(cosine.seconds).into(),
            Cell::text("under 5 min with its table, A100"),
            kilobytes(size(&cosine.file)),
        ],
        vec![
            Cell::text("microfacet head"),
            Value::Amount(weights(&glossy.head) as f64).into(),
            Cell::text("36k"),
            Value::Duration(glossy.seconds).into(),
            Cell::text("20 min, A100"),
            kilobytes(size(&glossy.file)),
        ],
        vec![
            Cell::text("table of 16 \u{d7} 32 normals, 8 \u{d7} 8 cells"),
            Value::Amount(32_768.0).into(),
            Cell::text("132 kB on disk"),
            missing(),
            missing(),
            kilobytes(131_072),
        ],
    ];
    output.table("models", &["model", "weights", "the paper's", "training", "the paper's training", "kB"], rows);
    Ok(output)
}

fn diffuse(context: &PaperContext) -> Result<PartOutput> {
    let environment = context.data.map(0)?;
    let file = context.heads.of(&environment, &MaterialSpec::LAMBERT)?.file;
    let head = SamplerSpec::file(FileKind::Head, file.clone()).build(&environment)?;
    let own = vec![("head", head), ("baked 8\u{d7}8", baked(&file, &environment, 8)?)];
    timings(context, &environment, "temple", "lambert", own)
}

fn glossy(context: &PaperContext) -> Result<PartOutput> {
    let environment = context.data.map(0)?;
    let file = context.heads.of(&environment, &GLOSSY)?.file;
    let own = vec![("head", SamplerSpec::file(FileKind::Head, file).build(&environment)?)];
    timings(context, &environment, "droid", &GLOSSY.to_string(), own)
}

fn timings(
    context: &PaperContext,
    environment: &Arc<Environment>,
    scene: &str,
    material: &str,
    own: Vec<(&str, Box<dyn Estimator>)>,
) -> Result<PartOutput> {
    let view = context.data.view(scene, material)?;
    let bench = Bench::new(context, &view, environment.clone())?;
    let mut entries = vec![
        Entry::new("mis", SamplerSpec::mis().build(environment)?),
        Entry::new("ris:4", SamplerSpec::ris(4).build(environment)?),
    ];
    entries.extend(own.into_iter().map(|(name, estimator)| Entry::new(name, estimator)));
    entries.push(Entry::new("patches", SamplerSpec::patches().build(environment)?));
    let (rows, _) = bench.measure(&entries, &[SPP], SPP)?;
    let pixels = bench.measured.len() as f64;
    let base = mean(&rows, "mis", SPP).1;
    let line = |entry: &Entry| {
        let (mse, seconds) = mean(&rows, &entry.name, SPP);
        let nanoseconds = 1e9 * seconds / (pixels * f64::from(SPP));
        vec![
            Cell::text(entry.name.as_str()),
            Value::Number(nanoseconds, 3).into(),
            Value::Times(seconds / base).into(),
            Cell::number(mse),
        ]
    };
    let mut output = PartOutput::of(heading(&format!("{}, {material}", view.name)));
    output.table(
        &format!("costs-{scene}"),
        &["sampler", "ns per sample", "of MIS", "MSE"],
        entries.iter().map(line).collect(),
    );
    Ok(output)
}
