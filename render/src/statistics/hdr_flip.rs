//! HDR-FLIP, the perceived difference of two renderings at any exposure (Andersson, Nilsson, Shirley and
//! Akenine-Möller 2021, "Visualizing Errors in Rendered High Dynamic Range Images"): the largest LDR-FLIP
//! over a range of exposures that the reference determines.

use glam::Vec3A;

use super::flip::{Seen, check, difference};
use crate::color::luminance;
use crate::error::Result;
use crate::image::Image;

/// Tone curve `(a x^2 + b x) / (c x^2 + d x + e)`: Narkowicz's fit to ACES, as in the paper.
const CURVE: [f64; 5] = [0.36 * 2.51, 0.6 * 0.03, 0.36 * 2.43, 0.6 * 0.59, 0.14];
/// Displayed value of the brightest pixel at the first exposure and of the median at the last one.
const SHOWN: f64 = 0.85;
/// Maximum number of exposures: a range of 2^32, more than f32 renderings use. Each stores five numbers per
/// pixel.
const MOST_EXPOSURES: usize = 32;

/// A reference as perceived at all of its exposures.
pub struct HdrFlip {
    size: (usize, usize),
    pixels_per_degree: f64,
    /// Each exposure in stops, with the perceived reference.
    exposures: Vec<(f64, Seen)>,
}

impl HdrFlip {
    /// Prepares a reference of linear RGB; negative values and NaN count as 0, infinity as the largest
    /// number.
    ///
    /// # Errors
    /// If `pixels_per_degree` is not between 1 and 1000.
    pub fn new(reference: &Image, pixels_per_degree: f64) -> Result<Self> {
        check(reference, reference, pixels_per_degree)?;
        let seen = |stops: f64| (stops, Seen::of(&shown(reference, stops), pixels_per_degree));
        let exposures = exposures(reference).into_iter().map(seen).collect();
        Ok(Self { size: (reference.width, reference.height), pixels_per_degree, exposures })
    }

    /// Returns the exposures in stops, from dark to bright.
    pub fn exposures(&self) -> impl Iterator<Item = f64> + '_ {
        self.exposures.iter().map(|(stops, _)| *stops)
    }

    /// Returns the difference of each pixel of a rendering, in `[0, 1]`, as `[height * width]`.
    ///
    /// # Errors
    /// If its size differs from the reference's.
    pub fn of(&self, test: &Image) -> Result<Vec<f64>> {
        let (width, height) = self.size;
        check(&Image { width, height, pixels: Vec::new() }, test, self.pixels_per_degree)?;
        let mut worst = vec![0.0_f64; width * height];
        for (stops, reference) in &self.exposures {
            let found = difference(reference, &Seen::of(&shown(test, *stops), self.pixels_per_degree));
            worst.iter_mut().zip(found).for_each(|(worst, found)| *worst = worst.max(found));
        }
        Ok(worst)
    }
}

/// Returns the exposures of a reference: the brightest pixel maps to 0.85 at the first one, the median at the
/// last one. If half of the picture is black, for which no such exposure exists, the median is that of the
/// other pixels.
fn exposures(reference: &Image) -> Vec<f64> {
    let mut luminances: Vec<f32> = reference.pixels.iter().map(|&pixel| luminance(usable(pixel))).collect();
    luminances.sort_by(f32::total_cmp);
    let Some(&brightest) = luminances.last().filter(|brightest| **brightest > 0.0) else { return vec![0.0] };
    let dark = luminances.partition_point(|&l| l <= 0.0);
    let middle = luminances.len() / 2;
    let median = luminances[if middle < dark { (dark + luminances.len()) / 2 } else { middle }];
    let [a, b, c, d, e] = CURVE;
    // The positive root of a quadratic equation.
    let (a, b, c) = (a - SHOWN * c, b - SHOWN * d, -SHOWN * e);
    let half = 0.5 * b / a;
    let value = -half + (half * half - c / a).sqrt();
    let [first, last] = [brightest, median].map(|l| (value / f64::from(l)).log2());
    let count = ((last - first).ceil() as usize).clamp(2, MOST_EXPOSURES);
    (0..count).map(|k| first + (last - first) * k as f64 / (count - 1) as f64).collect()
}

fn usable(pixel: [f32; 3]) -> Vec3A {
    let one = |c: f32| if c.is_nan() { 0.0 } else { c.clamp(0.0, f32::MAX) };
    Vec3A::from_array(pixel.map(one))
}

/// Returns the linear display values at an exposure.
fn shown(image: &Image, stops: f64) -> Image {
    let factor = stops.exp2();
    let [a, b, c, d, e] = CURVE;
    let channel = |value: f32| {
        let x = (f64::from(value) * factor).min(1e9);
        ((a * x + b) * x / ((c * x + d) * x + e)) as f32
    };
    Image { pixels: image.pixels.iter().map(|&pixel| usable(pixel).to_array().map(channel)).collect(), ..*image }
}

#[cfg(test)]
mod tests {
    use super::super::flip::tests::pair;
    use super::*;

    /// Returns the pictures of the test of LDR-FLIP, brighter by 10 stops from left to right.
    fn bright_pair() -> [Image; 2] {
        pair().map(|mut image| {
            for (k, pixel) in image.pixels.iter_mut().enumerate() {
                *pixel = pixel.map(|c| c * (((k % 41) as f32 - 20.0) / 4.0).exp2());
            }
            image
        })
    }

    #[test]
    fn values_match_the_authors_implementation() {
        // Values of the C++ version, in f32: its LDR values have errors of up to 1e-6, which the exponent 0.5
        // of small features amplifies.
        let [reference, test] = bright_pair();
        for (pixels_per_degree, expected) in [
            (67.0, [0.006_336, 0.752_940, 0.068_636, 0.133_044, 0.126_485]),
            (40.0, [0.000_631, 0.890_446, 0.043_363, 0.136_685, 0.122_746]),
        ] {
            let flip = HdrFlip::new(&reference, pixels_per_degree).unwrap();
            let exposures: Vec<f64> = flip.exposures().collect();
            assert!(exposures.len() == 8 && (exposures[0] + 3.821_35).abs() < 1e-4, "{exposures:?}");
            assert!((exposures[7] - 3.271_28).abs() < 1e-4, "{exposures:?}");
            let map = flip.of(&test).unwrap();
            let mean = map.iter().sum::<f64>() / map.len() as f64;
            let found = [map[0], map[12 * 41 + 25], map[20 * 41 + 5], map[28 * 41 + 40], mean];
            for (found, expected) in found.into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-4, "{found} {expected}");
            }
        }
    }

    #[test]
    fn a_common_exposure_does_not_change_differences() {
        let [reference, test] = bright_pair();
        let of = |factor: f32| {
            let [reference, test] = [&reference, &test].map(|image| Image {
                pixels: image.pixels.iter().map(|pixel| pixel.map(|c| c * factor)).collect(),
                ..*image
            });
            HdrFlip::new(&reference, 67.0).unwrap().of(&test).unwrap()
        };
        // A power of two scales pixels exactly; exposures have rounding errors.
        assert!(of(1.0).iter().zip(of(1024.0)).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    #[test]
    fn black_images_and_invalid_pixels_have_finite_differences() {
        let one = |value: f32| Image { width: 3, height: 1, pixels: vec![[value; 3], [0.0; 3], [0.0; 3]] };
        assert_eq!(HdrFlip::new(&one(0.0), 67.0).unwrap().of(&one(0.0)).unwrap(), [0.0; 3]);
        let bright = HdrFlip::new(&one(5.0), 67.0).unwrap();
        assert!(bright.exposures().count() == 2 && bright.exposures().all(f64::is_finite));
        for odd in [f32::NAN, f32::INFINITY, -1.0, f32::MAX] {
            assert!(bright.of(&one(odd)).unwrap().iter().all(|value| (0.0..=1.0).contains(value)), "{odd}");
        }
        assert!(bright.of(&Image::black(4, 4)).is_err() && HdrFlip::new(&one(1.0), 0.5).is_err());
    }
}
