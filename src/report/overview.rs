//! Several comparisons on one page: speed against accuracy for each, and over all of them.

use std::{collections::HashSet, fmt::Write};

use anyhow::Result;
use headtail_render::statistics::RatioInterval;

use super::Row;
use super::chart::pareto::{Place, front, scatter};
use super::html;
use super::number::{ends, escape, times};
use super::summary::{Budget, Measure, Summary, in_order};

/// A comparison at the budget that is shown.
struct Scene {
    title: String,
    summary: Summary,
    budget: Budget,
}

/// The page of the runs of each comparison.
pub fn page(comparisons: &[Vec<Row>]) -> Result<String> {
    let scenes = comparisons.iter().map(|rows| Scene::of(rows)).collect::<Result<Vec<_>>>()?;
    let version = comparisons.first().and_then(|rows| rows.first()).map_or("", |row| row.version.as_str());
    let mut page = html::head(version, "Speed and accuracy of samplers \u{b7} headtail");
    page += "<body>\n<header>\n<p class=\"kicker\">headtail \u{b7} several comparisons</p>\n<h1>Speed and accuracy</h1>\n</header>\n<main>\n";
    page += &over_all(&scenes);
    page += "<section>\n<h2>Each comparison</h2>\n<div class=\"charts overview\">\n";
    for scene in &scenes {
        let places: Vec<Place> =
            scene.summary.at(&scene.budget.name).map(|group| Place::of(&scene.summary, group)).collect();
        push(
            &mut page,
            format_args!(
                "<figure>{}<figcaption><b>{}</b>, {}.</figcaption></figure>\n",
                scatter(&places, "rendering time in seconds", "mean squared error"),
                escape(&scene.title),
                escape(&scene.budget.words())
            ),
        );
    }
    Ok(page + "</div>\n</section>\n</main>\n</body>\n</html>\n")
}

impl Scene {
    fn of(rows: &[Row]) -> Result<Self> {
        let summary = Summary::of(rows)?;
        let budget = summary.shown_first().clone();
        let shown = rows.iter().filter(|row| row.budget == budget.name).map(|row| row.points.as_str());
        let points = in_order(shown).join(", ");
        Ok(Self { title: format!("{} under {}, {points} points", rows[0].scene, rows[0].env), summary, budget })
    }

    /// Time and error of a sampler over those of the baseline.
    fn ratios(&self, names: &Names, name: &str) -> Option<(f64, RatioInterval)> {
        let group = self.summary.at(&self.budget.name).find(|group| names.of(&group.sampler) == name)?;
        let base = self.summary.group(&self.summary.baseline, &self.budget.name)?;
        let time = group.mean.seconds / base.mean.seconds;
        let error = base.ratio(group, Measure::Mse)?;
        (time.is_finite() && time > 0.0).then_some((time, error))
    }
}

/// What samplers of different comparisons are recognised by: the kind, where no comparison has two samplers of it, and else the
/// kind with the last name of the file. Files for different maps often have different names.
struct Names {
    /// Kinds of which some comparison has several.
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
            // What follows is no file: the 4 of ris:4.
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

/// The chart and the table of geometric means over all comparisons.
fn over_all(scenes: &[Scene]) -> String {
    let Some(first) = scenes.first() else { return String::new() };
    let known = Names::new(scenes);
    let mut names: Vec<String> = first.summary.samplers.iter().map(|sampler| known.of(sampler)).collect();
    // The baseline's colour and marker are the first ones, as in the other charts.
    names.sort_by_key(|name| *name != first.summary.baseline);
    names.retain(|name| scenes.iter().all(|scene| scene.ratios(&known, name).is_some()));
    // Of a name that all scenes have, the geometric means of time and error.
    let means = |name: &String| {
        let (times, errors): (Vec<f64>, Vec<RatioInterval>) =
            scenes.iter().filter_map(|scene| scene.ratios(&known, name)).unzip();
        let time = (times.iter().map(|time| time.ln()).sum::<f64>() / times.len() as f64).exp();
        Some((time, RatioInterval::geometric_mean(&errors)?))
    };
    let means: Vec<(f64, RatioInterval)> = names.iter().filter_map(means).collect();
    let places: Vec<Place> = names
        .iter()
        .zip(&means)
        .enumerate()
        .map(|(index, (name, (time, error)))| Place::new(name.clone(), index, *time, error.ratio))
        .collect();
    let best: Vec<String> = front(&places).into_iter().map(|place| place.name.clone()).collect();
    let rows = places.iter().zip(&means).map(|(place, (_, interval))| {
        let mark = if best.contains(&place.name) { " class=\"best\"" } else { "" };
        let [time, error] = [place.time, place.error].map(times);
        let efficiency = times(1.0 / (place.time * place.error));
        format!("<tr><th scope=\"row\"{mark}>{}</th><td class=\"number\">{time}</td><td class=\"number\">{error}{}</td><td class=\"number\">{efficiency}</td></tr>\n", escape(&place.name), uncertainty(interval))
    });
    format!(
        "<section>\n<h2>Over all {} comparisons</h2>\n<div class=\"charts\">\n<figure>{}<figcaption>Geometric means over the comparisons of time and \
         error at the budgets shown below, both relative to {}, of the samplers that all comparisons have. The gain is the inverse of \
         their product. Further down and left is better; the broad line is the Pareto front. Intervals of the MSE are of 95\u{a0}%, over runs that are \
         paired by their seeds, for these comparisons and no others.</figcaption></figure>\n\
         <div class=\"scroll\"><table class=\"plain\"><thead><tr><th scope=\"col\">Sampler</th><th scope=\"col\" class=\"number\">Time</th>\
         <th scope=\"col\" class=\"number\">MSE</th><th scope=\"col\" class=\"number\">Gain</th></tr></thead>\n<tbody>\n{}</tbody></table></div>\n\
         </div>\n</section>\n",
        scenes.len(),
        scatter(&places, "time relative to the baseline", "mean squared error relative to the baseline"),
        escape(&first.summary.baseline_words()),
        rows.collect::<String>(),
    )
}

/// The interval of a ratio for a cell of the table; empty if it is unknown.
fn uncertainty(ratio: &RatioInterval) -> String {
    match ends(ratio) {
        ends if ends.is_empty() => ends,
        ends => format!("<span class=\"ci\">{ends}</span>"),
    }
}

fn push(text: &mut String, arguments: std::fmt::Arguments) {
    text.write_fmt(arguments).expect("a String takes all that is written to it");
}

#[cfg(test)]
mod tests {
    use super::super::synthetic;
    use super::*;

    fn row(sampler: &str, seconds: f64, mse: f64) -> Row {
        Row { seconds, mse, ..synthetic::row(sampler, "4spp", 0) }
    }

    #[test]
    fn means_over_all_are_geometric_and_of_samplers_that_all_have() {
        let comparisons = [
            vec![row("mis", 1.0, 1.0), row("head:a/head.safetensors", 2.0, 0.1), row("ris:4", 3.0, 0.2)],
            vec![row("mis", 2.0, 3.0), row("head:b/room.safetensors", 4.0, 1.2)],
        ];
        let page = page(&comparisons).unwrap();
        // Time: sqrt(2 * 2) = 2; error: sqrt(0.1 * 0.4) = 0.2; gain 1 / 0.4.
        assert!(
            page.contains(
                ">head</th><td class=\"number\">2.0</td><td class=\"number\">0.20</td><td class=\"number\">2.5</td>"
            ),
            "{page}"
        );
        assert!(page.contains("<b>ball under sky, sobol points</b>"), "{page}");
        let over_all = &page[..page.find("Each comparison").unwrap()];
        assert!(!over_all.contains("ris:4") && page.contains("ris:4"));
        assert!(page.matches("<svg").count() == 6 && !page.contains("http:") && !page.contains("https:"));
    }

    #[test]
    fn several_runs_give_the_mean_error_an_interval() {
        let run = |sampler: &str, run: u32, mse: f64| Row { run: Some(run), ..row(sampler, 1.0, mse) };
        let comparison = vec![run("mis", 0, 1.0), run("mis", 1, 1.1), run("ris:4", 0, 0.5), run("ris:4", 1, 0.56)];
        let page = page(&[comparison]).unwrap();
        // 1.06 / 2.1 = 0.505; deviations -+0.00898, so that the logarithm is known to 12.71 * 0.00898 = 0.114.
        assert!(page.contains("0.50<span class=\"ci\">0.45 to 0.57</span>"), "{page}");
        assert!(page.contains("1.0</td><td class=\"number\">1.0</td>"), "the baseline has no interval");
    }

    #[test]
    fn two_samplers_of_a_kind_are_told_apart_by_their_files() {
        let comparison = |map: &str| {
            let [small, large] = ["small", "large"].map(|size| format!("head:{map}/{size}.safetensors"));
            vec![row("mis", 1.0, 1.0), row(&small, 2.0, 1.0), row(&large, 3.0, 1.0)]
        };
        let page = page(&[comparison("a"), comparison("b")]).unwrap();
        assert!(page.contains(">head:small</th>") && page.contains(">head:large</th>"), "{page}");
    }
}
