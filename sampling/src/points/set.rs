//! The kinds of points that a rendering uses.

use std::{fmt, str::FromStr};

use crate::error::{Error, Result};

/// A kind of points in the unit square (and cube). Estimates are unbiased with each; renderings with
/// different seeds are independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PointSet {
    /// Sobol's sequence with an Owen scrambling per pixel: any number of samples, which may grow; best at powers of two.
    Sobol,
    /// Rank-1 lattices of a known number of samples, with a random shift per pixel: for that number, whatever it is, most
    /// light estimates have less variance than with `Sobol`.
    Lattice {
        /// Samples per pixel; 0 until a renderer [plans](super::Points::planned) them.
        samples: u32,
    },
    /// Independent numbers.
    Independent,
}

impl PointSet {
    /// Lattices of as many samples as the rendering has.
    pub const LATTICE: Self = Self::Lattice { samples: 0 };
}

/// The default: [`PointSet::LATTICE`].
impl Default for PointSet {
    fn default() -> Self {
        Self::LATTICE
    }
}

/// `lattice`, or `lattice:N` with the number of samples; `sobol`, `independent`.
impl fmt::Display for PointSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sobol => f.write_str("sobol"),
            &Self::LATTICE => f.write_str("lattice"),
            Self::Lattice { samples } => write!(f, "lattice:{samples}"),
            Self::Independent => f.write_str("independent"),
        }
    }
}

impl FromStr for PointSet {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let samples = || text.strip_prefix("lattice:")?.parse().ok().filter(|&samples| samples > 0);
        match text {
            "lattice" => Ok(Self::LATTICE),
            "sobol" => Ok(Self::Sobol),
            "independent" => Ok(Self::Independent),
            _ => match samples() {
                Some(samples) => Ok(Self::Lattice { samples }),
                None => Err(Error::argument(text, "choose lattice, lattice:N with N samples, sobol, or independent")),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip_and_invalid_names_are_rejected() {
        for text in ["lattice", "lattice:1", "lattice:22", "lattice:4294967295", "sobol", "independent"] {
            assert_eq!(text.parse::<PointSet>().unwrap().to_string(), text);
        }
        for text in ["", "Sobol", "zsobol", "lattice:", "lattice:0", "lattice:-4", "lattice:4294967296"] {
            assert!(text.parse::<PointSet>().is_err(), "{text}");
        }
    }
}
