//! The mean of a few runs and how well it is known.

use statrs::distribution::{ContinuousCDF, StudentsT};

use super::Moments;

/// The mean of independent runs with its 95 % confidence interval, `mean +- half_width`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanInterval {
    /// The mean of the runs.
    pub mean: f64,
    /// Half the length of the interval; infinite for a single run, which says nothing about its spread.
    pub half_width: f64,
    /// The number of runs.
    pub count: usize,
}

impl MeanInterval {
    /// The interval of Student's t distribution with `count - 1` degrees of freedom. `None` without runs.
    pub fn of(runs: &[f64]) -> Option<Self> {
        let Moments { count, mean, variance } = Moments::of(runs)?;
        let half_width = match count {
            1 => f64::INFINITY,
            _ => students_t((count - 1) as f64).inverse_cdf(0.975) * (variance / count as f64).sqrt(),
        };
        Some(Self { mean, half_width, count })
    }

    /// The lower end.
    pub fn low(&self) -> f64 {
        self.mean - self.half_width
    }

    /// The upper end.
    pub fn high(&self) -> f64 {
        self.mean + self.half_width
    }
}

/// Student's t distribution, centred and of unit scale.
pub(super) fn students_t(degrees_of_freedom: f64) -> StudentsT {
    StudentsT::new(0.0, 1.0, degrees_of_freedom).expect("degrees of freedom are positive")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Stream};

    #[test]
    fn interval_of_a_textbook_sample() {
        // Ten values of mean 5.5 and variance 9.1667; t(0.975, 9) = 2.262157.
        let runs: Vec<f64> = (1..=10).map(f64::from).collect();
        let interval = MeanInterval::of(&runs).unwrap();
        assert!((interval.mean - 5.5).abs() < 1e-12);
        assert!((interval.half_width - 2.262_157 * (82.5_f64 / 9.0 / 10.0).sqrt()).abs() < 1e-5);
        assert!((interval.high() - interval.low() - 2.0 * interval.half_width).abs() < 1e-12);
    }

    #[test]
    fn one_run_has_no_interval_and_none_has_no_mean() {
        assert!(MeanInterval::of(&[]).is_none());
        let one = MeanInterval::of(&[3.0]).unwrap();
        assert_eq!((one.mean, one.half_width, one.count), (3.0, f64::INFINITY, 1));
    }

    #[test]
    fn nineteen_of_twenty_intervals_hold_the_true_mean() {
        let mut random = Stream::new(3, Purpose::Test, 0);
        let trials = 4000;
        let hits = (0..trials)
            .filter(|_| {
                // Sums of 12 uniform numbers are normal enough; the true mean is 6.
                let runs: Vec<f64> = (0..5).map(|_| (0..12).map(|_| f64::from(random.uniform())).sum()).collect();
                let interval = MeanInterval::of(&runs).unwrap();
                (interval.low()..=interval.high()).contains(&6.0)
            })
            .count();
        // Binomial standard deviation: sqrt(0.95 * 0.05 / 4000) = 0.0034; four of them.
        assert!((hits as f64 / f64::from(trials) - 0.95).abs() < 0.014, "{hits} of {trials}");
    }
}
