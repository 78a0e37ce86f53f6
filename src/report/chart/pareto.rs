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
pub struct MeasuredSampler {
    /// Its full name.
    pub name: String,
    /// Its colour and marker.
    pub look: Look,
    /// Time.
    pub time: Extent,
    /// Error.
    pub error: Extent,
}

impl MeasuredSampler {
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

/// Returns whether each sampler is on the front: no other beats it by more than the intervals. Samplers that
/// cannot be drawn are not.
pub fn on_front(samplers: &[MeasuredSampler]) -> Vec<bool> {
    let rivals = || samplers.iter().filter(|sampler| sampler.is_drawable());
    samplers.iter().map(|sampler| sampler.is_drawable() && !rivals().any(|other| sampler.is_beaten_by(other))).collect()
}

/// Draws the scatter plot on logarithmic axes. Empty if nothing can be drawn.
pub fn scatter(name: &str, samplers: &[MeasuredSampler], titles: [&str; 2]) -> Chart {
    let samplers: Vec<MeasuredSampler> = samplers.iter().filter(|sampler| sampler.is_drawable()).cloned().collect();
    let layouts = Layout::BOTH.iter().filter(|_| !samplers.is_empty());
    Chart { name: name.into(), drawings: layouts.map(|layout| draw(layout, &samplers, titles)).collect() }
}

fn draw(layout: &Layout, samplers: &[MeasuredSampler], [time, error]: [&str; 2]) -> Drawing {
    let [across, up] = layout.ends();
    let x = Axis::of_intervals(samplers.iter().map(|sampler| sampler.time), across.0, across.1);
    let y = Axis::of_intervals(samplers.iter().map(|sampler| sampler.error), up.0, up.1);
    let on_front = on_front(samplers);
    let entry = |(sampler, &on_front): (_, &bool)| {
        let MeasuredSampler { name, look, .. }: &MeasuredSampler = sampler;
        Entry { look: *look, name, on_front }
    };
    let entries: Vec<Entry> = samplers.iter().zip(&on_front).map(entry).collect();
    let legend = Legend::new(&entries, (layout.left, layout.width - layout.left - layout.right));
    let label = format!("{error} against {time}, both logarithmic, one point for each sampler");
    let mut drawing = Drawing::new(layout.class, (layout.width, layout.height + legend.height), label);
    layout.draw_frame(&mut drawing, &x, &y, [time, error]);
    steps(&mut drawing, [&x, &y], samplers);
    for (sampler, on_front) in samplers.iter().zip(on_front) {
        drawing.group(&sampler.look.class(), |drawing| {
            if on_front {
                ring(drawing, x.at(sampler.time.value), y.at(sampler.error.value));
            }
            let words =
                format!("{}: error {}, time {}", sampler.name, text(sampler.error.value), text(sampler.time.value));
            point(drawing, [&x, &y], sampler.look, [sampler.time, sampler.error], &words);
        });
    }
    legend.draw(&mut drawing, layout.height);
    drawing
}

/// Draws the front as steps: between two points, only the accuracy of the faster one is reachable.
pub(super) fn steps(drawing: &mut Drawing, [x, y]: [&Axis; 2], samplers: &[MeasuredSampler]) {
    let mut path = String::new();
    for sampler in best_means(samplers) {
        let (px, py) = (x.at(sampler.time.value), y.at(sampler.error.value));
        let start = if path.is_empty() { format!("M{px:.1} {:.1}", y.end) } else { format!("H{px:.1}") };
        path += &format!("{start}V{py:.1}");
    }
    drawing.path("front", format_args!("{path}H{:.1}", x.end));
}

/// Returns the samplers that no other beats in both means, from the fastest to the most accurate.
fn best_means(samplers: &[MeasuredSampler]) -> Vec<&MeasuredSampler> {
    let mut sorted: Vec<&MeasuredSampler> = samplers.iter().collect();
    let by = |a: &MeasuredSampler, b: &MeasuredSampler| {
        a.time.value.total_cmp(&b.time.value).then(a.error.value.total_cmp(&b.error.value))
    };
    sorted.sort_by(|a, b| by(a, b));
    let mut least = f64::INFINITY;
    sorted.retain(|sampler| {
        let better = sampler.error.value < least;
        least = least.min(sampler.error.value);
        better
    });
    sorted
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(name: &str, time: f64, error: f64) -> MeasuredSampler {
        let look = Look::of_all([name].into_iter())[0];
        MeasuredSampler { name: name.to_owned(), look, time: Extent::exact(time), error: Extent::exact(error) }
    }

    fn names(samplers: &[MeasuredSampler]) -> Vec<&str> {
        let chosen = samplers.iter().zip(on_front(samplers)).filter(|(_, on_front)| *on_front);
        chosen.map(|(sampler, _)| sampler.name.as_str()).collect()
    }

    #[test]
    fn the_front_has_the_points_that_none_dominates() {
        let samplers = [
            measured("slow", 4.0, 0.5),
            measured("mis", 1.0, 2.0),
            measured("worse", 2.0, 2.5),
            measured("head", 3.0, 0.4),
            measured("nan", 0.5, f64::NAN),
        ];
        assert_eq!(names(&samplers), ["mis", "head"]);
    }

    #[test]
    fn the_front_accounts_for_noise() {
        let spread = |sampler: MeasuredSampler, part: f64| {
            let around = |extent: Extent| Extent {
                ends: Some((extent.value * (1.0 - part), extent.value * (1.0 + part))),
                ..extent
            };
            MeasuredSampler { time: around(sampler.time), error: around(sampler.error), ..sampler }
        };
        // Slightly slower and less accurate, both within the intervals: not clearly beaten.
        let close = [measured("a", 1.0, 1.0), measured("b", 1.02, 1.02)];
        assert_eq!(names(&close), ["a"]);
        assert_eq!(names(&close.map(|sampler| spread(sampler, 0.05))), ["a", "b"]);
        // Slightly faster, within the interval, with a 10x higher error.
        let far = [measured("a", 1.0, 10.0), measured("b", 1.02, 1.0)];
        assert_eq!(names(&far), ["a", "b"]);
        assert_eq!(names(&far.map(|sampler| spread(sampler, 0.05))), ["b"]);
    }

    #[test]
    fn the_scatter_draws_every_point_and_one_front() {
        let samplers = [measured("mis", 1.0, 2.0), measured("a <b>", 2.0, 1.0), measured("zero", 0.0, 1.0)];
        let chart = scatter("pareto", &samplers, ["time", "error"]);
        for drawing in &chart.drawings {
            let svg = drawing.svg();
            assert_eq!((svg.matches("class=\"front\"").count(), svg.matches("class=\"ring\"").count()), (1, 4));
            assert!(svg.contains("a &lt;b&gt;") && !svg.contains("zero") && !svg.contains("NaN"));
        }
        assert!(chart.drawings.len() == 2 && scatter("x", &samplers[2..], ["time", "error"]).drawings.is_empty());
    }
}
