//! Decoding of PNG and JPEG files in memory, with size checks before anything is decoded.

use std::io::Cursor;

use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};

use super::{MAX_PIXELS, without_panic};

/// Maximum width or height of an image. With at most [`MAX_PIXELS`] texels of at most 8 bytes each, decoded
/// images fit into 1 GiB.
const MAX_SIDE: u32 = 16_384;

/// Maximum bytes that a decoder may allocate.
const MAX_DECODER_BYTES: u64 = 1 << 30;

/// Decodes a PNG or JPEG file of at most `texels_left` texels, ignoring its EXIF orientation. The error
/// completes a sentence whose subject is the image.
pub(crate) fn decode_compressed(bytes: &[u8], texels_left: u64) -> Result<DynamicImage, String> {
    without_panic(|| decode(bytes, texels_left)).unwrap_or_else(|| Err("is damaged".into()))
}

fn decode(bytes: &[u8], texels_left: u64) -> Result<DynamicImage, String> {
    let broken = |error: ImageError| format!("cannot be decoded: {error}");
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| broken(e.into()))?;
    let most_texels_per_byte = match reader.format() {
        // A byte of a deflate stream expands to at most 1032 bytes, and a texel has at least one bit.
        Some(ImageFormat::Png) => 8 * 1032,
        // Each block of 8 x 8 texels takes at least one bit.
        Some(ImageFormat::Jpeg) => 8 * 64,
        _ => return Err("is neither PNG nor JPEG".into()),
    };
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAX_DECODER_BYTES);
    reader.limits(limits);
    // This reads headers only.
    let decoder = reader.into_decoder().map_err(broken)?;
    let (width, height) = decoder.dimensions();
    let texels = u64::from(width) * u64::from(height);
    if texels > MAX_PIXELS as u64 || width.max(height) > MAX_SIDE {
        return Err(format!("has {width} x {height} texels; up to {MAX_PIXELS}, and {MAX_SIDE} in a row, can be read"));
    }
    if texels > texels_left {
        return Err(format!("has {width} x {height} texels, which are more than the {texels_left} that may be read"));
    }
    let least = texels.div_ceil(most_texels_per_byte);
    if (bytes.len() as u64) < least {
        return Err(format!("has {width} x {height} texels, which take at least {least} bytes, in {}", bytes.len()));
    }
    DynamicImage::from_decoder(decoder).map_err(broken)
}
