//! Tests for equal means of two samples: Welch's t-test for independent ones of unequal variance, Student's
//! for pairs.

use statrs::distribution::ContinuousCDF;

use super::interval::students_t;

/// Relative difference up to which means are equal if neither sample has any variance: sums of `f32`
/// radiances in different orders differ by some 1e-7, a wrong constant by far more.
const ROUNDING: f64 = 1e-5;

/// Number, mean and (unbiased) variance of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moments {
    /// Number of values, at least 1.
    pub count: usize,
    /// Mean.
    pub mean: f64,
    /// Variance with `count - 1`; 0 for a single value.
    pub variance: f64,
}

impl Moments {
    /// Computes the moments of a sample; `None` if it is empty.
    pub fn of(values: &[f64]) -> Option<Self> {
        if values.is_empty() {
            return None;
        }
        let count = values.len();
        let mean = values.iter().sum::<f64>() / count as f64;
        let squares: f64 = values.iter().map(|value| (value - mean) * (value - mean)).sum();
        let variance = if count > 1 { squares / (count - 1) as f64 } else { 0.0 };
        Some(Self { count, mean, variance })
    }

    /// Returns the variance of the mean.
    fn of_mean(&self) -> f64 {
        self.variance / self.count as f64
    }
}

/// The outcome of a t-test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TTest {
    /// Difference of the means over its standard error.
    pub t: f64,
    /// Degrees of freedom.
    pub degrees_of_freedom: f64,
    /// Probability of a `|t|` at least this large if the means are equal; 0 if an input is NaN.
    pub p_value: f64,
}

impl TTest {
    /// Performs Welch's test of two independent samples (Welch 1947; degrees of freedom by Welch and
    /// Satterthwaite).
    pub fn welch(a: &Moments, b: &Moments) -> Self {
        let (va, vb) = (a.of_mean(), b.of_mean());
        let freedom = |v: f64, count: usize| if v > 0.0 { v * v / (count - 1) as f64 } else { 0.0 };
        let degrees_of_freedom = (va + vb) * (va + vb) / (freedom(va, a.count) + freedom(vb, b.count));
        Self::new(a.mean - b.mean, va + vb, degrees_of_freedom, a.mean.abs().max(b.mean.abs()))
    }

    /// Performs Student's test that pairwise differences, of values near `scale`, have mean zero, with one
    /// degree of freedom less than the number of pairs. At least two pairs are needed.
    pub fn paired(differences: &Moments, scale: f64) -> Self {
        Self::new(differences.mean, differences.of_mean(), (differences.count - 1) as f64, scale)
    }

    fn new(difference: f64, variance: f64, degrees_of_freedom: f64, scale: f64) -> Self {
        if variance == 0.0 {
            let equal = difference.abs() <= ROUNDING * scale;
            let t = if equal { 0.0 } else { f64::INFINITY };
            return Self { t, degrees_of_freedom: f64::INFINITY, p_value: if equal { 1.0 } else { 0.0 } };
        }
        let t = difference / variance.sqrt();
        let p_value = if t.is_finite() { (2.0 * students_t(degrees_of_freedom).sf(t.abs())).min(1.0) } else { 0.0 };
        Self { t, degrees_of_freedom, p_value }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Stream};

    #[test]
    fn equal_variances_give_students_test() {
        let test = TTest::welch(&Moments::of(&[1.0, 2.0, 3.0]).unwrap(), &Moments::of(&[3.0, 4.0, 5.0]).unwrap());
        assert!((test.t + 6.0_f64.sqrt()).abs() < 1e-12);
        assert!((test.degrees_of_freedom - 4.0).abs() < 1e-12);
        // The distribution function of 4 degrees of freedom: 1/2 + 3/8 s (1 - s^2 / 12), s = t / sqrt(1 + t^2 / 4).
        let s = 6.0_f64.sqrt() / 2.5_f64.sqrt();
        assert!((test.p_value - 2.0 * (0.5 - 0.375 * s * (1.0 - s * s / 12.0))).abs() < 1e-9, "{test:?}");
    }

    #[test]
    fn n_pairs_have_n_minus_1_degrees_of_freedom() {
        let test = TTest::paired(&Moments::of(&[1.0, 2.0, 3.0]).unwrap(), 2.0);
        assert!((test.t - 12.0_f64.sqrt()).abs() < 1e-12 && test.degrees_of_freedom == 2.0);
        // The distribution function of 2 degrees of freedom: 1/2 + t / (2 sqrt(2 + t^2)).
        assert!((test.p_value - (1.0 - (12.0_f64 / 14.0).sqrt())).abs() < 1e-9, "{test:?}");
    }

    #[test]
    fn the_sample_with_all_the_variance_gives_the_degrees_of_freedom() {
        let constant = Moments { count: 100, mean: 5.0, variance: 0.0 };
        let test = TTest::welch(&Moments::of(&[0.0, 2.0]).unwrap(), &constant);
        assert!((test.t + 4.0).abs() < 1e-12 && (test.degrees_of_freedom - 1.0).abs() < 1e-12);
        // One degree of freedom is the Cauchy distribution.
        assert!((test.p_value - (1.0 - 2.0 * 4.0_f64.atan() / std::f64::consts::PI)).abs() < 1e-9, "{test:?}");
    }

    #[test]
    fn p_values_are_uniform_when_means_agree_and_variances_do_not() {
        let mut random = Stream::new(11, Purpose::Test, 0);
        let mut normal = move |scale: f64| scale * ((0..12).map(|_| f64::from(random.uniform())).sum::<f64>() - 6.0);
        let trials = 4000;
        let mut below = [0; 9];
        for _ in 0..trials {
            let a: Vec<f64> = (0..8).map(|_| normal(1.0)).collect();
            let b: Vec<f64> = (0..20).map(|_| normal(3.0)).collect();
            let p = TTest::welch(&Moments::of(&a).unwrap(), &Moments::of(&b).unwrap()).p_value;
            for (i, count) in below.iter_mut().enumerate() {
                *count += usize::from(p < (i + 1) as f64 / 10.0);
            }
        }
        for (i, &count) in below.iter().enumerate() {
            let expected = (i + 1) as f64 / 10.0;
            // Four binomial standard deviations, sqrt(0.25 / 4000) = 0.008 at most.
            assert!((count as f64 / f64::from(trials) - expected).abs() < 0.032, "{count} below {expected}");
        }
    }

    #[test]
    fn constant_samples_are_compared_up_to_rounding() {
        let constant = |mean| Moments { count: 4, mean, variance: 0.0 };
        assert_eq!(TTest::welch(&constant(1.0), &constant(1.0 + 1e-7)).p_value, 1.0);
        assert_eq!(TTest::welch(&constant(1.0), &constant(1.001)).p_value, 0.0);
        assert_eq!(TTest::welch(&constant(0.0), &constant(0.0)).p_value, 1.0);
    }

    #[test]
    fn nan_never_passes() {
        let a = Moments::of(&[1.0, 2.0, 3.0]).unwrap();
        let broken = Moments::of(&[1.0, f64::NAN, 3.0]).unwrap();
        assert_eq!(TTest::welch(&a, &broken).p_value, 0.0);
    }
}
