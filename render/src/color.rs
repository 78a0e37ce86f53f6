//! Linear Rec.709 radiance: luminance and the tone curve of the PNG files.

use glam::Vec3A;

/// Rec.709 luminance of a linear radiance; what every sampler is proportional to.
pub fn luminance(radiance: Vec3A) -> f32 {
    radiance.dot(Vec3A::new(0.2126, 0.7152, 0.0722))
}

/// The sRGB transfer curve, `[0, 1]` to `[0, 1]`; values outside are clamped.
pub fn srgb_encode(linear: f32) -> f32 {
    let x = linear.clamp(0.0, 1.0);
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// The inverse of [`srgb_encode`].
pub fn srgb_decode(encoded: f32) -> f32 {
    let x = encoded.clamp(0.0, 1.0);
    if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}
