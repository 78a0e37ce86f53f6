//! Automatic exposure of pictures.

use headtail_render::{color::luminance, image::Image, integrator::Rendering};

/// Luminance to which the mean of a picture is exposed; the tone curve maps it to 0.37.
const MIDDLE: f32 = 0.6;
/// The same for a photograph, which has no tone curve.
const MIDDLE_GREY: f32 = 0.22;
/// Side, in pixels, of the blocks over which luminance is averaged: their order hardly depends on noise.
const BLOCK: usize = 8;
/// Fraction of the brightest blocks that is excluded, so that a window or a spot of sun does not darken the
/// room.
const BRIGHTEST: f64 = 0.05;
/// Largest exposure in stops, in either direction; pictures that need more are empty or broken.
const MOST: f32 = 40.0;

/// Returns the exposure in stops that brings the surfaces of a rendering (if there are none, the environment)
/// to a middle brightness: the mean without the brightest 5 %. Pictures of one view by different samplers are
/// equally bright, up to the noise of that mean.
pub fn of_rendering(rendering: &Rendering) -> f32 {
    let background: Vec<f32> = rendering.coverage.iter().map(|covered| 1.0 - covered).collect();
    of_part(&rendering.surfaces, &rendering.coverage)
        .or_else(|| of_part(&rendering.background, &background))
        .unwrap_or(0.0)
}

/// Returns the exposure of an image in stops, rounded to tenths. Only pixels with `counted` are used (all, if
/// it is empty or nothing in them is bright).
pub fn of_image(image: &Image, counted: &[bool]) -> f32 {
    let all = vec![1.0; image.pixels.len()];
    let some: Vec<f32> = counted.iter().map(|&counted| f32::from(u8::from(counted))).collect();
    let stops = of_part(image, if counted.is_empty() { &all } else { &some }).or_else(|| of_part(image, &all));
    (10.0 * stops.unwrap_or(0.0)).round() / 10.0
}

/// Returns the exposure of a photograph in stops: [`of_image`] without a tone curve.
pub fn of_photograph(image: &Image) -> f32 {
    of_image(image, &[]) + (MIDDLE_GREY / MIDDLE).log2()
}

/// Returns the stops of an image that holds the light of the fraction `fractions` of each pixel; `None` if all
/// is black.
fn of_part(image: &Image, fractions: &[f32]) -> Option<f32> {
    let columns = image.width.div_ceil(BLOCK);
    let mut blocks = vec![(0.0_f32, 0.0_f32); columns * image.height.div_ceil(BLOCK)];
    for (k, (&pixel, fraction)) in image.pixels.iter().zip(fractions).enumerate() {
        let light = luminance(pixel.into());
        // Rounding may leave light in pixels with fraction 0.
        if *fraction > 0.0 && light.is_finite() {
            let (sum, total) = &mut blocks[k / image.width / BLOCK * columns + k % image.width / BLOCK];
            (*sum, *total) = (*sum + light.max(0.0), *total + fraction);
        }
    }
    blocks.retain(|(_, total)| *total > 0.0);
    blocks.sort_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)));
    let whole: f64 = blocks.iter().map(|(_, total)| f64::from(*total)).sum();
    let (mut sum, mut total) = (0.0_f64, 0.0_f64);
    for (light, fraction) in blocks {
        // If all else is black, the brightest blocks are used.
        if total + f64::from(fraction) > (1.0 - BRIGHTEST) * whole && sum > 0.0 {
            break;
        }
        (sum, total) = (sum + f64::from(light), total + f64::from(fraction));
    }
    let mean = (sum / total) as f32;
    (mean > 0.0 && mean.is_finite()).then(|| (MIDDLE / mean).log2().clamp(-MOST, MOST))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(width: usize, height: usize, value: f32) -> Image {
        Image { width, height, pixels: vec![[value; 3]; width * height] }
    }

    #[test]
    fn exposure_excludes_the_brightest_blocks() {
        assert_eq!(of_image(&grey(40, 40, MIDDLE), &[]), 0.0);
        assert_eq!(of_image(&grey(40, 40, 2.0 * MIDDLE), &[]), -1.0);
        // One of 25 blocks is a window.
        let mut room = grey(40, 40, MIDDLE);
        for k in 0..64 {
            room.pixels[k / 8 * 40 + k % 8] = [1e6; 3];
        }
        assert_eq!(of_image(&room, &[]), 0.0);
        let window: Vec<bool> = room.pixels.iter().map(|pixel| pixel[0] > 1.0).collect();
        assert!(of_image(&room, &window) < -20.0, "the window alone");
    }

    #[test]
    fn exposure_is_robust_to_noise() {
        // One pixel in four has all the light, like one sample of a small lamp.
        let mut noisy = grey(64, 64, 0.0);
        for k in (0..64 * 64).filter(|k| (k * 2_654_435_761_usize) >> 7 & 3 == 0) {
            noisy.pixels[k] = [4.0 * MIDDLE; 3];
        }
        assert!(of_image(&noisy, &[]).abs() <= 0.3, "{}", of_image(&noisy, &[]));
    }

    #[test]
    fn black_broken_and_empty_pictures_are_shown_as_they_are() {
        assert_eq!(of_image(&grey(9, 9, 0.0), &[]), 0.0);
        assert_eq!(of_image(&grey(9, 9, f32::NAN), &[]), 0.0);
        assert_eq!(of_image(&grey(9, 9, 0.6), &[false; 81]), 0.0, "nothing counts: all of it");
        assert_eq!(of_image(&grey(3, 3, f32::MIN_POSITIVE), &[]), MOST);
    }
}
