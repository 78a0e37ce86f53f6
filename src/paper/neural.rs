//! The paper's figures of neural materials: bedroom and cloth.

use anyhow::{Context, Result};
use headtail_render::spec::SamplerSpec;

use super::{
    Workshop,
    comparison::{Subject, compare},
    figure::heading,
    part::{Made, Part},
    scenes::{baselines, entry},
};

/// Scene, material, and how often its tile is repeated.
const FABRICS: [(&str, &str, u32); 3] = [("bedroom", "welt", 24), ("cloth", "satin", 20), ("cloth", "velvet", 12)];

/// The section.
pub fn section(workshop: &Workshop) -> (String, Vec<Part>) {
    let intro = "<p class=\"note\">Fabrics as networks over textures of features, 4 samples per pixel: a matte striped weave on the bed, metallic threads and glossy pile as a drape. \u{201c}brdf\u{201d} draws from \
         the two lobes that each material's own network gives, which is what NeuSample is to the paper; \u{201c}emitter\u{201d} draws from the light alone. There are no heads for materials with textures: \u{201c}patches\u{201d}, the product in \
         closed form, is this program's product sampler, and the ablation has a head for a measured fabric. <span class=\"paper\">The paper: NeuSample is little better than cosine sampling, emitter sampling is better than both, \
         its product sampler is the best by a significant margin, also where lobes are narrow and NeuSample is combined with emitter sampling (equal time; no figures but those of the ablation).</span></p>\n";
    let part = |(scene, material, repeat): (&'static str, &'static str, u32)| {
        let cost = 2.0 * workshop.effort.comparison(6);
        Part::new(format!("{scene}, {material}"), cost, move |workshop| fabric(workshop, scene, material, repeat))
    };
    let there = FABRICS.into_iter().filter(|(_, material, _)| workshop.data.neural_material(material).is_some());
    let parts: Vec<Part> = there.map(part).collect();
    let missing = FABRICS.len() - parts.len();
    let said = match missing {
        0 => String::new(),
        _ => format!(
            "<p class=\"incomplete\"><b>{missing} of {} materials are not here.</b> They are looked for as welt, satin and velvet.safetensors in DATA/materials and in ./checkpoints; \
             <code>headtail fit-material</code> makes them.</p>\n",
            FABRICS.len()
        ),
    };
    if parts.is_empty() {
        return (String::new(), vec![Part::new("none", 0.0, move |_| Ok(Made::of(intro.to_owned() + &said)))]);
    }
    (intro.to_owned() + &said, parts)
}

fn fabric(workshop: &Workshop, scene: &'static str, material: &'static str, repeat: u32) -> Result<Made> {
    let environment = workshop.data.map(if scene == "cloth" { 1 } else { 0 })?;
    let file = workshop.data.neural_material(material).context("a neural material that was there")?;
    let view = workshop.data.view(scene, &format!("neural:{},repeat={repeat}", file.display()))?;
    let title = format!("{scene}, {material}, under {}", environment.name());
    let mut entries = baselines(&environment)?;
    entries.insert(1, entry("brdf", &SamplerSpec::brdf(), &environment)?);
    entries.insert(2, entry("emitter", &SamplerSpec::emitter(), &environment)?);
    entries.push(entry("patches", &SamplerSpec::patches(), &environment)?);
    let samplers = vec![
        ("brdf", SamplerSpec::brdf()),
        ("emitter", SamplerSpec::emitter()),
        ("mis", SamplerSpec::mis()),
        ("patches", SamplerSpec::patches()),
    ];
    let subject = Subject { view, environment, entries, shown: Some("emitter"), heads: None, samplers };
    compare(workshop, &subject, heading(&title))
}
