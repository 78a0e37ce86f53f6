//! The budget of one rendering.

use std::{fmt, str::FromStr, time::Duration};

use headtail_render::integrator;

/// Samples per pixel, or wall-clock seconds of rendering. Written `16spp` or `0.25s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Budget {
    /// Samples per pixel, at least 1.
    Samples(u32),
    /// Seconds, above 0 and up to 1e6.
    Seconds(f64),
}

impl Budget {
    /// Returns the seconds of a budget of time.
    pub fn seconds(self) -> Option<f64> {
        match self {
            Self::Samples(_) => None,
            Self::Seconds(seconds) => Some(seconds),
        }
    }
}

impl From<Budget> for integrator::Budget {
    fn from(budget: Budget) -> Self {
        match budget {
            Budget::Samples(samples) => Self::Spp(samples),
            Budget::Seconds(seconds) => Self::Time(Duration::from_secs_f64(seconds)),
        }
    }
}

impl fmt::Display for Budget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Samples(samples) => write!(f, "{samples}spp"),
            Self::Seconds(seconds) => write!(f, "{seconds}s"),
        }
    }
}

impl FromStr for Budget {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("'{text}' is not a budget; write 16spp or 0.25s");
        if let Some(samples) = text.strip_suffix("spp") {
            return samples.parse().ok().filter(|samples| *samples > 0).map(Self::Samples).ok_or_else(wrong);
        }
        let seconds = text.strip_suffix('s').and_then(|seconds| seconds.parse::<f64>().ok()).ok_or_else(wrong)?;
        if seconds > 0.0 && seconds <= 1e6 { Ok(Self::Seconds(seconds)) } else { Err(wrong()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_read_back() {
        for budget in [Budget::Samples(16), Budget::Seconds(0.25), Budget::Seconds(2.0)] {
            assert_eq!(budget.to_string().parse(), Ok(budget));
        }
        for wrong in ["", "spp", "0spp", "-1spp", "0s", "nans", "infs", "2e6s", "4"] {
            assert!(wrong.parse::<Budget>().is_err(), "{wrong}");
        }
    }
}
