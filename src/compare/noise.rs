//! The noise of the reference itself, which every measured error contains.

use std::path::Path;

use anyhow::Result;
use headtail_render::{
    image::{Attribute, Image, text_attributes},
    statistics::ErrorMetrics,
};

use crate::report::Row;

/// The attributes of a reference that hold it.
const NAMES: [&str; 2] = ["reference.mse", "reference.relmse"];
/// What is left of an error that is all noise, as a share of the noise: it stays positive, so that it has a logarithm.
const LEAST: f64 = 0.05;

/// Expected errors of a reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Mean squared error.
    pub mse: f64,
    /// Mean relative squared error.
    pub relmse: f64,
}

impl Noise {
    /// The noise of the mean of two renderings of equally many samples that are independent: with `a` and `b` of variance `v`, the mean has `v / 2`,
    /// and `(a - b)^2 / 4`, the square of a half's distance to it, has that expectation.
    ///
    /// # Errors
    /// If the images differ in size.
    pub fn of(half: &Image, mean: &Image, covered: &[bool]) -> Result<Self> {
        let metrics = ErrorMetrics::of(&select(half, covered), &select(mean, covered))?;
        Ok(Self { mse: metrics.mse, relmse: metrics.relmse })
    }

    /// What a reference's file says of it; `None` where it says nothing.
    pub fn read(path: &Path) -> Option<Self> {
        let known = text_attributes(path).ok()?;
        let number = |name: &str| known.iter().find(|(found, _)| found == name)?.1.parse::<f64>().ok();
        let [mse, relmse] = NAMES.map(number);
        Some(Self { mse: mse?, relmse: relmse? }).filter(|noise| noise.mse >= 0.0 && noise.relmse >= 0.0)
    }

    /// For the reference's file.
    pub fn attributes(self) -> [Attribute; 2] {
        [Attribute::new(NAMES[0], self.mse), Attribute::new(NAMES[1], self.relmse)]
    }

    /// What is left of a measured error without a reference's noise.
    pub fn without(measured: f64, noise: f64) -> f64 {
        (measured - noise).max(LEAST * noise)
    }

    /// The sentences that stand beside a comparison: the noise, and which rows it limits, since less than it is left of their errors.
    pub fn words(self, rows: &[Row]) -> String {
        let mut groups: Vec<(&str, &str, f64, usize)> = Vec::new();
        for row in rows {
            match groups.iter_mut().find(|group| (group.0, group.1) == (&*row.sampler, &*row.budget)) {
                Some(group) => (group.2, group.3) = (group.2 + row.mse, group.3 + 1),
                None => groups.push((&row.sampler, &row.budget, row.mse, 1)),
            }
        }
        let is_limited = |group: &&(&str, &str, f64, usize)| group.2 / (group.3 as f64) < self.mse;
        let limited: Vec<String> =
            groups.iter().filter(is_limited).map(|(sampler, budget, ..)| format!("{sampler} at {budget}")).collect();
        let noise = format!(
            "Its own mean squared error, from two independent halves, is {:.2e}, and is subtracted from all.",
            self.mse
        );
        match limited.len() {
            0 => noise,
            _ => format!(
                "{noise} The ratios of {} are limited by it: their own error is smaller still; take more --reference-spp.",
                limited.join(", ")
            ),
        }
    }
}

/// The chosen pixels as an image of one row.
pub fn select(image: &Image, chosen: &[bool]) -> Image {
    let pixels: Vec<_> =
        image.pixels.iter().zip(chosen).filter(|(_, chosen)| **chosen).map(|(pixel, _)| *pixel).collect();
    Image { width: pixels.len(), height: 1, pixels }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_tell_the_variance_of_their_mean() {
        // Two values with errors of +3 and -1: the mean is off by 1, and half the distance is 2.
        let image = |value: f32| Image { width: 2, height: 1, pixels: vec![[value; 3], [100.0; 3]] };
        let noise = Noise::of(&image(13.0), &image(11.0), &[true, false]).unwrap();
        assert!((noise.mse - 4.0).abs() < 1e-6 && noise.relmse > 0.0);
        assert_eq!((Noise::without(10.0, 4.0), Noise::without(1.0, 4.0), Noise::without(3.0, 0.0)), (6.0, 0.2, 3.0));
    }
}
