//! Bars for the effects of the values of settings.

use super::{
    Axis, Chart, Drawing, Extent, Layout,
    bars::{bar, whisker},
    legend::wrap,
    tick,
};
use crate::report::number::text;

/// The bar of a value.
#[derive(Clone, Debug, PartialEq)]
pub struct Bar {
    /// The value in words.
    pub name: String,
    /// Its effect.
    pub extent: Extent,
}

/// Height of a bar's row, of a line of its name, of a title, and of the axis below.
const ROW: f64 = 24.0;
const LINE: f64 = 15.0;
const TITLE: f64 = 32.0;
const BOTTOM: f64 = 30.0;
/// Width for the number at the right.
const NUMBER: f64 = 60.0;

/// Draws bars from 1 on a logarithmic axis in titled groups; lower is to the left. Empty without bars.
pub fn effects(name: &str, groups: &[(String, Vec<Bar>)], label: &str) -> Chart {
    let layouts = Layout::BOTH.iter().filter(|_| groups.iter().any(|(_, bars)| !bars.is_empty()));
    Chart { name: name.into(), drawings: layouts.map(|layout| draw_effects(layout, groups, label)).collect() }
}

fn draw_effects(layout: &Layout, groups: &[(String, Vec<Bar>)], label: &str) -> Drawing {
    let reach = groups.iter().flat_map(|(_, bars)| bars).flat_map(|bar| {
        let (low, high) = bar.extent.ends.unwrap_or((bar.extent.value, bar.extent.value));
        // Intervals far wider than all effects are clipped.
        [low.max(bar.extent.value / 2.0), high.min(bar.extent.value * 2.0)]
    });
    let reach: Vec<f64> = reach.filter(|value| *value > 0.0).chain([0.9, 1.1]).collect();
    let names = Names::new(layout, groups.iter().flat_map(|(_, bars)| bars));
    let axis = Axis::around(reach.into_iter(), names.width, layout.width - NUMBER);
    let rows: f64 = groups.iter().map(|(_, bars)| TITLE + bars.iter().map(|bar| names.height(bar)).sum::<f64>()).sum();
    let mut drawing = Drawing::new(layout.class, (layout.width, rows + BOTTOM), label);
    let mut y = 0.0;
    for (title, bars) in groups {
        drawing.text("heading", "start", (4.0, y + 21.0), title);
        y += TITLE;
        for own in bars {
            let height = names.height(own);
            for (value, _) in axis.ticks() {
                drawing.path("grid minor", format_args!("M{:.1} {y:.1}v{height:.1}", axis.at(value)));
            }
            drawing.path("one", format_args!("M{:.1} {y:.1}v{height:.1}", axis.at(1.0)));
            names.draw(&mut drawing, own, y);
            let class = if own.extent.value > 1.0 { "series s1 v0" } else { "series s2 v0" };
            drawing.group(class, |drawing| {
                let top = y + 0.5 * (height - 18.0);
                bar(drawing, [axis.at(1.0), axis.at(own.extent.value)], top);
                if let Some((low, high)) = own.extent.ends {
                    whisker(drawing, [axis.at(low.max(f64::MIN_POSITIVE)), axis.at(high)], top);
                }
            });
            drawing.text("label", "end", (layout.width - 4.0, y + 0.5 * height + 4.5), &text(own.extent.value));
            y += height;
        }
    }
    for (value, _) in axis.ticks().into_iter().filter(|(_, labelled)| *labelled) {
        tick(&mut drawing, "middle", (axis.at(value), y + 18.0), value);
    }
    drawing
}

/// Names to the left of bars, wrapped.
struct Names {
    width: f64,
    letters: usize,
}

impl Names {
    const LETTER: f64 = 7.4;

    fn new<'a>(layout: &Layout, bars: impl Iterator<Item = &'a Bar>) -> Self {
        let longest = bars.map(|bar| bar.name.chars().count()).max().unwrap_or(0) as f64 * Self::LETTER;
        let width = longest.min(0.42 * layout.width).max(60.0);
        Self { width: width + 14.0, letters: (width / Self::LETTER) as usize }
    }

    fn height(&self, bar: &Bar) -> f64 {
        ROW + LINE * (wrap(&bar.name, self.letters).len() - 1) as f64
    }

    fn draw(&self, drawing: &mut Drawing, bar: &Bar, y: f64) {
        for (k, line) in wrap(&bar.name, self.letters).iter().enumerate() {
            drawing.text("label", "end", (self.width - 8.0, y + 0.5 * ROW + 4.5 + LINE * k as f64), line.trim_end());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bar_of(name: &str, value: f64, ends: Option<(f64, f64)>) -> Bar {
        Bar { name: name.into(), extent: Extent { value, ends } }
    }

    #[test]
    fn every_value_has_a_bar_and_its_full_name() {
        let long = "a/very/long/name/of/a/map/that/needs/more/than/one/line.hdr";
        let groups = [
            ("bins".to_owned(), vec![bar_of("4", 0.8, Some((0.7, 0.9))), bar_of("8", 1.2, None)]),
            ("env".to_owned(), vec![bar_of(long, 1.0, Some((-0.5, 40.0)))]),
        ];
        let chart = effects("effects", &groups, "effects");
        assert_eq!(chart.drawings.len(), 2);
        let svg = chart.drawings[0].svg();
        assert_eq!((svg.matches("class=\"bar\"").count(), svg.matches("class=\"whisker\"").count()), (3, 2));
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        let shown: String =
            svg.split("text-anchor=\"end\">").skip(1).filter_map(|part| part.split('<').next()).collect();
        assert!(shown.contains(long), "{shown}");
        assert!(effects("effects", &[("bins".into(), Vec::new())], "").drawings.is_empty());
    }
}
