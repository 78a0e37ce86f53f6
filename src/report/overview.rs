//! Several comparisons on one page: speed against accuracy, for each and over all.

use std::collections::HashSet;

use anyhow::Result;
use headtail_render::statistics::RatioInterval;
use maud::{Markup, html};

use super::chart::Extent;
use super::chart::pareto::{FRONT, MeasuredSampler, on_front, scatter};
use super::kind::Look;
use super::number::{ends, times};
use super::shell::{Page, count};
use super::summary::{Budget, Measure, Summary, in_order};
use super::table::{Cell, Column, Table, Value};
use headtail_eval::Measurement;

/// A comparison at one budget.
struct Scene {
    title: String,
    summary: Summary,
    budget: Budget,
}

/// Builds the page from the runs of each comparison.
pub fn page(comparisons: &[Vec<Measurement>]) -> Result<String> {
    let scenes = comparisons.iter().map(|rows| Scene::of(rows)).collect::<Result<Vec<_>>>()?;
    let version = comparisons.first().and_then(|rows| rows.first()).map_or("", |row| row.version.as_str());
    let chart = |(index, scene): (usize, &Scene)| {
        let summary = &scene.summary;
        let samplers: Vec<MeasuredSampler> =
            summary.at(&scene.budget.name).map(|group| MeasuredSampler::of(summary, group)).collect();
        scatter(&format!("comparison-{}", index + 1), &samplers, ["rendering time in seconds", "mean squared error"])
    };
    let main = html! {
        (over_all(&scenes))
        section {
            h2 { "Each comparison" }
            div.charts.overview {
                @for (index, scene) in scenes.iter().enumerate() {
                    figure {
                        (chart((index, scene)).html())
                        figcaption { b { (scene.title) } ", " (scene.budget.words()) "." }
                    }
                }
            }
        }
    };
    let page = Page {
        kicker: "several comparisons",
        title: "Speed and accuracy of samplers".into(),
        heading: html! { "Speed and accuracy" },
        facts: vec![count(scenes.len(), "comparison")],
        command: "",
        version,
        style: "",
        script: "",
    };
    Ok(page.encode(&main))
}

impl Scene {
    fn of(rows: &[Measurement]) -> Result<Self> {
        let summary = Summary::of(rows)?;
        let budget = summary.shown_first().clone();
        let shown = rows.iter().filter(|row| row.budget == budget.name).map(|row| row.points.as_str());
        let points = in_order(shown).join(", ");
        Ok(Self { title: format!("{} under {}, {points} points", rows[0].scene, rows[0].env), summary, budget })
    }

    /// Returns time and error of a sampler relative to the baseline.
    fn ratios(&self, names: &Names, name: &str) -> Option<[RatioInterval; 2]> {
        let group = self.summary.at(&self.budget.name).find(|group| names.of(&group.sampler) == name)?;
        let base = self.summary.group(&self.summary.baseline, &self.budget.name)?;
        Some([base.ratio(group, Measure::Time)?, base.ratio(group, Measure::Mse)?])
    }
}

/// Names that match samplers across comparisons: the kind if every comparison has one sampler of it, else the
/// kind and the file name. Files for different maps often have different names.
struct Names {
    /// Kinds of which a comparison has several samplers.
    several: HashSet<String>,
}

impl Names {
    fn new(scenes: &[Scene]) -> Self {
        let mut several = HashSet::new();
        for scene in scenes {
            let mut seen = HashSet::new();
            let kinds = scene.summary.samplers.iter().filter_map(|sampler| sampler.rsplit_once(':'));
            several.extend(kinds.filter(|(kind, _)| !seen.insert(*kind)).map(|(kind, _)| kind.to_owned()));
        }
        Self { several }
    }

    fn of(&self, sampler: &str) -> String {
        match sampler.rsplit_once(':') {
            // The suffix is a number, not a file: the 4 of ris:4.
            Some((_, rest)) if rest.bytes().all(|byte| byte.is_ascii_digit()) => sampler.to_owned(),
            Some((kind, _)) if !self.several.contains(kind) => kind.to_owned(),
            Some((kind, path)) => {
                let last = path.rsplit(['/', '\\']).next().unwrap_or(path);
                format!("{kind}:{}", last.strip_suffix(".safetensors").unwrap_or(last))
            }
            None => sampler.to_owned(),
        }
    }
}

/// Chart and table of geometric means over all comparisons.
fn over_all(scenes: &[Scene]) -> Markup {
    let Some(first) = scenes.first() else { return html! {} };
    let known = Names::new(scenes);
    let mut names: Vec<String> = first.summary.samplers.iter().map(|sampler| known.of(sampler)).collect();
    // The baseline's colour and marker are the first ones, as in the other charts.
    names.sort_by_key(|name| *name != first.summary.baseline);
    names.retain(|name| scenes.iter().all(|scene| scene.ratios(&known, name).is_some()));
    // Geometric means of time and error for names in all scenes.
    let means = |name: &String| {
        let ratios: Vec<[RatioInterval; 2]> = scenes.iter().filter_map(|scene| scene.ratios(&known, name)).collect();
        let mean = |k: usize| {
            RatioInterval::geometric_mean(
                &ratios.iter().map(|ratios: &[RatioInterval; 2]| ratios[k]).collect::<Vec<_>>(),
            )
        };
        Some((Extent::from(&mean(0)?), mean(1)?))
    };
    let means: Vec<(Extent, RatioInterval)> = names.iter().filter_map(means).collect();
    let looks = Look::of_all(names.iter().map(String::as_str));
    let samplers: Vec<MeasuredSampler> = names
        .iter()
        .zip(&looks)
        .zip(&means)
        .map(|((name, look), (time, error))| MeasuredSampler {
            name: name.clone(),
            look: *look,
            time: *time,
            error: Extent::from(error),
        })
        .collect();
    let row = |((sampler, (_, interval)), on_front): ((&MeasuredSampler, &(Extent, RatioInterval)), bool)| {
        let (time, error) = (sampler.time.value, sampler.error.value);
        let name = Cell { swatch: sampler.look.swatch(), ..Cell::text(&sampler.name).marked(on_front) };
        let [time_cell, error_cell, gain] =
            [time, error, 1.0 / (time * error)].map(|value| Cell::from(Value::Times(value)));
        let around =
            sampler.time.ends.map_or(String::new(), |(low, high)| format!("{} to {}", times(low), times(high)));
        vec![name, time_cell.beside(around), error_cell.beside(ends(interval)), gain]
    };
    let rows = samplers.iter().zip(&means).zip(on_front(&samplers)).map(row).collect();
    let columns = vec![
        Column::text("Sampler"),
        Column::number("Time", ""),
        Column::number("MSE", ""),
        Column::number("Gain", "\u{2191} better"),
    ];
    let titles = ["time relative to the baseline", "mean squared error relative to the baseline"];
    html! {
        section {
            h2 { "Over all " (scenes.len()) " comparisons" }
            div.charts {
                figure {
                    (scatter("over-all", &samplers, titles).html())
                    figcaption {
                        "Geometric means over the comparisons of time and error at the budgets shown below, both relative to "
                        (first.summary.baseline_words()) ", of the samplers that all comparisons have. The gain is the inverse of their product. \
                         Further down and left is better. " (FRONT) " Intervals are of 95\u{a0}%, over runs that are paired by their seeds, \
                         for these comparisons and no others."
                    }
                }
                div { (Table::new("over-all", columns, rows).html(false)) }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::synthetic;
    use super::*;

    fn row(sampler: &str, seconds: f64, mse: f64) -> Measurement {
        Measurement { seconds, mse, ..synthetic::row(sampler, "4spp", 0) }
    }

    /// The cells of a name's row.
    fn cells(page: &str, name: &str) -> Vec<String> {
        let row = page.split_once(&format!("</svg>{name}</th>")).unwrap().1;
        let row = &row[..row.find("</tr>").unwrap()];
        row.split("</td>").filter_map(|cell| Some(cell.rsplit_once('>')?.1.to_owned())).collect()
    }

    #[test]
    fn overall_means_are_geometric_over_common_samplers() {
        let comparisons = [
            vec![row("mis", 1.0, 1.0), row("head:a/head.safetensors", 2.0, 0.1), row("ris:4", 3.0, 0.2)],
            vec![row("mis", 2.0, 3.0), row("head:b/room.safetensors", 4.0, 1.2)],
        ];
        let page = page(&comparisons).unwrap();
        // Time: sqrt(2 * 2) = 2; error: sqrt(0.1 * 0.4) = 0.2; gain at least 1 / 0.4.
        assert!(cells(&page, "head") == ["2.0\u{d7}", "0.20\u{d7}", "2.5\u{d7}"], "{page}");
        assert!(page.contains("<b>ball under sky, sobol points</b>"), "{page}");
        let over_all = &page[..page.find("Each comparison").unwrap()];
        assert!(!over_all.contains("ris:4") && page.contains("ris:4"));
        assert!(page.matches("<svg class=\"chart").count() == 6 && !page.contains("http:") && !page.contains("https:"));
    }

    #[test]
    fn several_runs_give_the_mean_error_an_interval() {
        let run = |sampler: &str, run: u32, mse: f64| Measurement { run, ..row(sampler, 1.0, mse) };
        let comparison = vec![run("mis", 0, 1.0), run("mis", 1, 1.1), run("ris:4", 0, 0.5), run("ris:4", 1, 0.56)];
        let page = page(&[comparison]).unwrap();
        // 1.06 / 2.1 = 0.505; deviations -+0.00898, so the half-width of the logarithm is 12.71 * 0.00898 =
        // 0.114.
        assert!(page.contains("0.50\u{d7}<span class=\"ci\">0.45 to 0.57</span>"), "{page}");
        assert_eq!(cells(&page, "mis"), ["1.0\u{d7}"; 3], "the baseline has no interval");
    }

    #[test]
    fn samplers_of_one_kind_are_distinguished_by_file_name() {
        let comparison = |map: &str| {
            let [small, large] = ["small", "large"].map(|size| format!("head:{map}/{size}.safetensors"));
            vec![row("mis", 1.0, 1.0), row(&small, 2.0, 1.0), row(&large, 3.0, 1.0)]
        };
        let page = page(&[comparison("a"), comparison("b")]).unwrap();
        assert!(page.contains("</svg>head:small</th>") && page.contains("</svg>head:large</th>"), "{page}");
    }
}
