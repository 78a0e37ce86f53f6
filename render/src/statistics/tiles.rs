//! Test that two samplers converge to the same picture: a t-test per tile, with significance corrected for
//! the number of tiles.
//!
//! The mean over some hundred pixels is close to normally distributed even when single pixels are not, and a
//! bias of 0.1 %, invisible in a pixel, is significant. Tests are on luminance.

use std::fmt;

use super::{Moments, TTest, sidak};
use crate::color::luminance;
use crate::error::{Error, Result};
use crate::image::Image;

/// The outcome of a comparison tile by tile.
#[derive(Clone, Debug, PartialEq)]
pub struct TileTest {
    /// Number of columns of tiles.
    pub columns: usize,
    /// Number of rows of tiles.
    pub rows: usize,
    /// `[rows * columns]` tests, from the top left.
    pub tests: Vec<TTest>,
    /// Tiles with smaller p-values differ; the significance of the whole comparison after Sidak's correction.
    pub threshold: f64,
}

impl TileTest {
    fn new((columns, rows): (usize, usize), tests: Vec<TTest>, significance: f64) -> Self {
        let threshold = sidak(significance, tests.len());
        Self { columns, rows, tests, threshold }
    }

    /// Returns whether no tile differs.
    pub fn passed(&self) -> bool {
        self.worst().2 >= self.threshold
    }

    /// Returns column, row and p-value of the tile with the smallest p-value.
    pub fn worst(&self) -> (usize, usize, f64) {
        let (index, test) = self
            .tests
            .iter()
            .enumerate()
            .min_by(|a, b| a.1.p_value.total_cmp(&b.1.p_value))
            .expect("a comparison has at least one tile");
        (index % self.columns, index / self.columns, test.p_value)
    }

    /// Returns the number of tiles that differ.
    pub fn differing(&self) -> usize {
        self.tests.iter().filter(|test| test.p_value < self.threshold).count()
    }
}

impl fmt::Display for TileTest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (column, row, p) = self.worst();
        let (differing, all, threshold) = (self.differing(), self.tests.len(), self.threshold);
        let t = self.tests[row * self.columns + column].t;
        write!(f, "{differing} of {all} tiles differ; smallest p = {p:.2e} (threshold {threshold:.2e}, t = {t:.2}) ")?;
        write!(f, "at tile ({column}, {row}) of {} x {}", self.columns, self.rows)
    }
}

/// Compares two samplers by one rendering each of the same view: in each tile, a t-test that the differences
/// of their pixels have mean zero.
///
/// Texture and shading cancel in the difference, so that only noise remains. Of each difference,
/// 0.2 % of the luminance of the median tile of `b` are not counted. Pixels must be independent: the
/// reconstruction filter must be a box. `tile` is the minimum width and height
/// of a tile in pixels; 16 is a good choice. `significance` is the probability of a false rejection, for
/// example 0.01.
///
/// # Errors
/// [`Error::Argument`] if sizes differ, or tiles would have fewer than 8 pixels.
pub fn compare_images(a: &Image, b: &Image, tile: usize, significance: f64) -> Result<TileTest> {
    check_sizes(&[a, b])?;
    let (size, tiles) = tiles(a, tile)?;
    let mut means: Vec<f64> = tiles.iter().map(|tile| tile.mean(b).abs()).collect();
    means.sort_by(f64::total_cmp);
    let typical = means[means.len() / 2];
    // Values that are not finite are no excuse.
    let negligible = if typical.is_finite() { NEGLIGIBLE * typical } else { 0.0 };
    let tests = tiles
        .into_iter()
        .map(|tile| {
            let (a, b) = (tile.luminances(a), tile.luminances(b));
            let differences: Vec<f64> = a.iter().zip(&b).map(|(a, b)| a - b).collect();
            let scale = a.iter().zip(&b).map(|(a, b)| a.abs().max(b.abs())).sum::<f64>() / a.len() as f64;
            let own = Moments::of(&differences).expect("tiles have pixels");
            TTest::paired(&Moments { mean: own.mean - own.mean.clamp(-negligible, negligible), ..own }, scale)
        })
        .collect();
    Ok(TileTest::new(size, tests, significance))
}

/// Compares two samplers by runs of different seeds: in each tile, Welch's t-test on the tile's mean in each
/// run.
///
/// Pixels of a run need not be independent. At least two runs of each sampler are required, about ten for a
/// sensitive test. The runs of `a` must not share random numbers with those of `b`. For `tile`,
/// `significance` and errors see [`compare_images`].
///
/// # Errors
/// [`Error::Argument`] also for fewer than two runs.
pub fn compare_runs(a: &[Image], b: &[Image], tile: usize, significance: f64) -> Result<TileTest> {
    if a.len() < 2 || b.len() < 2 {
        return Err(Error::argument("runs", format!("{} and {} runs; two of each are needed", a.len(), b.len())));
    }
    check_sizes(&a.iter().chain(b).collect::<Vec<_>>())?;
    let (size, tiles) = tiles(&a[0], tile)?;
    let tests = tiles
        .into_iter()
        .map(|tile| {
            let moments = |runs: &[Image]| {
                let means: Vec<f64> = runs.iter().map(|run| tile.mean(run)).collect();
                Moments::of(&means).expect("there are two runs")
            };
            TTest::welch(&moments(a), &moments(b))
        })
        .collect();
    Ok(TileTest::new(size, tests, significance))
}

/// Minimum number of pixels of a tile.
const LEAST_PIXELS: usize = 8;
/// Fraction of the mean luminance of the median tile that [`compare_images`] takes from every difference: a tile
/// with so little light has it in rare samples, whose mean is not normal.
const NEGLIGIBLE: f64 = 2e-3;

/// A rectangle of pixels.
struct Tile {
    x: std::ops::Range<usize>,
    y: std::ops::Range<usize>,
}

impl Tile {
    fn luminances(&self, image: &Image) -> Vec<f64> {
        let pixels = self.y.clone().flat_map(|y| self.x.clone().map(move |x| (x, y)));
        pixels.map(|(x, y)| f64::from(luminance(image.get(x, y)))).collect()
    }

    fn mean(&self, image: &Image) -> f64 {
        let luminances = self.luminances(image);
        luminances.iter().sum::<f64>() / luminances.len() as f64
    }
}

/// Divides an image evenly into tiles at least `least` wide and high (or as large as the image).
fn tiles(image: &Image, least: usize) -> Result<((usize, usize), Vec<Tile>)> {
    let count = |length: usize| (length / least.max(1)).max(1);
    let (columns, rows) = (count(image.width), count(image.height));
    if (image.width / columns) * (image.height / rows) < LEAST_PIXELS {
        return Err(Error::argument("tile", format!("{least} pixels; a tile must have {LEAST_PIXELS} or more")));
    }
    let range = |i: usize, count: usize, length: usize| i * length / count..(i + 1) * length / count;
    let tile = |row, column| Tile { x: range(column, columns, image.width), y: range(row, rows, image.height) };
    let tiles = (0..rows).flat_map(|row| (0..columns).map(move |column| tile(row, column))).collect();
    Ok(((columns, rows), tiles))
}

fn check_sizes(images: &[&Image]) -> Result<()> {
    let size = |image: &Image| (image.width, image.height);
    match images.iter().find(|image| size(image) != size(images[0])) {
        None => Ok(()),
        Some(other) => {
            let reason = format!("sizes differ: {:?} and {:?}", size(images[0]), size(other));
            Err(Error::argument("images", reason))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Stream};

    /// Returns a textured image with exponential noise, times `factor` inside a disc.
    fn noisy(seed: u64, factor: f32) -> Image {
        let mut random = Stream::new(seed, Purpose::Test, 5);
        let mut image = Image::black(130, 70);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            let (x, y) = ((i % 130) as f32, (i / 130) as f32);
            let truth = 0.2 + ((x * 0.3).sin() * (y * 0.2).cos()).powi(2);
            let biased = if (x - 40.0).hypot(y - 30.0) < 20.0 { truth * factor } else { truth };
            *pixel = [-(1.0 - random.uniform()).ln() * biased; 3];
        }
        image
    }

    #[test]
    fn equal_samplers_pass_and_a_local_bias_is_found() {
        let test = compare_images(&noisy(1, 1.0), &noisy(2, 1.0), 16, 0.01).unwrap();
        assert!(test.passed(), "{test}");
        assert_eq!((test.columns, test.rows, test.tests.len()), (8, 4, 32));
        let test = compare_images(&noisy(1, 1.0), &noisy(2, 1.5), 16, 0.01).unwrap();
        assert!(!test.passed() && test.differing() < 8, "{test}");
        let (column, row, _) = test.worst();
        assert!((1..=3).contains(&column) && (0..=2).contains(&row), "the bias is around (40, 30): {test}");
    }

    #[test]
    fn rare_light_in_a_dark_tile_is_negligible_and_much_of_it_is_not() {
        let lit = |light: f32| {
            let mut image = noisy(1, 1.0);
            for (i, pixel) in image.pixels.iter_mut().enumerate().filter(|(i, _)| i % 130 < 16 && i / 130 < 17) {
                // As from one sample in the pixels that have any.
                *pixel = if i % 9 == 0 { [light; 3] } else { [0.0; 3] };
            }
            image
        };
        let found = |light: f32| !compare_images(&lit(0.0), &lit(light), 16, 0.01).unwrap().passed();
        // Of the median tile, which is near 0.6: 0.1 %, 1 %.
        assert!(!found(6e-3) && found(6e-2));
    }

    #[test]
    fn runs_find_a_smaller_bias_than_single_images() {
        let runs = |first: u64, factor: f32| (first..first + 10).map(|seed| noisy(seed, factor)).collect::<Vec<_>>();
        let (a, same, biased) = (runs(0, 1.0), runs(100, 1.0), runs(200, 1.15));
        let test = compare_runs(&a, &same, 16, 0.01).unwrap();
        assert!(test.passed(), "{test}");
        let test = compare_runs(&a, &biased, 16, 0.01).unwrap();
        assert!(!test.passed(), "{test}");
        assert!(compare_images(&a[0], &biased[0], 16, 0.01).unwrap().passed());
    }

    #[test]
    fn false_rejections_are_not_more_frequent_than_the_significance() {
        let rejected = (0..200)
            .filter(|seed| {
                !compare_images(&noisy(2 * seed, 1.0), &noisy(2 * seed + 1, 1.0), 16, 0.05).unwrap().passed()
            })
            .count();
        // 10 expected; four binomial standard deviations (3.1) above.
        assert!(rejected <= 22, "{rejected} of 200");
    }

    #[test]
    fn constant_images_are_compared_up_to_rounding_and_nan_pixels_fail() {
        let constant = |value: f32| Image { width: 32, height: 32, pixels: vec![[value; 3]; 1024] };
        assert!(compare_images(&constant(1.0), &constant(1.000_001), 16, 0.01).unwrap().passed());
        assert!(!compare_images(&constant(1.0), &constant(1.01), 16, 0.01).unwrap().passed());
        let mut broken = constant(1.0);
        broken.pixels[100] = [f32::NAN; 3];
        assert!(!compare_images(&constant(1.0), &broken, 16, 0.01).unwrap().passed());
    }

    #[test]
    fn invalid_sizes_are_rejected() {
        let image = |w, h| Image::black(w, h);
        assert!(compare_images(&image(32, 32), &image(32, 31), 16, 0.01).is_err());
        assert!(compare_images(&image(32, 32), &image(32, 32), 2, 0.01).is_err());
        assert!(compare_images(&image(0, 0), &image(0, 0), 16, 0.01).is_err());
        assert!(compare_images(&image(5, 3), &image(5, 3), 16, 0.01).is_ok(), "one tile of the whole image");
        assert!(compare_runs(&[image(32, 32)], &[image(32, 32), image(32, 32)], 16, 0.01).is_err());
    }
}
