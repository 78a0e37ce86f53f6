//! Linear Rec.709 radiance: luminance and the tone curve of the PNG files.

use glam::Vec3A;

/// Rec.709 luminance of a linear radiance; samplers target densities proportional to it.
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

/// The luminance that [`tone_map`] shows as white.
const WHITE: f32 = 8.0;

/// Tone-maps a linear radiance to an 8-bit sRGB colour.
///
/// Luminance follows the extended Reinhard curve, `L (1 + L / WHITE^2) / (1 + L)` (Reinhard et al. 2002,
/// equation 4): linear for dark values, with a shoulder that reaches white at `WHITE`. Ratios of channels
/// are kept; where a channel would exceed 1, the colour fades towards grey of the same luminance, so bright
/// red lamps turn pale instead of flat. Negative values are black, infinity is white, and NaN is magenta,
/// which stands out.
pub fn tone_map(radiance: Vec3A) -> [u8; 3] {
    if radiance.is_nan() {
        return [255, 0, 255];
    }
    let positive = radiance.max(Vec3A::ZERO);
    let bright = luminance(positive);
    if bright >= WHITE {
        return [255; 3];
    }
    let shown = bright * (1.0 + bright / (WHITE * WHITE)) / (1.0 + bright);
    let colour = if bright > 0.0 { positive * (shown / bright) } else { Vec3A::ZERO };
    let peak = colour.max_element();
    let fade = if peak > 1.0 { (1.0 - shown) / (peak - shown) } else { 1.0 };
    let colour = shown + (colour - shown) * fade;
    colour.to_array().map(|channel| (255.0 * srgb_encode(channel) + 0.5) as u8)
}
