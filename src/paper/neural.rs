//! The paper's figures of neural materials: bedroom and cloth.

use std::sync::Arc;

use anyhow::{Context, Result};
use headtail_render::{
    brdf::NeuralTexture,
    estimator::SingleSample,
    path_text::text_of,
    sampler::Covering,
    scene::MaterialSpec,
    spec::{Companion, FileKind, RivalFamily, SamplerSpec, Source},
};

use super::{
    PaperContext,
    comparison::{Subject, compare},
    cosine_weighted::CosineWeighted,
    figure::heading,
    measure::Entry,
    part::{Part, PartOutput},
    scenes::{baselines, entry},
};
use crate::cost;

/// Scene, material, and number of repetitions of its tile.
const FABRICS: [(&str, &str, u32); 3] = [("bedroom", "welt", 24), ("cloth", "satin", 20), ("cloth", "velvet", 12)];

/// The section.
pub fn section(context: &PaperContext) -> (String, Vec<Part>) {
    let mut intro = "<p class=\"note\">Fabrics as networks over textures of features, 4 samples per pixel: a matte striped weave on the bed, metallic threads and glossy pile as a drape. \u{201c}cosine\u{201d} draws as \
         for diffuse surfaces, \u{201c}brdf\u{201d} from the two lobes that each material\u{2019}s own network gives, \u{201c}neusample\u{201d} from NeuSample\u{2019}s flow for the material (<code>fit-rival --kind flow</code>), alone or in one-sample MIS \
         with the light (\u{201c}+ emitter\u{201d}), \u{201c}emitter\u{201d} from the light alone. \u{201c}head + MIS\u{201d} is a head on the material\u{2019}s features for what the camera sees (<code>fit --material neural:FILE --conditions-from SCENE</code>), with a learned share \
         beside the material\u{2019}s own lobes; \u{201c}patches\u{201d} is the product in closed form. <span class=\"paper\">The paper: NeuSample is little better than cosine sampling, emitter sampling is better than both, \
         its product sampler is the best by a significant margin, also where lobes are narrow and NeuSample is combined with emitter sampling (equal time; no figures but those of the ablation).</span></p>\n"
        .to_owned();
    if context.effort.rival_steps == 0 {
        intro += "<p class=\"incomplete\"><b>NeuSample\u{2019}s flows are left out of a quick page:</b> their training takes two minutes of one core for each material.</p>\n";
    }
    let part = |(scene, material, repeat): (&'static str, &'static str, u32)| {
        let training = cost::neural_head(context.effort.ggx_steps) + cost::rival(context.effort.rival_steps);
        let cost = 2.0 * context.effort.comparison(9) + training;
        Part::new(format!("{scene}, {material}"), cost, move |context| fabric(context, scene, material, repeat))
    };
    let there = FABRICS.into_iter().filter(|(_, material, _)| context.data.neural_material(material).is_some());
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
        return (String::new(), vec![Part::new("none", 0.0, move |_| Ok(PartOutput::of(intro.clone() + &said)))]);
    }
    (intro + &said, parts)
}

fn fabric(context: &PaperContext, scene: &'static str, material: &'static str, repeat: u32) -> Result<PartOutput> {
    let environment = context.data.map(if scene == "cloth" { 1 } else { 0 })?;
    let file = context.data.neural_material(material).context("a neural material that was there")?;
    let text = format!("neural:{},repeat={repeat}", text_of(file));
    let view = context.data.view(scene, &text)?;
    let title = format!("{scene}, {material}, under {}", environment.name());
    let own: MaterialSpec = text.parse()?;
    let head = SamplerSpec::file_with_mis(FileKind::Head, context.heads.of_view(&environment, &own, &view)?.file);
    let cosine = SingleSample::new(Covering::new(CosineWeighted)?, environment.clone());
    let mut samplers = vec![("brdf", SamplerSpec::brdf())];
    let mut entries = baselines(&environment)?;
    let resampling = entries.split_off(1);
    entries.push(Entry::new("cosine", Box::new(cosine)));
    entries.push(entry("brdf", &SamplerSpec::brdf(), &environment)?);
    if context.effort.rival_steps > 0 {
        let file = context.heads.neusample(&Arc::new(NeuralTexture::read(file)?))?;
        for (name, companion) in [("neusample", Companion::None), ("neusample + emitter", Companion::Emitter)] {
            let source = Source::Rival(RivalFamily::NeuSample, file.clone());
            let spec = SamplerSpec::new(source, companion)?;
            entries.push(entry(name, &spec, &environment)?);
            samplers.push((name, spec));
        }
    }
    entries.push(entry("emitter", &SamplerSpec::emitter(), &environment)?);
    entries.extend(resampling);
    entries.push(entry("head + MIS", &head, &environment)?);
    entries.push(entry("patches", &SamplerSpec::patches(), &environment)?);
    samplers.extend([("mis", SamplerSpec::mis()), ("head + MIS", head), ("patches", SamplerSpec::patches())]);
    let subject = Subject { view, environment, entries, shown: Some("head + MIS"), heads: None, samplers };
    compare(context, &subject, heading(&title))
}
