//! The paper's figure of all fits: target, intermediate, final and naive densities.

use anyhow::Result;
use glam::Vec3A;
use headtail_render::{
    brdf::{BrdfTable, Ggx, Lambert},
    head::Head,
    random::{Purpose, Stream},
    scene::{MaterialSpec, Scene},
    tail::Tail,
    tile::ShadingPoint,
};

use super::{
    PaperContext,
    densities::{self, Models, Surface},
    figure::heading,
    part::{Part, PartOutput},
};
use crate::cost;

/// The section.
pub fn section(context: &PaperContext) -> (String, Vec<Part>) {
    let intro = "<p class=\"note\">For each map and material, two random conditions: the target (light \u{d7} BRDF \u{d7} cosine), the density that the head gives over the \
         intermediate square, the density of the whole model, and a head of the same size that has to learn the product without a tail. A cross \
         marks the normal (red) and the reflected view (yellow). <span class=\"paper\">The paper shows six maps with one of three materials each, and gives no figures.</span></p>\n";
    let mut parts = Vec::new();
    for index in 0..context.effort.maps.min(context.data.map_count()) {
        // A measured material is fitted as a network for the map of the other sections.
        let measured = context.data.fabric().filter(|_| index == 0);
        for material in materials().into_iter().chain(measured) {
            let cost =
                cost::training(&context.heads.config(&material)) + cost::training(&context.heads.naive(&material));
            let name = format!("{}, {}", context.data.map_name(index), short_name(&material));
            parts.push(Part::new(name, cost, move |context| fit(context, index, &material)));
        }
    }
    (intro.to_owned(), parts)
}

/// Stand-ins for the paper's kinds of material, without neural ones.
fn materials() -> [MaterialSpec; 3] {
    [MaterialSpec::LAMBERT, MaterialSpec::ggx(0.4, 0.4), MaterialSpec::ggx(0.2, 0.8)]
}

/// A material's name; for measured and neural ones, without the path.
pub fn short_name(material: &MaterialSpec) -> String {
    if let MaterialSpec::Neural(spec) = material {
        return spec.file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    }
    let name = material.to_string();
    name.split_once('#').map_or(name.clone(), |(_, name)| name.to_owned())
}

fn fit(context: &PaperContext, index: usize, material: &MaterialSpec) -> Result<PartOutput> {
    let environment = &*context.data.map(index)?;
    let head = context.heads.of(environment, material)?.head;
    let tail = Tail::of_environment(context.heads.config(material).tail, environment)?;
    let naive = context.heads.naive_of(environment, material)?;
    let name = short_name(material);
    let mut output = PartOutput::of(heading(&format!("{} \u{b7} {name}", environment.name())));
    let stem = format!("fit-{}-{}", environment.name(), name.replace(|c: char| !c.is_ascii_alphanumeric(), "-"));
    let mut random = Stream::new(index as u64, Purpose::Test, 0);
    let mut lines = Vec::new();
    for letter in ["A", "B"] {
        let (point, brdfs) = condition(material, &mut random)?;
        let at = Surface { point: &point, brdfs: &brdfs };
        let models = Models { head: Some(&head), naive: Some(&naive), samplers: &[] };
        let divergences =
            densities::row((&mut output, &format!("{stem}-{letter}")), context.effort.density_rows, &tail, at, models)?;
        lines.push(densities::line(format!("condition {letter}"), &divergences));
    }
    output.figures(&stem, &["KL in nats", "final", "naive"], &lines);
    Ok(output)
}

/// A random surface whose normal is above the horizon, so that it receives some light.
fn condition(material: &MaterialSpec, random: &mut Stream) -> Result<(ShadingPoint, BrdfTable)> {
    let n = random.direction();
    let n = Vec3A::new(n.x, n.y.abs(), n.z);
    let wo = random.direction();
    let wo = if wo.dot(n) < 0.0 { -wo } else { wo };
    let alpha = |low: f32, high: f32, u: f32| low + u * (high - low);
    let (surface, brdfs) = match material {
        MaterialSpec::Lambert { .. } => (Lambert { albedo: glam::Vec3::ONE }.into(), BrdfTable::default()),
        MaterialSpec::Ggx { alpha: range, .. } => {
            (Ggx::new(alpha(range.low, range.high, random.uniform()), glam::Vec3::ONE).into(), BrdfTable::default())
        }
        MaterialSpec::Measured { .. } | MaterialSpec::Neural(_) => {
            let ball = Scene::built_in("sphere").ok_or_else(|| anyhow::anyhow!("a built-in scene"))?;
            let bounds = ball.bounds();
            let ball = material.dress(ball, &bounds)?;
            let camera = ball.camera();
            let hit = ball.intersect(&camera.ray(0.5, 0.5, 1, 1));
            (hit.ok_or_else(|| anyhow::anyhow!("a sphere that its camera sees"))?.surface, ball.brdfs().clone())
        }
    };
    Ok((ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface }, brdfs))
}

/// The number of weights of a head.
pub fn weights(head: &Head) -> usize {
    head.layers().iter().map(|(_, layer)| layer.weight().len() + layer.bias().len()).sum()
}
