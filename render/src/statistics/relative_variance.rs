//! The relative variance of a one-sample estimate.

/// Returns the variance of `f / q` over the square of its mean, where `q` is the density of the sample, from
/// the logarithm of `integral f^2 / q / (integral f)^2`: the chi-square divergence of `q` from the density
/// proportional to `f`.
///
/// That logarithm is the Renyi divergence of order 2; as a loss, it has bounded gradients.
pub fn relative_variance_of_log_moment(log_moment: f64) -> f64 {
    log_moment.exp_m1()
}

/// Returns the variance over the square of the mean, from the means of values and of their squares; clamped
/// at 0, since rounding may give negative values.
pub fn relative_variance(mean: f64, mean_square: f64) -> f64 {
    (mean_square / (mean * mean) - 1.0).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_are_the_variance_over_the_square_of_the_mean() {
        // Of 1 and 3: mean 2, variance 1.
        assert!((relative_variance(2.0, 5.0) - 0.25).abs() < 1e-15);
        assert!((relative_variance_of_log_moment(1.25_f64.ln()) - 0.25).abs() < 1e-15);
        assert_eq!(relative_variance(1.0, 1.0 - 1e-16), 0.0);
    }
}
