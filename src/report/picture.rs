//! The pictures of the page: renderings at one exposure, and false-colour error maps on one scale.

use anyhow::{Result, ensure};
use base64::Engine;
use glam::Vec3A;
use headtail_render::color::{srgb_decode, tone_map};
use headtail_render::image::{Image, encode_png, encode_png_rgb8};
use headtail_render::statistics::{PIXELS_PER_DEGREE, RELATIVE_EPSILON, flip};

use super::colours::ERROR;
use super::comparison::Comparison;

/// Maximum width of an error map. Errors are averaged over squares of pixels, since the error of a single
/// pixel is mostly noise.
pub const ERROR_MAP_WIDTH: usize = 160;

/// Decades that the error maps span.
const ERROR_DECADES: f64 = 4.0;

/// The colour of unmeasured pixels.
const UNMEASURED: [u8; 3] = [0x80, 0x80, 0x80];

/// The colour of NaN, which is not in the colour map.
const BROKEN: [u8; 3] = [0x00, 0xff, 0xff];

/// Encodes a PNG as a `data:` address for an `<img>`.
pub fn data_address(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", base64::engine::general_purpose::STANDARD.encode(png))
}

/// Encodes a rendering at an exposure as a `data:` address.
pub fn rendering(image: &Image, exposure: f32) -> Result<String> {
    Ok(data_address(&encode_png(image, exposure)?))
}

/// Converts an image to displayed linear values in `[0, 1]`.
fn display(image: &Image, exposure: f32) -> Image {
    let shown = |&pixel: &[f32; 3]| {
        tone_map(Vec3A::from_array(pixel) * exposure.exp2()).map(|code| srgb_decode(f32::from(code) / 255.0))
    };
    Image { pixels: image.pixels.iter().map(shown).collect(), ..*image }
}

/// Errors of an image, averaged over squares of pixels.
pub struct ErrorMap {
    width: usize,
    height: usize,
    /// `[height * width]`; `None` for squares without measured pixels.
    errors: Vec<Option<f64>>,
}

impl ErrorMap {
    /// Returns the relative squared errors of `image` against the reference of a comparison, which must have
    /// the same size.
    pub fn of(image: &Image, comparison: &Comparison) -> Result<Self> {
        let reference = &comparison.reference;
        let (size, wanted) = ((image.width, image.height), (reference.width, reference.height));
        ensure!(size == wanted, "images: an image is {size:?} pixels, the reference {wanted:?}");
        let error = |k: usize| {
            let channels = image.pixels[k].iter().zip(&reference.pixels[k]);
            let errors = channels.map(|(&x, &r)| {
                let (x, r) = (f64::from(x), f64::from(r));
                (x - r) * (x - r) / (r * r + RELATIVE_EPSILON)
            });
            errors.sum::<f64>() / 3.0
        };
        Ok(Self::averaged(comparison, error))
    }

    /// Returns the LDR-FLIP map of an image against the reference at an exposure, and the mean over the
    /// measured pixels.
    pub fn of_flip(image: &Image, comparison: &Comparison, exposure: f32) -> Result<(Self, f64)> {
        let [reference, shown] = [&comparison.reference, image].map(|image| display(image, exposure));
        let values = flip(&reference, &shown, PIXELS_PER_DEGREE)?;
        Ok((Self::averaged(comparison, |k| values[k]), comparison.mean_of_measured(&values)))
    }

    /// Averages values of measured pixels over squares.
    fn averaged(comparison: &Comparison, value: impl Fn(usize) -> f64) -> Self {
        let Image { width: columns, height: rows, .. } = comparison.reference;
        let side = columns.div_ceil(ERROR_MAP_WIDTH).max(1);
        let (width, height) = (columns.div_ceil(side), rows.div_ceil(side));
        let mut sums = vec![(0.0, 0_u32); width * height];
        for k in (0..columns * rows).filter(|&k| comparison.is_measured(k)) {
            let (sum, count) = &mut sums[k / columns / side * width + k % columns / side];
            *sum += value(k);
            *count += 1;
        }
        let errors = sums.into_iter().map(|(sum, count)| (count > 0).then(|| sum / f64::from(count))).collect();
        Self { width, height, errors }
    }

    /// Encodes a map of values from 0 to 1 in false colour as a `data:` address.
    pub fn fraction_picture(&self) -> Result<String> {
        self.coloured(|fraction| if fraction.is_nan() { BROKEN } else { ERROR.at(fraction) })
    }

    fn coloured(&self, colour: impl Fn(f64) -> [u8; 3]) -> Result<String> {
        let pixels: Vec<[u8; 3]> = self.errors.iter().map(|error| error.map_or(UNMEASURED, &colour)).collect();
        Ok(data_address(&encode_png_rgb8(self.width, self.height, &pixels)?))
    }

    /// Encodes the map in false colour on a scale as a `data:` address.
    pub fn picture(&self, scale: &ErrorScale) -> Result<String> {
        self.coloured(|error| scale.colour(error))
    }
}

/// The logarithmic scale of all error maps of a budget.
pub struct ErrorScale {
    /// The power of ten of the brightest colour.
    pub top: f64,
}

impl ErrorScale {
    /// The scale whose brightest colour is exceeded by at most 0.5 % of the errors.
    pub fn of<'a>(maps: impl Iterator<Item = &'a ErrorMap>) -> Self {
        let mut errors: Vec<f64> =
            maps.flat_map(|map| map.errors.iter().flatten()).copied().filter(|e| *e > 0.0 && e.is_finite()).collect();
        if errors.is_empty() {
            return Self { top: 0.0 };
        }
        errors.sort_by(f64::total_cmp);
        let high = errors[(errors.len() - 1) * 995 / 1000];
        Self { top: high.log10().ceil() }
    }

    /// The power of ten of the darkest colour.
    pub fn bottom(&self) -> f64 {
        self.top - ERROR_DECADES
    }

    fn colour(&self, error: f64) -> [u8; 3] {
        if error.is_nan() {
            return BROKEN;
        }
        ERROR.at((error.log10() - self.bottom()) / ERROR_DECADES)
    }
}

#[cfg(test)]
mod tests {
    use headtail_render::color::luminance;

    use super::super::synthetic;
    use super::*;

    fn grey(width: usize, height: usize, value: f32) -> Image {
        Image { width, height, pixels: vec![[value; 3]; width * height] }
    }

    fn error_map(image: &Image, reference: Image, measured: Vec<bool>) -> Result<ErrorMap> {
        ErrorMap::of(image, &Comparison { reference, measured, ..synthetic::comparison() })
    }

    #[test]
    fn error_maps_hold_the_relative_squared_error() {
        let map = error_map(&grey(500, 301, 3.0), grey(500, 301, 1.0), Vec::new()).unwrap();
        assert!(map.width <= ERROR_MAP_WIDTH && map.height == 301_usize.div_ceil(4));
        assert!(map.errors.iter().all(|error| (error.unwrap() - 4.0 / 1.01).abs() < 1e-9));
        assert!(error_map(&grey(5, 3, 1.0), grey(3, 5, 1.0), Vec::new()).is_err());
    }

    #[test]
    fn unmeasured_pixels_are_excluded_from_error_maps() {
        let mut image = grey(4, 1, 3.0);
        image.pixels[2] = [1e9; 3];
        let map = error_map(&image, grey(4, 1, 1.0), vec![true, true, false, true]).unwrap();
        assert!(map.errors[2].is_none() && map.errors[3].is_some());
        assert!(ErrorScale::of([map].iter()).top < 2.0);
    }

    #[test]
    fn colours_run_from_dark_to_bright_and_mark_nan() {
        let scale = ErrorScale { top: 0.0 };
        assert_eq!(scale.colour(0.0), ERROR.at(0.0));
        assert_eq!(scale.colour(1e-9), ERROR.at(0.0));
        assert_eq!(scale.colour(f64::INFINITY), ERROR.at(1.0));
        assert_eq!(scale.colour(1.0), ERROR.at(1.0));
        assert_eq!(scale.colour(f64::NAN), BROKEN);
        let brightness = |e: f64| luminance(Vec3A::from_array(scale.colour(e).map(f32::from)));
        assert!((0..40).all(|i| brightness(1e-4 * 1.2_f64.powi(i)) <= brightness(1e-4 * 1.2_f64.powi(i + 1))));
    }

    #[test]
    fn the_scale_fits_the_errors() {
        let map = |value: f32| error_map(&grey(8, 8, value), grey(8, 8, 1.0), Vec::new()).unwrap();
        assert_eq!(ErrorScale::of([map(1.1), map(1.2)].iter()).top, -1.0);
        assert_eq!(ErrorScale::of([map(1.0)].iter()).top, 0.0);
        assert_eq!(ErrorScale::of([].iter()).bottom(), -4.0);
    }
}
