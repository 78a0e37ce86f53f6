//! MSE against time: one line per sampler over its budgets.

use super::{Axis, Chart, Drawing, Entry, Extent, Group, Layout, Legend, Look, Summary, is_drawable, point, text};

/// Draws MSE against time on logarithmic axes. Empty if nothing can be drawn.
pub fn error_over_time(summary: &Summary) -> Chart {
    let lines = lines(summary);
    let layouts = Layout::BOTH.iter().filter(|_| !lines.is_empty());
    Chart { name: "error-time".into(), drawings: layouts.map(|layout| draw(layout, &lines)).collect() }
}

/// A sampler's points in ascending order of time.
struct Line<'a> {
    sampler: &'a str,
    look: Look,
    points: Vec<&'a Group>,
}

/// Returns the lines without points that are zero, infinite or NaN.
fn lines(summary: &Summary) -> Vec<Line<'_>> {
    summary
        .samplers
        .iter()
        .filter_map(|sampler| {
            let mut points: Vec<&Group> = summary
                .groups
                .iter()
                .filter(|group| group.sampler == *sampler)
                .filter(|group| is_drawable(group.mse.mean) && is_drawable(group.seconds.mean))
                .collect();
            points.sort_by(|a, b| a.mean.seconds.total_cmp(&b.mean.seconds));
            (!points.is_empty()).then_some(Line { sampler, look: summary.look(sampler), points })
        })
        .collect()
}

fn draw(layout: &Layout, lines: &[Line]) -> Drawing {
    let groups = || lines.iter().flat_map(|line| line.points.iter().copied());
    let [across, up] = layout.ends();
    let x = Axis::of_intervals(groups().map(|group| Extent::from(&group.seconds)), across.0, across.1);
    let y = Axis::of_intervals(groups().map(|group| Extent::from(&group.mse)), up.0, up.1);
    let entries: Vec<Entry> =
        lines.iter().map(|line| Entry { look: line.look, name: line.sampler, on_front: false }).collect();
    let legend = Legend::new(&entries, (layout.left, layout.width - layout.left - layout.right));
    let label = "Mean squared error against rendering time, both logarithmic, one line for each sampler";
    let mut drawing = Drawing::new(layout.class, (layout.width, layout.height + legend.height), label);
    layout.draw_frame(&mut drawing, &x, &y, ["rendering time in seconds", "mean squared error"]);
    guides(&mut drawing, &x, &y, lines);
    for line in lines {
        drawing.group(&line.look.class(), |drawing| {
            let path: Vec<String> = line
                .points
                .iter()
                .map(|group| format!("{:.1} {:.1}", x.at(group.seconds.mean), y.at(group.mse.mean)))
                .collect();
            drawing.path("line", format_args!("M{}", path.join("L")));
            for group in &line.points {
                let (error, time) = (text(group.mse.mean), text(group.seconds.mean));
                let words = format!("{}, {}: MSE {error} in {time} s", group.sampler, group.budget);
                point(drawing, [&x, &y], line.look, [(&group.seconds).into(), (&group.mse).into()], &words);
            }
        });
    }
    legend.draw(&mut drawing, layout.height);
    drawing
}

/// Lines of slope -1, one per decade, along which MSE x time is constant as for Monte Carlo.
fn guides(drawing: &mut Drawing, x: &Axis, y: &Axis, lines: &[Line]) {
    let at = |seconds: f64, product: f64| (x.at(10_f64.powf(seconds)), y.at(10_f64.powf(product - seconds)));
    // The part of a line inside the frame, in decades of time.
    let inside = |product: f64| (x.low.max(product - y.high), x.high.min(product - y.low));
    let ends = |product: f64| {
        let (from, to) = inside(product);
        (at(from, product), at(to, product))
    };
    let products: Vec<f64> =
        ((x.low + y.low).ceil() as i32..=(x.high + y.high).floor() as i32).map(f64::from).collect();
    for &product in &products {
        let ((x1, y1), (x2, y2)) = ends(product);
        drawing.path("guide", format_args!("M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}"));
    }
    // The label is placed on a line beside the data that is long enough for it, preferably above.
    let long = |product: &f64| inside(*product).1 - inside(*product).0 > 0.3 * (x.high - x.low);
    let data = || lines.iter().flat_map(|line| &line.points).map(|group| (group.mse.mean * group.seconds.mean).log10());
    let (least, largest) = (data().fold(f64::INFINITY, f64::min), data().fold(f64::NEG_INFINITY, f64::max));
    let above = products.iter().find(|&product| *product > largest + 0.1 && long(product));
    let below = products.iter().rfind(|&product| *product < least - 0.1 && long(product));
    if let Some(&product) = above.or(below) {
        let ((x1, y1), (x2, y2)) = ends(product);
        let (cx, cy, angle) = (0.5 * (x1 + x2), 0.5 * (y1 + y2), (y2 - y1).atan2(x2 - x1).to_degrees());
        drawing.raw(format_args!(
            "<text class=\"guide-label\" text-anchor=\"middle\" transform=\"translate({cx:.1} {cy:.1}) rotate({angle:.1})\" \
             dy=\"-5\">slope \u{2212}1</text>"
        ));
    }
}

#[cfg(test)]
mod tests {
    use headtail_eval::Measurement;

    use super::super::super::synthetic;
    use super::*;

    #[test]
    fn nonpositive_points_are_excluded() {
        let rows = [("mis", 0.0), ("ris:4", f64::NAN), ("a", 1.0)]
            .map(|(sampler, mse)| Measurement { mse, ..synthetic::row(sampler, "4spp", 0) });
        let chart = error_over_time(&Summary::of(&rows).unwrap());
        assert_eq!(chart.drawings.len(), 2, "two layouts");
        for drawing in &chart.drawings {
            let svg = drawing.svg();
            assert_eq!(svg.matches("class=\"line\"").count(), 1);
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        }
        assert!(error_over_time(&Summary::of(&rows[..2]).unwrap()).drawings.is_empty());
    }

    #[test]
    fn intervals_of_error_and_time_are_both_drawn() {
        let run = |run: u32, mse: f64, seconds: f64| Measurement { mse, seconds, ..synthetic::row("mis", "4spp", run) };
        let count = |rows: &[Measurement]| {
            error_over_time(&Summary::of(rows).unwrap()).drawings[0].svg().matches("class=\"ci-bar\"").count()
        };
        assert_eq!(count(&[run(0, 1.0, 1.0), run(1, 1.1, 1.2)]), 2);
        assert_eq!(count(&[run(0, 1.0, 1.0)]), 0, "one run says nothing about its spread");
    }
}
