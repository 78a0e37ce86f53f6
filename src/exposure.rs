//! The exposure that a picture is shown with, found by the picture itself.

use headtail_render::{color::luminance, image::Image, integrator::Rendering};

/// The luminance that the mean of a picture is shown with, before the tone curve, which makes 0.37 of it.
const MIDDLE: f32 = 0.6;
/// Luminances are means over squares of so many pixels, at least a part of which counts: their order hardly depends on noise.
const BLOCK: usize = 8;
/// The brightest part of the squares is left out, so that a window or a spot of sun does not make the room black.
const BRIGHTEST: f64 = 0.05;
/// Stops in either direction; what needs more is empty or broken.
const MOST: f32 = 40.0;

/// The stops by which the surfaces of a rendering (where there is none, the environment) are shown in a middle brightness: the mean of all but the
/// brightest twentieth. Pictures of one view by different samplers are equally bright but for what noise does to that mean.
pub fn of_rendering(rendering: &Rendering) -> f32 {
    let background: Vec<f32> = rendering.coverage.iter().map(|covered| 1.0 - covered).collect();
    of_part(&rendering.surfaces, &rendering.coverage)
        .or_else(|| of_part(&rendering.background, &background))
        .unwrap_or(0.0)
}

/// The stops of an image of which some pixels count (all, if `counted` is empty), rounded to tenths: a number to be quoted.
pub fn of_image(image: &Image, counted: &[bool]) -> f32 {
    let all = vec![1.0; image.pixels.len()];
    let some: Vec<f32> = counted.iter().map(|&counted| f32::from(u8::from(counted))).collect();
    let stops = of_part(image, if counted.is_empty() { &all } else { &some }).or_else(|| of_part(image, &all));
    (10.0 * stops.unwrap_or(0.0)).round() / 10.0
}

/// The stops of an image that holds the light of a share of each pixel; `None` where nothing is bright.
fn of_part(image: &Image, shares: &[f32]) -> Option<f32> {
    let columns = image.width.div_ceil(BLOCK);
    let mut blocks = vec![(0.0_f32, 0.0_f32); columns * image.height.div_ceil(BLOCK)];
    for (k, (&pixel, share)) in image.pixels.iter().zip(shares).enumerate() {
        let light = luminance(pixel.into());
        // A share of nothing may hold what rounding left there.
        if *share > 0.0 && light.is_finite() {
            let (sum, total) = &mut blocks[k / image.width / BLOCK * columns + k % image.width / BLOCK];
            (*sum, *total) = (*sum + light.max(0.0), *total + share);
        }
    }
    blocks.retain(|(_, total)| *total > 0.0);
    blocks.sort_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)));
    let whole: f64 = blocks.iter().map(|(_, total)| f64::from(*total)).sum();
    let (mut sum, mut total) = (0.0_f64, 0.0_f64);
    for (light, share) in blocks {
        // Where the rest is black, the brightest is what there is to see.
        if total + f64::from(share) > (1.0 - BRIGHTEST) * whole && sum > 0.0 {
            break;
        }
        (sum, total) = (sum + f64::from(light), total + f64::from(share));
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
    fn the_mean_without_the_brightest_twentieth_is_shown_in_the_middle() {
        assert_eq!(of_image(&grey(40, 40, MIDDLE), &[]), 0.0);
        assert_eq!(of_image(&grey(40, 40, 2.0 * MIDDLE), &[]), -1.0);
        // One of 25 squares is a window.
        let mut room = grey(40, 40, MIDDLE);
        for k in 0..64 {
            room.pixels[k / 8 * 40 + k % 8] = [1e6; 3];
        }
        assert_eq!(of_image(&room, &[]), 0.0);
        let window: Vec<bool> = room.pixels.iter().map(|pixel| pixel[0] > 1.0).collect();
        assert!(of_image(&room, &window) < -20.0, "the window alone");
    }

    #[test]
    fn noise_hardly_changes_it() {
        // One pixel in four has all the light: as one sample of a small lamp.
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
