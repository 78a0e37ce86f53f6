//! Forest plots: ratios by row on a logarithmic axis, one dot per scene or picture, with intervals.

use std::fmt::Write as _;

use anyhow::{Context, Result, ensure};
use headtail_eval::summary::{Interval, Ratios, ViewRuns};
use serde_json::Value;

use crate::{
    block::Block,
    markdown::{CHART, Filled, digits},
    shown::Shown,
};

const ROW: f64 = 17.0;
const LEFT: f64 = 250.0;
const WIDTH: f64 = 760.0;
const RIGHT: f64 = 130.0;
const TOP: f64 = 60.0;
const MARGIN: f64 = 8.0;
/// Colours that are distinct under colour-vision deficiency (Okabe and Ito 2008).
const COLOURS: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];

/// How a dot is drawn: the first six series are round, others square.
#[derive(Clone, Copy)]
struct Mark {
    series: usize,
    is_full: bool,
}

struct Row {
    label: String,
    dots: Vec<(Interval, Mark)>,
    mean: String,
}

/// A chart without its place in a page.
struct Forest {
    title: String,
    mean: &'static str,
    rows: Vec<Row>,
    /// Names of the series.
    legend: Vec<String>,
    ticks: &'static [f64],
    /// Least and greatest end of the axis.
    limits: (f64, f64),
}

/// Returns the chart of a block on an experiment and the line that embeds it: rows are materials and maps, colours are
/// scenes.
///
/// # Errors
/// If a setting is missing.
pub fn of_experiment(shown: &Shown<'_>, block: &Block) -> Result<Filled> {
    let (at, baselines) = (block.comparison()?, block.names("baselines"));
    let sets = block.sampler_sets();
    let samplers: Vec<String> = sets.iter().flat_map(|set| set.samplers.clone()).collect();
    let is_shown = |name: &String| shown.views.iter().any(|view| view.key.scene == *name);
    let scenes: Vec<String> = shown.experiment.scenes.iter().map(|scene| scene.name.clone()).filter(is_shown).collect();
    let mut rows: Vec<Row> = Vec::new();
    for material in &shown.experiment.materials {
        for map in &shown.experiment.maps {
            let is_here = |view: &&ViewRuns| view.key.material == material.name && view.key.map == map.name;
            let views: Vec<&ViewRuns> = shown.views.iter().filter(is_here).collect();
            let dot = |view: &&ViewRuns| {
                let series = scenes.iter().position(|own| *own == view.key.scene)?;
                let mark = Mark { series, is_full: shown.experiment.is_tuned(&view.key) };
                Some((view.interval(&samplers, &baselines, &at)?, mark))
            };
            let dots: Vec<_> = views.iter().filter_map(dot).collect();
            if !dots.is_empty() {
                let mean = Ratios::of(&views, &samplers, &baselines, &at);
                let mean = mean.map_or(String::new(), |mean| digits(mean.mean.value));
                rows.push(Row { label: format!("{}, {}", material.name, map.name), dots, mean });
            }
        }
    }
    let label: Vec<&str> = sets.iter().map(|set| set.label.trim_matches('`')).collect();
    let chart = Forest {
        title: format!(
            "MSE of the best of {} baselines over that of {}; bars: 95 % intervals; hollow: an untuned map or scene",
            baselines.len(),
            label.join(", ")
        ),
        mean: "geometric mean",
        rows,
        legend: scenes,
        ticks: &[0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0],
        limits: (0.1, 100.0),
    };
    let alt = format!(
        "MSE of the best of {} baselines over that of {}, by material and map; one dot for each scene",
        baselines.len(),
        label.join(", ")
    );
    filled(&chart, &alt, block)
}

/// Returns the chart of a block on a recorded list and the line that embeds it: `rows=` and `columns=` name the keys
/// of rows and colours, `value=` that of the ratio, whose interval is under the same key with `_low` and `_high`;
/// `baseline=` is the row that the ratios refer to, which is not drawn, and `full=key:value` selects full dots. Objects
/// without an interval are left out.
///
/// # Errors
/// If a setting is missing, or nothing is drawn.
pub fn of_list(list: &[Value], block: &Block) -> Result<Filled> {
    let [row_key, series_key, value_key] = [block.need("rows")?, block.need("columns")?, block.need("value")?];
    let (baseline, full) = (block.need("baseline")?, block.need("full")?);
    let (full_key, full_value) = full.split_once(':').context("full is not key:value")?;
    let (mut rows, mut series): (Vec<Row>, Vec<String>) = (Vec::new(), Vec::new());
    for object in list {
        let text = |key: &str| object.get(key).and_then(Value::as_str).unwrap_or_default();
        let number = |suffix: &str| object.get(format!("{value_key}{suffix}")).and_then(Value::as_f64);
        let label = text(row_key);
        let (Some(value), Some(low), Some(high)) = (number(""), number("_low"), number("_high")) else { continue };
        if label == baseline {
            continue;
        }
        let name = text(series_key);
        let place = series.iter().position(|own| own == name).unwrap_or_else(|| {
            series.push(name.to_owned());
            series.len() - 1
        });
        let dot = (Interval { value, low, high }, Mark { series: place, is_full: text(full_key) == full_value });
        match rows.iter_mut().find(|row| row.label == label) {
            Some(row) => row.dots.push(dot),
            None => rows.push(Row { label: label.to_owned(), dots: vec![dot], mean: String::new() }),
        }
    }
    ensure!(!rows.is_empty(), "there is no '{value_key}' with '{value_key}_low' and '{value_key}_high'");
    for row in &mut rows {
        let logs: f64 = row.dots.iter().map(|(interval, _)| interval.value.ln()).sum();
        row.mean = format!("{} ({})", digits((logs / row.dots.len() as f64).exp()), row.dots.len());
    }
    let alt = format!("{value_key} to {baseline} by {row_key}; one dot for each picture");
    let chart = Forest {
        title: format!("{value_key} to {baseline}; bars: 95 % intervals; hollow: {full_key} other than {full_value}"),
        mean: "geometric mean (dots)",
        rows,
        legend: series,
        ticks: &[0.01, 0.1, 1.0, 10.0, 100.0, 1000.0],
        limits: (0.01, 1000.0),
    };
    filled(&chart, &alt, block)
}

fn filled(chart: &Forest, alt: &str, block: &Block) -> Result<Filled> {
    let file = block.need("file")?.to_owned();
    Ok(Filled { markdown: format!("![{alt}.]({CHART})"), chart: Some((file, chart.draw())) })
}

impl Forest {
    /// Returns the chart as an SVG.
    fn draw(&self) -> String {
        let bottom = TOP + ROW * self.rows.len() as f64;
        let legend = bottom + 34.0;
        let height = legend + 16.0 * self.legend.len().div_ceil(4) as f64 + 10.0;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" font-family=\"sans-serif\" font-size=\"11\">\n\
             <rect width=\"{WIDTH}\" height=\"{height}\" fill=\"white\"/>\n"
        );
        text(&mut svg, (MARGIN, 16.0), "start", &self.title);
        text(&mut svg, (WIDTH - MARGIN, 34.0), "end", self.mean);
        let axis = self.axis();
        self.draw_axis(&mut svg, axis, bottom);
        for (index, row) in self.rows.iter().enumerate() {
            row.draw(&mut svg, axis, TOP + ROW * (index as f64 + 0.5));
        }
        for (series, name) in self.legend.iter().enumerate() {
            let (column, line) = ((series % 4) as f64, (series / 4) as f64);
            let (x, y) = (LEFT - 160.0 + 165.0 * column, legend + 16.0 * line);
            text(&mut svg, (x + 12.0, y + 4.0), "start", name);
            dot(&mut svg, (x, y), Mark { series, is_full: true });
        }
        svg + "</svg>\n"
    }

    /// Returns the axis, which contains all intervals within the limits.
    fn axis(&self) -> Axis {
        let ends =
            self.rows.iter().flat_map(|row| row.dots.iter().flat_map(|(interval, _)| [interval.low, interval.high]));
        let (low, high) = ends.fold((0.5_f64, 4.0_f64), |(low, high), end| (low.min(end), high.max(end)));
        Axis { low: low.max(self.limits.0), high: high.min(self.limits.1) }
    }

    fn draw_axis(&self, svg: &mut String, axis: Axis, bottom: f64) {
        for &tick in self.ticks.iter().filter(|tick| (axis.low..=axis.high).contains(*tick)) {
            let (x, (width, colour)) = (axis.x(tick), if tick == 1.0 { (1.5, "#222") } else { (0.5, "#bbb") });
            text(svg, (x, TOP - 10.0), "middle", &tick.to_string());
            let _ = writeln!(
                svg,
                "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{TOP}\" y2=\"{bottom:.1}\" stroke=\"{colour}\" stroke-width=\"{width}\"/>"
            );
        }
    }
}

/// A logarithmic axis.
#[derive(Clone, Copy)]
struct Axis {
    low: f64,
    high: f64,
}

impl Axis {
    /// Returns the place of a ratio; those beyond the axis are at its ends.
    fn x(self, ratio: f64) -> f64 {
        let part = (ratio / self.low).ln() / (self.high / self.low).ln();
        LEFT + (WIDTH - LEFT - RIGHT) * part.clamp(0.0, 1.0)
    }
}

impl Row {
    fn draw(&self, svg: &mut String, axis: Axis, middle: f64) {
        text(svg, (LEFT - 12.0, middle + 4.0), "end", &self.label);
        text(svg, (WIDTH - MARGIN, middle + 4.0), "end", &self.mean);
        let count = self.dots.len() as f64;
        for (number, (interval, mark)) in self.dots.iter().enumerate() {
            let y = middle + (number as f64 - 0.5 * (count - 1.0)) * (ROW - 5.0) / count.max(4.0);
            if !(axis.low..=axis.high).contains(&interval.value) {
                let arrow = if interval.value < axis.low { "\u{25c2}" } else { "\u{25b8}" };
                text(svg, (axis.x(interval.value), y + 4.0), "middle", arrow);
                continue;
            }
            let _ = writeln!(
                svg,
                "<line x1=\"{:.1}\" x2=\"{:.1}\" y1=\"{y:.1}\" y2=\"{y:.1}\" stroke=\"{}\" stroke-width=\"1\"/>",
                axis.x(interval.low),
                axis.x(interval.high),
                mark.colour()
            );
            dot(svg, (axis.x(interval.value), y), *mark);
        }
    }
}

impl Mark {
    fn colour(self) -> &'static str {
        COLOURS[self.series % COLOURS.len()]
    }
}

fn text(svg: &mut String, at: (f64, f64), anchor: &str, words: &str) {
    let _ = writeln!(svg, "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\">{words}</text>", at.0, at.1);
}

fn dot(svg: &mut String, (x, y): (f64, f64), mark: Mark) {
    let colour = mark.colour();
    let fill = if mark.is_full { colour } else { "white" };
    let shape = if mark.series < COLOURS.len() {
        format!("circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.8\"")
    } else {
        format!("rect x=\"{:.1}\" y=\"{:.1}\" width=\"5.2\" height=\"5.2\"", x - 2.6, y - 2.6)
    };
    let _ = writeln!(svg, "<{shape} fill=\"{fill}\" stroke=\"{colour}\" stroke-width=\"1.2\"/>");
}
