//! The sampling direction of a spline, in double precision, from its logits.

use headtail_model::spline::{MIN_BIN, MIN_SLOPE, Topology, slope_offset};

/// `z -> y` of the spline with `3 K + 1` logits. On the circle `z` and `y` are lifted to the line: `z + 1` gives `y + 1`, and the shift is
/// not wrapped, so that `y` is continuous in the logits.
pub fn invert(topology: Topology, logits: &[f32], z: f64) -> f64 {
    let bins = (logits.len() - 1) / 3;
    let widths = sizes(&logits[..bins]);
    let heights = sizes(&logits[bins..2 * bins]);
    let turns = if topology == Topology::Circle { z.floor() } else { 0.0 };
    let inside = (z - turns).clamp(0.0, 1.0);
    let (mut bin, mut left, mut bottom) = (0, 0.0, 0.0);
    while bin + 1 < bins && inside >= bottom + heights[bin] {
        left += widths[bin];
        bottom += heights[bin];
        bin += 1;
    }
    let right = if topology == Topology::Circle && bin + 1 == bins { 0 } else { bin + 1 };
    let (d0, d1) = (slope(logits[2 * bins + bin]), slope(logits[2 * bins + right]));
    let x = left
        + widths[bin] * solve(heights[bin] / widths[bin], d0, d1, ((inside - bottom) / heights[bin]).clamp(0.0, 1.0));
    match topology {
        Topology::Interval => x.clamp(0.0, 1.0),
        Topology::Circle => turns + x - f64::from(logits[3 * bins]),
    }
}

fn sizes(logits: &[f32]) -> Vec<f64> {
    let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let exponentials: Vec<f64> = logits.iter().map(|&logit| f64::from(logit - largest).exp()).collect();
    let total: f64 = exponentials.iter().sum();
    let free = 1.0 - logits.len() as f64 * MIN_BIN;
    exponentials.into_iter().map(|e| MIN_BIN + free * e / total).collect()
}

fn slope(logit: f32) -> f64 {
    MIN_SLOPE + (f64::from(logit) + slope_offset()).exp().ln_1p()
}

/// Where in a bin of secant `s` and end slopes `d0`, `d1` the rational quadratic has a value: the root in which nothing cancels.
fn solve(s: f64, d0: f64, d1: f64, value: f64) -> f64 {
    let e = d0 + d1 - 2.0 * s;
    let (a, b, c) = (s - d0 + value * e, d0 - value * e, s * value);
    let root = (b * b + 4.0 * a * c).max(0.0).sqrt();
    let t = if b >= 0.0 { 2.0 * c / (b + root) } else { (root - b) / (2.0 * a) };
    if t.is_finite() { t.clamp(0.0, 1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use headtail_model::spline::analytic::AnalyticSpline;
    use headtail_render::random::{Purpose, Stream};

    use super::*;

    #[test]
    fn it_is_the_inverse_of_the_density_direction() {
        let mut random = Stream::new(3, Purpose::Test, 0);
        for topology in [Topology::Interval, Topology::Circle] {
            for bins in [2, 8, 128] {
                let logits: Vec<f32> = (0..=3 * bins).map(|_| 3.0 * random.uniform() - 1.5).collect();
                let mut spline = AnalyticSpline::new(topology, bins);
                spline.prepare(&logits);
                for _ in 0..200 {
                    let y = random.uniform();
                    let at = spline.evaluate(y);
                    let back = invert(topology, &logits, f64::from(at.z));
                    let apart = match topology {
                        Topology::Interval => (back - f64::from(y)).abs(),
                        Topology::Circle => ((back - f64::from(y)) + 0.5).rem_euclid(1.0) - 0.5,
                    };
                    // z is known to 1e-7, which one over the slope magnifies.
                    assert!(
                        apart.abs() < 3e-6 * (1.0 + f64::from(-at.log_slope).exp()),
                        "{topology:?} {bins}: {y} {back}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_circle_is_lifted() {
        let logits: Vec<f32> = (0..25).map(|k| (k % 5) as f32 * 0.3 + if k == 24 { 3.0 } else { 0.0 }).collect();
        let (low, high) = (invert(Topology::Circle, &logits, 0.2), invert(Topology::Circle, &logits, 1.2));
        assert!((high - low - 1.0).abs() < 1e-12);
        let (below, above) = (invert(Topology::Circle, &logits, 1.0 - 1e-12), invert(Topology::Circle, &logits, 1.0));
        assert!((above - below).abs() < 1e-9);
    }
}
