//! The paper's ablation table and its figure of tails.

use std::sync::Arc;

use anyhow::Result;
use headtail_render::{
    environment::Environment,
    estimator::{Estimator, SingleSample},
    head::WithoutTail,
    sampler::{Covering, EnvironmentLight, ProductSampler},
    scene::MaterialSpec,
    tail::{Tail, TailKind},
};
use headtail_train::{FitConfig, Loss, Preset, Viewpoints, build_target};

use super::{
    PaperContext,
    effort::Effort,
    figure::{heading, note},
    fits::short_name,
    measure::{Bench, Entry, mean},
    part::{Part, PartOutput},
};
use crate::{
    cost,
    inspect::{self, tails::Found},
    progress::Interrupted,
    report::{
        number::{escape, times},
        table::{Cell, Value},
    },
};

/// Samples per pixel.
const SPP: u32 = 4;

/// A column of the paper's table.
#[derive(Clone, Copy)]
struct Column {
    name: &'static str,
    scene: &'static str,
    /// The paper's MSE of each variant; NaN where it has none.
    paper: [f64; 5],
}

/// The variants. From the third on, each adds to the one before it.
const VARIANTS: [&str; 5] = ["naive neural flow", "hierarchical tail", "flow tail", "+ encoder", "+ entropic term"];
const COSINE: Column = Column { name: "cosine", scene: "temple", paper: [0.715, 0.437, 0.406, f64::NAN, 0.401] };
const MICROFACET: Column = Column { name: "microfacet", scene: "droid", paper: [1.411, 0.940, 0.901, 0.580, 0.542] };
const NEURAL: Column = Column { name: "neural material", scene: "bedroom", paper: [1.320, 0.896, 0.739, 0.323, 0.269] };

/// The section.
pub fn section(context: &PaperContext) -> (String, Vec<Part>) {
    let Effort { cosine_steps, ggx_steps, flow_steps, .. } = context.effort;
    let mut intro = format!(
        "<p class=\"note\">Every variant of a column is trained alike: {cosine_steps} steps of the cosine head, {ggx_steps} of the others, K = 32 bins, forward KL, no share beside BRDF sampling; the flow tail has {flow_steps} steps. The rows add to each other from \
         the flow tail on. Scenes, maps and lengths of training differ from the paper's: what can be compared is how many times lower the error is than that of the naive flow.</p>\n"
    );
    let fabric = context.data.fabric();
    if fabric.is_none() {
        intro += "<p class=\"incomplete\"><b>The column of the neural material is missing.</b> It needs DATA/nbrdf/nbrdf_all.f32.</p>\n";
    }
    let columns = [
        Some((COSINE, MaterialSpec::LAMBERT)),
        Some((MICROFACET, MaterialSpec::ggx(0.2, 0.8))),
        fabric.map(|fabric| (NEURAL, fabric)),
    ];
    let part = |(column, material): (Column, MaterialSpec)| {
        let cost = 5.0 * cost::training(&variants(context, &material)[0])
            + cost::flow_tail(flow_steps)
            + context.effort.rendering(context.effort.reference_spp + 5 * SPP * context.effort.runs);
        Part::new(column.name, cost, move |context| ablate(context, column, &material))
    };
    (intro, columns.into_iter().flatten().map(part).collect())
}

/// Draws the tails' mappings of the unit square. `ratio` is the MSE over the flow tail divided by that over
/// the hierarchical one.
fn tails(environment: &Environment, flow: Option<&Tail>, ratio: f64) -> Result<String> {
    let Found { picture, table, .. } = inspect::tails::inspect(environment, flow)?;
    let ours = match flow {
        Some(_) => {
            format!("Above, the MSE over the flow tail is {} times that over the hierarchical one.", times(ratio))
        }
        None => "The flow tail is missing: see above.".to_owned(),
    };
    let said = format!(
        "Colours and lines encode the mapping from the unit square; below, the discontinuities of each tail. {ours} <span class=\"paper\">The paper: its flow tail \u{201c}makes for a smooth mapping and halves the \
         MSE of images\u{201d} against the hierarchical one; in its table it is 0.93 (cosine), 0.96 (microfacet) and 0.82 (neural) times that.</span>"
    );
    Ok(format!(
        "{}{}{}<pre class=\"command\"><code>{}</code></pre>\n",
        heading("Tails"),
        note(&said),
        picture.html().into_string(),
        escape(&table),
    ))
}

/// The configurations of the variants, in the order of [`VARIANTS`]. For materials that need no encoder, the
/// fourth equals the third.
fn variants(context: &PaperContext, material: &MaterialSpec) -> [FitConfig; 5] {
    let mut plain = FitConfig { loss: Loss::ForwardKl, learning_rate: 4e-3, ..context.heads.config(material) };
    plain.head.bins = 32;
    plain.head.encoder = None;
    plain.flow.steps = context.effort.flow_steps;
    let flow = FitConfig { tail: TailKind::Flow, ..plain.clone() };
    let mut encoded = flow.clone();
    if !material.is_lambert() {
        encoded.head.encoder = Preset::PaperGgx.config().head.encoder;
    }
    let entropic = FitConfig { entropic: 1e-4, ..encoded.clone() };
    [FitConfig { naive: true, ..plain.clone() }, plain, flow, encoded, entropic]
}

/// One column of the table: the MSE of a rendering with each variant.
fn ablate(context: &PaperContext, column: Column, material: &MaterialSpec) -> Result<PartOutput> {
    let environment = context.data.map(0)?;
    let view = context.data.view(column.scene, &material.to_string())?;
    let bench = Bench::new(context, &view, environment.clone())?;
    let configs = variants(context, material);
    let exact = context.heads.tail(&configs[1], &environment)?;
    // The table of a flow that is far from convergence can be rejected.
    let (smooth, refused) = match context.heads.tail(&configs[2], &environment) {
        Ok(tail) => (Some(tail), String::new()),
        Err(error) if error.is::<Interrupted>() => return Err(error),
        Err(error) => {
            (None, note(&format!("The flow tail of this map cannot be used: {}.", escape(&format!("{error:#}")))))
        }
    };
    let mut rows: Vec<Vec<Cell>> = Vec::new();
    let mut errors = [f64::NAN; VARIANTS.len()];
    for (k, config) in configs.iter().enumerate() {
        context.check()?;
        if column.paper[k].is_nan() {
            continue;
        }
        let tail = if k < 2 { Some(&exact) } else { smooth.as_ref() };
        let paper = [Cell::number(column.paper[k]), Value::Times(column.paper[0] / column.paper[k]).into()];
        let Some(tail) = tail else {
            let missing = [Cell::text(VARIANTS[k]), Value::Missing.into(), Value::Missing.into()];
            rows.push(missing.into_iter().chain(paper).collect());
            continue;
        };
        let entries = [Entry::new("variant", train(context, config, tail, &environment)?)];
        let (measured, _) = bench.measure(&entries, &[SPP], SPP)?;
        errors[k] = mean(&measured, "variant", SPP).0;
        let own = [Cell::text(VARIANTS[k]), Cell::number(errors[k]), Value::Times(errors[0] / errors[k]).into()];
        rows.push(own.into_iter().chain(paper).collect());
    }
    let mut output = PartOutput::of(heading(&format!(
        "{}: {} under {}, {}",
        column.name,
        view.name,
        environment.name(),
        short_name(material)
    )));
    let table = format!("ablation-{}", column.name.replace(' ', "-"));
    output.table(
        &table,
        &["MSE at 4 spp", "ours", "lower than naive", "the paper's", "the paper's, lower than naive"],
        rows,
    );
    output.html += &refused;
    // All columns use the same map, hence the same tails.
    if column.name == COSINE.name {
        output.html += &tails(&environment, smooth.as_deref(), errors[2] / errors[1])?;
    }
    Ok(output)
}

fn train(
    context: &PaperContext,
    config: &FitConfig,
    tail: &Arc<Tail>,
    environment: &Arc<Environment>,
) -> Result<Box<dyn Estimator>> {
    let target = build_target(config, tail, Viewpoints::Sphere)?;
    let (head, _) = context.heads.train(config, &*target)?;
    if config.naive {
        return Ok(Box::new(SingleSample::new(Covering::new(WithoutTail(head))?, environment.clone())));
    }
    let light = EnvironmentLight::with_tail(environment.clone(), tail.clone());
    Ok(Box::new(SingleSample::new(Covering::new(ProductSampler::new(light, head))?, environment.clone())))
}
