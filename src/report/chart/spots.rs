//! Many points of two measures with their Pareto front; a script shows their names.

use super::{
    Axis, Chart, Drawing, Extent, Layout, is_drawable,
    pareto::{MeasuredSampler, steps},
};
use crate::report::kind::Look;

/// A point.
#[derive(Clone, Debug, PartialEq)]
pub struct Spot {
    /// The index that the script uses.
    pub index: usize,
    /// Horizontal and vertical values; lower is better for both.
    pub at: [f64; 2],
    /// Whether it is filled.
    pub is_marked: bool,
}

/// Draws the points on logarithmic axes. Empty if nothing can be drawn.
pub fn spots(name: &str, spots: &[Spot], titles: [&str; 2]) -> Chart {
    let spots: Vec<&Spot> = spots.iter().filter(|spot| spot.at.iter().all(|&value| is_drawable(value))).collect();
    let layouts = Layout::BOTH.iter().filter(|_| !spots.is_empty());
    Chart { name: name.into(), drawings: layouts.map(|layout| draw(layout, &spots, titles)).collect() }
}

fn draw(layout: &Layout, spots: &[&Spot], titles: [&str; 2]) -> Drawing {
    let [across, up] = layout.ends();
    let x = Axis::around(spots.iter().map(|spot| spot.at[0]), across.0, across.1);
    let y = Axis::around(spots.iter().map(|spot| spot.at[1]), up.0, up.1);
    let label = format!("{} against {}, both logarithmic", titles[1], titles[0]);
    let mut drawing = Drawing::new(layout.class, (layout.width, layout.height), label);
    layout.draw_frame(&mut drawing, &x, &y, titles);
    let look = Look::of_all(["spot"].into_iter())[0];
    let measured = |spot: &&Spot| MeasuredSampler {
        name: String::new(),
        look,
        time: Extent::exact(spot.at[0]),
        error: Extent::exact(spot.at[1]),
    };
    steps(&mut drawing, [&x, &y], &spots.iter().map(measured).collect::<Vec<_>>());
    drawing.group("series s2 v0", |drawing| {
        for Spot { index, at, is_marked } in spots {
            let (px, py) = (x.at(at[0]), y.at(at[1]));
            let class = if *is_marked { "spot marked" } else { "spot" };
            drawing.raw(format_args!(
                "<circle class=\"{class}\" cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"5\" tabindex=\"0\" data-index=\"{index}\"/>"
            ));
        }
    });
    drawing
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_that_can_be_drawn_is_there_and_can_be_found() {
        let spot = |index: usize, at: [f64; 2]| Spot { index, at, is_marked: index == 0 };
        let all = [spot(0, [1.0, 2.0]), spot(1, [2.0, 1.0]), spot(2, [0.0, 1.0]), spot(3, [3.0, f64::NAN])];
        let chart = spots("front", &all, ["time", "error"]);
        assert_eq!(chart.drawings.len(), 2);
        for drawing in &chart.drawings {
            let svg = drawing.svg();
            assert_eq!((svg.matches("<circle").count(), svg.matches("spot marked").count()), (2, 1));
            assert!(svg.contains("data-index=\"1\"") && !svg.contains("NaN"), "{svg}");
            assert_eq!(svg.matches("class=\"front\"").count(), 1);
        }
        assert!(spots("front", &all[2..], ["time", "error"]).drawings.is_empty());
    }
}
