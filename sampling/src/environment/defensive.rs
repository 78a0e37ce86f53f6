//! Defensive sampling of maps whose lamps outshine all other light (after Hesterberg 1995, "Weighted Average
//! Importance Sampling and Defensive Mixture Distributions").
//!
//! A lamp of 10^12 times the sky gets all samples, also on surfaces that do not see it: the sky's part of the unit
//! square is narrower than the spacing of 32-bit numbers. Samplers of such a map draw in proportion to luminance with a
//! floor; radiance is unchanged, hence means are, too.

/// The floor as a fraction of the mean luminance of the sphere: at most this fraction of the samples goes to
/// directions that the floor raises.
const FLOOR: f64 = 1.0 / 64.0;
/// Largest second moment of weights without a floor. Photographed maps have 2 to 60, dark studios 400.
const MOST: f64 = 1024.0;

/// Returns the least luminance that samplers assume of texels that are not black: 0, unless the light is very
/// uneven.
///
/// Unevenness is the mean of `mean / luminance` over directions with light: the second moment of the sample weights
/// with which the map's luminance samples uniform light, as seen where its lamps are hidden.
pub fn least_luminance(width: usize, height: usize, luminance: &[f32]) -> f32 {
    let of_texel = |value: f64| if value > 0.0 { [value, 1.0, 1.0 / value] } else { [0.0; 3] };
    let [mean, lit, reciprocal] = solid_angle_means(width, height, luminance, of_texel);
    if reciprocal * mean > MOST * lit { (FLOOR * mean) as f32 } else { 0.0 }
}

/// Returns the luminance that samplers assume of a texel.
pub fn raised(luminance: f32, least: f32) -> f32 {
    if luminance > 0.0 { luminance.max(least) } else { luminance }
}

/// Returns the means over the sphere of functions of a map's values.
pub fn solid_angle_means<const N: usize>(
    width: usize,
    height: usize,
    values: &[f32],
    functions: impl Fn(f64) -> [f64; N],
) -> [f64; N] {
    let (mut sums, mut weights) = ([0.0; N], 0.0);
    for (row, values) in values.chunks_exact(width).enumerate() {
        let weight = (std::f64::consts::PI * row as f64 / (height - 1) as f64).sin().max(1e-6);
        let mut of_row = [0.0; N];
        for &value in values {
            let found = functions(f64::from(value));
            (0..N).for_each(|k| of_row[k] += found[k]);
        }
        (0..N).for_each(|k| sums[k] += weight * of_row[k]);
        weights += weight * width as f64;
    }
    sums.map(|sum| sum / weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sky of 1 with a lamp in one texel near the horizon.
    fn sky_with_lamp(lamp: f32) -> Vec<f32> {
        let mut luminance = vec![1.0; 64 * 32];
        luminance[15 * 64 + 7] = lamp;
        luminance
    }

    #[test]
    fn floor_is_a_fraction_of_the_mean_under_extreme_lamps_only() {
        // The lamp's texel is 7.9e-4 of the sphere.
        for (lamp, mean) in [(1.0, None), (1e4, None), (1e6, None), (1e8, Some(7.9e4)), (1e12, Some(7.9e8))] {
            let least = f64::from(least_luminance(64, 32, &sky_with_lamp(lamp)));
            match mean {
                Some(mean) => assert!((least / (FLOOR * mean) - 1.0).abs() < 0.05, "{lamp}: {least}"),
                None => assert_eq!(least, 0.0, "{lamp}"),
            }
        }
    }

    #[test]
    fn floor_depends_neither_on_scale_nor_on_black_texels() {
        let mut luminance = sky_with_lamp(1e9);
        for row in luminance.chunks_exact_mut(64).skip(20) {
            row.fill(0.0);
        }
        let least = least_luminance(64, 32, &luminance);
        let scaled: Vec<f32> = luminance.iter().map(|value| value * 1024.0).collect();
        assert!(least > 0.0 && least_luminance(64, 32, &scaled) == 1024.0 * least);
        assert_eq!([0.0, 1.0, 1e9].map(|value| raised(value, least)), [0.0, least, 1e9]);
    }

    #[test]
    fn a_little_dim_light_among_black_is_raised() {
        // All light but the lamp comes from three texels.
        let mut luminance = vec![0.0; 64 * 32];
        (luminance[15 * 64 + 7], luminance[3 * 64 + 40], luminance[3 * 64 + 41], luminance[28 * 64]) =
            (1e9, 1.0, 1.0, 2.0);
        assert!(least_luminance(64, 32, &luminance) > 1e3);
    }
}
