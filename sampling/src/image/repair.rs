//! Values that light cannot have, and their replacements.

use crate::remark::Remark;

/// Larger radiance is treated as infinite, so that sums of squares stay in the range of f32.
const LARGEST_RADIANCE: f32 = 1e15;
/// The largest value of 16 bits, the replacement of values that overflowed when they were written.
const LARGEST_HALF: f32 = 65504.0;

/// Counts of the values of an image that are not radiance, and their replacements.
#[derive(Clone, Debug, PartialEq)]
pub struct Repair {
    pub(super) nan: usize,
    pub(super) negative: usize,
    /// Values that the conversion to Rec.709 made negative: their colours are outside of it.
    pub(super) outside: usize,
    infinite: usize,
    /// The replacement of infinite values.
    largest: f32,
    is_half: bool,
}

impl Repair {
    /// Examines channel values; `is_half` if they have 16 bits.
    pub fn of(values: impl Iterator<Item = f32>, is_half: bool) -> Self {
        let mut repair = Self { nan: 0, negative: 0, outside: 0, infinite: 0, largest: 0.0, is_half };
        for value in values {
            match value {
                _ if value.is_nan() => repair.nan += 1,
                _ if value < 0.0 => repair.negative += 1,
                _ if value > LARGEST_RADIANCE => repair.infinite += 1,
                _ => repair.largest = repair.largest.max(value),
            }
        }
        if is_half {
            repair.largest = LARGEST_HALF;
        }
        repair
    }

    /// Counts negative values as those of colours outside of Rec.709.
    #[must_use]
    pub fn outside(self) -> Self {
        Self { negative: 0, outside: self.outside + self.negative, ..self }
    }

    /// Replaces NaN and minus infinity by 0, and infinity by the largest value.
    pub fn finite(&self, value: f32) -> f32 {
        match value {
            _ if value > LARGEST_RADIANCE => self.largest,
            _ if value >= -LARGEST_RADIANCE => value,
            _ => 0.0,
        }
    }

    /// Returns the value as radiance: finite, and 0 instead of negative.
    pub fn radiance(&self, value: f32) -> f32 {
        if value < 0.0 { 0.0 } else { self.finite(value) }
    }

    /// Returns one warning per kind of value that [`Self::finite`] replaces.
    pub(super) fn of_infinite(&self) -> Vec<Remark> {
        self.list(0, 0, "")
    }

    /// Returns one warning per kind of value that [`Self::radiance`] replaces.
    pub fn remarks(&self) -> Vec<Remark> {
        self.list(self.negative, self.outside, "")
    }

    /// Returns the remarks on an image that keeps its values where no object is.
    pub fn remarks_of_photograph(&self) -> Vec<Remark> {
        let mut remarks = self.list(self.negative, 0, " in shadows, reflections and light");
        if self.outside > 0 {
            let outside = self.outside;
            remarks.push(Remark::Note(format!(
                "{outside} channel values are of colours outside of Rec.709: they stay in OpenEXR, and are clipped in PNG and as light"
            )));
        }
        remarks
    }

    fn list(&self, negative: usize, outside: usize, place: &str) -> Vec<Remark> {
        let (infinite, kind) =
            if self.is_half { ("infinite", "of 16 bits") } else { ("infinite or above 1e15", "usable one") };
        let largest = format!("{}, the largest {kind}", self.largest);
        [
            (self.nan, "were NaN and", "0"),
            (negative, "were negative and", "0"),
            (outside, "became negative in the conversion to Rec.709, whose colours do not include theirs, and", "0"),
            (self.infinite, &format!("were {infinite} and"), &largest),
        ]
        .into_iter()
        .filter(|(count, ..)| *count > 0)
        .map(|(count, what, by)| Remark::Warning(format!("{count} channel values {what} were replaced by {by}{place}")))
        .collect()
    }
}
