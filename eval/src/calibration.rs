//! Number of samples per pixel that fit into a time.

use crate::{Budget, Result};

/// Maximum number of renderings per calibration.
const MOST_RENDERINGS: usize = 4;
/// Factor by which a rendering's time may differ from the target.
pub const TOLERANCE: f64 = 1.15;

/// Samples that fit into a time.
#[derive(Debug, PartialEq)]
pub struct Calibration {
    /// Samples per pixel, at least 1.
    pub samples: u32,
    /// Seconds of the last rendering if it is off by more than [`TOLERANCE`].
    pub off: Option<f64>,
}

/// Finds the samples per pixel that fit into `seconds`: a rendering of 1/4 of the time gives an
/// estimate; a rendering with that number of samples corrects it, and is repeated while it is off. `render`
/// returns samples and seconds of a rendering, or `None` after an interruption.
///
/// All runs of a sampler then take the same number of samples, whatever else the machine does.
///
/// # Errors
/// Those of `render`.
pub fn calibrate(
    seconds: f64,
    mut render: impl FnMut(Budget) -> Result<Option<(u32, f64)>>,
) -> Result<Option<Calibration>> {
    let mut trial = Budget::Seconds(0.25 * seconds);
    let mut found = Calibration { samples: 1, off: None };
    // Long renderings are faster per sample than short ones: their passes are longer.
    for _ in 0..MOST_RENDERINGS {
        let Some((samples, taken)) = render(trial)? else { return Ok(None) };
        found.samples = (f64::from(samples) * seconds / taken).round().max(1.0) as u32;
        if matches!(trial, Budget::Samples(_)) {
            let is_right = taken <= seconds * TOLERANCE && seconds <= taken * TOLERANCE;
            found.off = (!is_right && found.samples > 1).then_some(taken);
            if found.off.is_none() {
                break;
            }
        }
        trial = Budget::Samples(found.samples);
    }
    Ok(Some(found))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Calibrates on a machine whose renderings take these seconds per sample (the last value is repeated);
    /// also returns the number of renderings.
    fn calibrated(seconds_per_sample: &[f64]) -> (Calibration, usize) {
        let mut renderings = 0;
        let found = calibrate(2.0, |trial| {
            let seconds = seconds_per_sample[renderings.min(seconds_per_sample.len() - 1)];
            renderings += 1;
            let samples = match trial {
                Budget::Samples(samples) => samples,
                Budget::Seconds(time) => (time / seconds) as u32,
            };
            Ok(Some((samples, f64::from(samples) * seconds)))
        });
        (found.unwrap().unwrap(), renderings)
    }

    #[test]
    fn renderings_that_are_off_are_repeated_and_reported() {
        let right = |samples| Calibration { samples, off: None };
        assert_eq!(calibrated(&[0.01]), (right(200), 2));
        // The short rendering is slow per sample, and the first long one is disturbed.
        assert_eq!(calibrated(&[0.02, 0.01]), (right(200), 3));
        assert_eq!(calibrated(&[0.01, 0.03, 0.01]), (right(200), 4));
        // A machine whose times alternate.
        let (found, renderings) = calibrated(&[0.01, 0.02, 0.01, 0.02]);
        assert!(renderings == MOST_RENDERINGS && found.off.is_some_and(|taken| taken > 2.0 * TOLERANCE), "{found:?}");
        // One sample takes longer than the time.
        assert_eq!(calibrated(&[0.1, 5.0]).0, right(1));
        assert_eq!(calibrate(2.0, |_| Ok(None)).unwrap(), None);
    }
}
