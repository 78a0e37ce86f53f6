//! Errors of an image against a reference.

use crate::error::{Error, Result};
use crate::image::Image;

/// Added to the squared reference in the relative error, so that black pixels do not dominate it.
pub const RELATIVE_EPSILON: f64 = 0.01;

/// Fraction of the pixels, those with the largest error, that the trimmed relative error excludes: a few
/// outliers ("fireflies") can dominate a mean.
pub const TRIMMED_FRACTION: f64 = 0.001;

/// Means over all pixels and channels of the error of an image against a reference.
///
/// An image with NaN or infinite pixels has NaN or infinite values of all three: trimming does not hide
/// broken pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorMetrics {
    /// Mean of `(x - r)^2`.
    pub mse: f64,
    /// Mean of `(x - r)^2 / (r^2 + RELATIVE_EPSILON)`.
    pub relmse: f64,
    /// `relmse` without the [`TRIMMED_FRACTION`] (rounded down) of pixels with the largest relative error.
    pub relmse_trimmed: f64,
}

impl ErrorMetrics {
    /// Compares `image` with `reference`.
    ///
    /// # Errors
    /// [`Error::Argument`] if the sizes differ or are zero.
    pub fn of(image: &Image, reference: &Image) -> Result<Self> {
        let (size, reference_size) = ((image.width, image.height), (reference.width, reference.height));
        if size != reference_size || image.pixels.is_empty() {
            let reason = format!("its size is {size:?}, that of the reference is {reference_size:?}");
            return Err(Error::argument("image", reason));
        }
        let mut squared = 0.0;
        let mut relative = Vec::with_capacity(image.pixels.len());
        for (pixel, reference) in image.pixels.iter().zip(&reference.pixels) {
            let mut pixel_relative = 0.0;
            for (&x, &r) in pixel.iter().zip(reference) {
                let (x, r) = (f64::from(x), f64::from(r));
                let error = (x - r) * (x - r);
                squared += error;
                pixel_relative += error / (r * r + RELATIVE_EPSILON);
            }
            relative.push(pixel_relative / 3.0);
        }
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let (mse, relmse) = (squared / (3 * relative.len()) as f64, mean(&relative));
        let trimmed = (relative.len() as f64 * TRIMMED_FRACTION) as usize;
        let relmse_trimmed = if relmse.is_finite() {
            let kept = relative.len() - trimmed;
            if trimmed > 0 {
                relative.select_nth_unstable_by(kept, f64::total_cmp);
            }
            mean(&relative[..kept])
        } else {
            relmse
        };
        Ok(Self { mse, relmse, relmse_trimmed })
    }
}

/// Returns the time to unit variance, `mse * seconds`.
///
/// With independent samples, MSE is inversely proportional to time: the product does not depend on the
/// budget, and its ratio between two samplers is the ratio of their times to equal MSE. With Sobol points MSE
/// falls faster, and the product is comparable only at about equal times.
pub fn ttuv(mse: f64, seconds: f64) -> f64 {
    mse * seconds
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(values: &[f32]) -> Image {
        Image { width: values.len(), height: 1, pixels: values.iter().map(|&v| [v; 3]).collect() }
    }

    #[test]
    fn errors_match_the_formulas() {
        let metrics = ErrorMetrics::of(&grey(&[1.0, 3.0]), &grey(&[0.0, 1.0])).unwrap();
        assert!((metrics.mse - 2.5).abs() < 1e-12);
        assert!((metrics.relmse - 0.5 * (1.0 / 0.01 + 4.0 / 1.01)).abs() < 1e-9);
        assert_eq!(metrics.relmse, metrics.relmse_trimmed, "2 pixels are too few to trim");
    }

    #[test]
    fn channels_have_equal_weight() {
        let image = |pixel| Image { width: 1, height: 1, pixels: vec![pixel] };
        for pixel in [[3.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 3.0]] {
            assert!((ErrorMetrics::of(&image(pixel), &image([0.0; 3])).unwrap().mse - 3.0).abs() < 1e-12);
        }
    }

    #[test]
    fn trimming_removes_one_outlier_in_a_thousand_and_no_more() {
        let reference = grey(&[1.0; 2000]);
        let mut values = [1.5_f32; 2000];
        let clean = ErrorMetrics::of(&grey(&values), &reference).unwrap();
        (values[17], values[1999]) = (1e4, 1e5);
        let dirty = ErrorMetrics::of(&grey(&values), &reference).unwrap();
        assert!((dirty.relmse_trimmed - clean.relmse).abs() < 1e-12);
        assert!(dirty.relmse > 1e3);
        values[3] = 1e3;
        assert!(ErrorMetrics::of(&grey(&values), &reference).unwrap().relmse_trimmed > 100.0);
    }

    #[test]
    fn broken_pixels_are_not_hidden() {
        let reference = grey(&[1.0; 3000]);
        for broken in [f32::NAN, f32::INFINITY] {
            let mut values = [1.0_f32; 3000];
            values[5] = broken;
            let metrics = ErrorMetrics::of(&grey(&values), &reference).unwrap();
            assert!(!metrics.mse.is_finite() && !metrics.relmse.is_finite() && !metrics.relmse_trimmed.is_finite());
        }
    }

    #[test]
    fn different_and_empty_sizes_are_rejected() {
        assert!(ErrorMetrics::of(&Image::black(2, 3), &Image::black(3, 2)).is_err());
        assert!(ErrorMetrics::of(&Image::black(0, 0), &Image::black(0, 0)).is_err());
    }
}
