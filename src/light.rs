//! How a map is turned, scaled and tinted without making another one: samplers that were made for it stay right.

use std::str::FromStr;

use anyhow::{Result, ensure};
use clap::Args;
use glam::Vec3A;

/// The light of a picture in terms of its map.
#[derive(Args, Clone, Copy, Debug)]
pub struct LightArguments {
    /// Turn the map around the vertical, counter-clockwise from above.
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_hyphen_values = true)]
    pub env_rotate: f32,
    /// Multiply the map's light: one factor, or three for red, green and blue.
    #[arg(long, value_name = "S|R,G,B", default_value = "1")]
    pub env_scale: Factors,
}

/// Factors per channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Factors(pub Vec3A);

impl FromStr for Factors {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<f32>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
        let is_usable = |x: &f32| (0.0..=1e9).contains(x);
        match numbers.as_deref() {
            Some([s]) if is_usable(s) && *s > 0.0 => Ok(Self(Vec3A::splat(*s))),
            Some([r, g, b]) if [r, g, b].into_iter().all(is_usable) && r + g + b > 0.0 => {
                Ok(Self(Vec3A::new(*r, *g, *b)))
            }
            _ => Err("write a positive factor, or three that are not negative, as in 1,0.9,0.7".into()),
        }
    }
}

impl LightArguments {
    /// Checks what the parser of arguments does not.
    ///
    /// # Errors
    /// If the angle is no number.
    pub fn check(&self) -> Result<()> {
        ensure!(self.env_rotate.is_finite(), "--env-rotate: not an angle");
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_factor_or_three() {
        assert_eq!("2".parse(), Ok(Factors(Vec3A::splat(2.0))));
        assert_eq!("1, 0,0.5".parse(), Ok(Factors(Vec3A::new(1.0, 0.0, 0.5))));
        for wrong in ["", "0", "-1", "nan", "inf", "1,2", "0,0,0", "1,2,3,4", "1,,2"] {
            assert!(wrong.parse::<Factors>().is_err(), "{wrong}");
        }
    }
}
