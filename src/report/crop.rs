//! Squares of a picture that are enlarged.

use anyhow::Result;
use glam::Vec3A;
use headtail_render::{
    color::tone_map,
    image::{Image, encode_png, encode_png_rgb8},
    statistics::RELATIVE_EPSILON,
};

/// A square of pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crop {
    /// Its left column.
    pub left: usize,
    /// Its top row.
    pub top: usize,
    /// Columns and rows.
    pub side: usize,
}

impl Crop {
    /// Returns the square of 20 % of the width in which an image differs most from a reference.
    pub fn worst(image: &Image, reference: &Image, measured: &[bool]) -> Self {
        Self::worst_beside(&[], (image, reference), measured, |a, b| (a - b).powi(2))
    }

    /// Returns two disjoint squares in which an image differs most from a reference, relative to the
    /// reference's brightness so that highlights do not take both.
    pub fn two_worst(image: &Image, reference: &Image, measured: &[bool]) -> [Self; 2] {
        let relative = |a: f64, b: f64| (a - b).powi(2) / (b * b + RELATIVE_EPSILON);
        let first = Self::worst_beside(&[], (image, reference), measured, relative);
        [first, Self::worst_beside(&[first], (image, reference), measured, relative)]
    }

    fn worst_beside(
        taken: &[Self],
        (image, reference): (&Image, &Image),
        measured: &[bool],
        error: impl Fn(f64, f64) -> f64,
    ) -> Self {
        let side = (image.width / 5).min(image.height).max(1);
        let step = (side / 4).max(1);
        let mut best = (0.0, Self { left: 0, top: 0, side });
        for top in (0..=image.height - side).step_by(step) {
            for left in (0..=image.width - side).step_by(step) {
                let crop = Self { left, top, side };
                let overlaps = |other: &Self| left.abs_diff(other.left) < side && top.abs_diff(other.top) < side;
                if taken.iter().any(overlaps) {
                    continue;
                }
                let sum = crop.sum(image, reference, measured, &error).0;
                if sum > best.0 {
                    best = (sum, crop);
                }
            }
        }
        best.1
    }

    /// Sums an error over the measured pixels and channels and counts them. An empty `measured` means all
    /// pixels.
    fn sum(self, image: &Image, reference: &Image, measured: &[bool], error: impl Fn(f64, f64) -> f64) -> (f64, u32) {
        let (mut sum, mut count) = (0.0, 0);
        for k in self.pixels(image.width).filter(|&k| measured.get(k).copied().unwrap_or(true)) {
            for (&a, &b) in image.pixels[k].iter().zip(&reference.pixels[k]) {
                sum += error(f64::from(a), f64::from(b));
                count += 1;
            }
        }
        (sum, count)
    }

    /// Returns the centre and side relative to the width and height, as the page's script reads them.
    pub fn attribute(&self, (width, height): (usize, usize)) -> String {
        let (width, height, half) = (width as f64, height as f64, 0.5 * self.side as f64);
        let middle = [(self.left as f64 + half) / width, (self.top as f64 + half) / height, self.side as f64 / width];
        middle.map(|part| format!("{part:.3}")).join(",")
    }

    fn pixels(self, width: usize) -> impl Iterator<Item = usize> {
        (self.top..self.top + self.side)
            .flat_map(move |y| (self.left..self.left + self.side).map(move |x| y * width + x))
    }

    /// Returns the MSE over the measured pixels of the crop.
    pub fn error(self, image: &Image, reference: &Image, measured: &[bool]) -> f64 {
        let (sum, count) = self.sum(image, reference, measured, |a, b| (a - b).powi(2));
        sum / f64::from(count.max(1))
    }

    /// Encodes the crop as a PNG.
    pub fn png(self, image: &Image, exposure: f32) -> Result<Vec<u8>> {
        let pixels = self.pixels(image.width).map(|k| image.pixels[k]).collect();
        Ok(encode_png(&Image { width: self.side, height: self.side, pixels }, exposure)?)
    }

    /// Encodes the image with the crop's frame as a PNG.
    pub fn framed(self, image: &Image, exposure: f32) -> Result<Vec<u8>> {
        let mut pixels: Vec<[u8; 3]> =
            image.pixels.iter().map(|&pixel| tone_map(Vec3A::from_array(pixel) * exposure.exp2())).collect();
        let (right, bottom) = (self.left + self.side - 1, self.top + self.side - 1);
        for k in 0..self.side {
            for (x, y) in
                [(self.left + k, self.top), (self.left + k, bottom), (self.left, self.top + k), (right, self.top + k)]
            {
                pixels[y * image.width + x] = [0xff, 0xb0, 0x00];
            }
        }
        Ok(encode_png_rgb8(image.width, image.height, &pixels)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_squares_do_not_overlap() {
        let reference = Image { width: 50, height: 40, pixels: vec![[1.0; 3]; 2000] };
        let mut image = reference.clone();
        for y in 0..10 {
            for x in 0..10 {
                image.pixels[(y + 5) * 50 + x + 5] = [3.0; 3];
                image.pixels[(y + 25) * 50 + x + 35] = [2.0; 3];
            }
        }
        let [first, second] = Crop::two_worst(&image, &reference, &[]);
        assert!(first.left.abs_diff(5) <= 2 && first.top.abs_diff(5) <= 2, "{first:?}");
        assert!(second.left.abs_diff(35) <= 2 && second.top.abs_diff(25) <= 2, "{second:?}");
        assert_eq!(Crop { left: 10, top: 10, side: 10 }.attribute((50, 40)), "0.300,0.375,0.200");
        // Unmeasured pixels do not count.
        let measured: Vec<bool> = (0..2000).map(|k| k % 50 > 25).collect();
        assert!(Crop::worst(&image, &reference, &measured).left > 25);
    }
}
