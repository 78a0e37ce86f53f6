//! Conversion of the values of a file to linear Rec.709.

use glam::{DMat3, DVec3};

use super::{Image, repair::Repair};
use crate::remark::Remark;

/// Negative results of at most this fraction of a pixel's largest value are rounding errors: 16-bit
/// values have 11 bits, and chromaticities are written with three digits.
const ROUNDING: f64 = 1e-3;

/// How stored values become light.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(not(feature = "exr"), allow(dead_code))]
pub(super) enum Transfer {
    Linear,
    Srgb,
    /// A power; negative values are kept.
    Power(f64),
}

impl Transfer {
    fn decode(self, value: f64) -> f64 {
        match self {
            Self::Srgb if value > 0.040_45 => ((value + 0.055) / 1.055).powf(2.4),
            Self::Srgb => value / 12.92,
            Self::Power(exponent) if value > 0.0 => value.powf(exponent),
            Self::Linear | Self::Power(_) => value,
        }
    }
}

/// The steps from stored values to linear Rec.709, in their order.
pub(super) struct Conversion {
    /// The luminance of red, green and blue, if the channels are RY, Y and BY instead.
    pub luminance: Option<DVec3>,
    pub transfer: Transfer,
    /// From the primaries of the file.
    pub matrix: Option<DMat3>,
}

impl Conversion {
    /// Whether any value changes.
    pub fn is_needed(&self) -> bool {
        self.luminance.is_some() || self.transfer != Transfer::Linear || self.matrix.is_some()
    }

    /// Converts an image; returns the values that are still not radiance.
    ///
    /// NaN and infinite values, which a sum would spread to other channels, are replaced before.
    pub fn apply(&self, image: &mut Image, is_half: bool, remarks: &mut Vec<Remark>) -> Repair {
        let stored = image.pixels.iter().flatten().copied();
        if !self.is_needed() {
            return Repair::of(stored, is_half);
        }
        let mut before = match self.luminance {
            None => Repair::of(stored, is_half),
            Some(_) => Repair::of(image.pixels.iter().map(|pixel| pixel[1]), is_half),
        };
        if self.luminance.is_some() {
            let chroma = image.pixels.iter().flat_map(|&[red, _, blue]| [red, blue]);
            before.nan += chroma.filter(|value| !value.is_finite()).count();
        }
        remarks.extend(before.of_infinite());
        let (mut negative, mut outside) = (0, 0);
        for pixel in &mut image.pixels {
            let own = match self.luminance {
                None => DVec3::from(pixel.map(|value| f64::from(before.finite(value)))),
                Some(weights) => colors(*pixel, before.finite(pixel[1]), weights),
            };
            let own = DVec3::from(own.to_array().map(|value| self.transfer.decode(value)));
            let converted = self.matrix.map_or(own, |matrix| matrix * own);
            let least = -ROUNDING * converted.max_element().max(0.0);
            let count = converted.to_array().into_iter().filter(|&value| value < least).count();
            *(if own.min_element() < 0.0 { &mut negative } else { &mut outside }) += count;
            *pixel = converted.to_array().map(|value| value as f32);
        }
        let mut after = Repair::of(image.pixels.iter().flatten().copied(), false);
        (after.negative, after.outside) = (negative, outside);
        after
    }
}

/// The colours of a pixel of RY, Y and BY, as in OpenEXR's `RgbaYca`: RY = (R - Y) / Y, BY = (B - Y) / Y.
fn colors([red, _, blue]: [f32; 3], luminance: f32, weights: DVec3) -> DVec3 {
    let y = f64::from(luminance);
    let chroma = [red, blue].map(|value| if value.is_finite() { f64::from(value) } else { 0.0 });
    if chroma == [0.0; 2] {
        return DVec3::splat(y);
    }
    let [r, b] = chroma.map(|chroma| (1.0 + chroma) * y);
    DVec3::new(r, (y - weights.x * r - weights.z * b) / weights.y, b)
}

#[cfg(test)]
mod tests {
    use super::*;

    const REC_709: DVec3 = DVec3::new(0.2126, 0.7152, 0.0722);

    fn convert(conversion: &Conversion, pixels: &[[f32; 3]]) -> (Vec<[f32; 3]>, Vec<String>) {
        let mut image = Image { width: pixels.len(), height: 1, pixels: pixels.to_vec() };
        let mut remarks = Vec::new();
        let repair = conversion.apply(&mut image, false, &mut remarks);
        remarks.extend(repair.remarks());
        (image.pixels, remarks.iter().map(|remark| remark.text().to_owned()).collect())
    }

    #[test]
    fn luminance_and_chroma_become_colors() {
        let conversion = Conversion { luminance: Some(REC_709), transfer: Transfer::Linear, matrix: None };
        // The luminance of 2, 1, 0.5 is 1.1765.
        let y = 2.0 * 0.2126 + 0.7152 + 0.5 * 0.0722;
        let chroma = [2.0 / y - 1.0, y, 0.5 / y - 1.0];
        let infinite = [chroma[0], f32::INFINITY, chroma[2]];
        let (pixels, said) = convert(&conversion, &[chroma, [0.0, 3.0, 0.0], infinite, [f32::NAN, 1.0, 0.0]]);
        for (found, expected) in pixels.iter().zip([[2.0, 1.0, 0.5], [3.0; 3]]) {
            assert!((0..3).all(|k| (found[k] - expected[k]).abs() < 1e-6), "{found:?}");
        }
        // The largest luminance is 3, and the colour is kept.
        assert!((0..3).all(|k| (pixels[2][k] / pixels[0][k] - 3.0 / y).abs() < 1e-5), "{pixels:?}");
        assert_eq!(pixels[3], [1.0; 3]);
        assert!(said[0].starts_with("1 channel values were NaN") && said[1].contains("by 3, the largest"), "{said:?}");
    }

    #[test]
    fn transfer_curves_are_decoded() {
        let decode = |transfer| {
            let conversion = Conversion { luminance: None, transfer, matrix: None };
            convert(&conversion, &[[0.5, 0.02, 2.0]]).0[0]
        };
        // IEC 61966-2-1: 0.5 is 0.21404.
        for (found, expected) in decode(Transfer::Srgb).into_iter().zip([0.214_041, 0.02 / 12.92, 4.953_8]) {
            assert!((found / expected - 1.0).abs() < 1e-4, "{found} {expected}");
        }
        for (found, expected) in decode(Transfer::Power(2.0)).into_iter().zip([0.25, 0.0004, 4.0]) {
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
        }
    }
}
