//! The kinds of points that a rendering uses.

use std::{fmt, str::FromStr};

use crate::error::{Error, Result};

/// A kind of points in the unit square (and cube). Estimates are unbiased with each; renderings with
/// different seeds are independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PointSet {
    /// Sobol's sequence with an Owen scrambling per pixel. Any number of samples, best at powers of two.
    Sobol,
    /// One such sequence per block of pixels, along a curve through them, so that neighbours share the square
    /// (Ahmed and Wonka 2020, "Screen-Space Blue-Noise Diffusion of Monte Carlo Sampling Error via
    /// Hierarchical Ordering of Pixels"). The error of a pixel is that of `Sobol`; summed over neighbours, it
    /// is smaller. Pixels are not independent.
    ZSobol {
        /// Base-2 logarithm of the planned samples per pixel, at most [`Self::MAX_LOG2_SAMPLES`]; later
        /// samples come from fresh sets.
        log2_samples: u32,
    },
    /// Independent numbers.
    Independent,
}

impl PointSet {
    /// Base-2 logarithm of the largest number of planned samples.
    pub const MAX_LOG2_SAMPLES: u32 = 20;

    /// Returns `ZSobol` for a number of samples per pixel, rounded up to a power of two and clamped to the
    /// largest.
    pub fn zsobol(samples: u32) -> Self {
        let samples = samples.clamp(1, 1 << Self::MAX_LOG2_SAMPLES);
        Self::ZSobol { log2_samples: samples.next_power_of_two().ilog2() }
    }
}

/// `sobol`, `independent`, or `zsobol:N` with the planned samples.
impl fmt::Display for PointSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sobol => f.write_str("sobol"),
            Self::ZSobol { log2_samples } => write!(f, "zsobol:{}", 1_u64 << log2_samples),
            Self::Independent => f.write_str("independent"),
        }
    }
}

impl FromStr for PointSet {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let most = 1_u32 << Self::MAX_LOG2_SAMPLES;
        match (text, text.strip_prefix("zsobol:").map(str::parse)) {
            ("sobol", _) => Ok(Self::Sobol),
            ("independent", _) => Ok(Self::Independent),
            (_, Some(Ok(samples))) if u32::is_power_of_two(samples) && samples <= most => Ok(Self::zsobol(samples)),
            _ => Err(Error::argument(
                text,
                format!(
                    "unknown kind of points; choose sobol, independent, or zsobol:N with a power of two up to {most}"
                ),
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip_and_invalid_names_are_rejected() {
        for log2_samples in 0..=PointSet::MAX_LOG2_SAMPLES {
            let set = PointSet::ZSobol { log2_samples };
            assert_eq!(set.to_string().parse::<PointSet>().unwrap(), set);
        }
        for text in ["sobol", "independent"] {
            assert_eq!(text.parse::<PointSet>().unwrap().to_string(), text);
        }
        for text in [
            "",
            "Sobol",
            "zsobol",
            "zsobol:",
            "zsobol:0",
            "zsobol:3",
            "zsobol:-4",
            "zsobol:2097152",
            "zsobol:4294967296",
        ] {
            assert!(text.parse::<PointSet>().is_err(), "{text}");
        }
    }

    #[test]
    fn planned_samples_are_the_next_power_of_two() {
        let planned = |samples| PointSet::zsobol(samples).to_string();
        let expected = [(0, "1"), (1, "1"), (2, "2"), (3, "4"), (16, "16"), (17, "32"), (u32::MAX >> 1, "1048576")];
        for (samples, text) in expected {
            assert_eq!(planned(samples), format!("zsobol:{text}"));
        }
        assert_eq!(planned(u32::MAX), "zsobol:1048576");
    }
}
