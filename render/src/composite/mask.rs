//! The shadow mask, and the forms in which samples on a catcher estimate it.

use std::{fmt, str::FromStr};

use glam::DVec4;

use super::film::{CatcherSums, Film};
use crate::error::{Error, Result};

/// The estimator of a pixel's mask.
///
/// `w = L cos / p` is the weight of a sample, per channel, and `E` the exact irradiance for the surface's
/// normal. Where a catcher shadows itself, the mask is relative to the light that the catcher does not block:
/// `V` is then the visibility of the samples that it does not block, and the mean of `w V` is the mean of all
/// `w` times the ratio `sum(w V) / sum(w)` of these samples. The bias, of the order of one over the number of
/// samples, comes only from variation of the blocked fraction; it is 0 where the catcher blocks nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MaskForm {
    /// The paper's form: the fraction of visible samples, equal for all channels. It converges to the mean
    /// visibility under the sampler's density, which is the mask only if that density is proportional to the
    /// product of luminance and cosine.
    Paper,
    /// `mean(w V) / E`: unbiased, but noisy in unshadowed pixels unless the sampler is exact.
    Weights,
    /// `sum(w V) / sum(w)`: exactly 1 in unshadowed pixels, with a bias of the order of one over the samples
    /// of the pixel.
    Ratio,
    /// `mean(w V) / E + b (1 - mean(w) / E)`, with the weights as a control variate of known mean: unbiased
    /// for any `b` that does not depend on these samples. `b` is the slope of `w V` over `w` in the
    /// surrounding pixels, whose random numbers are independent. The variation of a sampler's weights thus
    /// cancels in light and in shadow, also where weights are large because the sampler expects a shadow.
    #[default]
    ControlVariate,
}

impl MaskForm {
    /// All forms.
    pub const ALL: [Self; 4] = [Self::Paper, Self::Weights, Self::Ratio, Self::ControlVariate];

    fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Weights => "weights",
            Self::Ratio => "ratio",
            Self::ControlVariate => "control-variate",
        }
    }
}

impl fmt::Display for MaskForm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for MaskForm {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|form| form.name() == text);
        found.ok_or_else(|| Error::argument("mask", "choose control-variate, ratio, weights or paper"))
    }
}

/// A shadow mask per channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Mask {
    /// Number of columns.
    pub width: usize,
    /// Remaining fraction of the irradiance, `[height * width]`: red, green, blue, luminance. 1 where there
    /// is no catcher. Unbiased forms are not clamped: noise may go slightly below 0 and above 1.
    pub values: Vec<[f32; 4]>,
}

/// Radius in pixels of the neighbourhood that determines the factor of a control variate.
const REACH: i32 = 2;
/// Regularisation of the slope: this multiple of the squared mean weight is added to the variance. Where
/// weights vary by less than its root, 22 %, the slope of few samples is mostly noise and is replaced by the
/// ratio. Values from 0.05 to 0.2 change the noise of masks by at most 0.5 %.
const SHRINKAGE: f64 = 0.05;

impl Mask {
    /// Estimates the mask in a form.
    pub fn of(film: &Film, form: MaskForm) -> Self {
        let pixel = |index: usize| {
            let own = &film.catcher[index];
            if own.hits == 0 {
                return [1.0; 4];
            }
            let drawn = own.drawn / f64::from(own.hits);
            let value = match form {
                MaskForm::Paper => DVec4::splat(own.seen as f64 / own.draws.max(1) as f64),
                MaskForm::Weights => drawn * ratio(own.visible, own.all),
                MaskForm::Ratio => ratio(own.visible, own.all),
                MaskForm::ControlVariate => {
                    let factor = factor(film, index);
                    factor + drawn * (ratio_or(own.visible, own.all, factor) - factor)
                }
            };
            value.as_vec4().to_array()
        };
        Self { width: film.width, values: (0..film.catcher.len()).map(pixel).collect() }
    }

    /// Returns the mask with that of luminance in all channels.
    #[must_use]
    pub fn grey(&self) -> Self {
        Self { values: self.values.iter().map(|value| [value[3]; 4]).collect(), ..*self }
    }
}

/// Returns `visible / all`; 1 where no light could be shadowed.
fn ratio(visible: DVec4, all: DVec4) -> DVec4 {
    ratio_or(visible, all, DVec4::ONE)
}

/// Returns `visible / all`; `otherwise` where no light could be shadowed.
fn ratio_or(visible: DVec4, all: DVec4, otherwise: DVec4) -> DVec4 {
    DVec4::select(all.cmpgt(DVec4::ZERO), visible / all, otherwise)
}

/// Returns the slope of visible weights over all weights in the surrounding pixels, which minimises the
/// variance, shrunk towards their ratio where weights hardly vary. It is 1 where everything is visible, and 0
/// where nothing is.
fn factor(film: &Film, index: usize) -> DVec4 {
    let (x, y) = ((index % film.width) as i32, (index / film.width) as i32);
    let mut around = CatcherSums::default();
    for dy in -REACH..=REACH {
        for dx in -REACH..=REACH {
            let inside = (0..film.width as i32).contains(&(x + dx)) && (0..film.height as i32).contains(&(y + dy));
            if inside && (dx, dy) != (0, 0) {
                let other = &film.catcher[((y + dy) * film.width as i32 + x + dx) as usize];
                around.hits += other.hits;
                around.visible += other.visible;
                around.all += other.all;
                around.visible_squares += other.visible_squares;
                around.all_squares += other.all_squares;
            }
        }
    }
    let count = f64::from(around.hits.max(1));
    let mean = around.all / count;
    let variance = around.all_squares / count - mean * mean;
    let covariance = around.visible_squares / count - around.visible / count * mean;
    let ratio = ratio(around.visible, around.all);
    let least = SHRINKAGE * mean * mean;
    DVec4::select(mean.cmpgt(DVec4::ZERO), (covariance + least * ratio) / (variance + least), ratio)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_print_as_they_parse() {
        for form in MaskForm::ALL {
            assert_eq!(form.to_string().parse::<MaskForm>().unwrap(), form);
        }
        assert!("best".parse::<MaskForm>().is_err());
    }

    fn film(sums: CatcherSums) -> Film {
        let mut film = Film::new(3, 3);
        film.catcher.fill(sums);
        film
    }

    #[test]
    fn unshadowed_pixels_are_white_whatever_the_weights() {
        let sums = CatcherSums {
            hits: 4,
            visible: DVec4::splat(7.0),
            all: DVec4::splat(7.0),
            drawn: DVec4::splat(7.0),
            seen: 4,
            draws: 4,
            ..CatcherSums::default()
        };
        let film = film(sums);
        for form in [MaskForm::Paper, MaskForm::Ratio, MaskForm::ControlVariate] {
            assert_eq!(Mask::of(&film, form).values[4], [1.0; 4], "{form}");
        }
        assert_eq!(Mask::of(&film, MaskForm::Weights).values[4], [1.75; 4]);
    }

    /// The catcher blocks half of a pixel's light, the object half of the rest: the mask is one half.
    #[test]
    fn self_shadowing_of_the_catcher_is_not_in_the_mask() {
        let [visible, all, drawn] = [1.0, 2.0, 4.0].map(DVec4::splat);
        let film = film(CatcherSums { hits: 4, visible, all, drawn, seen: 1, draws: 2, ..CatcherSums::default() });
        for form in MaskForm::ALL {
            assert_eq!(Mask::of(&film, form).values[4], [0.5; 4], "{form}");
        }
    }

    /// Two samples per pixel, of weights `1 - spread` and `1 + spread`; the second is visible. The slope is
    /// `(1 + spread) / (2 spread)`, the ratio `(1 + spread) / 2`.
    #[test]
    fn factors_are_slopes_for_varying_weights_and_ratios_for_constant_weights() {
        let factor_of = |spread: f64| {
            let [low, high] = [1.0 - spread, 1.0 + spread];
            let [visible, all, visible_squares, all_squares] =
                [high, low + high, high * high, low * low + high * high].map(DVec4::splat);
            let sums = CatcherSums { hits: 2, visible, all, visible_squares, all_squares, ..CatcherSums::default() };
            factor(&film(sums), 4).x
        };
        for (spread, weight_of_slope) in
            [(1e-9, 0.0), (0.01, 1e-4 / (1e-4 + SHRINKAGE)), (0.9, 0.81 / (0.81 + SHRINKAGE))]
        {
            let (slope, ratio) = ((1.0 + spread) / (2.0 * spread), (1.0 + spread) / 2.0);
            let expected = weight_of_slope * slope + (1.0 - weight_of_slope) * ratio;
            // For the smallest spread, the slope contributes 1e-18 / 0.05 times 5e8, 1e-8; rounding of
            // squares near 1 leaves 1e-14.
            assert!((factor_of(spread) - expected).abs() < 1e-7, "{spread}: {} not {expected}", factor_of(spread));
        }
    }

    #[test]
    fn black_pixels_are_black_and_empty_ones_white() {
        let weights = DVec4::splat(7.0);
        let black = CatcherSums { hits: 4, all: weights, drawn: weights, draws: 4, ..CatcherSums::default() };
        for form in MaskForm::ALL {
            assert_eq!(Mask::of(&film(black), form).values[4], [0.0; 4], "{form}");
            assert_eq!(Mask::of(&film(CatcherSums::default()), form).values[4], [1.0; 4], "{form}");
        }
    }
}
