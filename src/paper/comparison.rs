//! A view rendered by several samplers: pictures, crops, errors at equal samples and at equal time, and
//! densities at a marked point.

use std::sync::Arc;

use anyhow::{Context, Result};
use headtail_render::{
    environment::Environment,
    head::Head,
    image::Image,
    sampler::{EnvironmentLight, Sampler},
    spec::SamplerSpec,
    tail::TailKind,
};

use super::{
    PaperContext,
    data::View,
    densities::{self, Models, Surface, with_cross},
    figure::{Layout, Panel, Strip, note},
    measure::{Bench, Entry, EqualTime, mean},
    part::PartOutput,
};
use crate::report::{
    self, Measurement,
    crop::Crop,
    number::{text, times},
    table::{Cell, Value},
};

/// Samples per pixel of the pictures, as in the paper.
const SHOWN: u32 = 4;
/// Samples per pixel of the timings.
const TIMED: u32 = 16;
/// The colour of the marked point, as in the paper.
const GREEN: [u8; 3] = [40, 230, 70];

/// What is compared.
pub struct Subject {
    /// The view.
    pub view: View,
    /// The light.
    pub environment: Arc<Environment>,
    /// The samplers; the first is the baseline.
    pub entries: Vec<Entry>,
    /// The sampler whose whole picture is shown between the first and the last.
    pub shown: Option<&'static str>,
    /// Two heads, with and without a tail, for the densities.
    pub heads: Option<[Head; 2]>,
    /// Samplers for the densities, with their names.
    pub samplers: Vec<(&'static str, SamplerSpec)>,
}

/// Renders everything.
pub fn compare(context: &PaperContext, subject: &Subject, title: String) -> Result<PartOutput> {
    let Subject { view, environment, entries, .. } = subject;
    let bench = Bench::new(context, view, environment.clone())?;
    let (rows, images) = bench.measure(entries, &[1, SHOWN, TIMED], SHOWN)?;
    let equal = bench.equal_time(entries, &rows, TIMED, SHOWN)?;
    // Pixels of neural materials are preferred for the crop and the densities.
    let chosen = bench.special();
    let crop = Crop::worst(&images[0], &bench.reference, &chosen);
    let mut output = PartOutput::of(title);
    let mark = bench.nearest(&chosen, crop.left + crop.side / 2, crop.top + crop.side / 2);
    let mark = mark.context("no surface fills a pixel of the view")?;
    let surface = bench.surface_of(mark).context("a surface in a pixel that one fills")?;
    let width = bench.reference.width;
    let framed = crop.framed(&bench.reference, bench.exposure)?;
    let reference = with_cross(&framed, (mark % width, mark / width), GREEN)?;
    let whole = |k: usize| -> Result<Panel> {
        let caption = format!("{SHOWN} spp, MSE {}", text(mean(&rows, &entries[k].name, SHOWN).0));
        Ok(Panel::new(&crop.framed(&images[k], bench.exposure)?, entries[k].name.as_str(), caption))
    };
    let middle = entries.iter().position(|entry| Some(entry.name.as_str()) == subject.shown);
    let mut panels =
        vec![Panel::new(&reference, "reference", format!("{} spp", context.effort.reference_spp)), whole(0)?];
    panels.extend(middle.map(&whole).transpose()?);
    panels.push(whole(entries.len() - 1)?);
    let stem = stem(subject);
    let layout = if panels.len() > 3 { Layout::Four } else { Layout::Wide };
    output.strip(&format!("pictures-{stem}"), &Strip { layout, panels, scales: Vec::new() })?;
    output.html +=
        &note(&format!("The square at {SHOWN} samples per pixel; errors are of the whole picture and of the square."));
    let errors: Vec<f64> = entries.iter().map(|entry| mean(&rows, &entry.name, SHOWN).0).collect();
    let captions: Vec<String> =
        errors.iter().map(|mse| format!("MSE {}, {}\u{d7}", text(*mse), times(errors[0] / mse))).collect();
    let squares = crops(&bench, crop, entries, &images.iter().collect::<Vec<_>>(), &captions)?;
    output.strip(&format!("squares-{stem}"), &squares)?;
    output.html += &note("The same square in equal time: each takes the time of the slowest at 4 samples per pixel.");
    let captions: Vec<String> = equal
        .iter()
        .map(|own| format!("{} spp, MSE {}, {}\u{d7}", own.spp, text(own.mse), times(equal[0].mse / own.mse)))
        .collect();
    let squares = crops(&bench, crop, entries, &equal.iter().map(|own| &own.image).collect::<Vec<_>>(), &captions)?;
    output.strip(&format!("squares-{stem}-equal-time"), &squares)?;
    output.table(
        &format!("numbers-{stem}"),
        &[
            "sampler",
            "MSE, 4 spp",
            "lower than the first",
            "time of the first",
            "spp in equal time",
            "MSE in equal time",
            "lower in equal time",
        ],
        numbers(&rows, entries, &equal),
    );
    charts(&mut output, &rows, &stem, context.effort.runs)?;
    output.html += &note(
        "Densities at the green cross, without shadows; crosses mark the normal (red) and the reflected view (yellow).",
    );
    let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
    let samplers: Vec<(&str, Arc<dyn Sampler>)> = subject
        .samplers
        .iter()
        .map(|(name, spec)| Ok((*name, spec.build_sampler(environment)?)))
        .collect::<Result<_>>()?;
    let samplers: Vec<(&str, &dyn Sampler)> = samplers.iter().map(|(name, sampler)| (*name, &**sampler)).collect();
    let heads = subject.heads.as_ref();
    let models =
        Models { head: heads.map(|[head, _]| head), naive: heads.map(|[_, naive]| naive), samplers: &samplers };
    let at = Surface { point: &surface, brdfs: bench.scene().brdfs() };
    let divergences = densities::row(
        (&mut output, &format!("densities-{stem}")),
        context.effort.density_rows,
        light.tail(),
        at,
        models,
    )?;
    let names: Vec<&str> =
        std::iter::once("KL in nats").chain(divergences.iter().map(|(name, _)| name.as_str())).collect();
    output.figures(&format!("densities-{stem}"), &names, &[densities::line("green cross", &divergences)]);
    Ok(output)
}

/// File name stem of a comparison.
fn stem(subject: &Subject) -> String {
    let name = format!("{}-{}-{}", subject.view.name, subject.view.material, subject.environment.name());
    name.replace(|c: char| !c.is_ascii_alphanumeric(), "-")
}

/// The same square of the reference and of the pictures, with captions and the MSE in the square.
fn crops(
    bench: &Bench<'_>,
    crop: Crop,
    entries: &[Entry],
    images: &[&Image],
    captions: &[String],
) -> Result<Strip<'static>> {
    let mut panels = vec![Panel::new(&crop.png(&bench.reference, bench.exposure)?, "reference", "")];
    for ((entry, image), caption) in entries.iter().zip(images).zip(captions) {
        let note = format!("{caption}, square {}", text(crop.error(image, &bench.reference, &bench.measured)));
        panels.push(Panel::new(&crop.png(image, bench.exposure)?, entry.name.as_str(), note));
    }
    Ok(Strip { layout: Layout::Crops, panels, scales: Vec::new() })
}

/// Errors at the shown number of samples, and at equal time.
fn numbers(rows: &[Measurement], entries: &[Entry], equal: &[EqualTime]) -> Vec<Vec<Cell>> {
    let (base, base_seconds) = mean(rows, &entries[0].name, SHOWN);
    let line = |(entry, own): (&Entry, &EqualTime)| {
        let (mse, seconds) = mean(rows, &entry.name, SHOWN);
        vec![
            Cell::text(entry.name.as_str()),
            Cell::number(mse),
            Value::Times(base / mse).into(),
            Value::Times(seconds / base_seconds).into(),
            Value::Amount(f64::from(own.spp)).into(),
            Cell::number(own.mse),
            Value::Times(equal[0].mse / own.mse).into(),
        ]
    };
    entries.iter().zip(equal).map(line).collect()
}

fn charts(output: &mut PartOutput, rows: &[Measurement], stem: &str, runs: u32) -> Result<()> {
    let [mut lines, mut bars] = report::charts(rows)?;
    (lines.name, bars.name) = (format!("error-time-{stem}"), format!("ratios-{stem}"));
    let [lines, bars] = [lines, bars].map(|chart| chart.html().into_string());
    output.html += &format!(
        "<div class=\"charts\">\n<figure>{lines}<figcaption>MSE against rendering time at 1, 4 and 16 samples per pixel, means of {runs} runs.</figcaption></figure>\n\
         <figure>{bars}<figcaption>How many times lower the MSE is than that of the first.</figcaption></figure>\n</div>\n"
    );
    Ok(())
}
