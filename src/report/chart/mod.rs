//! The charts of all pages as vector drawings.
//!
//! They are drawn here, without a plotting library, because colours and text follow the page's theme and
//! charts have two layouts: the text of a wide chart would be unreadable on a telephone.
//!
//! | file | concept |
//! | --- | --- |
//! | `bars.rs`, `lines.rs`, `pareto.rs` | ratios; MSE against time; speed against accuracy |
//! | `matrix.rs`, `curves.rs` | a table of ratios as colours; many curves |
//! | `settings.rs`, `spots.rs` | effects of settings; many points |
//! | `densities.rs` | pictures in false colour |
//! | `legend.rs` | the legend of a chart |

mod bars;
mod curves;
mod densities;
mod legend;
mod lines;
mod matrix;
pub mod pareto;
mod settings;
mod spots;

pub use bars::{comparisons, ratio_bars};
pub use curves::{Curve, curves};
pub use densities::{Panel, Scale, Sides, densities};
pub use lines::error_over_time;
pub use matrix::{Cell, Matrix, matrix};
pub use settings::{Bar, effects};
pub use spots::{Spot, spots};

use headtail_render::statistics::{MeanInterval, RatioInterval};
use legend::{Entry, Legend};

use super::kind::Look;
use super::number::{escape, text, times};
use super::summary::{BudgetKind, Group, Measure, Summary};
use super::vector::{Chart, Drawing};

/// A value with its 95 % interval, if known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// The value.
    pub value: f64,
    /// The lower and upper ends.
    pub ends: Option<(f64, f64)>,
}

impl Extent {
    /// A value without an interval.
    pub fn exact(value: f64) -> Self {
        Self { value, ends: None }
    }

    /// Returns whether this interval is entirely below another.
    fn is_below(&self, other: &Self) -> bool {
        self.ends.map_or(self.value, |ends| ends.1) < other.ends.map_or(other.value, |ends| ends.0)
    }
}

impl From<&MeanInterval> for Extent {
    fn from(interval: &MeanInterval) -> Self {
        let known = interval.half_width.is_finite() && interval.half_width > 0.0;
        Self { value: interval.mean, ends: known.then(|| (interval.low(), interval.high())) }
    }
}

impl From<&RatioInterval> for Extent {
    fn from(ratio: &RatioInterval) -> Self {
        Self { value: ratio.ratio, ends: ratio.ends().filter(|(low, high)| low < high) }
    }
}

/// A logarithmic axis that maps decades to pixels.
struct Axis {
    low: f64,
    high: f64,
    start: f64,
    end: f64,
}

impl Axis {
    /// An axis for positive values with a margin, at least 1/3 of a decade long.
    fn around(values: impl Iterator<Item = f64> + Clone, start: f64, end: f64) -> Self {
        let low = values.clone().fold(f64::INFINITY, f64::min).log10();
        let high = values.fold(f64::NEG_INFINITY, f64::max).log10();
        let margin = (0.06 * (high - low)).max((0.33 - (high - low)) / 2.0).max(0.04);
        Self { low: low - margin, high: high + margin, start, end }
    }

    /// An axis for values and their intervals. Intervals that reach zero or far beyond all values are clipped
    /// at the frame.
    fn of_intervals(values: impl Iterator<Item = Extent>, start: f64, end: f64) -> Self {
        let values: Vec<Extent> = values.collect();
        let known = || values.iter().map(|extent| extent.value);
        let (least, most) = (known().fold(f64::INFINITY, f64::min), known().fold(0.0, f64::max));
        let ends = values.iter().filter_map(|extent| extent.ends).flat_map(|(low, high)| [low, high]);
        let ends = ends.filter(move |&end| end > 0.3 * least && end < 3.0 * most);
        Self::around(known().chain(ends).collect::<Vec<_>>().into_iter(), start, end)
    }

    fn at(&self, value: f64) -> f64 {
        let t = (value.log10() - self.low) / (self.high - self.low);
        self.start + t.clamp(0.0, 1.0) * (self.end - self.start)
    }

    /// Returns the values of grid lines and whether they are labelled.
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

    /// Returns [`Self::ticks`] without overlapping labels, powers of ten first; `room` is the length of a
    /// label along the axis.
    fn spaced_ticks(&self, room: impl Fn(f64) -> f64) -> Vec<(f64, bool)> {
        let mut ticks = self.ticks();
        let mut order: Vec<usize> = (0..ticks.len()).filter(|&k| ticks[k].1).collect();
        order.sort_by_key(|&k| match leading(ticks[k].0).0 {
            1 => 0,
            5 => 1,
            2 => 2,
            _ => 3,
        });
        let mut placed: Vec<(f64, f64)> = Vec::new();
        for k in order {
            let (at, half) = (self.at(ticks[k].0), 0.5 * room(ticks[k].0));
            ticks[k].1 = placed.iter().all(|(other, own)| (at - other).abs() > half + own);
            if ticks[k].1 {
                placed.push((at, half));
            }
        }
        ticks
    }
}

/// Dimensions of a chart.
#[derive(Clone, Copy)]
struct Layout {
    class: &'static str,
    width: f64,
    /// Without the legend below.
    height: f64,
    left: f64,
    right: f64,
}

impl Layout {
    const TOP: f64 = 30.0;
    const BOTTOM: f64 = 46.0;
    /// Layouts for telephones and for wide windows.
    const BOTH: [Self; 2] = [
        Self { class: "narrow", width: 380.0, height: 380.0, left: 50.0, right: 12.0 },
        Self { class: "wide", width: 560.0, height: 400.0, left: 62.0, right: 16.0 },
    ];

    /// Returns the ends of the axes, from left to right and from bottom to top.
    fn ends(&self) -> [(f64, f64); 2] {
        [(self.left, self.width - self.right), (self.height - Self::BOTTOM, Self::TOP)]
    }

    /// Draws the grid, frame and axis titles.
    fn draw_frame(&self, drawing: &mut Drawing, x: &Axis, y: &Axis, [time, error]: [&str; 2]) {
        for (value, labelled) in y.spaced_ticks(|_| LINE) {
            let (at, class) = (y.at(value), if labelled { "grid" } else { "grid minor" });
            drawing.path(class, format_args!("M{:.1} {at:.1}H{:.1}", x.start, x.end));
            if labelled {
                tick(drawing, "end", (x.start - 7.0, at + 4.5), value);
            }
        }
        for (value, labelled) in x.spaced_ticks(label_width) {
            let (at, class) = (x.at(value), if labelled { "grid" } else { "grid minor" });
            drawing.path(class, format_args!("M{at:.1} {:.1}V{:.1}", y.start, y.end));
            if labelled {
                tick(drawing, "middle", (at, y.start + 18.0), value);
            }
        }
        drawing.path("frame", format_args!("M{:.1} {:.1}V{:.1}H{:.1}", x.start, y.end, y.start, x.end));
        drawing.text("axis", "middle", (0.5 * (x.start + x.end), self.height - 8.0), time);
        drawing.text("axis", "start", (4.0, 14.0), error);
    }
}

/// Draws a marker with the 95 % intervals of both values and a tooltip.
fn point(drawing: &mut Drawing, [x, y]: [&Axis; 2], look: Look, [time, error]: [Extent; 2], words: &str) {
    let (px, py) = (x.at(time.value), y.at(error.value));
    // A lower end at or below zero is drawn to the frame.
    let at = |axis: &Axis, end: f64| if end > 0.0 { axis.at(end) } else { axis.start };
    if let Some((low, high)) = error.ends {
        let (low, high, left) = (at(y, low), at(y, high), px - 3.0);
        drawing.path("ci-bar", format_args!("M{px:.1} {low:.1}V{high:.1}M{left:.1} {low:.1}h6M{left:.1} {high:.1}h6"));
    }
    if let Some((low, high)) = time.ends {
        let (low, high, top) = (at(x, low), at(x, high), py - 3.0);
        drawing.path("ci-bar", format_args!("M{low:.1} {py:.1}H{high:.1}M{low:.1} {top:.1}v6M{high:.1} {top:.1}v6"));
    }
    drawing.raw(format_args!("<g>{}<title>{}</title></g>", look.marker(px, py), escape(words)));
}

fn is_drawable(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

/// Draws a tick label: plain if short, else a power of ten in superscript.
fn tick(drawing: &mut Drawing, anchor: &str, (x, y): (f64, f64), value: f64) {
    let label = power_label(value);
    drawing.raw(format_args!("<text class=\"tick\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{label}</text>"));
}

/// Height of a line of labels in pixels.
const LINE: f64 = 15.0;

/// Estimates the width of a label in pixels, with some margin.
fn label_width(value: f64) -> f64 {
    const CHARACTER: f64 = 7.0;
    let (mut count, mut is_inside) = (1, true);
    for c in power_label(value).chars() {
        match c {
            '<' => is_inside = false,
            '>' => is_inside = true,
            _ => count += i32::from(is_inside),
        }
    }
    CHARACTER * f64::from(count)
}

/// Returns the leading digit and the power of ten of a value with one significant digit.
fn leading(value: f64) -> (i32, i32) {
    let exponent = (value.log10() + 1e-9).floor() as i32;
    ((value / 10_f64.powi(exponent)).round() as i32, exponent)
}

fn power_label(value: f64) -> String {
    let (digit, exponent) = leading(value);
    if (-3..=3).contains(&exponent) {
        let decimals = (-exponent).max(0) as usize;
        return format!("{value:.decimals$}");
    }
    let factor = if digit == 1 { String::new() } else { format!("{digit}\u{d7}") };
    let exponent = exponent.to_string().replace('-', "\u{2212}");
    format!("{factor}10<tspan dy=\"-5\" font-size=\"9.5\">{exponent}</tspan>")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_always_have_labelled_ticks() {
        for (low, high) in [(1e-3, 1.01e-3), (5.5e-4, 2e-3), (1e-3, 4e-3), (1.0, 30.0), (1e-7, 1e4), (3e-9, 2e12)] {
            let axis = Axis::around([low, high].into_iter(), 0.0, 480.0);
            let ticks = axis.spaced_ticks(label_width);
            let labelled: Vec<f64> = ticks.iter().filter(|tick| tick.1).map(|tick| tick.0).collect();
            assert!((1..=12).contains(&labelled.len()), "{labelled:?} from {low} to {high}");
            for pair in labelled.windows(2) {
                let apart = axis.at(pair[1]) - axis.at(pair[0]);
                assert!(apart > 0.5 * (label_width(pair[0]) + label_width(pair[1])), "{pair:?} from {low} to {high}");
            }
            assert!(axis.at(low) > 0.0 && axis.at(high) < 480.0);
        }
    }

    #[test]
    fn tick_labels_are_short() {
        assert_eq!(power_label(0.02), "0.02");
        assert_eq!(power_label(500.0), "500");
        assert_eq!(power_label(1e-4), "10<tspan dy=\"-5\" font-size=\"9.5\">\u{2212}4</tspan>");
        assert!(power_label(5e-4).starts_with("5\u{d7}10"));
        assert_eq!(power_label(1e-3), "0.001");
    }

    #[test]
    fn intervals_that_reach_zero_do_not_stretch_the_axis() {
        let extent = |value, ends| Extent { value, ends };
        let values = [extent(1.0, Some((-4.0, 6.0))), extent(2.0, Some((1.5, 2.5))), extent(1.5, None)];
        let axis = Axis::of_intervals(values.into_iter(), 0.0, 100.0);
        assert!(axis.at(2.5) < 100.0 && axis.at(10.0) == 100.0 && axis.at(0.3) == 0.0);
    }
}
