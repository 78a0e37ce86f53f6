//! The paper's table of what each part of the model is worth, and its figure of tails.

use std::sync::Arc;

use anyhow::Result;
use headtail_render::{
    environment::Environment,
    estimator::{Estimator, SingleSample},
    head::WithoutTail,
    sampler::{Covering, EnvironmentLight, ProductSampler},
    tail::TailKind,
};
use headtail_train::{FitConfig, Loss, Material, Preset, TrainingLight, Viewpoints, build_target};

use super::{
    Workshop,
    figure::table,
    measure::{Bench, Entry, mean},
};
use crate::{
    inspect,
    report::number::{escape, text},
};

/// Samples per pixel.
const SPP: u32 = 4;

/// The paper's rows: cosine on its temple, microfacet on its droid, neural material on its bedroom.
const PAPER: [(&str, &str, &str, &str); 5] = [
    ("naive neural flow", "0.715", "1.411", "1.320"),
    ("hierarchical tail", "0.437", "0.940", "0.896"),
    ("flow tail", "0.406", "0.901", "0.739"),
    ("+ encoder", "\u{2013}", "0.580", "0.323"),
    ("+ entropic term", "0.401", "0.542", "0.269"),
];

/// The section.
pub fn section(workshop: &Workshop) -> Result<String> {
    let environment = workshop.data.map(0)?;
    let cosine = column(workshop, &environment, Material::Lambert, "temple")?;
    let glossy = column(workshop, &environment, Material::Ggx { low: 0.2, high: 0.8 }, "droid")?;
    let rows: Vec<Vec<String>> = PAPER
        .iter()
        .enumerate()
        .map(|(k, (name, a, b, c))| {
            let own = |values: &[Option<f64>]| values[k].map_or("\u{2013}".into(), text);
            let [a, b, c] = [a, b, c].map(|paper| (*paper).to_owned());
            vec![(*name).into(), own(&cosine), a, own(&glossy), b, "not implemented".into(), c]
        })
        .collect();
    let head = ["MSE at 4 spp", "cosine, temple", "paper", "microfacet, droid", "paper", "neural, bedroom", "paper"];
    let (chart, figures) = inspect::tail_picture(&environment)?;
    Ok(format!(
        "<p class=\"note\">Every variant is trained alike: {} and {} steps, K = 32 bins, forward KL, no share beside BRDF sampling; the flow tail has {} steps. The rows add to each other from \
         the flow tail on. Scenes, maps and lengths of training differ from the paper's: compare within a column.</p>\n{}\
         <h3>Tails</h3>\n{}<pre class=\"command\"><code>{}</code></pre>\n",
        workshop.effort.cosine_steps,
        workshop.effort.ggx_steps,
        workshop.effort.flow_steps,
        table("ablation", &head, &rows),
        chart.html().into_string(),
        escape(&figures),
    ))
}

/// The five variants of a material; `None` where the paper has none.
fn column(
    workshop: &Workshop,
    environment: &Arc<Environment>,
    material: Material,
    scene: &str,
) -> Result<Vec<Option<f64>>> {
    let view = workshop.data.view(scene, &material.to_string())?;
    let bench = Bench::new(workshop, &view, environment.clone())?;
    let mut plain = FitConfig { loss: Loss::ForwardKl, learning_rate: 4e-3, ..workshop.heads.config(material) };
    plain.head.bins = 32;
    plain.head.encoder = None;
    plain.flow.steps = workshop.effort.flow_steps;
    let flow = FitConfig { tail: TailKind::Flow, ..plain };
    let mut encoded = FitConfig { ..flow };
    encoded.head.encoder = Preset::PaperGgx.config().head.encoder;
    let has_encoder = material != Material::Lambert;
    let last = if has_encoder { &encoded } else { &flow };
    let entropic = FitConfig { entropic: 1e-4, ..*last };
    let exact = workshop.heads.light(&plain, environment)?;
    let smooth = workshop.heads.light(&flow, environment)?;
    let variants = [
        Some((FitConfig { naive: true, ..plain }, &exact)),
        Some((plain, &exact)),
        Some((flow, &smooth)),
        has_encoder.then_some((encoded, &smooth)),
        Some((entropic, &smooth)),
    ];
    let mut figures = Vec::new();
    for (config, light) in variants.into_iter().map(Option::unzip) {
        workshop.check()?;
        let (Some(config), Some(light)) = (config, light) else {
            figures.push(None);
            continue;
        };
        let estimator = train(workshop, &config, light, environment)?;
        let entries = [Entry { name: "variant".into(), estimator }];
        let (rows, _) = bench.measure(&entries, &[SPP], SPP)?;
        figures.push(Some(mean(&rows, "variant", SPP).0));
    }
    Ok(figures)
}

fn train(
    workshop: &Workshop,
    config: &FitConfig,
    light: &TrainingLight,
    environment: &Arc<Environment>,
) -> Result<Box<dyn Estimator>> {
    let target = build_target(config, &light.tail, Viewpoints::Sphere);
    let (head, _) = workshop.heads.train(config, &*target)?;
    if config.naive {
        return Ok(Box::new(SingleSample::new(Covering::new(WithoutTail(head))?, environment.clone())));
    }
    let light = EnvironmentLight::with_tail(environment.clone(), light.tail.clone());
    Ok(Box::new(SingleSample::new(Covering::new(ProductSampler::new(light, head))?, environment.clone())))
}
