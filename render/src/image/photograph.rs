//! Photographs: linear radiance from OpenEXR or Radiance files, and sRGB pictures from PNG or JPEG.

use std::{io::Read, path::Path};

use glam::{Vec2, Vec3A};
use image::{ImageDecoder, metadata::Orientation};

use super::{
    Format, Image, MAX_PIXELS, Picture, Repair, color_profile::linear_pixels, compressed::decode_compressed,
    read_picture,
};
use crate::{
    color::srgb_encode,
    error::{Error, Result},
    file::open_regular,
    memory,
    remark::Remark,
};

/// Maximum size of a PNG or JPEG file, in bytes.
const MAX_BYTES: u64 = 1 << 30;

/// A photograph as linear Rec.709.
#[derive(Clone, Debug)]
pub struct Photograph {
    /// Linear values as in the file, which may be negative, infinite or NaN: radiance, or decoded 8- or 16-bit
    /// codes, whose colours may lie outside of Rec.709.
    pub image: Image,
    /// Whether the values are radiance in the units of a map; otherwise the exposure is unknown.
    pub is_radiance: bool,
    /// Remarks on conversions and on values that are not radiance.
    pub remarks: Vec<Remark>,
    repair: Repair,
}

impl Photograph {
    /// Reads an OpenEXR, Radiance, PNG or JPEG file; the first bytes determine the format.
    ///
    /// # Errors
    /// If the file cannot be read, has another format, or is damaged; see [`read_picture`].
    pub fn read(path: &Path) -> Result<Self> {
        match Format::of(path)? {
            Format::OpenExr | Format::Radiance => {
                let Picture { image, mut remarks, repair, .. } = read_picture(path, None)?;
                remarks.extend(repair.remarks_of_photograph());
                Ok(Self { image, is_radiance: true, remarks, repair })
            }
            Format::Png | Format::Jpeg => {
                let (file, size) = open_regular(path).map_err(|error| Error::io(path, error))?;
                if size > MAX_BYTES {
                    return Err(Error::invalid(path, "file", format!("has {size} bytes; up to {MAX_BYTES} are read")));
                }
                let mut bytes = Vec::new();
                file.take(MAX_BYTES).read_to_end(&mut bytes).map_err(|error| Error::io(path, error))?;
                Self::decode(&bytes).map_err(|reason| Error::invalid(path, "image", reason))
            }
            Format::Other => Err(Error::invalid(path, "first bytes", "not an OpenEXR, Radiance, PNG or JPEG image")),
        }
    }

    /// Creates a photograph from radiance.
    pub fn of_radiance(image: Image) -> Self {
        let repair = Repair::of(image.pixels.iter().flatten().copied(), false);
        Self { image, is_radiance: true, remarks: repair.remarks_of_photograph(), repair }
    }

    /// Decodes a PNG or JPEG file and applies its EXIF orientation. The error completes a sentence whose
    /// subject is the image.
    pub fn decode(bytes: &[u8]) -> std::result::Result<Self, String> {
        Self::decode_turned(bytes, orientation(bytes))
    }

    /// Decodes as [`Self::decode`] does, but ignores the EXIF orientation.
    pub fn decode_stored(bytes: &[u8]) -> std::result::Result<Self, String> {
        Self::decode_turned(bytes, Orientation::NoTransforms)
    }

    fn decode_turned(bytes: &[u8], orientation: Orientation) -> std::result::Result<Self, String> {
        let mut decoded = decode_compressed(bytes, MAX_PIXELS as u64)?;
        decoded.apply_orientation(orientation);
        let (width, height) = (decoded.width() as usize, decoded.height() as usize);
        // Codes and colours.
        let needed = memory::require(24 * (width * height) as u64, || format!("an image of {width} x {height} pixels"));
        needed.map_err(|error| error.to_string())?;
        let (pixels, remark) = linear_pixels(decoded, bytes);
        let repair = Repair::of(pixels.iter().flatten().copied(), false).outside();
        let remarks = remark.into_iter().chain(repair.remarks_of_photograph()).collect();
        Ok(Self { image: Image { width, height, pixels }, is_radiance: false, remarks, repair })
    }

    /// Returns a pixel as radiance, by its index: finite and not negative.
    fn radiance(&self, index: usize) -> Vec3A {
        self.image.pixels[index].map(|value| self.repair.radiance(value)).into()
    }

    /// Returns a pixel by its index, with finite values.
    pub(crate) fn finite(&self, index: usize) -> Vec3A {
        self.image.pixels[index].map(|value| self.repair.finite(value)).into()
    }

    /// Returns the radiance at a point of the image (pixels from the top left corner), interpolated
    /// between pixel centres; `None` outside.
    pub fn sample(&self, at: Vec2) -> Option<Vec3A> {
        let size = Vec2::new(self.image.width as f32, self.image.height as f32);
        if !(at.cmpge(Vec2::ZERO).all() && at.cmplt(size).all()) {
            return None;
        }
        let inside = (at - 0.5).clamp(Vec2::ZERO, size - 1.0);
        let (column, row) = (inside.x as usize, inside.y as usize);
        let (right, below) = ((column + 1).min(self.image.width - 1), (row + 1).min(self.image.height - 1));
        let at = |x: usize, y: usize| self.radiance(y * self.image.width + x);
        let mix = |y| at(column, y).lerp(at(right, y), inside.x.fract());
        Some(mix(row).lerp(mix(below), inside.y.fract()))
    }

    /// Resamples the image; each new pixel is the mean of the area that it covers, with finite values.
    ///
    /// # Panics
    /// If a side is 0.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let across = cover(self.image.width, width);
        let down = cover(self.image.height, height);
        let mut image = Image::black(width, height);
        for (y, rows) in down.iter().enumerate() {
            for (x, columns) in across.iter().enumerate() {
                let mut sum = Vec3A::ZERO;
                for &(row, tall) in rows {
                    for &(column, wide) in columns {
                        sum += tall * wide * self.finite(row * self.image.width + column);
                    }
                }
                image.pixels[y * width + x] = sum.to_array();
            }
        }
        let repair = Repair::of(image.pixels.iter().flatten().copied(), false);
        Self { image, is_radiance: self.is_radiance, remarks: self.remarks.clone(), repair }
    }
}

/// Returns, for each of `to` pixels, the pixels of a row of `from` that it covers, with weights of sum 1.
fn cover(from: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let step = from as f64 / to as f64;
    let pixels = |k: usize| {
        let (start, end) = (k as f64 * step, (k + 1) as f64 * step);
        let touched = start as usize..(end.ceil() as usize).min(from);
        touched
            .map(|i| (i, ((end.min((i + 1) as f64) - start.max(i as f64)) / step) as f32))
            .filter(|(_, weight)| *weight > 0.0)
            .collect()
    };
    (0..to).map(pixels).collect()
}

/// Reads the EXIF orientation of an image.
fn orientation(bytes: &[u8]) -> Orientation {
    let reader = image::ImageReader::new(std::io::Cursor::new(bytes)).with_guessed_format().ok();
    let turned = super::without_panic(|| reader?.into_decoder().ok()?.orientation().ok()).flatten();
    turned.unwrap_or(Orientation::NoTransforms)
}

/// Returns the 8-bit sRGB code of a linear value, clipped at 1; the inverse of [`Photograph::decode`].
pub fn srgb_code(linear: f32) -> u8 {
    (255.0 * srgb_encode(linear) + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::encode_png_rgb8;

    fn ramp(width: usize, height: usize) -> Vec<[u8; 3]> {
        (0..width * height).map(|k| [(k % 256) as u8, (k / 2 % 256) as u8, 255 - (k % 256) as u8]).collect()
    }

    #[test]
    fn srgb_codes_survive_the_round_trip() {
        let pixels = ramp(32, 16);
        let read = Photograph::decode(&encode_png_rgb8(32, 16, &pixels).unwrap()).unwrap();
        assert!(!read.is_radiance);
        let codes: Vec<[u8; 3]> = read.image.pixels.iter().map(|pixel| pixel.map(srgb_code)).collect();
        assert_eq!(codes, pixels);
    }

    #[test]
    fn damaged_images_are_rejected() {
        let good = encode_png_rgb8(32, 16, &ramp(32, 16)).unwrap();
        for cut in [0, 3, 8, 20, 40, good.len() / 2] {
            assert!(Photograph::decode(&good[..cut]).is_err(), "{cut} bytes");
        }
        let mut huge = good.clone();
        huge[16..20].copy_from_slice(&u32::MAX.to_be_bytes());
        assert!(Photograph::decode(&huge).is_err());
        for place in 0..good.len() {
            let mut damaged = good.clone();
            damaged[place] ^= 0x55;
            // Any result except a panic is correct.
            let _ = Photograph::decode(&damaged);
        }
    }

    #[test]
    fn resizing_preserves_the_mean() {
        let image = Image { width: 30, height: 20, pixels: (0..600).map(|k| [k as f32, 1.0, 0.5]).collect() };
        let mean =
            |image: &Image| image.pixels.iter().map(|p| f64::from(p[0])).sum::<f64>() / image.pixels.len() as f64;
        let large = Photograph::of_radiance(image);
        for (width, height) in [(15, 10), (7, 9), (30, 20), (45, 31), (1, 1)] {
            let small = large.resized(width, height);
            // Each weight has a few f32 roundings.
            assert!((mean(&small.image) / mean(&large.image) - 1.0).abs() < 1e-5, "{width} x {height}");
        }
        assert_eq!(large.resized(30, 20).image, large.image);
    }

    #[test]
    fn samples_interpolate_pixel_centres_and_are_none_outside() {
        let image = Image { width: 3, height: 2, pixels: (0..6).map(|k| [k as f32; 3]).collect() };
        let photograph = Photograph::of_radiance(image);
        assert_eq!(photograph.sample(Vec2::new(1.5, 1.5)).unwrap().x, 4.0);
        assert_eq!(photograph.sample(Vec2::new(1.0, 0.5)).unwrap().x, 0.5);
        assert_eq!(photograph.sample(Vec2::new(2.99, 1.99)).unwrap().x, 5.0);
        for outside in [Vec2::new(-0.1, 1.0), Vec2::new(3.0, 1.0), Vec2::new(f32::NAN, 1.0)] {
            assert!(photograph.sample(outside).is_none());
        }
    }
}
