//! What can be made of samples on a catcher: forms of the mask.

use std::{fmt, str::FromStr};

use glam::DVec4;

use super::film::{CatcherSums, Film};
use crate::error::{Error, Result};

/// How the mask of a pixel is estimated. With `w = L cos / p` of a sample, per channel, and `E` the exact irradiance of the surface's normal. Where a
/// catcher shadows itself, the mask is what the object leaves over of the rest: `V` is then the visibility among the samples that the catcher
/// does not block itself, and a mean of `w V` is that of all `w` times the ratio `sum(w V) / sum(w)` of these. That is biased only as far as
/// the share that the catcher blocks varies, of the order of one over the samples; where it blocks nothing, not at all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MaskForm {
    /// The paper's: the share of samples that are visible, the same for all channels. It converges to the mean visibility under the sampler's own
    /// density, which is the mask only where that is the product of luminance and cosine.
    Paper,
    /// `mean(w V) / E`: unbiased, and noisy where nothing casts a shadow, unless the sampler is exact.
    Weights,
    /// `sum(w V) / sum(w)`: 1 where nothing casts a shadow, with a bias of the order of one over the samples of the pixel.
    Ratio,
    /// `mean(w V) / E + b (1 - mean(w) / E)`, the weights as a control variate whose mean is known: unbiased for any `b` that does not depend on
    /// these samples. It is the slope of `w V` over `w` in the pixels around, whose random numbers are independent, so that what a sampler's weights
    /// vary by cancels in the light and in the shadow, also where they are large because the sampler expects a shadow.
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

/// A mask per channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Mask {
    /// Pixels in a row.
    pub width: usize,
    /// `[height * width]` share of the irradiance that is left: red, green, blue, luminance. 1 where there is no catcher. Unbiased forms are
    /// not cut off: noise goes a little below 0 and above 1.
    pub values: Vec<[f32; 4]>,
}

/// The pixels around one that give its control variate its factor.
const REACH: i32 = 2;
/// What is added to the variance of weights, over their mean square: where they vary by less than its root, 22 %, the slope of so few samples is mostly
/// noise, and the ratio takes its place. Masks have the same noise to half a per cent from 0.05 to 0.2.
const SHRINKAGE: f64 = 0.05;

impl Mask {
    /// The mask in a form.
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

    /// The same with the mask of luminance in all channels.
    #[must_use]
    pub fn grey(&self) -> Self {
        Self { values: self.values.iter().map(|value| [value[3]; 4]).collect(), ..*self }
    }

    /// The quotient of the sums of a pass with the object and of one without it, both of the same camera: two passes.
    pub fn of_two(with: &Film, without: &Film) -> Self {
        let quotient = |(a, b): (&CatcherSums, &CatcherSums)| {
            if a.hits == 0 || b.hits == 0 {
                return [1.0; 4];
            }
            ratio(a.visible / f64::from(a.hits), b.all / f64::from(b.hits)).as_vec4().to_array()
        };
        Self { width: with.width, values: with.catcher.iter().zip(&without.catcher).map(quotient).collect() }
    }
}

/// 1 where there is no light that could be shadowed.
fn ratio(visible: DVec4, all: DVec4) -> DVec4 {
    ratio_or(visible, all, DVec4::ONE)
}

/// Something else where there is no light that could be shadowed.
fn ratio_or(visible: DVec4, all: DVec4, otherwise: DVec4) -> DVec4 {
    DVec4::select(all.cmpgt(DVec4::ZERO), visible / all, otherwise)
}

/// The slope of visible weights over all weights in the samples of the pixels around one, which leaves the least variance, drawn towards their ratio where
/// the weights hardly vary. 1 where all is visible, and 0 where nothing is.
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

    /// Half of a pixel's light the catcher takes itself, of the rest the object takes half: the mask is one half, whatever the weights.
    #[test]
    fn what_the_catcher_blocks_itself_is_not_in_the_mask() {
        let [visible, all, drawn] = [1.0, 2.0, 4.0].map(DVec4::splat);
        let film = film(CatcherSums { hits: 4, visible, all, drawn, seen: 1, draws: 2, ..CatcherSums::default() });
        for form in MaskForm::ALL {
            assert_eq!(Mask::of(&film, form).values[4], [0.5; 4], "{form}");
        }
    }

    /// Two samples in each pixel, of weights `1 - spread` and `1 + spread`, of which the second is visible. The slope is `(1 + spread) / (2 spread)`, the ratio
    /// `(1 + spread) / 2`.
    #[test]
    fn factors_are_slopes_of_weights_that_vary_and_ratios_of_others() {
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
            // Of the smallest spread the slope's part is 1e-18 / 0.05 times 5e8, 1e-8; rounding of squares near 1 leaves 1e-14.
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
