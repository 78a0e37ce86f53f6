//! Bars of each sampler's MSE ratio to the baseline.

use headtail_render::statistics::RatioInterval;

use super::{Axis, BudgetKind, Chart, Drawing, Layout, Measure, Summary, legend::wrap, tick, times};

/// Times that differ by a larger fraction are not equal, e.g. if whole passes overrun a budget of time.
const EQUAL_TIMES: f64 = 0.05;

/// Returns the two comparisons that the bars show: at equal samples, and at equal time.
///
/// If times are not equal, or without a budget of time (then at the largest budget of samples), MSE x time
/// replaces MSE. Its ratio equals that at equal time for independent samples, whose MSE is inverse to time;
/// for Sobol points, whose MSE falls faster, it underestimates the faster sampler.
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
pub fn ratio_bars(summary: &Summary) -> Chart {
    Chart { name: "ratios".into(), drawings: Layout::BOTH.iter().map(|layout| draw(layout, summary)).collect() }
}

/// Height of a line of a name.
const NAME: f64 = 17.0;
/// Height of a bar.
const BAR: f64 = 18.0;
/// Height of a comparison's title.
const TITLE: f64 = 30.0;

fn draw(layout: &Layout, summary: &Summary) -> Drawing {
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
    let reach: Vec<f64> = reach.chain([1.0]).collect();
    let axis = Axis::around(reach.into_iter(), 4.0, layout.width - 64.0);
    // Names are above their bars, so that none is cut.
    let names: Vec<(&String, Vec<String>)> =
        summary.samplers.iter().map(|name| (name, wrap(name, ((layout.width - 30.0) / 7.4) as usize))).collect();
    let rows: f64 = names.iter().map(|(_, lines)| NAME * lines.len() as f64 + BAR + 4.0).sum();
    let height = (TITLE + rows) * comparisons.len() as f64 + 40.0;
    let label = format!("Times that the error is lower than that of {}, logarithmic", summary.baseline_words());
    let mut drawing = Drawing::new(layout.class, (layout.width, height), label);
    let mut y = 0.0;
    for (title, budget, measure) in &comparisons {
        drawing.text("heading", "start", (4.0, y + 20.0), &format!("At {title}"));
        y += TITLE;
        for (sampler, lines) in &names {
            let look = summary.look(sampler);
            drawing.group(&look.class(), |drawing| {
                drawing.raw(format_args!("{}", look.marker(12.0, y + 0.5 * NAME)));
                for (k, line) in lines.iter().enumerate() {
                    drawing.text("label", "start", (24.0, y + NAME * k as f64 + 13.0), line);
                }
                y += NAME * lines.len() as f64;
                for (value, _) in axis.ticks() {
                    drawing.path("grid minor", format_args!("M{:.1} {y:.1}v{BAR:.1}", axis.at(value)));
                }
                drawing.path("one", format_args!("M{:.1} {y:.1}v{BAR:.1}", axis.at(1.0)));
                bar_of(drawing, &axis, y, ratio(sampler, budget, *measure), layout.width);
            });
            y += BAR + 4.0;
        }
    }
    for (value, labelled) in axis.ticks() {
        if labelled {
            tick(&mut drawing, "middle", (axis.at(value), y + 18.0), value);
        }
    }
    drawing
}

/// A bar with its interval and its ratio.
fn bar_of(drawing: &mut Drawing, axis: &Axis, y: f64, ratio: Option<RatioInterval>, width: f64) {
    let Some(ratio) = ratio else {
        drawing.text("label", "end", (width - 4.0, y + 13.0), "\u{2013}");
        return;
    };
    bar(drawing, [axis.at(1.0), axis.at(ratio.ratio)], y);
    if let Some((low, high)) = ratio.ends().filter(|(low, high)| low < high) {
        whisker(drawing, [axis.at(low), axis.at(high)], y);
    }
    drawing.text("label", "end", (width - 4.0, y + 13.0), &format!("{}\u{d7}", times(ratio.ratio)));
}

/// A bar between two x positions in a row that begins at `y`.
pub(super) fn bar(drawing: &mut Drawing, [from, to]: [f64; 2], y: f64) {
    let (left, length) = (from.min(to), (from - to).abs());
    drawing.raw(format_args!(
        "<rect class=\"bar\" x=\"{left:.1}\" y=\"{:.1}\" width=\"{length:.1}\" height=\"12\"/>",
        y + 3.0
    ));
}

/// Draws an interval over a bar.
pub(super) fn whisker(drawing: &mut Drawing, [low, high]: [f64; 2], y: f64) {
    let (middle, top) = (y + 9.0, y + 5.0);
    drawing.path("whisker", format_args!("M{low:.1} {middle:.1}H{high:.1}M{low:.1} {top:.1}v8M{high:.1} {top:.1}v8"));
}

#[cfg(test)]
mod tests {
    use headtail_eval::Measurement;

    use super::super::super::synthetic;
    use super::*;

    #[test]
    fn samplers_without_a_ratio_have_no_bar() {
        let rows = [("mis", 1.0), ("ris:4", f64::NAN), ("patches", 0.5)]
            .map(|(sampler, mse)| Measurement { mse, ..synthetic::row(sampler, "4spp", 0) });
        let svg = ratio_bars(&Summary::of(&rows).unwrap()).drawings[1].svg();
        // At equal samples, and by MSE x time at equal time.
        assert_eq!(svg.matches("class=\"bar\"").count(), 2 + 3);
        assert!(!svg.contains("NaN") && !svg.contains("inf") && svg.contains(">2.0\u{d7}<"), "{svg}");
    }
}
