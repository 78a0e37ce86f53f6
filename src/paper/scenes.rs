//! The paper's figures of rendered scenes: cosine-weighted emitter sampling, and microfacets.

use std::{path::Path, sync::Arc};

use anyhow::{Result, bail};
use glam::Vec3A;
use headtail_render::{
    bake::{CellGrid, NormalGrid},
    environment::Environment,
    estimator::{Estimator, SingleSample},
    export::{ExportedSampler, Intermediate},
    sampler::{Covering, EnvironmentLight, ProductSampler},
    spec::{FileKind, SamplerSpec},
    tail::TailKind,
};
use headtail_train::{Material, learned_bake};

use super::{
    Workshop,
    data::View,
    figure::{Panel, legend, strip, table},
    fits::Densities,
    measure::{Bench, Entry, mean},
};
use crate::report::{
    self, Row,
    chart::Scale,
    crop::Crop,
    number::{escape, text, times},
};

/// Samples per pixel of the pictures: the paper's.
const SHOWN: u32 = 4;

/// Temple and dishware.
pub fn cosine(workshop: &Workshop) -> Result<String> {
    let mut html = String::from(
        "<p class=\"note\">Diffuse surfaces, 4 samples per pixel with at most one shadow ray each. \u{201c}head\u{201d} is a small network (K = 4, no encoder) over a \
         hierarchical tail, \u{201c}baked 8\u{d7}8\u{201d} its table over 16 \u{d7} 32 normals, \u{201c}patches\u{201d} this program's closed form, which needs no training. \
         <span class=\"paper\">The paper: head 2.2\u{d7} lower variance than MIS on its temple at equal time (4 spp, 35 ms); baked 2.4\u{d7} lower MSE on its diorama \
         at about the run time of MIS.</span></p>\n",
    );
    html += &intermediate(workshop)?;
    for (name, map) in [("temple", 0), ("dishes", 1), ("diorama", 0)] {
        let environment = workshop.data.map(map)?;
        let view = workshop.data.view(name, "lambert")?;
        let mut entries = baselines(&environment)?;
        let file = workshop.heads.of(&environment, Material::Lambert)?.file;
        entries.push(entry("head", &SamplerSpec::file(FileKind::Head, file.clone()), &environment)?);
        entries.push(Entry { name: "baked 8\u{d7}8".into(), estimator: baked(&file, &environment, 8)? });
        entries.push(entry("patches", &SamplerSpec::patches(), &environment)?);
        html += &comparison(workshop, &view, &environment, &entries)?;
    }
    Ok(html)
}

/// The droid with a fixed and with a textured roughness.
pub fn microfacet(workshop: &Workshop) -> Result<String> {
    let mut html = String::from(
        "<p class=\"note\">Trowbridge\u{2013}Reitz reflection, f0 = 1, 4 samples per pixel with at most one shadow ray each. <span class=\"paper\">The paper: at fixed \
         roughness its head easily outperforms MIS and RIS-4 at equal time; with roughness as a condition it outperforms MIS but not RIS at equal time, and \
         is mixed with BRDF sampling.</span></p>\n",
    );
    for (material, mixed) in
        [(Material::Ggx { low: 0.4, high: 0.4 }, false), (Material::Ggx { low: 0.2, high: 0.8 }, true)]
    {
        let environment = workshop.data.map(0)?;
        let view = workshop.data.view("droid", &material.to_string())?;
        let mut entries = baselines(&environment)?;
        let file = workshop.heads.of(&environment, material)?.file;
        if !mixed {
            entries.push(entry("head", &SamplerSpec::file(FileKind::Head, file.clone()), &environment)?);
        }
        entries.push(entry("head + MIS", &SamplerSpec::file_with_mis(FileKind::Head, file), &environment)?);
        entries.push(entry("patches", &SamplerSpec::patches(), &environment)?);
        html += &comparison(workshop, &view, &environment, &entries)?;
    }
    Ok(html)
}

fn baselines(environment: &Arc<Environment>) -> Result<Vec<Entry>> {
    Ok(vec![entry("mis", &SamplerSpec::mis(), environment)?, entry("ris:4", &SamplerSpec::ris(4), environment)?])
}

fn entry(name: &str, spec: &SamplerSpec, environment: &Arc<Environment>) -> Result<Entry> {
    Ok(Entry { name: name.into(), estimator: spec.build(environment)? })
}

/// The paper's figure of intermediate densities: a head's, and those of its tables.
fn intermediate(workshop: &Workshop) -> Result<String> {
    let environment = workshop.data.map(0)?;
    let head = workshop.heads.of(&environment, Material::Lambert)?.head;
    let light = EnvironmentLight::new(environment, TailKind::Hierarchical)?;
    let grid = Densities::new(workshop.effort.density_rows);
    let mut html = String::from("<h3>Intermediate densities of the head and of its tables</h3>\n");
    for (name, normal) in [("A", Vec3A::new(0.5, 0.6, 0.6)), ("B", Vec3A::new(-0.8, 0.1, -0.5))] {
        let n = normal.normalize();
        let own = grid.of_head(&head, &n.to_array())?;
        let scale = Scale::of(&own, 2.0);
        let columns = 2 * grid.rows;
        let title = format!("{name}: head");
        let note = format!("normal {:.2}, {:.2}, {:.2}", n.x, n.y, n.z);
        let mut panels = vec![Panel::new(&scale.png(&own, columns)?, title, note)];
        for side in [8, 32] {
            let table = learned_bake(&head, light.tail(), NormalGrid::new(16, 32)?, CellGrid::new(side, side)?)?;
            let density = table.density_at(n, &grid.points);
            let note = format!("KL from the head {}", text(grid.kl(&own, &density)));
            panels.push(Panel::new(&scale.png(&density, columns)?, format!("{name}: baked {side}\u{d7}{side}"), note));
        }
        html += &(strip("fits", &panels) + &legend(scale, "density over the square Y"));
    }
    Ok(html)
}

/// A head's table of `side` x `side` cells over the paper's normals.
pub fn baked(file: &Path, environment: &Arc<Environment>, side: usize) -> Result<Box<dyn Estimator>> {
    let exported = ExportedSampler::read(file)?;
    let Intermediate::Head(head) = &exported.intermediate else { bail!("{}: not a head", file.display()) };
    let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
    let table = learned_bake(head, light.tail(), NormalGrid::new(16, 32)?, CellGrid::new(side, side)?)?;
    Ok(Box::new(SingleSample::new(Covering::new(ProductSampler::new(light, table))?, environment.clone())))
}

fn comparison(workshop: &Workshop, view: &View, environment: &Arc<Environment>, entries: &[Entry]) -> Result<String> {
    let bench = Bench::new(workshop, view, environment.clone())?;
    let (rows, images) = bench.measure(entries, &[1, SHOWN, 16], SHOWN)?;
    let crop = Crop::worst(&images[0], &bench.reference, &bench.measured);
    let whole = [
        Panel::new(
            &crop.framed(&bench.reference, bench.exposure)?,
            "reference",
            format!("{} spp", workshop.effort.reference_spp),
        ),
        Panel::new(&crop.framed(&images[0], bench.exposure)?, entries[0].name.as_str(), format!("{SHOWN} spp")),
        Panel::new(
            &crop.framed(&images[images.len() - 1], bench.exposure)?,
            entries[entries.len() - 1].name.as_str(),
            format!("{SHOWN} spp"),
        ),
    ];
    let base = mean(&rows, &entries[0].name, SHOWN).0;
    let mut crops = vec![Panel::new(&crop.png(&bench.reference, bench.exposure)?, "reference", "")];
    for (entry, image) in entries.iter().zip(&images) {
        let mse = mean(&rows, &entry.name, SHOWN).0;
        let note = format!(
            "MSE {} ({}\u{d7}), crop {}",
            text(mse),
            times(base / mse),
            text(crop.error(image, &bench.reference, &bench.measured))
        );
        crops.push(Panel::new(&crop.png(image, bench.exposure)?, entry.name.as_str(), note));
    }
    let [mut lines, mut bars] = report::charts(&rows)?;
    let stem = format!("{}-{}", view.name, environment.name());
    (lines.name, bars.name) = (format!("error-time-{stem}"), format!("ratios-{stem}"));
    let [lines, bars] = [lines, bars].map(|chart| chart.html().into_string());
    Ok(format!(
        "<h3>{} under {}</h3>\n{}{}{}<div class=\"charts\">\n<figure>{lines}<figcaption>MSE against rendering time at 1, 4 and 16 samples per pixel, means of {} runs.</figcaption></figure>\n\
         <figure>{bars}<figcaption>How many times lower the MSE is than that of one-sample MIS.</figcaption></figure>\n</div>\n",
        escape(&view.name),
        escape(environment.name()),
        strip("wide", &whole),
        strip("crops", &crops),
        numbers(&rows, entries),
        workshop.effort.runs,
    ))
}

/// MSE, time and their product at the shown number of samples.
fn numbers(rows: &[Row], entries: &[Entry]) -> String {
    let (base, base_seconds) = mean(rows, &entries[0].name, SHOWN);
    let line = |entry: &Entry| {
        let (mse, seconds) = mean(rows, &entry.name, SHOWN);
        vec![
            entry.name.clone(),
            text(mse),
            format!("{}\u{d7}", times(base / mse)),
            format!("{}\u{d7}", times(seconds / base_seconds)),
            format!("{}\u{d7}", times(base * base_seconds / (mse * seconds))),
        ]
    };
    let lines: Vec<Vec<String>> = entries.iter().map(line).collect();
    table("numbers", &["4 samples per pixel", "MSE", "lower than MIS", "time of MIS", "lower MSE \u{d7} time"], &lines)
}
