//! Tables of experiments.

use std::collections::BTreeMap;

use anyhow::{Result, ensure};
use headtail_eval::summary::{Comparison, Interval, Ratios, ViewRuns};
use headtail_render::statistics::{MeanInterval, sidak};

use crate::{
    block::Block,
    markdown::{digits, table},
    shown::Shown,
};

/// Largest number of baselines that a table's title names; the text around it has the others.
const MOST_NAMED: usize = 4;

/// Table of error ratios: a row per sampler, a column per group of views.
pub fn ratios(shown: &Shown<'_>, block: &Block) -> Result<String> {
    let (at, baselines) = (block.comparison()?, block.names("baselines"));
    ensure!(!baselines.is_empty(), "baselines: name at least one");
    let groups = shown.groups(block)?;
    let head = groups.iter().map(|(name, views)| format!("{name} ({})", views.len()));
    let rows = block.sampler_sets().into_iter().map(|set| {
        let cells = groups.iter().map(|(_, views)| {
            let ratios = Ratios::of(views, &set.samplers, &baselines, &at);
            ratios.map_or("\u{2013}".to_owned(), |ratios| ratio_cell(&ratios))
        });
        std::iter::once(set.label.clone()).chain(cells).collect()
    });
    let what = match &at {
        Comparison::Samples(samples) => format!("after {samples}"),
        Comparison::Time { seconds, counts_preparation: true } => format!("after {seconds} s, preparation included"),
        Comparison::Time { seconds, counts_preparation: false } => {
            format!("after {seconds} s, preparation not counted")
        }
    };
    let named: Vec<String> = baselines.iter().map(|name| format!("`{name}`")).collect();
    let baseline = match &named[..] {
        [one] => one.clone(),
        few if few.len() <= MOST_NAMED => format!("the best of {}", few.join(", ")),
        many => format!("the best of {} baselines", many.len()),
    };
    let title = format!("MSE of {baseline} over MSE {what}; \u{2193}: views below 1");
    Ok(table(&std::iter::once(title).chain(head).collect::<Vec<_>>(), &rows.collect::<Vec<_>>()))
}

/// Formats a geometric mean with its interval and the number of views below 1.
fn ratio_cell(ratios: &Ratios) -> String {
    let Ratios { mean, below_one, without, .. } = ratios;
    let mut cell = interval_cell(mean);
    if *below_one > 0 {
        cell += &format!(" \u{2193}{below_one}");
    }
    if *without > 0 {
        cell += &format!(", {without} without");
    }
    cell
}

fn interval_cell(interval: &Interval) -> String {
    format!("{} [{}\u{2013}{}]", digits(interval.value), digits(interval.low), digits(interval.high))
}

/// Table of sample times relative to a baseline, by group, and of seconds of preparation.
pub fn cost(shown: &Shown<'_>, block: &Block) -> Result<String> {
    let baseline = block.need("baseline")?;
    let groups = shown.groups(block)?;
    let time = |view: &ViewRuns, sampler: &str| {
        let runs: Vec<f64> =
            view.samplers.get(sampler)?.values().flatten().map(|run| (run.seconds / run.spp).ln()).collect();
        Some((runs.iter().sum::<f64>() / runs.len() as f64).exp())
    };
    let head = groups.iter().map(|(name, _)| name.clone());
    let head =
        std::iter::once(format!("time of a sample over `{baseline}`")).chain(head).chain(["preparation, s".to_owned()]);
    let rows = shown.samplers().into_iter().map(|sampler| {
        let cells = groups.iter().map(|(_, views)| {
            let ratios = views.iter().filter_map(|view| Some((time(view, &sampler)? / time(view, baseline)?).ln()));
            let ratios: Vec<f64> = ratios.collect();
            match ratios.len() {
                0 => "\u{2013}".to_owned(),
                count => digits((ratios.iter().sum::<f64>() / count as f64).exp()),
            }
        });
        let mut prepared: Vec<f64> = shown
            .views
            .iter()
            .filter_map(|view| view.samplers.get(&sampler))
            .map(|budgets| budgets.values().flatten().map(|run| run.preparation).fold(f64::INFINITY, f64::min))
            .collect();
        prepared.sort_by(f64::total_cmp);
        let ends = match prepared[..] {
            [] => "\u{2013}".to_owned(),
            [one] => digits(one),
            _ => format!("{} to {}", digits(prepared[0]), digits(prepared[prepared.len() - 1])),
        };
        std::iter::once(format!("`{sampler}`")).chain(cells).chain([ends]).collect()
    });
    Ok(table(&head.collect::<Vec<_>>(), &rows.collect::<Vec<_>>()))
}

/// Relative errors of mean luminances: the number of 95 % intervals over runs that exclude 0, and the largest
/// error.
pub fn bias(shown: &Shown<'_>) -> String {
    let rows = shown.samplers().into_iter().map(|sampler| {
        let (mut count, mut excluded, mut largest, mut narrowest, mut widest, mut tiles) =
            (0, 0, 0.0_f64, f64::MAX, 0.0_f64, 0);
        let mut least_p = 1.0_f64;
        for budgets in shown.views.iter().filter_map(|view| view.samplers.get(&sampler)) {
            let Some(runs) = budgets.values().max_by(|a, b| a[0].spp.total_cmp(&b[0].spp)) else { continue };
            let off: Vec<f64> = runs.iter().map(|run| run.mean_luminance / run.reference_luminance - 1.0).collect();
            let Some(interval) = MeanInterval::of(&off) else { continue };
            count += 1;
            excluded += usize::from(interval.low() > 0.0 || interval.high() < 0.0);
            largest = if interval.mean.abs() > largest.abs() { interval.mean } else { largest };
            narrowest = narrowest.min(interval.half_width);
            widest = widest.max(interval.half_width);
            tiles += runs.iter().filter(|run| run.tile_p.is_finite()).count();
            least_p = runs.iter().map(|run| run.tile_p).filter(|p| p.is_finite()).fold(least_p, f64::min);
        }
        vec![
            format!("`{sampler}`"),
            format!("{excluded} of {count}"),
            format!("{:+.1e}", largest),
            format!("{:.1e} to {:.1e}", narrowest, widest),
            format!("{least_p:.1e} (1 % level {:.1e})", sidak(0.01, tiles)),
        ]
    });
    let head = [
        "sampler",
        "95 % intervals that exclude 0",
        "largest difference",
        "half widths",
        "smallest p-value of a picture's tiles",
    ];
    table(&head.map(str::to_owned), &rows.collect::<Vec<_>>())
}

/// Largest contribution of a sample relative to the mean luminance of its picture: median over views and
/// maximum, by material.
pub fn weights(shown: &Shown<'_>) -> String {
    let mut materials: Vec<String> = Vec::new();
    for view in &shown.views {
        if !materials.contains(&view.key.material) {
            materials.push(view.key.material.clone());
        }
    }
    let rows = shown.samplers().into_iter().map(|sampler| {
        let cells = materials.iter().map(|material| {
            let mut largest: Vec<f64> = shown
                .views
                .iter()
                .filter(|view| view.key.material == *material)
                .filter_map(|view| view.samplers.get(&sampler))
                .map(|budgets| {
                    budgets.values().flatten().map(|run| run.max_weight / run.reference_luminance).fold(0.0, f64::max)
                })
                .collect();
            largest.sort_by(f64::total_cmp);
            match largest.len() {
                0 => "\u{2013}".to_owned(),
                count => format!("{}, {}", digits(largest[count / 2]), digits(largest[count - 1])),
            }
        });
        std::iter::once(format!("`{sampler}`")).chain(cells).collect()
    });
    let head = materials.iter().map(|material| format!("{material}: median, largest"));
    table(&std::iter::once("sampler".to_owned()).chain(head).collect::<Vec<_>>(), &rows.collect::<Vec<_>>())
}

/// Scenes and maps of an experiment, and whether settings were tuned on them.
pub fn inputs(shown: &Shown<'_>) -> String {
    let words = |tuned: bool| if tuned { "tuned" } else { "untuned" }.to_owned();
    let mut used: BTreeMap<(&str, String), [String; 2]> = BTreeMap::new();
    for view in &shown.views {
        if let Some(scene) = shown.experiment.scene(&view.key.scene) {
            let kind = if scene.interior { "interior" } else { "object" }.to_owned();
            used.insert(("scene", scene.name.clone()), [kind, words(scene.tuned)]);
        }
        if let Some(map) = shown.experiment.map(&view.key.map) {
            used.insert(("map", map.name.clone()), [map.kind.clone(), words(map.tuned)]);
        }
    }
    let rows: Vec<Vec<String>> =
        used.into_iter().map(|((what, name), [kind, tuned])| vec![what.to_owned(), name, kind, tuned]).collect();
    table(&["", "name", "kind", "settings"].map(str::to_owned), &rows)
}
