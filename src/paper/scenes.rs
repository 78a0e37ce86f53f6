//! The paper's figures of rendered scenes: cosine-weighted emitter sampling, and microfacets.

use std::{path::Path, sync::Arc};

use anyhow::{Result, bail};
use glam::Vec3A;
use headtail_render::{
    bake::{CellGrid, NormalGrid},
    environment::Environment,
    estimator::{Estimator, SingleSample},
    export::{ExportedSampler, Intermediate},
    head::Head,
    sampler::{Covering, EnvironmentLight, ProductSampler},
    scene::MaterialSpec,
    spec::{FileKind, SamplerSpec},
    tail::TailKind,
};
use headtail_train::learned_bake;

use super::{
    PaperContext,
    comparison::{Subject, compare},
    densities::Densities,
    figure::{Layout, Panel, Strip, heading},
    measure::Entry,
    part::{Part, PartOutput},
};
use crate::cost;
use crate::report::{chart::Scale, number::text, table::Cell};

/// Temple, dishware and diorama with diffuse surfaces.
pub fn cosine(context: &PaperContext) -> (String, Vec<Part>) {
    let intro = "<p class=\"note\">Diffuse surfaces, 4 samples per pixel with at most one shadow ray each. \u{201c}head\u{201d} is a small network (K = 4, no encoder) over a \
         hierarchical tail, \u{201c}baked 8\u{d7}8\u{201d} its table over 16 \u{d7} 32 normals, \u{201c}patches\u{201d} this program's closed form, which needs no training. \
         The densities are those of the point with the green cross; shadows are not in them. \
         <span class=\"paper\">The paper: head 2.2\u{d7} lower variance than MIS on its temple at equal time (4 spp, 35 ms); baked 2.4\u{d7} lower MSE on its diorama \
         at about the run time of MIS.</span></p>\n";
    let training = cost::training(&context.heads.config(&MaterialSpec::LAMBERT));
    let mut parts = vec![Part::new("intermediate densities", training, intermediate)];
    for (name, map) in [("temple", 0), ("dishes", 1), ("diorama", 0)] {
        let cost = context.effort.comparison(5) + 2.0 * training;
        parts.push(Part::new(name, cost, move |context| diffuse(context, name, map)));
    }
    (intro.to_owned(), parts)
}

fn diffuse(context: &PaperContext, name: &str, map: usize) -> Result<PartOutput> {
    let environment = context.data.map(map)?;
    let view = context.data.view(name, "lambert")?;
    let mut entries = baselines(&environment)?;
    let trained = context.heads.of(&environment, &MaterialSpec::LAMBERT)?;
    let naive = context.heads.naive_of(&environment, &MaterialSpec::LAMBERT)?;
    entries.push(entry("head", &SamplerSpec::file(FileKind::Head, trained.file.clone()), &environment)?);
    entries.push(Entry::new("baked 8\u{d7}8", baked(&trained.file, &environment, 8)?));
    entries.push(entry("patches", &SamplerSpec::patches(), &environment)?);
    let samplers = vec![("patches", SamplerSpec::patches())];
    let shown = Some("head");
    let subject = Subject { view, environment, entries, shown, heads: Some([trained.head, naive]), samplers };
    compare(context, &subject, heading(&format!("{} under {}", subject.view.name, subject.environment.name())))
}

/// The droid with one and with textured roughness.
pub fn microfacet(context: &PaperContext) -> (String, Vec<Part>) {
    let intro = "<p class=\"note\">Trowbridge\u{2013}Reitz reflection, f0 = 1, 4 samples per pixel with at most one shadow ray each. <span class=\"paper\">The paper: at fixed \
         roughness (0.4) its head easily outperforms MIS and RIS-4 at equal time; with roughness as a condition (0.2 to 0.8) it outperforms MIS but not RIS at equal time, and \
         is mixed with BRDF sampling.</span></p>\n";
    let mut parts = Vec::new();
    for (name, material) in
        [("one roughness", MaterialSpec::ggx(0.4, 0.4)), ("roughness as a condition", MaterialSpec::ggx(0.2, 0.8))]
    {
        let training = cost::training(&context.heads.config(&material));
        let cost = context.effort.comparison(5) + 2.0 * training;
        parts.push(Part::new(name, cost, move |context| glossy(context, &material)));
    }
    (intro.to_owned(), parts)
}

fn glossy(context: &PaperContext, material: &MaterialSpec) -> Result<PartOutput> {
    let environment = context.data.map(0)?;
    let view = context.data.view("droid", &material.to_string())?;
    let mut entries = baselines(&environment)?;
    let trained = context.heads.of(&environment, material)?;
    let naive = context.heads.naive_of(&environment, material)?;
    entries.push(entry("head", &SamplerSpec::file(FileKind::Head, trained.file.clone()), &environment)?);
    entries.push(entry("head + MIS", &SamplerSpec::file_with_mis(FileKind::Head, trained.file), &environment)?);
    entries.push(entry("patches", &SamplerSpec::patches(), &environment)?);
    let samplers = vec![("patches", SamplerSpec::patches())];
    let title = format!("{} under {}, {material}", view.name, environment.name());
    let shown = Some("head + MIS");
    let subject = Subject { view, environment, entries, shown, heads: Some([trained.head, naive]), samplers };
    compare(context, &subject, heading(&title))
}

/// One-sample MIS, and RIS with four candidates.
pub fn baselines(environment: &Arc<Environment>) -> Result<Vec<Entry>> {
    Ok(vec![entry("mis", &SamplerSpec::mis(), environment)?, entry("ris:4", &SamplerSpec::ris(4), environment)?])
}

/// Builds a sampler from its spec.
pub fn entry(name: &str, spec: &SamplerSpec, environment: &Arc<Environment>) -> Result<Entry> {
    Ok(Entry::new(name, spec.build(environment)?))
}

/// The paper's figure of intermediate densities: of a head and of its tables.
fn intermediate(context: &PaperContext) -> Result<PartOutput> {
    let environment = context.data.map(0)?;
    let head: Head = context.heads.of(&environment, &MaterialSpec::LAMBERT)?.head;
    let light = EnvironmentLight::new(environment, TailKind::Hierarchical)?;
    let grid = Densities::new(context.effort.density_rows);
    let mut output = PartOutput::of(heading("Intermediate densities of the head and of its tables"));
    let mut lines = Vec::new();
    for (name, normal) in [("A", Vec3A::new(0.5, 0.6, 0.6)), ("B", Vec3A::new(-0.8, 0.1, -0.5))] {
        let n = normal.normalize();
        let own = grid.of_head(&head, &n.to_array())?;
        let scale = Scale::of(&own, 2.0);
        let columns = 2 * grid.rows;
        let title = format!("{name}: head");
        let note = format!("normal {:.2}, {:.2}, {:.2}", n.x, n.y, n.z);
        let mut panels = vec![Panel::new(&scale.png(&own, columns)?, title, note)];
        let mut line = vec![Cell::text(format!("normal {name}"))];
        for side in [8, 32] {
            let table = learned_bake(&head, light.tail(), NormalGrid::new(16, 32)?, CellGrid::new(side, side)?)?;
            let density = table.density_at(n, &grid.points);
            let kl = grid.kl(&own, &density);
            let note = format!("KL from the head {}", text(kl));
            panels.push(Panel::new(&scale.png(&density, columns)?, format!("{name}: baked {side}\u{d7}{side}"), note));
            line.push(Cell::number(kl));
        }
        let scales = vec![(scale, "density over the square Y")];
        output.strip(&format!("intermediate-{name}"), &Strip { layout: Layout::Four, panels, scales })?;
        lines.push(line);
    }
    output.figures("intermediate", &["KL from the head in nats", "baked 8\u{d7}8", "baked 32\u{d7}32"], &lines);
    Ok(output)
}

/// A head baked to `side` x `side` cells over the paper's normals.
pub fn baked(file: &Path, environment: &Arc<Environment>, side: usize) -> Result<Box<dyn Estimator>> {
    let exported = ExportedSampler::read(file)?;
    let Intermediate::Head(head) = &exported.intermediate else { bail!("{}: not a head", file.display()) };
    let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
    let table = learned_bake(head, light.tail(), NormalGrid::new(16, 32)?, CellGrid::new(side, side)?)?;
    Ok(Box::new(SingleSample::new(Covering::new(ProductSampler::new(light, table))?, environment.clone())))
}
