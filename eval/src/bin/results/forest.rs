//! Forest plots: ratios of errors by material and map, one dot per scene.

use std::fmt::Write as _;

use anyhow::Result;
use headtail_eval::summary::{Interval, Ratios, ViewRuns};

use crate::{
    block::Block,
    tables::{CHART, Filled, Shown, digits},
};

const ROW: f64 = 17.0;
const LEFT: f64 = 250.0;
const WIDTH: f64 = 760.0;
const RIGHT: f64 = 130.0;
const TOP: f64 = 46.0;
/// Colours that are distinct under colour-vision deficiency (Okabe and Ito 2008).
const COLOURS: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];

struct Row {
    label: String,
    dots: Vec<(Interval, String, bool)>,
    mean: Option<Ratios>,
}

/// Returns the chart of a block and the line that embeds it.
///
/// # Errors
/// If a setting is missing.
pub fn forest(shown: &Shown<'_>, block: &Block) -> Result<Filled> {
    let (at, baselines, file) = (block.comparison()?, block.names("baselines"), block.need("file")?);
    let sets = block.sampler_sets();
    let samplers: Vec<String> = sets.iter().flat_map(|set| set.samplers.clone()).collect();
    let mut rows: Vec<Row> = Vec::new();
    for material in &shown.experiment.materials {
        for map in &shown.experiment.maps {
            let is_here = |view: &&ViewRuns| view.key.material == material.name && view.key.map == map.name;
            let views: Vec<&ViewRuns> = shown.views.iter().filter(is_here).collect();
            let dot = |view: &&ViewRuns| {
                let interval = view.interval(&samplers, &baselines, &at)?;
                Some((interval, view.key.scene.clone(), shown.experiment.is_tuned(&view.key)))
            };
            let dots: Vec<_> = views.iter().filter_map(dot).collect();
            if !dots.is_empty() {
                let mean = Ratios::of(&views, &samplers, &baselines, &at);
                rows.push(Row { label: format!("{}, {}", material.name, map.name), dots, mean });
            }
        }
    }
    let svg = draw(shown, &rows, &baselines);
    let label: Vec<&str> = sets.iter().map(|set| set.label.trim_matches('`')).collect();
    let alt = format!(
        "MSE of the best of {} over that of {}, by material and map; one dot for each scene",
        baselines.join(", "),
        label.join(", ")
    );
    Ok(Filled { markdown: format!("![{alt}.]({CHART})"), chart: Some((file.to_owned(), svg)) })
}

fn draw(shown: &Shown<'_>, rows: &[Row], baselines: &[String]) -> String {
    let ends = rows.iter().flat_map(|row| row.dots.iter().flat_map(|(interval, ..)| [interval.low, interval.high]));
    let (low, high) = ends.fold((0.5_f64, 4.0_f64), |(low, high), end| (low.min(end), high.max(end)));
    let (low, high) = (low.max(0.1).ln(), high.min(100.0).ln());
    let x = |ratio: f64| LEFT + (WIDTH - LEFT - RIGHT) * ((ratio.ln() - low) / (high - low)).clamp(0.0, 1.0);
    let mut scenes: Vec<&str> = Vec::new();
    for (_, scene, _) in rows.iter().flat_map(|row| &row.dots) {
        if !scenes.contains(&scene.as_str()) {
            scenes.push(scene);
        }
    }
    let names: Vec<&str> = shown.experiment.scenes.iter().map(|scene| scene.name.as_str()).collect();
    scenes.sort_by_key(|scene| names.iter().position(|name| name == scene));
    let legend = TOP + ROW * rows.len() as f64 + 34.0;
    let height = legend + 16.0 * scenes.len().div_ceil(4) as f64 + 10.0;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" font-family=\"sans-serif\" font-size=\"11\">\n\
         <rect width=\"{WIDTH}\" height=\"{height}\" fill=\"white\"/>\n"
    );
    let bottom = TOP + ROW * rows.len() as f64;
    let mut text = |at: (f64, f64), anchor: &str, words: &str| {
        let _ = writeln!(svg, "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\">{words}</text>", at.0, at.1);
    };
    text(
        (LEFT, 16.0),
        "start",
        &format!("MSE of the best of {} over ours; bars: 95 % intervals", baselines.join(", ")),
    );
    text((WIDTH - RIGHT + 8.0, 16.0), "start", "geometric mean");
    for tick in [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0] {
        if (low..=high).contains(&f64::ln(tick)) {
            text((x(tick), TOP - 10.0), "middle", &digits(tick).trim_end_matches(".00").replace(".0", ""));
        }
    }
    for (index, row) in rows.iter().enumerate() {
        let y = TOP + ROW * (index as f64 + 0.5);
        text((LEFT - 12.0, y + 4.0), "end", &row.label);
        if let Some(mean) = &row.mean {
            text((WIDTH - RIGHT + 8.0, y + 4.0), "start", &digits(mean.mean.value));
        }
    }
    for (index, scene) in scenes.iter().enumerate() {
        let (column, line) = ((index % 4) as f64, (index / 4) as f64);
        text((LEFT - 100.0 + 150.0 * column + 12.0, legend + 16.0 * line + 4.0), "start", scene);
    }
    for tick in [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0] {
        if (low..=high).contains(&f64::ln(tick)) {
            let (width, colour) = if tick == 1.0 { (1.5, "#222") } else { (0.5, "#bbb") };
            let _ = writeln!(
                svg,
                "<line x1=\"{0:.1}\" x2=\"{0:.1}\" y1=\"{TOP}\" y2=\"{bottom:.1}\" stroke=\"{colour}\" stroke-width=\"{width}\"/>",
                x(tick)
            );
        }
    }
    let place = |scene: &str| scenes.iter().position(|own| *own == scene).unwrap_or(0);
    let colour = |scene: &str| COLOURS[place(scene) % COLOURS.len()];
    let is_square = |scene: &str| place(scene) >= COLOURS.len();
    for (index, row) in rows.iter().enumerate() {
        let middle = TOP + ROW * (index as f64 + 0.5);
        let count = row.dots.len() as f64;
        for (number, (interval, scene, tuned)) in row.dots.iter().enumerate() {
            let y = middle + (number as f64 - 0.5 * (count - 1.0)) * (ROW - 5.0) / count.max(4.0);
            let colour = colour(scene);
            let _ = writeln!(
                svg,
                "<line x1=\"{:.1}\" x2=\"{:.1}\" y1=\"{y:.1}\" y2=\"{y:.1}\" stroke=\"{colour}\" stroke-width=\"1\"/>",
                x(interval.low),
                x(interval.high)
            );
            dot(&mut svg, (x(interval.value), y), (colour, is_square(scene)), *tuned);
        }
    }
    for (index, scene) in scenes.iter().enumerate() {
        let (column, line) = ((index % 4) as f64, (index / 4) as f64);
        dot(&mut svg, (LEFT - 100.0 + 150.0 * column, legend + 16.0 * line), (colour(scene), is_square(scene)), true);
    }
    svg + "</svg>\n"
}

/// Draws a dot, round or square; hollow if map or scene are untuned.
fn dot(svg: &mut String, (x, y): (f64, f64), (colour, is_square): (&str, bool), is_full: bool) {
    let fill = if is_full { colour } else { "white" };
    let shape = if is_square {
        format!("rect x=\"{:.1}\" y=\"{:.1}\" width=\"5.2\" height=\"5.2\"", x - 2.6, y - 2.6)
    } else {
        format!("circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.8\"")
    };
    let _ = writeln!(svg, "<{shape} fill=\"{fill}\" stroke=\"{colour}\" stroke-width=\"1.2\"/>");
}
