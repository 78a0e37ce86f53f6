//! Linear values of a picture on a page, for exposures and differences beyond 8 bits.

use std::io::Write;

use anyhow::Result;
use base64::Engine;
use flate2::{Compression, write::ZlibEncoder};
use headtail_render::image::Image;

/// Exponent bias, which makes it a positive byte. The largest exponent encodes infinity and NaN.
const BIAS: i32 = 128;

/// Encodes `[4, height, width]` bytes, compressed and in base64: mantissas of red, green and blue and their
/// common exponent, at an exposure in stops. A value is `mantissa * 2^(exponent - 136)`. In each row, every
/// byte is the difference to the previous one.
///
/// The absolute error is at most 1/256 of the largest channel. Negative values become 0.
pub fn encode(image: &Image, exposure: f32) -> Result<String> {
    let mut planes = vec![0_u8; 4 * image.pixels.len()];
    let (count, scale) = (image.pixels.len(), exposure.exp2());
    for (k, pixel) in image.pixels.iter().enumerate() {
        let coded = shared_exponent(pixel.map(|c| c * scale));
        for (channel, byte) in coded.into_iter().enumerate() {
            planes[channel * count + k] = byte;
        }
    }
    for row in planes.chunks_mut(image.width.max(1)) {
        for k in (1..row.len()).rev() {
            row[k] = row[k].wrapping_sub(row[k - 1]);
        }
    }
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(&planes)?;
    Ok(base64::engine::general_purpose::STANDARD.encode(encoder.finish()?))
}

/// Returns three mantissas and an exponent.
fn shared_exponent(pixel: [f32; 3]) -> [u8; 4] {
    if pixel.iter().any(|c| c.is_nan()) {
        return [255, 0, 255, 255];
    }
    // Clamped to the range of the exponent, which exceeds any display.
    let [r, g, b] = pixel.map(|c| c.clamp(0.0, 1e38));
    let largest = r.max(g).max(b);
    if largest < 1e-32 {
        return [0; 4];
    }
    let mut exponent = largest.log2().floor() as i32 + 1;
    let code = |c: f32, exponent: i32| (f64::from(c) * 2.0_f64.powi(8 - exponent)).round();
    if code(largest, exponent) > 255.0 {
        exponent += 1;
    }
    let [r, g, b] = [r, g, b].map(|c| code(c, exponent).min(255.0) as u8);
    [r, g, b, (exponent + BIAS).clamp(1, 254) as u8]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value([r, g, b, exponent]: [u8; 4]) -> [f64; 3] {
        [r, g, b].map(|mantissa| f64::from(mantissa) * 2.0_f64.powi(i32::from(exponent) - 136))
    }

    #[test]
    fn values_round_trip_to_half_a_step() {
        for pixel in
            [[1.0, 0.5, 0.25], [0.999, 1e-3, 0.0], [1e-6, 3e-6, 2e-6], [12345.0, 1.0, 9999.0], [255.7, 1.0, 1.0]]
        {
            let largest = pixel.iter().copied().fold(0.0_f32, f32::max);
            for (found, expected) in value(shared_exponent(pixel)).into_iter().zip(pixel) {
                // The largest mantissa is at least 127.5, and codes are rounded to the nearest.
                let step = f64::from(largest) / 127.5;
                assert!((found - f64::from(expected)).abs() <= 0.5001 * step, "{found} {expected}");
            }
        }
        assert_eq!(shared_exponent([0.0, -1.0, 0.0]), [0; 4]);
        assert_eq!(shared_exponent([f32::NAN, 1.0, 1.0]), [255, 0, 255, 255]);
        assert!(shared_exponent([f32::INFINITY, 1.0, 0.0])[3] <= 254);
    }
}
