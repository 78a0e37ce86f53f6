//! Means of a few runs, ratios of such means, and their confidence intervals.

use statrs::distribution::{ContinuousCDF, StudentsT};

use super::Moments;

/// The mean of independent runs with its 95 % confidence interval, `mean +- half_width`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanInterval {
    /// The mean of the runs.
    pub mean: f64,
    /// Half the length of the interval; infinite for a single run, whose spread is unknown.
    pub half_width: f64,
    /// The number of runs.
    pub count: usize,
}

impl MeanInterval {
    /// Computes the interval by Student's t distribution with `count - 1` degrees of freedom. `None` without
    /// runs.
    pub fn of(runs: &[f64]) -> Option<Self> {
        let Moments { count, mean, variance } = Moments::of(runs)?;
        let half_width = match count {
            1 => f64::INFINITY,
            _ => students_t((count - 1) as f64).inverse_cdf(0.975) * (variance / count as f64).sqrt(),
        };
        Some(Self { mean, half_width, count })
    }

    /// Returns the lower end.
    pub fn low(&self) -> f64 {
        self.mean - self.half_width
    }

    /// Returns the upper end.
    pub fn high(&self) -> f64 {
        self.mean + self.half_width
    }
}

/// The ratio of two means over paired runs, with the standard error of its logarithm.
///
/// Paired runs share random numbers (camera rays, for example): their common noise cancels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RatioInterval {
    /// Mean of the numerators over mean of the denominators, positive and finite.
    pub ratio: f64,
    /// Standard error of `ln(ratio)`; infinite for a single pair, whose spread is unknown.
    pub log_error: f64,
    /// Degrees of freedom of that error: pairs minus one.
    pub degrees_of_freedom: f64,
}

impl RatioInterval {
    /// Computes the ratio over runs of which `numerators[k]` and `denominators[k]` are a pair.
    ///
    /// The error is the delta method's for paired samples (Casella and Berger 2002, section 5.5.4): to first order,
    /// `ln(a / b)` deviates by the mean of `a_k / a - b_k / b`, where `a` and `b` are the means.
    /// `None` without runs, or if the ratio is not positive and finite.
    ///
    /// # Panics
    /// If the two lists differ in length.
    pub fn paired(numerators: &[f64], denominators: &[f64]) -> Option<Self> {
        assert_eq!(numerators.len(), denominators.len(), "runs come in pairs");
        let (a, b) = (Moments::of(numerators)?.mean, Moments::of(denominators)?.mean);
        let ratio = a / b;
        if !(ratio.is_finite() && ratio > 0.0) {
            return None;
        }
        let deviations: Vec<f64> = numerators.iter().zip(denominators).map(|(x, y)| x / a - y / b).collect();
        let Moments { count, variance, .. } = Moments::of(&deviations)?;
        let log_error = if count > 1 { (variance / count as f64).sqrt() } else { f64::INFINITY };
        Some(Self { ratio, log_error, degrees_of_freedom: (count - 1) as f64 })
    }

    /// Returns the reciprocal ratio.
    pub fn inverse(self) -> Self {
        Self { ratio: 1.0 / self.ratio, ..self }
    }

    /// Returns the geometric mean of independent ratios, with degrees of freedom by Welch and Satterthwaite.
    /// `None` without ratios.
    pub fn geometric_mean(ratios: &[Self]) -> Option<Self> {
        if ratios.is_empty() {
            return None;
        }
        let count = ratios.len() as f64;
        let ratio = (ratios.iter().map(|one| one.ratio.ln()).sum::<f64>() / count).exp();
        let variances = || ratios.iter().map(|one| (one.log_error / count).powi(2));
        let variance: f64 = variances().sum();
        let terms = variances().zip(ratios).filter(|(variance, _)| *variance > 0.0);
        let freedom: f64 = terms.map(|(own, one)| (own / variance).powi(2) / one.degrees_of_freedom).sum();
        // Without variance (freedom 0) the quantile is multiplied by 0, and any value works.
        let degrees_of_freedom = if freedom > 0.0 { 1.0 / freedom } else { 1.0 };
        Some(Self { ratio, log_error: variance.sqrt(), degrees_of_freedom })
    }

    /// Returns the ends of the 95 % confidence interval, symmetric around the ratio on a logarithmic scale;
    /// `None` for a single pair.
    pub fn ends(&self) -> Option<(f64, f64)> {
        if !self.log_error.is_finite() {
            return None;
        }
        let half = students_t(self.degrees_of_freedom).inverse_cdf(0.975) * self.log_error;
        Some((self.ratio * (-half).exp(), self.ratio * half.exp()))
    }
}

/// Returns Student's t distribution, centred and of unit scale.
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
    fn intervals_contain_the_true_mean_with_95_percent_probability() {
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

    #[test]
    fn common_noise_of_pairs_cancels_in_their_ratio() {
        let noise = [0.3, 1.9, 0.7, 1.1, 4.0];
        let twice: Vec<f64> = noise.iter().map(|x| 2.0 * x).collect();
        let ratio = RatioInterval::paired(&twice, &noise).unwrap();
        assert!((ratio.ratio - 2.0).abs() < 1e-12 && ratio.log_error < 1e-12, "{ratio:?}");
        let mut shuffled = twice;
        shuffled.rotate_left(1);
        assert!(RatioInterval::paired(&shuffled, &noise).unwrap().log_error > 0.1);
    }

    #[test]
    fn ratio_of_a_textbook_sample() {
        // Deviations 1/2 - 3/2, 1 - 1, 3/2 - 1/2: variance 1, of the mean 1/3; t(0.975, 2) = 4.302653.
        let ratio = RatioInterval::paired(&[1.0, 2.0, 3.0], &[3.0, 2.0, 1.0]).unwrap();
        assert_eq!((ratio.ratio, ratio.degrees_of_freedom), (1.0, 2.0));
        let (low, high) = ratio.ends().unwrap();
        assert!((high.ln() - 4.302_653 / 3.0_f64.sqrt()).abs() < 1e-5 && (low * high - 1.0).abs() < 1e-12);
    }

    #[test]
    fn one_pair_has_no_interval_and_invalid_means_have_no_ratio() {
        assert_eq!(RatioInterval::paired(&[4.0], &[2.0]).unwrap().ends(), None);
        for broken in [f64::NAN, f64::INFINITY, -1.0] {
            assert_eq!(RatioInterval::paired(&[1.0, broken], &[1.0, 1.0]), None);
            assert_eq!(RatioInterval::paired(&[1.0, 1.0], &[1.0, broken]), None);
        }
        assert_eq!(RatioInterval::paired(&[], &[]), None);
        assert_eq!(RatioInterval::geometric_mean(&[]), None);
    }

    #[test]
    fn errors_of_independent_ratios_add_in_squares() {
        let one = |ratio, log_error| RatioInterval { ratio, log_error, degrees_of_freedom: 4.0 };
        let mean = RatioInterval::geometric_mean(&[one(2.0, 0.3), one(8.0, 0.4)]).unwrap();
        assert!((mean.ratio - 4.0).abs() < 1e-12 && (mean.log_error - 0.25).abs() < 1e-12);
        // (9 + 16)^2 / (81 / 4 + 256 / 4).
        assert!((mean.degrees_of_freedom - 2500.0 / 337.0).abs() < 1e-9, "{mean:?}");
        let single = one(1.0, f64::INFINITY);
        assert_eq!(RatioInterval::geometric_mean(&[one(2.0, 0.3), single]).unwrap().ends(), None);
        let exact = RatioInterval::geometric_mean(&[one(3.0, 0.0)]).unwrap().ends().unwrap();
        assert!((exact.0 - 3.0).abs() < 1e-12 && (exact.1 - 3.0).abs() < 1e-12);
    }

    #[test]
    fn intervals_contain_the_true_ratio_with_95_percent_probability() {
        let mut random = Stream::new(5, Purpose::Test, 0);
        let mut normal = move || (0..12).map(|_| f64::from(random.uniform())).sum::<f64>() - 6.0;
        let trials = 4000;
        let hits = (0..trials)
            .filter(|_| {
                // Errors of 5 % common to a pair and 2 % individual ones; the true ratio of the means is 3.
                let pairs: Vec<(f64, f64)> = (0..6)
                    .map(|_| {
                        let shared = 1.0 + 0.05 * normal();
                        (3.0 * (shared + 0.02 * normal()), shared + 0.02 * normal())
                    })
                    .collect();
                let (a, b): (Vec<f64>, Vec<f64>) = pairs.into_iter().unzip();
                let (low, high) = RatioInterval::paired(&a, &b).unwrap().ends().unwrap();
                (low..=high).contains(&3.0)
            })
            .count();
        // As above: four binomial standard deviations. The delta method has an error of order 0.02^2.
        assert!((hits as f64 / f64::from(trials) - 0.95).abs() < 0.014, "{hits} of {trials}");
    }
}
