//! What samplers cost: training, size, time per sample.

use std::sync::Arc;

use anyhow::Result;
use headtail_render::{
    environment::Environment,
    estimator::Estimator,
    spec::{FileKind, SamplerSpec},
};
use headtail_train::Material;

use super::{
    Workshop,
    figure::table,
    fits::weights,
    measure::{Bench, Entry, mean},
    scenes::baked,
};
use crate::report::number::{duration, text, times};

/// Samples per pixel of the timings.
const SPP: u32 = 16;

/// The section.
pub fn section(workshop: &Workshop) -> Result<String> {
    let environment = workshop.data.map(0)?;
    let cosine = workshop.heads.of(&environment, Material::Lambert)?;
    let glossy = workshop.heads.of(&environment, Material::Ggx { low: 0.2, high: 0.8 })?;
    let size = |path: &std::path::Path| std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let kilobytes = |bytes: u64| format!("{} kB", bytes / 1000);
    let models = table(
        "models",
        &["", "weights", "paper", "training", "paper", "file"],
        &[
            vec![
                "cosine head".into(),
                weights(&cosine.head).to_string(),
                "\u{2013}".into(),
                duration(cosine.seconds),
                "under 5 min, A100".into(),
                kilobytes(size(&cosine.file)),
            ],
            vec![
                "microfacet head".into(),
                weights(&glossy.head).to_string(),
                "36k".into(),
                duration(glossy.seconds),
                "20 min, A100".into(),
                kilobytes(size(&glossy.file)),
            ],
            vec![
                "table, 16 \u{d7} 32 normals of 8 \u{d7} 8 cells".into(),
                "32768 masses".into(),
                "132 kB".into(),
                "\u{2013}".into(),
                "\u{2013}".into(),
                "131 kB".into(),
            ],
        ],
    );
    let diffuse = timings(
        workshop,
        &environment,
        "temple",
        "lambert",
        vec![
            ("head", SamplerSpec::file(FileKind::Head, cosine.file.clone()).build(&environment)?),
            ("baked 8\u{d7}8", baked(&cosine.file, &environment, 8)?),
        ],
    )?;
    let microfacet = timings(
        workshop,
        &environment,
        "droid",
        "ggx:alpha=0.2..0.8",
        vec![("head", SamplerSpec::file(FileKind::Head, glossy.file).build(&environment)?)],
    )?;
    Ok(format!(
        "<p class=\"note\">Training on this machine's processor; files hold the map's luminance besides weights. Times are of whole renderings at {SPP} samples per pixel, camera and \
         shadow rays included.</p>\n{models}<h3>temple, diffuse</h3>\n{diffuse}<h3>droid, microfacets</h3>\n{microfacet}"
    ))
}

fn timings(
    workshop: &Workshop,
    environment: &Arc<Environment>,
    scene: &str,
    material: &str,
    own: Vec<(&str, Box<dyn Estimator>)>,
) -> Result<String> {
    let view = workshop.data.view(scene, material)?;
    let bench = Bench::new(workshop, &view, environment.clone())?;
    let mut entries = vec![
        Entry { name: "mis".into(), estimator: SamplerSpec::mis().build(environment)? },
        Entry { name: "ris:4".into(), estimator: SamplerSpec::ris(4).build(environment)? },
    ];
    entries.extend(own.into_iter().map(|(name, estimator)| Entry { name: name.into(), estimator }));
    entries.push(Entry { name: "patches".into(), estimator: SamplerSpec::patches().build(environment)? });
    let (rows, _) = bench.measure(&entries, &[SPP], SPP)?;
    let pixels = bench.measured.len() as f64;
    let base = mean(&rows, "mis", SPP).1;
    let line = |entry: &Entry| {
        let (mse, seconds) = mean(&rows, &entry.name, SPP);
        let nanoseconds = 1e9 * seconds / (pixels * f64::from(SPP));
        vec![entry.name.clone(), format!("{nanoseconds:.0} ns"), format!("{}\u{d7}", times(seconds / base)), text(mse)]
    };
    Ok(table(
        &format!("costs-{scene}"),
        &["", "time per sample", "of MIS", "MSE"],
        &entries.iter().map(line).collect::<Vec<_>>(),
    ))
}
