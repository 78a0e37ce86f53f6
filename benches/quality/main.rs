//! Variance and KL of every sampler without shadows: `cargo bench --bench quality -- [--material MATERIAL] [--ablation] [--only NAME,...] [--set KEY=VALUE] [MAP ...]`.
//!
//! **Lambert** (the default): for 100 random normals the relative variance of one sample is integrated over 250 x 250 jittered points of the
//! intermediate square, where the emitter's density is constant, so that a sun costs no more points than a sky, and over 512 x 1024 points
//! of the map, so that no dark part is stepped over; the balance heuristic joins them.
//! Resampled samplers have no pdf: theirs is measured from 8,000 draws per normal.
//!
//! **`ggx:alpha=0.4`, `ggx:alpha=0.2..0.8`**: 60 random conditions (view direction, normal and width as in training). A lobe may
//! fall between points of Y, so the integrals are over 160 x 160 jittered points of Y, 128 x 256 of the map and 112 x 112 stratified BRDF samples, joined by
//! the balance heuristic. Everything is measured twice with other points (resampled samplers: twice 4,000 draws), the tables
//! give the mean, and a last one half the relative difference: the error. `direct` is the table of a Lambert surface.
//!
//! A head is trained for each map with the fast preset of the material. Prints mean relative variance of one-sample MIS over
//! that of the sampler (at one shadow ray each; higher is better), KL(product || sampler) in nats, and the largest weight over its mean that
//! any point of the quadratures has. With `--ablation` the
//! samplers are variants of the model, see `ablation.rs`; with `--only` they are `mis` and those that are named. `--set` goes to heads over patches, as for `fit`. Without maps it takes the built-in environments.

mod ablation;
mod measure;
mod samplers;

use std::sync::Arc;

use headtail_render::environment::{BUILT_IN_NAMES, Environment};
use headtail_train::{ConfigBuilder, Material, Preset};

use measure::Quality;
use samplers::Qualities;

type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

fn main() -> Fallible<()> {
    let (mut material, mut ablation, mut maps, mut only) = (Material::Lambert, false, Vec::new(), Vec::new());
    let (mut over_patches, mut has_settings) = (ConfigBuilder::new(Preset::OverPatches), false);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match &*argument {
            "--material" => material = arguments.next().unwrap_or_default().parse()?,
            "--ablation" => ablation = true,
            "--only" => only = arguments.next().unwrap_or_default().split(',').map(str::to_owned).collect(),
            "--set" => {
                over_patches.assignment(&arguments.next().unwrap_or_default())?;
                has_settings = true;
            }
            // Cargo passes it.
            "--bench" => {}
            other if other.starts_with("--") => return Err(format!("{other} is no option").into()),
            _ => maps.push(argument),
        }
    }
    if matches!(material, Material::Measured(_)) {
        return Err("measured materials are not among the benchmark's".into());
    }
    if maps.is_empty() {
        maps = BUILT_IN_NAMES.map(str::to_owned).to_vec();
    }
    if ablation && !only.is_empty() {
        return Err("--only names samplers, and --ablation has none".into());
    }
    if has_settings && (ablation || material == Material::Lambert) {
        return Err(
            "--set goes to heads over patches, which are measured on glossy surfaces and not in the ablation".into()
        );
    }
    let over_patches = over_patches.build()?.for_material(material);
    over_patches.validate()?;
    let mut results = Vec::new();
    for map in &maps {
        let environment = Arc::new(Environment::open(map)?);
        let found = if ablation {
            ablation::measure_map(material, &environment)?
        } else {
            samplers::measure_map(material, &over_patches, &environment, &only)?
        };
        results.push((environment.name().to_owned(), found));
    }
    let ratio = |qualities: &Qualities, k: usize| qualities[0].1.relative_variance / qualities[k].1.relative_variance;
    print_table("relative variance of mis over that of the sampler", &results, ratio, ablation);
    print_table("KL(product || sampler) in nats", &results, |qualities, k| qualities[k].1.kl, ablation);
    print_table("largest weight over its mean", &results, |qualities, k| qualities[k].1.largest_weight, ablation);
    if material != Material::Lambert {
        let error = |qualities: &Qualities, k: usize| 100.0 * qualities[k].1.error;
        print_table("relative error of the variances, percent", &results, error, ablation);
    }
    Ok(())
}

/// A Markdown table of one figure, with the median over maps last. `by_sampler` makes a row of each sampler, not of each map.
fn print_table(
    title: &str,
    results: &[(String, Qualities)],
    figure: impl Fn(&Qualities, usize) -> f64,
    by_sampler: bool,
) {
    let samplers: Vec<String> = results[0].1.iter().map(|(name, _): &(&str, Quality)| (*name).to_owned()).collect();
    let mut maps: Vec<String> = results.iter().map(|(name, _)| name.clone()).collect();
    let mut rows: Vec<Vec<f64>> =
        results.iter().map(|(_, qualities)| (0..samplers.len()).map(|k| figure(qualities, k)).collect()).collect();
    let median = |k: usize| {
        let mut values: Vec<f64> = rows.iter().map(|row| row[k]).collect();
        values.sort_by(f64::total_cmp);
        0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
    };
    let medians = (0..samplers.len()).map(median).collect();
    rows.push(medians);
    maps.push("median".into());

    let (columns, lines): (&[String], &[String]) = if by_sampler { (&maps, &samplers) } else { (&samplers, &maps) };
    let corner = if by_sampler { "model" } else { "map" };
    println!("\n{title}\n\n| {corner} | {} |\n|---|{}", columns.join(" | "), "---|".repeat(columns.len()));
    for (line, name) in lines.iter().enumerate() {
        let value = |column: usize| if by_sampler { rows[column][line] } else { rows[line][column] };
        let cell = |value: f64| if value.is_nan() { "-".into() } else { format!("{value:.3}") };
        println!("| {name} | {} |", (0..columns.len()).map(|k| cell(value(k))).collect::<Vec<_>>().join(" | "));
    }
}
