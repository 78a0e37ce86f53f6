//! The charts: MSE against time, and how many times lower than the baseline each sampler's MSE is.
//!
//! The SVG is written here, not by a plotting library: colours and text must follow the page's light or dark theme (they
//! are CSS variables and `currentColor`), lines are labelled where they end, and each chart comes in two layouts, since
//! shrinking a wide one to a telephone's width would leave its text unreadable.

pub mod pareto;

use std::fmt::Write;

use headtail_render::statistics::RatioInterval;

use super::number::{escape, text, times};
use super::summary::{BudgetKind, Group, Measure, Summary};

/// Colours of the palette (`--s0` to `--s7` in the style sheet); samplers beyond them have dashed lines and hollow markers.
const COLOURS: usize = 8;

/// The CSS class that gives a sampler its colour: ink for the baseline, then the palette in order.
pub fn series_class(summary: &Summary, sampler: &str) -> String {
    let index = series_index(summary, sampler);
    let dashed = if index >= COLOURS { " dashed" } else { "" };
    format!("series s{}{dashed}", index % COLOURS)
}

fn series_index(summary: &Summary, sampler: &str) -> usize {
    if sampler == summary.baseline {
        return 0;
    }
    1 + summary.samplers.iter().filter(|name| **name != summary.baseline).position(|name| name == sampler).unwrap_or(0)
}

/// An SVG picture of a sampler's marker, for use beside its name.
pub fn swatch(summary: &Summary, sampler: &str) -> String {
    let marker = marker(series_index(summary, sampler), 7.0, 7.0);
    let class = series_class(summary, sampler);
    format!("<svg class=\"swatch {class}\" viewBox=\"0 0 14 14\" aria-hidden=\"true\">{marker}</svg>")
}

/// MSE against time, both logarithmic: a wide and a narrow layout, of which the style sheet shows one. Empty if there is
/// nothing that could be drawn.
pub fn error_over_time(summary: &Summary) -> String {
    let lines = lines(summary);
    if lines.is_empty() {
        return String::new();
    }
    let wide = Layout { class: "wide", width: 700.0, height: 460.0, left: 62.0, right: 150.0, letters: 20 };
    let narrow = Layout { class: "narrow", width: 380.0, height: 400.0, left: 50.0, right: 132.0, letters: 14 };
    [wide, narrow].iter().map(|layout| layout.draw(summary, &lines)).collect()
}

/// A sampler's points from little to much time.
struct Line<'a> {
    sampler: &'a str,
    points: Vec<&'a Group>,
}

/// The lines that can be drawn on logarithmic axes, i.e. without what is zero, infinite or not a number.
fn lines(summary: &Summary) -> Vec<Line<'_>> {
    let drawable = |value: f64| value.is_finite() && value > 0.0;
    summary
        .samplers
        .iter()
        .filter_map(|sampler| {
            let mut points: Vec<&Group> = summary
                .groups
                .iter()
                .filter(|group| group.sampler == *sampler)
                .filter(|group| drawable(group.mse.mean) && drawable(group.mean.seconds))
                .collect();
            points.sort_by(|a, b| a.mean.seconds.total_cmp(&b.mean.seconds));
            (!points.is_empty()).then_some(Line { sampler, points })
        })
        .collect()
}

/// A logarithmic axis: decades onto pixels.
struct Axis {
    low: f64,
    high: f64,
    start: f64,
    end: f64,
}

impl Axis {
    /// The axis of positive values with a margin, at least a third of a decade long.
    fn around(values: impl Iterator<Item = f64> + Clone, start: f64, end: f64) -> Self {
        let low = values.clone().fold(f64::INFINITY, f64::min).log10();
        let high = values.fold(f64::NEG_INFINITY, f64::max).log10();
        let margin = (0.06 * (high - low)).max((0.33 - (high - low)) / 2.0).max(0.04);
        Self { low: low - margin, high: high + margin, start, end }
    }

    fn at(&self, value: f64) -> f64 {
        let t = (value.log10() - self.low) / (self.high - self.low);
        self.start + t.clamp(0.0, 1.0) * (self.end - self.start)
    }

    /// Values of the grid lines, and whether they are labelled.
    fn ticks(&self) -> Vec<(f64, bool)> {
        let span = self.high - self.low;
        let labelled: &[u32] = match span {
            s if s < 0.7 => &[1, 2, 3, 4, 5, 6, 7, 8, 9],
            s if s < 1.7 => &[1, 2, 5],
            _ => &[1],
        };
        let every = (span / 7.0).ceil().max(1.0) as i32;
        let mut ticks = Vec::new();
        for decade in self.low.floor() as i32..=self.high.ceil() as i32 {
            for digit in 1..=9 {
                let value = f64::from(digit) * 10_f64.powi(decade);
                if (self.low..=self.high).contains(&value.log10()) {
                    ticks.push((value, labelled.contains(&digit) && decade % every == 0));
                }
            }
        }
        ticks
    }
}

/// Where the parts of a chart are.
struct Layout {
    class: &'static str,
    width: f64,
    height: f64,
    left: f64,
    right: f64,
    /// The longest label in letters.
    letters: usize,
}

impl Layout {
    const TOP: f64 = 30.0;
    const BOTTOM: f64 = 46.0;
    /// The least distance of labels.
    const LINE_HEIGHT: f64 = 17.0;

    fn draw(&self, summary: &Summary, lines: &[Line]) -> String {
        let groups = || lines.iter().flat_map(|line| &line.points);
        let seconds = groups().map(|group| group.mean.seconds);
        let ends = groups().flat_map(|group| [group.mse.mean, group.mse.low(), group.mse.high()]);
        let largest = groups().map(|group| group.mse.mean).fold(0.0, f64::max);
        let least = groups().map(|group| group.mse.mean).fold(f64::INFINITY, f64::min);
        // An interval that reaches zero (or, of a single run, everywhere) is cut at the frame instead of stretching it.
        let ends = ends.filter(|&end| end.is_finite() && end > 0.3 * least && end < 3.0 * largest);
        let x = Axis::around(seconds, self.left, self.width - self.right);
        let y = Axis::around(ends, self.height - Self::BOTTOM, Self::TOP);
        let mut svg = format!(
            "<svg class=\"chart {}\" viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"Mean squared error against rendering \
             time, both logarithmic, one line for each sampler\">",
            self.class, self.width, self.height
        );
        self.draw_frame(&mut svg, &x, &y, "rendering time in seconds", "mean squared error");
        self.draw_guides(&mut svg, &x, &y, lines);
        for line in lines {
            self.draw_line(&mut svg, &x, &y, summary, line);
        }
        self.draw_labels(&mut svg, &x, &y, summary, lines);
        svg + "</svg>"
    }

    /// Lines of slope -1, along which MSE x time stays the same, as it does for Monte Carlo; one for each power of ten.
    fn draw_guides(&self, svg: &mut String, x: &Axis, y: &Axis, lines: &[Line]) {
        let point = |seconds: f64, product: f64| (x.at(10_f64.powf(seconds)), y.at(10_f64.powf(product - seconds)));
        // The part of a line inside the frame, in decades of time.
        let inside = |product: f64| (x.low.max(product - y.high), x.high.min(product - y.low));
        let products: Vec<f64> =
            ((x.low + y.low).ceil() as i32..=(x.high + y.high).floor() as i32).map(f64::from).collect();
        for &product in &products {
            let (from, to) = inside(product);
            let ((x1, y1), (x2, y2)) = (point(from, product), point(to, product));
            push(svg, format_args!("<path class=\"guide\" d=\"M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}\"/>"));
        }
        // The label goes to a line beside the data that is long enough for it: above them if there is one, else below.
        let long = |product: &f64| inside(*product).1 - inside(*product).0 > 0.3 * (x.high - x.low);
        let data =
            || lines.iter().flat_map(|line| &line.points).map(|group| (group.mse.mean * group.mean.seconds).log10());
        let (least, largest) = (data().fold(f64::INFINITY, f64::min), data().fold(f64::NEG_INFINITY, f64::max));
        let above = products.iter().find(|&product| *product > largest + 0.1 && long(product));
        let below = products.iter().rfind(|&product| *product < least - 0.1 && long(product));
        if let Some(&product) = above.or(below) {
            let (from, to) = inside(product);
            let ((x1, y1), (x2, y2)) = (point(from, product), point(to, product));
            let angle = (y2 - y1).atan2(x2 - x1).to_degrees();
            let (cx, cy) = (0.5 * (x1 + x2), 0.5 * (y1 + y2));
            push(
                svg,
                format_args!(
                    "<text class=\"guide-label\" text-anchor=\"middle\" transform=\"translate({cx:.1} {cy:.1}) \
                     rotate({angle:.1})\" dy=\"-5\">slope \u{2212}1</text>"
                ),
            );
        }
    }

    fn draw_line(&self, svg: &mut String, x: &Axis, y: &Axis, summary: &Summary, line: &Line) {
        push(svg, format_args!("<g class=\"{}\">", series_class(summary, line.sampler)));
        let mut path = String::new();
        for group in &line.points {
            let command = if path.is_empty() { 'M' } else { 'L' };
            push(&mut path, format_args!("{command}{:.1} {:.1}", x.at(group.mean.seconds), y.at(group.mse.mean)));
        }
        push(svg, format_args!("<path class=\"line\" d=\"{path}\"/>"));
        for group in &line.points {
            let (cx, cy) = (x.at(group.mean.seconds), y.at(group.mse.mean));
            if group.mse.half_width.is_finite() {
                // A lower end at or below zero has no place on the axis: the bar runs to the frame.
                let low = if group.mse.low() > 0.0 { y.at(group.mse.low()) } else { y.start };
                let high = y.at(group.mse.high());
                push(
                    svg,
                    format_args!(
                        "<path class=\"ci-bar\" d=\"M{cx:.1} {low:.1}V{high:.1}M{:.1} {low:.1}h6M{:.1} {high:.1}h6\"/>",
                        cx - 3.0,
                        cx - 3.0
                    ),
                );
            }
            let title = format!(
                "{}, {}: MSE {} in {} s",
                summary.name(&group.sampler),
                group.budget,
                text(group.mse.mean),
                text(group.mean.seconds)
            );
            let marker = marker(series_index(summary, line.sampler), cx, cy);
            push(svg, format_args!("<g>{marker}<title>{}</title></g>", escape(&title)));
        }
        svg.push_str("</g>");
    }

    /// Names at the right edge, in the order of the lines' ends and no closer than they can be read.
    fn draw_labels(&self, svg: &mut String, x: &Axis, y: &Axis, summary: &Summary, lines: &[Line]) {
        let mut labels: Vec<(&Line, f64, f64)> = lines
            .iter()
            .filter_map(|line| line.points.last().map(|last| (line, x.at(last.mean.seconds), y.at(last.mse.mean))))
            .collect();
        labels.sort_by(|a, b| a.2.total_cmp(&b.2));
        let places =
            spread(&labels.iter().map(|label| label.2).collect::<Vec<_>>(), Self::LINE_HEIGHT, y.end + 4.0, y.start);
        for ((line, end_x, end_y), place) in labels.into_iter().zip(places) {
            let left = x.end + 14.0;
            let name = shorten(summary.name(line.sampler), self.letters);
            push(svg, format_args!("<g class=\"{}\">", series_class(summary, line.sampler)));
            push(
                svg,
                format_args!(
                    "<path class=\"leader\" d=\"M{:.1} {end_y:.1}L{:.1} {place:.1}\"/>",
                    end_x + 6.0,
                    left - 3.0
                ),
            );
            push(svg, format_args!("<g>{}</g>", marker(series_index(summary, line.sampler), left + 4.0, place)));
            push(
                svg,
                format_args!(
                    "<text class=\"label\" x=\"{:.1}\" y=\"{place:.1}\" dy=\".35em\">{}</text></g>",
                    left + 13.0,
                    escape(&name)
                ),
            );
        }
    }
}

/// Moves sorted places apart to a least distance, staying between two ends if they fit.
fn spread(places: &[f64], distance: f64, first: f64, last: f64) -> Vec<f64> {
    let mut spread = places.to_vec();
    for i in 1..spread.len() {
        spread[i] = spread[i].max(spread[i - 1] + distance);
    }
    let mut limit = last;
    for place in spread.iter_mut().rev() {
        *place = place.min(limit);
        limit = *place - distance;
    }
    let mut limit = first;
    for place in &mut spread {
        *place = place.max(limit);
        limit = *place + distance;
    }
    spread
}

fn shorten(name: &str, letters: usize) -> String {
    if name.chars().count() <= letters {
        name.to_owned()
    } else {
        name.chars().take(letters - 1).chain(['\u{2026}']).collect()
    }
}

/// The outline of a sampler's marker: its shape tells it apart where colour cannot.
fn marker(index: usize, x: f64, y: f64) -> String {
    let polygon = |points: &[(f64, f64)]| {
        let points: Vec<String> = points.iter().map(|(dx, dy)| format!("{:.1} {:.1}", x + dx, y + dy)).collect();
        format!("<path class=\"marker\" d=\"M{}Z\"/>", points.join("L"))
    };
    match index % 8 {
        0 => format!("<circle class=\"marker\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4.4\"/>"),
        1 => polygon(&[(-4.0, -4.0), (4.0, -4.0), (4.0, 4.0), (-4.0, 4.0)]),
        2 => polygon(&[(0.0, -5.2), (5.0, 3.8), (-5.0, 3.8)]),
        3 => polygon(&[(0.0, -5.8), (5.0, 0.0), (0.0, 5.8), (-5.0, 0.0)]),
        4 => polygon(&[(0.0, 5.2), (5.0, -3.8), (-5.0, -3.8)]),
        5 => polygon(&[
            (-2.0, -5.0),
            (2.0, -5.0),
            (2.0, -2.0),
            (5.0, -2.0),
            (5.0, 2.0),
            (2.0, 2.0),
            (2.0, 5.0),
            (-2.0, 5.0),
            (-2.0, 2.0),
            (-5.0, 2.0),
            (-5.0, -2.0),
            (-2.0, -2.0),
        ]),
        6 => polygon(&[(0.0, -5.4), (5.1, -1.7), (3.2, 4.4), (-3.2, 4.4), (-5.1, -1.7)]),
        _ => polygon(&[(-5.0, -5.0), (5.0, -5.0), (0.0, 0.0), (5.0, 5.0), (-5.0, 5.0), (0.0, 0.0)]),
    }
}

/// A tick label: plain where it is short, else a power of ten in superscript.
fn power_label(value: f64) -> String {
    let exponent = (value.log10() + 1e-9).floor() as i32;
    let digit = (value / 10_f64.powi(exponent)).round();
    if (-3..=3).contains(&exponent) {
        let decimals = (-exponent).max(0) as usize;
        return format!("{value:.decimals$}");
    }
    let factor = if digit == 1.0 { String::new() } else { format!("{digit}\u{d7}") };
    let exponent = exponent.to_string().replace('-', "\u{2212}");
    format!("{factor}10<tspan dy=\"-.45em\" font-size=\"75%\">{exponent}</tspan>")
}

/// Times that differ by a larger part are not equal: a budget of time that was overrun, e.g. by whole passes.
const EQUAL_TIMES: f64 = 0.05;

/// The two comparisons that the bars show: at equal samples, and at equal time.
///
/// Where times are not equal, the ratio of MSE x time stands in for that of MSE. With independent samples, whose MSE falls inversely with time, it is
/// what the ratio at equal time would be; with Sobol points, whose MSE falls faster, it gives too little to the quicker sampler. So it does
/// without a budget of time, at the largest budget of samples.
pub fn comparisons(summary: &Summary) -> Vec<(String, String, Measure)> {
    let mut comparisons = Vec::new();
    let samples = summary.largest(BudgetKind::Samples);
    if let Some(budget) = samples {
        comparisons.push((format!("equal samples ({})", budget.words()), budget.name.clone(), Measure::Mse));
    }
    if let Some(budget) = summary.largest(BudgetKind::Time).or(samples) {
        let seconds = || summary.at(&budget.name).map(|group| group.mean.seconds);
        let (least, most) = (seconds().fold(f64::INFINITY, f64::min), seconds().fold(0.0, f64::max));
        let equal = budget.kind == BudgetKind::Time && most <= (1.0 + EQUAL_TIMES) * least;
        comparisons.push(if equal {
            (format!("equal time ({})", budget.words()), budget.name.clone(), Measure::Mse)
        } else {
            (format!("equal time (MSE \u{d7} time at {})", budget.name), budget.name.clone(), Measure::Ttuv)
        });
    }
    if comparisons.is_empty() {
        let budget = summary.shown_first();
        comparisons.push((budget.words(), budget.name.clone(), Measure::Mse));
    }
    comparisons
}

/// Bars on a logarithmic axis: to the right of 1, a sampler's MSE is lower than the baseline's.
pub fn ratio_bars(summary: &Summary) -> String {
    let comparisons = comparisons(summary);
    let ratio = |sampler: &str, budget: &str, measure| {
        summary.group(sampler, budget).and_then(|group| summary.ratio(group, measure))
    };
    let ratios = summary.samplers.iter().flat_map(|sampler| {
        comparisons.iter().filter_map(move |(_, budget, measure)| ratio(sampler, budget, *measure))
    });
    let reach = ratios.flat_map(|ratio| {
        let (low, high) = ratio.ends().unwrap_or((ratio.ratio, ratio.ratio));
        [low.max(ratio.ratio / 3.0), high.min(ratio.ratio * 3.0)]
    });
    let axis = Axis::around(reach.chain([1.0]).collect::<Vec<_>>().into_iter(), 0.0, 100.0);
    let mut html = String::from("<div class=\"bars\">");
    for (title, budget, measure) in &comparisons {
        push(&mut html, format_args!("<p class=\"bars-title\">At {}</p>", escape(title)));
        for sampler in &summary.samplers {
            bar(&mut html, summary, &axis, sampler, ratio(sampler, budget, *measure));
        }
    }
    html.push_str("<div class=\"bar-row bar-axis\"><span></span><span class=\"bar-track\">");
    for (value, labelled) in axis.ticks() {
        if labelled {
            push(&mut html, format_args!("<span style=\"left:{:.2}%\">{}</span>", axis.at(value), text_tick(value)));
        }
    }
    html.push_str("</span><span></span></div></div>");
    html
}

fn bar(html: &mut String, summary: &Summary, axis: &Axis, sampler: &str, ratio: Option<RatioInterval>) {
    let class = series_class(summary, sampler);
    push(
        html,
        format_args!(
            "<div class=\"bar-row {class}\"><span class=\"bar-name\">{}</span>",
            escape(summary.name(sampler))
        ),
    );
    push(
        html,
        format_args!("<span class=\"bar-track\"><span class=\"bar-one\" style=\"left:{:.2}%\"></span>", axis.at(1.0)),
    );
    let Some(ratio) = ratio else {
        html.push_str("</span><span class=\"bar-value\">\u{2013}</span></div>");
        return;
    };
    let span = |a: f64, b: f64| {
        let (a, b) = (axis.at(a), axis.at(b));
        format!("left:{:.2}%;width:{:.2}%", a.min(b), (a - b).abs())
    };
    push(html, format_args!("<span class=\"bar\" style=\"{}\"></span>", span(1.0, ratio.ratio)));
    if let Some((low, high)) = ratio.ends().filter(|(low, high)| low < high) {
        push(html, format_args!("<span class=\"bar-ci\" style=\"{}\"></span>", span(low, high)));
    }
    push(html, format_args!("</span><span class=\"bar-value\">{}\u{d7}</span></div>", times(ratio.ratio)));
}

fn text_tick(value: f64) -> String {
    if value >= 1.0 { format!("{value:.0}") } else { format!("{value}") }
}

fn push(text: &mut String, arguments: std::fmt::Arguments) {
    text.write_fmt(arguments).expect("a String takes all that is written to it");
}

#[cfg(test)]
mod tests {
    use super::super::Row;
    use super::super::synthetic;
    use super::*;

    #[test]
    fn labels_never_overlap_and_stay_inside() {
        let places = spread(&[10.0, 11.0, 12.0, 95.0, 99.0], 15.0, 5.0, 100.0);
        assert!(places.windows(2).all(|pair| pair[1] - pair[0] >= 15.0 - 1e-9), "{places:?}");
        assert!(places[0] >= 5.0 && places[4] <= 100.0, "{places:?}");
        assert_eq!(spread(&[20.0, 60.0], 15.0, 0.0, 100.0), [20.0, 60.0]);
    }

    #[test]
    fn axes_always_have_labelled_ticks() {
        for (low, high) in [(1e-3, 1.01e-3), (1e-3, 4e-3), (1.0, 30.0), (1e-7, 1e4), (3e-9, 2e12)] {
            let axis = Axis::around([low, high].into_iter(), 0.0, 100.0);
            let labelled = axis.ticks().iter().filter(|tick| tick.1).count();
            assert!((1..=12).contains(&labelled), "{labelled} labels from {low} to {high}");
            assert!(axis.at(low) > 0.0 && axis.at(high) < 100.0);
        }
    }

    #[test]
    fn tick_labels_are_short() {
        assert_eq!(power_label(0.02), "0.02");
        assert_eq!(power_label(500.0), "500");
        assert_eq!(power_label(1e-4), "10<tspan dy=\"-.45em\" font-size=\"75%\">\u{2212}4</tspan>");
        assert!(power_label(5e-4).starts_with("5\u{d7}10"));
        assert_eq!(power_label(1e-3), "0.001");
    }

    #[test]
    fn points_that_have_no_logarithm_are_left_out() {
        let rows = [("mis", 0.0), ("ris", f64::NAN), ("a", 1.0)]
            .map(|(sampler, mse)| Row { mse, ..synthetic::row(sampler, "4spp", 0) });
        let summary = Summary::of(&rows).unwrap();
        let svg = error_over_time(&summary);
        assert_eq!(svg.matches("class=\"line\"").count(), 2, "one line in each of two layouts");
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        assert!(error_over_time(&Summary::of(&rows[..2]).unwrap()).is_empty());
        let bars = ratio_bars(&summary);
        assert!(!bars.contains("NaN") && !bars.contains("inf"), "{bars}");
    }

    #[test]
    fn every_sampler_has_its_own_marker_and_colour() {
        let comparison = synthetic::comparison();
        let summary = Summary::of(&comparison.rows).unwrap();
        let mut classes: Vec<String> = summary.samplers.iter().map(|name| series_class(&summary, name)).collect();
        assert_eq!(series_class(&summary, "mis"), "series s0");
        classes.sort();
        classes.dedup();
        assert_eq!(classes.len(), summary.samplers.len());
    }
}
