//! Evaluation of results: errors against a reference, confidence intervals, and tests that samplers agree
//! with their densities and with each other.
//!
//! Everything here computes in `f64`.
//!
//! | file | concept |
//! | --- | --- |
//! | `metric.rs`, `relative_variance.rs` | MSE, relMSE, trimmed relMSE, TTUV; relative variance |
//! | `interval.rs` | means, ratios and their intervals |
//! | `flip.rs`, `hdr_flip.rs` | LDR-FLIP and HDR-FLIP |
//! | `welch.rs`, `tiles.rs` | whether two samplers have the same mean |
//! | `chi_square.rs` | whether directions follow their pdf |

mod chi_square;
mod flip;
mod hdr_flip;
mod interval;
mod metric;
mod relative_variance;
mod tiles;
mod welch;

pub use chi_square::{ChiSquareReport, SphereChiSquare};
pub use flip::{PIXELS_PER_DEGREE, flip};
pub use hdr_flip::HdrFlip;
pub use interval::{MeanInterval, RatioInterval};
pub use metric::{ErrorMetrics, RELATIVE_EPSILON, TRIMMED_FRACTION, ttuv};
pub use relative_variance::{relative_variance, relative_variance_of_log_moment};
pub use tiles::{TileTest, compare_images, compare_runs};
pub use welch::{Moments, TTest};

/// Returns the significance per test, `1 - (1 - significance)^(1 / tests)`, at which the probability that
/// *any* of `tests` independent tests rejects a true hypothesis is `significance` (Sidak 1967).
pub fn sidak(significance: f64, tests: usize) -> f64 {
    // Avoids cancellation: significances of 1e-8 and below are common with thousands of tiles.
    -((-significance).ln_1p() / tests.max(1) as f64).exp_m1()
}

#[cfg(test)]
mod unit {
    use super::sidak;

    #[test]
    fn sidak_of_many_tests_multiplies_back_to_the_whole() {
        assert!((sidak(0.01, 1) - 0.01).abs() < 1e-15);
        for tests in [2, 10, 1000, 1_000_000] {
            let each = sidak(0.01, tests);
            let all = 1.0 - (1.0 - each).powi(tests as i32);
            assert!(each < 0.01 && (all - 0.01).abs() < 1e-9, "{tests}: {each} {all}");
        }
    }
}
