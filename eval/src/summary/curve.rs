//! Error of one sampler on one view as a function of rendering time.

/// Measured points of one sampler on one view: seconds of rendering and mean squared error, by increasing time.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// `(seconds, error)`, both positive.
    points: Vec<(f64, f64)>,
    /// Seconds of preparation.
    pub preparation: f64,
}

/// Factor beyond the measured times up to which errors are extrapolated.
const REACH: f64 = 2.5;
/// Exponent of error over time if only one budget was measured: that of independent samples.
const INDEPENDENT: f64 = -1.0;

impl Curve {
    /// Returns the curve through points, which are sorted; `None` without points or with one that is not
    /// positive.
    pub fn new(mut points: Vec<(f64, f64)>, preparation: f64) -> Option<Self> {
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let is_positive = |x: f64| x > 0.0 && x.is_finite();
        let all = !points.is_empty() && points.iter().all(|&(x, y)| is_positive(x) && is_positive(y));
        all.then_some(Self { points, preparation })
    }

    /// Returns the error after `seconds`, less the preparation if `counts_preparation`. Between two measured
    /// times it follows the power law through them, beyond them that of the nearest two. `None` if no time is
    /// left, or if it is more than a factor of 2.5 outside the measured ones.
    pub fn error_at(&self, seconds: f64, counts_preparation: bool) -> Option<f64> {
        let time = if counts_preparation { seconds - self.preparation } else { seconds };
        let (first, last) = (self.points[0].0, self.points[self.points.len() - 1].0);
        if time < first / REACH || time > last * REACH {
            return None;
        }
        let next = self.points.iter().position(|point| point.0 >= time).unwrap_or(self.points.len() - 1).max(1);
        let (x0, y0) = self.points[next - 1];
        let slope = self.points.get(next).filter(|point| point.0 > 1.05 * x0);
        let slope = slope.map_or(INDEPENDENT, |(x1, y1)| (y1 / y0).ln() / (x1 / x0).ln());
        Some(y0 * (time / x0).powf(slope))
    }

    /// Returns the exponent of error over time between the first and the last budget; `None` with one budget.
    pub fn slope(&self) -> Option<f64> {
        let ((x0, y0), (x1, y1)) = (self.points[0], self.points[self.points.len() - 1]);
        (x1 > 1.05 * x0).then(|| (y1 / y0).ln() / (x1 / x0).ln())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn power_laws_are_followed_exactly() {
        let error = |seconds: f64| 3.0 * seconds.powf(-1.3);
        let curve = Curve::new([1.0, 0.25].map(|t| (t, error(t))).to_vec(), 0.1).unwrap();
        for seconds in [0.11, 0.25, 0.5, 1.0, 2.0] {
            assert!((curve.error_at(seconds, false).unwrap() / error(seconds) - 1.0).abs() < 1e-12, "{seconds}");
        }
        assert!((curve.error_at(0.6, true).unwrap() / error(0.5) - 1.0).abs() < 1e-12);
        assert!((curve.slope().unwrap() + 1.3).abs() < 1e-12);
    }

    #[test]
    fn errors_are_not_extrapolated_far_beyond_the_measurements() {
        let curve = Curve::new(vec![(0.25, 2.0), (1.0, 0.5)], 0.9).unwrap();
        assert_eq!(curve.error_at(0.05, false), None);
        assert_eq!(curve.error_at(3.0, false), None);
        assert_eq!(curve.error_at(0.95, true), None, "preparation leaves a twentieth of a second");
        assert_eq!(Curve::new(vec![], 0.0), None);
        assert_eq!(Curve::new(vec![(1.0, f64::NAN)], 0.0), None);
    }

    #[test]
    fn a_single_budget_falls_like_independent_samples() {
        let curve = Curve::new(vec![(1.0, 0.5)], 0.0).unwrap();
        assert!((curve.error_at(2.0, false).unwrap() - 0.25).abs() < 1e-12 && curve.slope().is_none());
    }
}
