//! Speed against accuracy: one point for each sampler, and the front of those that no other beats in both.

use super::{
    Axis, Layout, Summary, escape, marker, power_label, push, series_class, series_index, shorten, spread, text,
};
use crate::report::summary::Group;

/// A sampler's place; less is better on both axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// The name that is shown.
    pub name: String,
    /// Its colour, as [`series_class`] gives it.
    class: String,
    /// Which marker it has.
    index: usize,
    /// Time.
    pub time: f64,
    /// Error.
    pub error: f64,
}

impl Place {
    /// The place of a group: seconds and MSE.
    pub fn of(summary: &Summary, group: &Group) -> Self {
        Self {
            name: summary.name(&group.sampler).to_owned(),
            class: series_class(summary, &group.sampler),
            index: series_index(summary, &group.sampler),
            time: group.mean.seconds,
            error: group.mse.mean,
        }
    }

    /// A place of a sampler that is number `index` of those shown; the first one has the baseline's colour.
    pub fn new(name: String, index: usize, time: f64, error: f64) -> Self {
        let dashed = if index >= super::COLOURS { " dashed" } else { "" };
        Self { name, class: format!("series s{}{dashed}", index % super::COLOURS), index, time, error }
    }

    fn is_drawable(&self) -> bool {
        [self.time, self.error].iter().all(|value| value.is_finite() && *value > 0.0)
    }
}

/// The places that no other one beats in both time and error, from the fastest to the most accurate.
pub fn front(places: &[Place]) -> Vec<&Place> {
    let mut sorted: Vec<&Place> = places.iter().filter(|place| place.is_drawable()).collect();
    sorted.sort_by(|a, b| a.time.total_cmp(&b.time).then(a.error.total_cmp(&b.error)));
    let mut least = f64::INFINITY;
    sorted.retain(|place| {
        let better = place.error < least;
        least = least.min(place.error);
        better
    });
    sorted
}

/// The scatter in a wide and a narrow layout, both axes logarithmic; empty if there is nothing that could be drawn.
pub fn scatter(places: &[Place], time: &str, error: &str) -> String {
    let places: Vec<Place> = places.iter().filter(|place| place.is_drawable()).cloned().collect();
    if places.is_empty() {
        return String::new();
    }
    let wide = Layout { class: "wide", width: 700.0, height: 430.0, left: 62.0, right: 150.0, letters: 20 };
    let narrow = Layout { class: "narrow", width: 380.0, height: 400.0, left: 50.0, right: 132.0, letters: 14 };
    [wide, narrow].iter().map(|layout| draw(layout, &places, time, error)).collect()
}

fn draw(layout: &Layout, places: &[Place], time: &str, error: &str) -> String {
    let x = Axis::around(places.iter().map(|place| place.time), layout.left, layout.width - layout.right);
    let y = Axis::around(places.iter().map(|place| place.error), layout.height - Layout::BOTTOM, Layout::TOP);
    let mut svg = format!(
        "<svg class=\"chart pareto {}\" viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{} against {}, both logarithmic, \
         one point for each sampler\">",
        layout.class,
        layout.width,
        layout.height,
        escape(error),
        escape(time)
    );
    layout.draw_frame(&mut svg, &x, &y, time, error);
    // Steps: between two points of the front, only the faster one's accuracy is to be had.
    let mut path = String::new();
    for place in front(places) {
        let (px, py) = (x.at(place.time), y.at(place.error));
        if path.is_empty() {
            push(&mut path, format_args!("M{px:.1} {:.1}V{py:.1}", y.end));
        } else {
            push(&mut path, format_args!("H{px:.1}V{py:.1}"));
        }
    }
    push(&mut svg, format_args!("<path class=\"front\" d=\"{path}H{:.1}\"/>", x.end));
    labelled_points(&mut svg, layout, &x, &y, places);
    svg + "</svg>"
}

/// The points, and their names at the right edge in the order of the errors.
fn labelled_points(svg: &mut String, layout: &Layout, x: &Axis, y: &Axis, places: &[Place]) {
    let on_front: Vec<*const Place> = front(places).into_iter().map(std::ptr::from_ref).collect();
    let mut sorted: Vec<&Place> = places.iter().collect();
    sorted.sort_by(|a, b| b.error.total_cmp(&a.error));
    let heights: Vec<f64> = sorted.iter().map(|place| y.at(place.error)).collect();
    for (place, label) in sorted.into_iter().zip(spread(&heights, Layout::LINE_HEIGHT, y.end + 4.0, y.start)) {
        let (px, py, left) = (x.at(place.time), y.at(place.error), x.end + 14.0);
        let best = if on_front.contains(&std::ptr::from_ref(place)) { " on-front" } else { "" };
        let title = format!("{}: error {}, time {}", place.name, text(place.error), text(place.time));
        push(svg, format_args!("<g class=\"{}{best}\">", place.class));
        push(svg, format_args!("<path class=\"leader\" d=\"M{:.1} {py:.1}L{:.1} {label:.1}\"/>", px + 6.0, left - 3.0));
        push(svg, format_args!("<g>{}<title>{}</title></g>", marker(place.index, px, py), escape(&title)));
        push(svg, format_args!("<g>{}</g>", marker(place.index, left + 4.0, label)));
        let name = escape(&shorten(&place.name, layout.letters));
        push(
            svg,
            format_args!(
                "<text class=\"label\" x=\"{:.1}\" y=\"{label:.1}\" dy=\".35em\">{name}</text></g>",
                left + 13.0
            ),
        );
    }
}

impl Layout {
    /// Grid, frame and the axes' titles.
    pub(super) fn draw_frame(&self, svg: &mut String, x: &Axis, y: &Axis, time: &str, error: &str) {
        for (value, labelled) in y.ticks() {
            let (at, class) = (y.at(value), if labelled { "grid" } else { "grid minor" });
            push(svg, format_args!("<path class=\"{class}\" d=\"M{:.1} {at:.1}H{:.1}\"/>", x.start, x.end));
            if labelled {
                let (left, label) = (x.start - 7.0, power_label(value));
                push(
                    svg,
                    format_args!(
                        "<text class=\"tick\" x=\"{left:.1}\" y=\"{at:.1}\" dy=\".35em\" text-anchor=\"end\">{label}</text>"
                    ),
                );
            }
        }
        for (value, labelled) in x.ticks() {
            let (at, class) = (x.at(value), if labelled { "grid" } else { "grid minor" });
            push(svg, format_args!("<path class=\"{class}\" d=\"M{at:.1} {:.1}V{:.1}\"/>", y.start, y.end));
            if labelled {
                let (below, label) = (y.start + 18.0, power_label(value));
                push(
                    svg,
                    format_args!(
                        "<text class=\"tick\" x=\"{at:.1}\" y=\"{below:.1}\" text-anchor=\"middle\">{label}</text>"
                    ),
                );
            }
        }
        push(
            svg,
            format_args!("<path class=\"frame\" d=\"M{:.1} {:.1}V{:.1}H{:.1}\"/>", x.start, y.end, y.start, x.end),
        );
        let middle = 0.5 * (x.start + x.end);
        push(
            svg,
            format_args!(
                "<text class=\"axis\" x=\"{middle:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                self.height - 8.0,
                escape(time)
            ),
        );
        push(svg, format_args!("<text class=\"axis\" x=\"4.0\" y=\"14\">{}</text>", escape(error)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(name: &str, time: f64, error: f64) -> Place {
        Place::new(name.to_owned(), 0, time, error)
    }

    #[test]
    fn the_front_has_what_nothing_beats_in_both() {
        let places = [
            place("slow", 4.0, 0.5),
            place("mis", 1.0, 2.0),
            place("worse", 2.0, 2.5),
            place("head", 3.0, 0.4),
            place("nan", 0.5, f64::NAN),
        ];
        let names: Vec<&str> = front(&places).iter().map(|place| place.name.as_str()).collect();
        assert_eq!(names, ["mis", "head"]);
    }

    #[test]
    fn the_scatter_draws_every_point_and_one_front() {
        let places = [place("mis", 1.0, 2.0), place("a <b>", 2.0, 1.0), place("zero", 0.0, 1.0)];
        let svg = scatter(&places, "time", "error");
        assert_eq!(svg.matches("class=\"front\"").count(), 2, "one in each of two layouts");
        assert_eq!(svg.matches("on-front").count(), 4);
        assert!(svg.contains("a &lt;b&gt;") && !svg.contains("zero") && !svg.contains("NaN"));
        assert!(scatter(&places[2..], "time", "error").is_empty());
    }
}
