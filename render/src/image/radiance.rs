//! Reading Radiance RGBE files (`#?RADIANCE`, `#?RGBE`): run-length coded or not, rows from the top left (`-Y h +X w`).

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use image::ImageDecoder;
use image::codecs::hdr::HdrDecoder;

use super::Image;
use super::size::check_size;
use crate::error::{Error, Result};

/// The first bytes of every Radiance file; what program wrote it follows.
pub(super) const MAGIC: &[u8] = b"#?";

/// Runs of runs could code any row by a few bytes. What writers make of a constant picture has about a thousand pixels to a byte.
const MOST_PIXELS_PER_BYTE: u64 = 1 << 12;

/// Reads the open `file` of `file_size` bytes; `path` is for the messages.
pub(super) fn read(path: &Path, file: File, file_size: u64) -> Result<Image> {
    // Not strict: the decoder would insist on `#?RADIANCE`, and refuse a map for a comment it cannot parse.
    let decoder = HdrDecoder::new_nonstrict(BufReader::new(file)).map_err(|e| invalid(path, "header", &e))?;
    let (width, height) = decoder.dimensions();
    let (width, height) = (width as usize, height as usize);
    check_size(path, "dimensions", width, height)?;
    let least = (least_row_bytes(width) * height as u64).max((width * height) as u64 / MOST_PIXELS_PER_BYTE);
    if file_size < least {
        let reason = format!("{width} x {height} pixels take at least {least} bytes, the file has {file_size}");
        return Err(Error::invalid(path, "dimensions", reason));
    }
    let mut image = Image::black(width, height);
    decoder.read_image(bytemuck::cast_slice_mut(&mut image.pixels)).map_err(|e| invalid(path, "pixels", &e))?;
    Ok(image)
}

/// The fewest bytes that can code a row: one pixel, then runs of 255, 255 * 256, ... copies of it, 4 bytes each.
fn least_row_bytes(width: usize) -> u64 {
    let (mut bytes, mut covered, mut run) = (4, 1, 255);
    while covered < width {
        bytes += 4;
        covered += run;
        run *= 256;
    }
    bytes
}

fn invalid(path: &Path, field: &str, error: &image::ImageError) -> Error {
    match error {
        image::ImageError::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => {
            Error::invalid(path, field, "the file ends too early")
        }
        _ => Error::invalid(path, field, error.to_string()),
    }
}
