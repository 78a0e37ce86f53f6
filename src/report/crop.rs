//! Squares of a picture that are enlarged.

use anyhow::Result;
use headtail_render::{
    image::{Image, encode_png},
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
    /// Returns two disjoint squares, of 20 % of the width, in which an image differs most from a reference, relative
    /// to the reference's brightness so that highlights do not take both.
    pub fn two_worst(image: &Image, reference: &Image, measured: &[bool]) -> [Self; 2] {
        let first = Self::worst_beside(&[], (image, reference), measured);
        [first, Self::worst_beside(&[first], (image, reference), measured)]
    }

    fn worst_beside(taken: &[Self], (image, reference): (&Image, &Image), measured: &[bool]) -> Self {
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
                let sum = crop.relative_error(image, reference, measured);
                if sum > best.0 {
                    best = (sum, crop);
                }
            }
        }
        best.1
    }

    /// Sums the relative squared error over the measured pixels and channels. An empty `measured` means all pixels.
    fn relative_error(self, image: &Image, reference: &Image, measured: &[bool]) -> f64 {
        let relative = |(&a, &b): (&f32, &f32)| {
            let (a, b) = (f64::from(a), f64::from(b));
            (a - b).powi(2) / (b * b + RELATIVE_EPSILON)
        };
        let measured = self.pixels(image.width).filter(|&k| measured.get(k).copied().unwrap_or(true));
        measured.flat_map(|k| image.pixels[k].iter().zip(&reference.pixels[k])).map(relative).sum()
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

    /// Encodes the crop as a PNG.
    pub fn png(self, image: &Image, exposure: f32) -> Result<Vec<u8>> {
        let pixels = self.pixels(image.width).map(|k| image.pixels[k]).collect();
        Ok(encode_png(&Image { width: self.side, height: self.side, pixels }, exposure)?)
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
        assert!(Crop::two_worst(&image, &reference, &measured)[0].left > 25);
    }
}
