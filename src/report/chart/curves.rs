//! Many thin curves with one highlighted.

use super::{Axis, Chart, Drawing, Layout, is_drawable};
use crate::report::number::escape;

/// A curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Shown for the pointer.
    pub name: String,
    /// Coordinates from left to right.
    pub points: Vec<(f64, f64)>,
}

/// Draws curves on logarithmic axes, the first one highlighted. Empty if nothing can be drawn.
pub fn curves(name: &str, curves: &[Curve], titles: [&str; 2]) -> Chart {
    let drawable = |curve: &Curve| {
        let points = curve.points.iter().copied().filter(|(x, y)| is_drawable(*x) && is_drawable(*y));
        Curve { name: curve.name.clone(), points: points.collect() }
    };
    let curves: Vec<Curve> = curves.iter().map(drawable).filter(|curve| curve.points.len() > 1).collect();
    let layouts = Layout::BOTH.iter().filter(|_| !curves.is_empty());
    Chart { name: name.into(), drawings: layouts.map(|layout| draw(layout, &curves, titles)).collect() }
}

fn draw(layout: &Layout, curves: &[Curve], titles: [&str; 2]) -> Drawing {
    let points: Vec<(f64, f64)> = curves.iter().flat_map(|curve| curve.points.iter().copied()).collect();
    let [across, up] = layout.ends();
    let x = Axis::around(points.iter().map(|point| point.0), across.0, across.1);
    let y = Axis::around(points.iter().map(|point| point.1), up.0, up.1);
    let label = format!("{} against {}, both logarithmic, one line for each of {}", titles[1], titles[0], curves.len());
    let mut drawing = Drawing::new(layout.class, (layout.width, layout.height), label);
    layout.draw_frame(&mut drawing, &x, &y, titles);
    // The first curve is drawn last, on top.
    for (number, Curve { name, points }) in curves.iter().enumerate().rev() {
        let class = if number == 0 { "series s1 v0" } else { "series s2 v0 thin" };
        drawing.group(class, |drawing| {
            let path: Vec<String> =
                points.iter().map(|point| format!("{:.1} {:.1}", x.at(point.0), y.at(point.1))).collect();
            let words = escape(name);
            drawing.raw(format_args!("<path class=\"line\" d=\"M{}\"><title>{words}</title></path>", path.join("L")));
        });
    }
    drawing
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_curve_is_drawn_last_and_nonpositive_points_are_excluded() {
        let curve = |name: &str, points: &[(f64, f64)]| Curve { name: name.into(), points: points.to_vec() };
        let all = [
            curve("best", &[(0.0, 3.0), (1.0, 2.0), (10.0, 1.0)]),
            curve("<b>", &[(1.0, 3.0), (10.0, 2.0), (20.0, f64::NAN)]),
            curve("short", &[(0.0, 3.0), (1.0, 3.0)]),
        ];
        let svg = curves("curves", &all, ["steps", "error"]).drawings[1].svg();
        assert_eq!(svg.matches("class=\"line\"").count(), 2);
        assert!(svg.find("&lt;b&gt;").unwrap() < svg.find("best").unwrap() && !svg.contains("NaN"), "{svg}");
        assert!(curves("curves", &all[2..], ["steps", "error"]).drawings.is_empty());
    }
}
