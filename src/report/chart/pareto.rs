//! Speed against accuracy: one point per sampler, and the Pareto front within uncertainty.

use super::{
    Axis, Chart, Drawing, Entry, Extent, Layout, Legend, Look, Summary, is_drawable, legend::ring, point, text,
};
use crate::report::summary::Group;

/// The note on the front below every such chart.
pub const FRONT: &str = "Ringed, with bold names, are the samplers that no other clearly beats: none has a time or an error whose interval lies \
                         below theirs without being as clearly behind in the other. The broad line joins those that none beats in the means.";

/// A sampler's time and error; lower is better for both.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Its full name.
    pub name: String,
    /// Its colour and marker.
    pub look: Look,
    /// Time.
    pub time: Extent,
    /// Error.
    pub error: Extent,
}

impl Place {
    /// Seconds and MSE of a group.
    pub fn of(summary: &Summary, group: &Group) -> Self {
        let look = summary.look(&group.sampler);
        Self { name: group.sampler.clone(), look, time: (&group.seconds).into(), error: (&group.mse).into() }
    }

    fn is_drawable(&self) -> bool {
        is_drawable(self.time.value) && is_drawable(self.error.value)
    }

    /// Returns whether another is clearly better in one measure and not clearly worse in the other.
    fn is_beaten_by(&self, other: &Self) -> bool {
        let [better_time, better_error] = [other.time.is_below(&self.time), other.error.is_below(&self.error)];
        let [worse_time, worse_error] = [self.time.is_below(&other.time), self.error.is_below(&other.error)];
        (better_time && !worse_error) || (better_error && !worse_time)
    }
}

/// Returns whether each place is on the front: no other beats it by more than the intervals. Places that
/// cannot be drawn are not.
pub fn on_front(places: &[Place]) -> Vec<bool> {
    let rivals = || places.iter().filter(|place| place.is_drawable());
    places.iter().map(|place| place.is_drawable() && !rivals().any(|other| place.is_beaten_by(other))).collect()
}

/// Draws the scatter plot on logarithmic axes. Empty if nothing can be drawn.
pub fn scatter(name: &str, places: &[Place], titles: [&str; 2]) -> Chart {
    let places: Vec<Place> = places.iter().filter(|place| place.is_drawable()).cloned().collect();
    let layouts = Layout::BOTH.iter().filter(|_| !places.is_empty());
    Chart { name: name.into(), drawings: layouts.map(|layout| draw(layout, &places, titles)).collect() }
}

fn draw(layout: &Layout, places: &[Place], [time, error]: [&str; 2]) -> Drawing {
    let [across, up] = layout.ends();
    let x = Axis::of_intervals(places.iter().map(|place| place.time), across.0, across.1);
    let y = Axis::of_intervals(places.iter().map(|place| place.error), up.0, up.1);
    let on_front = on_front(places);
    let entry = |(place, &on_front): (_, &bool)| {
        let Place { name, look, .. }: &Place = place;
        Entry { look: *look, name, on_front }
    };
    let entries: Vec<Entry> = places.iter().zip(&on_front).map(entry).collect();
    let legend = Legend::new(&entries, (layout.left, layout.width - layout.left - layout.right));
    let label = format!("{error} against {time}, both logarithmic, one point for each sampler");
    let mut drawing = Drawing::new(layout.class, (layout.width, layout.height + legend.height), label);
    layout.draw_frame(&mut drawing, &x, &y, [time, error]);
    steps(&mut drawing, [&x, &y], places);
    for (place, on_front) in places.iter().zip(on_front) {
        drawing.group(&place.look.class(), |drawing| {
            if on_front {
                ring(drawing, x.at(place.time.value), y.at(place.error.value));
            }
            let words = format!("{}: error {}, time {}", place.name, text(place.error.value), text(place.time.value));
            point(drawing, [&x, &y], place.look, [place.time, place.error], &words);
        });
    }
    legend.draw(&mut drawing, layout.height);
    drawing
}

/// Draws the front as steps: between two points, only the accuracy of the faster one is reachable.
pub(super) fn steps(drawing: &mut Drawing, [x, y]: [&Axis; 2], places: &[Place]) {
    let mut path = String::new();
    for place in best_means(places) {
        let (px, py) = (x.at(place.time.value), y.at(place.error.value));
        let start = if path.is_empty() { format!("M{px:.1} {:.1}", y.end) } else { format!("H{px:.1}") };
        path += &format!("{start}V{py:.1}");
    }
    drawing.path("front", format_args!("{path}H{:.1}", x.end));
}

/// Returns the places that no other beats in both means, from the fastest to the most accurate.
fn best_means(places: &[Place]) -> Vec<&Place> {
    let mut sorted: Vec<&Place> = places.iter().collect();
    let by = |a: &Place, b: &Place| a.time.value.total_cmp(&b.time.value).then(a.error.value.total_cmp(&b.error.value));
    sorted.sort_by(|a, b| by(a, b));
    let mut least = f64::INFINITY;
    sorted.retain(|place| {
        let better = place.error.value < least;
        least = least.min(place.error.value);
        better
    });
    sorted
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(name: &str, time: f64, error: f64) -> Place {
        let look = Look::of_all([name].into_iter())[0];
        Place { name: name.to_owned(), look, time: Extent::exact(time), error: Extent::exact(error) }
    }

    fn names(places: &[Place]) -> Vec<&str> {
        let chosen = places.iter().zip(on_front(places)).filter(|(_, on_front)| *on_front);
        chosen.map(|(place, _)| place.name.as_str()).collect()
    }

    #[test]
    fn the_front_has_the_points_that_none_dominates() {
        let places = [
            place("slow", 4.0, 0.5),
            place("mis", 1.0, 2.0),
            place("worse", 2.0, 2.5),
            place("head", 3.0, 0.4),
            place("nan", 0.5, f64::NAN),
        ];
        assert_eq!(names(&places), ["mis", "head"]);
    }

    #[test]
    fn the_front_accounts_for_noise() {
        let spread = |place: Place, part: f64| {
            let around = |extent: Extent| Extent {
                ends: Some((extent.value * (1.0 - part), extent.value * (1.0 + part))),
                ..extent
            };
            Place { time: around(place.time), error: around(place.error), ..place }
        };
        // Slightly slower and less accurate, both within the intervals: not clearly beaten.
        let close = [place("a", 1.0, 1.0), place("b", 1.02, 1.02)];
        assert_eq!(names(&close), ["a"]);
        assert_eq!(names(&close.map(|place| spread(place, 0.05))), ["a", "b"]);
        // Slightly faster, within the interval, with a 10x higher error.
        let far = [place("a", 1.0, 10.0), place("b", 1.02, 1.0)];
        assert_eq!(names(&far), ["a", "b"]);
        assert_eq!(names(&far.map(|place| spread(place, 0.05))), ["b"]);
    }

    #[test]
    fn the_scatter_draws_every_point_and_one_front() {
        let places = [place("mis", 1.0, 2.0), place("a <b>", 2.0, 1.0), place("zero", 0.0, 1.0)];
        let chart = scatter("pareto", &places, ["time", "error"]);
        for drawing in &chart.drawings {
            let svg = drawing.svg();
            assert_eq!((svg.matches("class=\"front\"").count(), svg.matches("class=\"ring\"").count()), (1, 4));
            assert!(svg.contains("a &lt;b&gt;") && !svg.contains("zero") && !svg.contains("NaN"));
        }
        assert!(chart.drawings.len() == 2 && scatter("x", &places[2..], ["time", "error"]).drawings.is_empty());
    }
}
