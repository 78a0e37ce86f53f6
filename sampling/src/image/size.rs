//! The size limit of images.

use std::path::Path;

use crate::error::{Error, Result};
use crate::memory;

/// Maximum number of pixels, 2^27: a map of 16384 x 8192, or 1.6 GB in memory.
pub const MAX_PIXELS: usize = 1 << 27;

/// Rejects empty images, and those of more than [`MAX_PIXELS`] pixels or the available memory.
pub(super) fn check_size(path: &Path, field: &str, width: usize, height: usize) -> Result<()> {
    match width.checked_mul(height) {
        Some(pixels @ 1..=MAX_PIXELS) => {
            let needed = memory::require(12 * pixels as u64, || format!("an image of {width} x {height} pixels"));
            needed.map_err(|error| Error::invalid(path, field, error.to_string()))
        }
        _ => {
            let reason = format!("{width} x {height} pixels; between 1 and {MAX_PIXELS} can be read");
            Err(Error::invalid(path, field, reason))
        }
    }
}
