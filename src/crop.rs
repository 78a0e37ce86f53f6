//! A part of a picture, as given on the command line.

use std::str::FromStr;

use anyhow::{Result, ensure};
use headtail_render::integrator::{Part, View};

/// First column and row, width and height in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crop(Part);

impl Crop {
    /// Returns the part.
    ///
    /// # Errors
    /// If it extends beyond the picture.
    pub fn of(self, view: &View) -> Result<Part> {
        let Self(part) = self;
        ensure!(
            part.left + part.width <= view.width && part.top + part.height <= view.height,
            "--crop: it is not inside of the picture, which has {} x {} pixels",
            view.width,
            view.height
        );
        Ok(part)
    }
}

impl FromStr for Crop {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<u16>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[x, y, w, h]) if w > 0 && h > 0 => {
                let [left, top, width, height] = [x, y, w, h].map(usize::from);
                Ok(Self(Part { left, top, width, height }))
            }
            _ => Err("write four counts separated by commas, as in 200,150,240,180".into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use headtail_eval::part_text;

    #[test]
    fn four_counts_make_a_part() {
        let Crop(part) = "3, 4,50,60".parse().unwrap();
        assert_eq!(part_text(part), "3,4,50,60");
        for wrong in ["", "1,2,3", "1,2,3,0", "-1,2,3,4", "1,2,3,4,5", "1,2,3,70000", "a,b,c,d"] {
            assert!(wrong.parse::<Crop>().is_err(), "{wrong}");
        }
    }
}
