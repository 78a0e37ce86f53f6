//! LDR-FLIP, the perceived difference of two alternating pictures (Andersson, Nilsson, Akenine-Möller,
//! Oskarsson, Åström and Fairchild 2020, "FLIP: A Difference Evaluator for Alternating Images"); the basis of
//! [`super::HdrFlip`].

use std::f64::consts::PI;

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::image::Image;

/// Pixels per degree of the paper's observer: 0.7 m from a monitor that is 0.7 m and 3840 pixels wide.
pub const PIXELS_PER_DEGREE: f64 = 67.0;

/// Linear sRGB to XYZ, the exact matrix of the primaries and of D65.
const XYZ_OF_RGB: [[f64; 3]; 3] = [
    [10_135_552.0 / 24_577_794.0, 8_788_810.0 / 24_577_794.0, 4_435_075.0 / 24_577_794.0],
    [2_613_072.0 / 12_288_897.0, 8_788_810.0 / 12_288_897.0, 887_015.0 / 12_288_897.0],
    [1_425_312.0 / 73_733_382.0, 8_788_810.0 / 73_733_382.0, 70_074_185.0 / 73_733_382.0],
];
/// Inverse of [`XYZ_OF_RGB`].
const RGB_OF_XYZ: [[f64; 3]; 3] = [
    [3.241_003_275, -1.537_398_935, -0.498_615_861],
    [-0.969_224_271, 1.875_929_983, 0.041_554_226],
    [0.055_639_423, -0.204_011_209, 1.057_148_934],
];
/// Contrast sensitivity as `(a, b)` of two Gaussians `a sqrt(pi / b) exp(-pi^2 x^2 / b)`, x in degrees, for
/// the achromatic, red-green and blue-yellow channels.
const SENSITIVITY: [[(f64, f64); 2]; 3] =
    [[(1.0, 0.0047), (0.0, 1e-5)], [(1.0, 0.0053), (0.0, 1e-5)], [(34.1, 0.04), (13.5, 0.025)]];
/// Width of the edge and point detectors, in degrees.
const FEATURE_WIDTH: f64 = 0.082;
/// The exponent of colour differences.
const Q_COLOUR: f64 = 0.7;
/// The exponent of feature differences.
const Q_FEATURE: f64 = 0.5;
/// Colour differences up to this fraction of the largest one ...
const P_COLOUR: f64 = 0.4;
/// ... map to this fraction of the range.
const P_RANGE: f64 = 0.95;

/// Returns the difference of each pixel, in `[0, 1]`, as `[height * width]`.
///
/// Both pictures are display-referred linear RGB (Rec.709); values are clamped to `[0, 1]`, and NaN counts as
/// 0.
///
/// # Errors
/// If the sizes differ, or `pixels_per_degree` is not between 1 and 1000.
pub fn flip(reference: &Image, test: &Image, pixels_per_degree: f64) -> Result<Vec<f64>> {
    check(reference, test, pixels_per_degree)?;
    let [a, b] = [reference, test].map(|image| Seen::of(image, pixels_per_degree));
    Ok(difference(&a, &b))
}

/// Checks the arguments of [`flip`].
pub(super) fn check(reference: &Image, test: &Image, pixels_per_degree: f64) -> Result<()> {
    let failed = |what: &str, reason: String| Err(Error::Argument { what: what.into(), reason });
    if (reference.width, reference.height) != (test.width, test.height) {
        let sizes = [reference, test].map(|image| format!("{} x {}", image.width, image.height));
        return failed("test", format!("is {} pixels, the reference {}", sizes[1], sizes[0]));
    }
    if !(1.0..=1000.0).contains(&pixels_per_degree) {
        return failed("pixels_per_degree", format!("is {pixels_per_degree}; must be between 1 and 1000"));
    }
    Ok(())
}

/// Returns the difference of each pixel.
pub(super) fn difference(a: &Seen, b: &Seen) -> Vec<f64> {
    let largest = colour_distance(hunt(lab([0.0, 1.0, 0.0])), hunt(lab([0.0, 0.0, 1.0]))).powf(Q_COLOUR);
    let knee = P_COLOUR * largest;
    let pixel = |k: usize| {
        let distance = colour_distance(a.colours[k], b.colours[k]).powf(Q_COLOUR);
        let colour = if distance < knee {
            P_RANGE / knee * distance
        } else {
            P_RANGE + (distance - knee) / (largest - knee) * (1.0 - P_RANGE)
        };
        let feature = (a.edges[k] - b.edges[k]).abs().max((a.points[k] - b.points[k]).abs());
        let feature = (feature / 2.0_f64.sqrt()).powf(Q_FEATURE).min(1.0);
        colour.powf(1.0 - feature)
    };
    (0..a.edges.len()).map(pixel).collect()
}

/// The perceived colours and features of a picture.
pub(super) struct Seen {
    /// L*a*b* after contrast sensitivity and Hunt's effect.
    colours: Vec<[f64; 3]>,
    /// Strength of edges.
    edges: Vec<f64>,
    /// Strength of points.
    points: Vec<f64>,
}

impl Seen {
    /// Computes the perception of linear RGB, clamped to `[0, 1]`.
    pub(super) fn of(image: &Image, pixels_per_degree: f64) -> Self {
        let size = (image.width, image.height);
        let clamp = |c: f32| if c.is_nan() { 0.0 } else { f64::from(c.clamp(0.0, 1.0)) };
        let opponent: Vec<[f64; 3]> = image.pixels.iter().map(|pixel| opponent(pixel.map(clamp))).collect();
        let plane = |c: usize| -> Vec<f64> { opponent.iter().map(|pixel| pixel[c]).collect() };
        let planes = [0, 1, 2].map(|c| sensitivity(&plane(c), size, SENSITIVITY[c], pixels_per_degree));
        let colour = |k: usize| hunt(lab(rgb_of_opponent(planes.each_ref().map(|plane| plane[k])).map(unit)));
        // The achromatic channel, scaled to `[0, 1]`.
        let light: Vec<f64> = opponent.iter().map(|pixel| (pixel[0] + 16.0) / 116.0).collect();
        let [edges, points] = features(&light, size, pixels_per_degree);
        Self { colours: (0..opponent.len()).map(colour).collect(), edges, points }
    }
}

fn unit(value: f64) -> f64 {
    value.clamp(0.0, 1.0)
}

fn product(matrix: &[[f64; 3]; 3], [x, y, z]: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * x + row[1] * y + row[2] * z)
}

/// Returns the XYZ of white.
fn white() -> [f64; 3] {
    product(&XYZ_OF_RGB, [1.0; 3])
}

/// Converts to YCxCz: an achromatic and two opponent channels, linear in RGB.
fn opponent(rgb: [f64; 3]) -> [f64; 3] {
    let ([x, y, z], [xn, yn, zn]) = (product(&XYZ_OF_RGB, rgb), white());
    [116.0 * y / yn - 16.0, 500.0 * (x / xn - y / yn), 200.0 * (y / yn - z / zn)]
}

fn rgb_of_opponent([achromatic, cx, cz]: [f64; 3]) -> [f64; 3] {
    let [xn, yn, zn] = white();
    let y = (achromatic + 16.0) / 116.0;
    product(&RGB_OF_XYZ, [xn * (y + cx / 500.0), yn * y, zn * (y - cz / 200.0)])
}

/// Converts to CIE 1976 L*a*b* under D65.
fn lab(rgb: [f64; 3]) -> [f64; 3] {
    const DELTA: f64 = 6.0 / 29.0;
    let curve = |t: f64| if t > DELTA.powi(3) { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
    let (xyz, white) = (product(&XYZ_OF_RGB, rgb), white());
    let [x, y, z] = [0, 1, 2].map(|c| curve(xyz[c] / white[c]));
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Applies the Hunt effect: bright colours look more saturated.
fn hunt([l, a, b]: [f64; 3]) -> [f64; 3] {
    [l, 0.01 * l * a, 0.01 * l * b]
}

/// Returns the HyAB distance of colours (Abasi, Amani Tehran and Fairchild 2020), which suits large
/// differences.
fn colour_distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

/// Filters a channel by the contrast sensitivity.
fn sensitivity(plane: &[f64], size: (usize, usize), terms: [(f64, f64); 2], pixels_per_degree: f64) -> Vec<f64> {
    let widest = SENSITIVITY.iter().flatten().map(|term| term.1).fold(0.0, f64::max);
    let radius = (3.0 * (widest / (2.0 * PI * PI)).sqrt() * pixels_per_degree).ceil() as i32;
    let mut sum = vec![0.0; plane.len()];
    let mut total = 0.0;
    // Each term is separable; their sum is not.
    for (a, b) in terms.into_iter().filter(|term| term.0 > 0.0) {
        let kernel: Vec<f64> =
            (-radius..=radius).map(|k| (-(PI * f64::from(k) / pixels_per_degree).powi(2) / b).exp()).collect();
        let weight = a * (PI / b).sqrt();
        total += weight * kernel.iter().sum::<f64>().powi(2);
        let blurred = separable(plane, size, &kernel, &kernel);
        sum.iter_mut().zip(blurred).for_each(|(sum, value)| *sum += weight * value);
    }
    sum.into_iter().map(|value| value / total).collect()
}

/// Returns the strengths of edges and of points.
fn features(light: &[f64], size: (usize, usize), pixels_per_degree: f64) -> [Vec<f64>; 2] {
    let deviation = 0.5 * FEATURE_WIDTH * pixels_per_degree;
    let radius = (3.0 * deviation).ceil() as i32;
    let of = |shape: fn(f64) -> f64| -> Vec<f64> {
        (-radius..=radius).map(|k| f64::from(k) / deviation).map(|t| shape(t) * (-0.5 * t * t).exp()).collect()
    };
    // Normalises positive weights to the sum 1 and negative ones to -1.
    let balanced = |kernel: Vec<f64>| -> Vec<f64> {
        let of_sign = |sign: f64| kernel.iter().map(|w| (sign * w).max(0.0)).sum::<f64>();
        let [positive, negative] = [of_sign(1.0), of_sign(-1.0)];
        kernel.iter().map(|&w| if w > 0.0 { w / positive } else { w / negative.max(f64::MIN_POSITIVE) }).collect()
    };
    let across = balanced(of(|_| 1.0));
    [balanced(of(|t| -t)), balanced(of(|t| t * t - 1.0))].map(|along| {
        let [x, y] = [separable(light, size, &along, &across), separable(light, size, &across, &along)];
        x.into_iter().zip(y).map(|(x, y)| x.hypot(y)).collect()
    })
}

/// Correlates a plane with the product of two kernels of odd length, with clamped edges.
fn separable(plane: &[f64], (width, height): (usize, usize), horizontal: &[f64], vertical: &[f64]) -> Vec<f64> {
    let at = |place: usize, k: usize, radius: usize, end: usize| (place + k).saturating_sub(radius).min(end - 1);
    let mut rows = vec![0.0; plane.len()];
    rows.par_chunks_mut(width).zip(plane.par_chunks(width)).for_each(|(out, row)| {
        for (x, out) in out.iter_mut().enumerate() {
            let terms = horizontal.iter().enumerate();
            *out = terms.map(|(k, weight)| weight * row[at(x, k, horizontal.len() / 2, width)]).sum();
        }
    });
    let mut out = vec![0.0; plane.len()];
    out.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (k, weight) in vertical.iter().enumerate() {
            let from = at(y, k, vertical.len() / 2, height) * width;
            out.iter_mut().zip(&rows[from..from + width]).for_each(|(out, value)| *out += weight * value);
        }
    });
    out
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    fn image(width: usize, height: usize, pixel: impl Fn(usize, usize) -> [f32; 3]) -> Image {
        let pixels = (0..width * height).map(|k| pixel(k % width, k / width)).collect();
        Image { width, height, pixels }
    }

    /// Returns a pattern with colours, edges and points, and a copy with a grid of darker pixels and a green
    /// patch.
    pub fn pair() -> [Image; 2] {
        let part = |value: usize, of: usize| (value % of) as f32 / (of - 1) as f32;
        let reference = image(41, 29, |x, y| {
            let bright = if x < 20 { 0.25 } else { 1.0 };
            [part(7 * x + 3 * y, 32), part(5 * x + 11 * y, 16), part(x + y * y, 24)].map(|c| c * bright)
        });
        let mut test = reference.clone();
        for (k, pixel) in test.pixels.iter_mut().enumerate() {
            let (x, y) = (k % 41, k / 41);
            if x % 4 == 0 && y % 3 == 0 {
                *pixel = pixel.map(|c| 0.5 * c);
            }
            if (22..30).contains(&x) && (10..14).contains(&y) {
                pixel[1] = 0.9;
            }
        }
        [reference, test]
    }

    #[test]
    fn values_match_the_authors_implementation() {
        // Values of the C++ version, in f32, and of numpy and scipy in double precision with two-dimensional
        // kernels; the two agree in all digits but one. Pixels here are rounded to f32 and the inverse matrix
        // to nine digits, which the exponent 0.5 of features of about 1e-7 turns into at most 3e-4; the
        // observed error is 1e-5.
        let [reference, test] = pair();
        let map = flip(&reference, &test, PIXELS_PER_DEGREE).unwrap();
        let mean = map.iter().sum::<f64>() / map.len() as f64;
        let found = [map[0], map[12 * 41 + 25], map[20 * 41 + 5], map[28 * 41 + 40], mean];
        let expected = [0.028_940, 0.918_520, 0.072_564, 0.111_773, 0.149_795];
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() < 3e-5, "{found} {expected}");
        }
        let near = flip(&reference, &test, 40.0).unwrap();
        assert!((near.iter().sum::<f64>() / near.len() as f64 - 0.141_536).abs() < 3e-5);
    }

    #[test]
    fn equal_pictures_have_difference_0_and_black_and_white_nearly_1() {
        let [reference, test] = pair();
        assert!(flip(&reference, &reference, PIXELS_PER_DEGREE).unwrap().iter().all(|&value| value == 0.0));
        assert!(flip(&reference, &test, PIXELS_PER_DEGREE).unwrap().iter().all(|value| (0.0..=1.0).contains(value)));
        // 100^0.7 = 25.119 of 41.276, the distance of green and blue to the same power: 0.95 + 0.05 (25.119 -
        // 16.510) / 24.766.
        let [black, white] = [0.0, 1.0].map(|value| image(9, 9, |_, _| [value; 3]));
        let found = flip(&black, &white, PIXELS_PER_DEGREE).unwrap();
        assert!(found.iter().all(|value| (value - 0.967_38).abs() < 1e-5), "{found:?}");
    }

    #[test]
    fn different_sizes_and_invalid_distances_are_rejected() {
        let [reference, _] = pair();
        let error = flip(&reference, &image(29, 41, |_, _| [0.0; 3]), 67.0).unwrap_err().to_string();
        assert_eq!(error, "test: is 29 x 41 pixels, the reference 41 x 29");
        assert!(flip(&reference, &reference, 0.0).is_err() && flip(&reference, &reference, f64::NAN).is_err());
        let one = image(1, 1, |_, _| [f32::NAN; 3]);
        assert_eq!(flip(&one, &one, 67.0).unwrap(), [0.0]);
    }
}
