//! Rotation, scale and tint of a map at render time: samplers made for the map stay valid.

use std::str::FromStr;

use anyhow::{Result, ensure};
use clap::Args;
use glam::Vec3A;

/// Rotation and scale of a map's light.
#[derive(Args, Clone, Copy, Debug)]
pub struct LightArguments {
    /// Turn the map around the vertical, counter-clockwise from above.
    #[arg(long, visible_alias = "turn-env", value_name = "DEGREES", default_value_t = 0.0, allow_hyphen_values = true)]
    pub env_rotate: f32,
    /// Multiply the map's light by one factor, or by three for R, G and B.
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

impl Default for LightArguments {
    fn default() -> Self {
        Self { env_rotate: 0.0, env_scale: Factors(Vec3A::ONE) }
    }
}

impl LightArguments {
    /// Returns the suffix of the map's name; empty for an unchanged map.
    pub fn words(&self) -> String {
        let Factors(scale) = self.env_scale;
        let [r, g, b] = scale.to_array();
        let turned =
            if self.env_rotate == 0.0 { String::new() } else { format!(", turned by {}\u{b0}", self.env_rotate) };
        match scale == Vec3A::ONE {
            true => turned,
            false if r == g && g == b => format!("{turned}, {r} times as bright"),
            false => format!("{turned}, times {r},{g},{b}"),
        }
    }

    /// Checks what the argument parser does not.
    ///
    /// # Errors
    /// If the angle is not finite.
    pub fn check(&self) -> Result<()> {
        ensure!(self.env_rotate.is_finite(), "--env-rotate: not an angle");
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_appended_to_the_name() {
        let of =
            |env_rotate: f32, scale: &str| LightArguments { env_rotate, env_scale: scale.parse().unwrap() }.words();
        assert_eq!(LightArguments::default().words(), "");
        assert_eq!(of(-90.0, "2"), ", turned by -90\u{b0}, 2 times as bright");
        assert_eq!(of(0.0, "1,0.5,0"), ", times 1,0.5,0");
    }

    #[test]
    fn one_or_three_factors_are_parsed() {
        assert_eq!("2".parse(), Ok(Factors(Vec3A::splat(2.0))));
        assert_eq!("1, 0,0.5".parse(), Ok(Factors(Vec3A::new(1.0, 0.0, 0.5))));
        for wrong in ["", "0", "-1", "nan", "inf", "1,2", "0,0,0", "1,2,3,4", "1,,2"] {
            assert!(wrong.parse::<Factors>().is_err(), "{wrong}");
        }
    }
}
