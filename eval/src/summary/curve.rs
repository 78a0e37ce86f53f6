//! Error of one sampler on one view as a function of rendering time.

/// The runs of one budget.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Mean seconds of rendering.
    pub seconds: f64,
    /// Mean squared error.
    pub error: f64,
    /// Seconds of preparation: those of `auto` depend on the budget, as does the sampler that it chooses.
    pub preparation: f64,
}

/// Measured points of one sampler on one view, by increasing time.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve(Vec<Point>);

/// Factor beyond the measured times up to which errors are extrapolated.
const REACH: f64 = 2.5;
/// Exponent of error over time if only one budget was measured: that of independent samples.
const INDEPENDENT: f64 = -1.0;
/// Limits of the exponent. Where `auto` chooses another sampler for another budget, the slope between the two
/// says nothing about either.
const EXPONENTS: [f64; 2] = [-2.0, -0.5];

impl Curve {
    /// Returns the curve through points, which are sorted; `None` without points or with one that is not
    /// positive.
    pub fn new(mut points: Vec<Point>) -> Option<Self> {
        points.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
        let is_positive = |x: f64| x > 0.0 && x.is_finite();
        let all =
            !points.is_empty() && points.iter().all(|point| is_positive(point.seconds) && is_positive(point.error));
        all.then_some(Self(points))
    }

    /// Returns the error after `seconds`, less the preparation if `counts_preparation`: that of the nearest
    /// measured time, from which it follows the power law through that point and its neighbour. `None` if no
    /// time is left, or if it is more than a factor of 2.5 outside the measured ones.
    pub fn error_at(&self, seconds: f64, counts_preparation: bool) -> Option<f64> {
        let points = &self.0;
        let preparation = |point: &Point| if counts_preparation { point.preparation } else { 0.0 };
        let distance = |point: &Point| ((point.seconds + preparation(point)) / seconds).ln().abs();
        let nearest = (0..points.len()).min_by(|&a, &b| distance(&points[a]).total_cmp(&distance(&points[b])))?;
        let (point, time) = (points[nearest], seconds - preparation(&points[nearest]));
        if time < points[0].seconds / REACH || time > points[points.len() - 1].seconds * REACH {
            return None;
        }
        let is_after = time > point.seconds;
        let toward = if is_after { nearest + 1 } else { nearest.wrapping_sub(1) };
        let away = if is_after { nearest.wrapping_sub(1) } else { nearest + 1 };
        let slope = [toward, away].into_iter().filter_map(|k| points.get(k)).find_map(|other| {
            let step = (other.seconds / point.seconds).ln();
            (step.abs() > 0.05).then(|| (other.error / point.error).ln() / step)
        });
        let slope = slope.map_or(INDEPENDENT, |slope| slope.clamp(EXPONENTS[0], EXPONENTS[1]));
        Some(point.error * (time / point.seconds).powf(slope))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(points: &[(f64, f64)], preparation: f64) -> Option<Curve> {
        Curve::new(points.iter().map(|&(seconds, error)| Point { seconds, error, preparation }).collect())
    }

    #[test]
    fn power_laws_are_followed_exactly() {
        let error = |seconds: f64| 3.0 * seconds.powf(-1.3);
        let curve = curve(&[1.0, 0.25].map(|t| (t, error(t))), 0.1).unwrap();
        for seconds in [0.11, 0.25, 0.5, 1.0, 2.0] {
            assert!((curve.error_at(seconds, false).unwrap() / error(seconds) - 1.0).abs() < 1e-12, "{seconds}");
        }
        assert!((curve.error_at(0.6, true).unwrap() / error(0.5) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn errors_are_not_extrapolated_far_beyond_the_measurements() {
        let measured = curve(&[(0.25, 2.0), (1.0, 0.5)], 0.9).unwrap();
        assert_eq!(measured.error_at(0.05, false), None);
        assert_eq!(measured.error_at(3.0, false), None);
        assert_eq!(measured.error_at(0.95, true), None, "preparation leaves a twentieth of a second");
        assert_eq!(curve(&[], 0.0), None);
        assert_eq!(curve(&[(1.0, f64::NAN)], 0.0), None);
    }

    #[test]
    fn a_single_budget_falls_like_independent_samples() {
        let curve = curve(&[(1.0, 0.5)], 0.0).unwrap();
        assert!((curve.error_at(2.0, false).unwrap() - 0.25).abs() < 1e-12);
    }

    #[test]
    fn each_budget_has_its_own_preparation_and_sampler() {
        let point = |seconds, error, preparation| Point { seconds, error, preparation };
        // The larger budget takes another sampler, with a 50th of the error and a longer preparation.
        let curve = Curve::new(vec![point(0.25, 1.0, 0.05), point(1.0, 0.02, 0.2)]).unwrap();
        assert!((curve.error_at(1.0, true).unwrap() / (0.02 * 0.8_f64.powi(-2)) - 1.0).abs() < 1e-12);
        assert!((curve.error_at(0.25, true).unwrap() / 0.8_f64.powi(-2) - 1.0).abs() < 1e-12);
    }
}
