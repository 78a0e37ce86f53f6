//! Monotone rational-quadratic splines on `[0,1]` (Durkan et al. 2019) and on the circle (Rezende et al. 2020), one point at a time.

use super::{MAX_BINS, Topology};

/// Floor of a bin's width and height.
pub(super) const MIN_BIN: f32 = 1e-4;
/// Floor of a slope.
pub(super) const MIN_SLOPE: f32 = 1e-4;
/// `ln(e^(1 - MIN_SLOPE) - 1)`: makes a zero logit the slope 1.
pub(super) const SLOPE_OFFSET: f32 = 0.541_166_65;
/// The largest f32 below 1.
pub(super) const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// A spline of K bins. Its `3 K + 1` logits are widths, heights, and then slopes at the K + 1 knots (interval), or slopes at K
/// knots and a shift in turns (circle). Zero logits are the identity.
#[derive(Clone, Copy, Debug)]
pub struct Spline {
    topology: Topology,
    bins: usize,
    widths: [f32; MAX_BINS],
    heights: [f32; MAX_BINS],
    slopes: [f32; MAX_BINS + 1],
    shift: f32,
}

/// One bin: its left knot on both axes, its sizes, and the slopes at its two knots.
#[derive(Clone, Copy, Debug)]
struct Bin {
    left: f32,
    bottom: f32,
    width: f32,
    height: f32,
    slopes: [f32; 2],
}

impl Spline {
    /// The spline of `3 K + 1` logits, `2 <= K <= MAX_BINS`.
    pub fn new(topology: Topology, logits: &[f32]) -> Self {
        let bins = (logits.len() - 1) / 3;
        let mut spline = Self {
            topology,
            bins,
            widths: [0.0; MAX_BINS],
            heights: [0.0; MAX_BINS],
            slopes: [0.0; MAX_BINS + 1],
            shift: 0.0,
        };
        normalize_bin_sizes(&logits[..bins], &mut spline.widths[..bins]);
        normalize_bin_sizes(&logits[bins..2 * bins], &mut spline.heights[..bins]);
        let knots = &logits[2 * bins..];
        match topology {
            Topology::Interval => spline.slopes[..=bins].copy_from_slice(knots),
            Topology::Circle => {
                spline.slopes[..bins].copy_from_slice(&knots[..bins]);
                spline.slopes[bins] = knots[0];
                spline.shift = knots[bins] - knots[bins].round_ties_even();
            }
        }
        spline
    }

    /// `y -> (z, ln |dz/dy|)`, the density direction, in closed form. `y` is clamped (interval) or wrapped (circle).
    pub fn inverse(&self, y: f32) -> (f32, f32) {
        let x = match self.topology {
            Topology::Interval => y.clamp(0.0, 1.0),
            Topology::Circle => wrap(wrap(y) + self.shift),
        };
        let bin = self.find(x, &self.widths);
        let t = ((x - bin.left) / bin.width).clamp(0.0, 1.0);
        let (value, log_slope) = bin.evaluate(t);
        ((bin.bottom + bin.height * value).clamp(0.0, 1.0), log_slope)
    }

    /// `z -> (y, ln |dz/dy|)`, the sampling direction, by the quadratic's root; the log-derivative is the log-density at `y`.
    pub fn forward(&self, z: f32) -> (f32, f32) {
        let z = z.clamp(0.0, 1.0);
        let bin = self.find(z, &self.heights);
        let t = bin.solve(((z - bin.bottom) / bin.height).clamp(0.0, 1.0));
        let x = (bin.left + bin.width * t).clamp(0.0, 1.0);
        let y = match self.topology {
            Topology::Interval => x.min(BELOW_ONE),
            Topology::Circle => wrap(x - self.shift),
        };
        (y, bin.evaluate(t).1)
    }

    /// The bin that holds `x` on one axis: the number of interior knots at or below it.
    fn find(&self, x: f32, sizes: &[f32; MAX_BINS]) -> Bin {
        let (mut index, mut knot) = (0, 0.0);
        for (k, size) in sizes[..self.bins - 1].iter().enumerate() {
            knot += size;
            index = if x >= knot { k + 1 } else { index };
        }
        Bin {
            left: self.widths[..index].iter().sum(),
            bottom: self.heights[..index].iter().sum(),
            width: self.widths[index],
            height: self.heights[index],
            slopes: [slope(self.slopes[index]), slope(self.slopes[index + 1])],
        }
    }
}

impl Bin {
    /// The value in the bin at position `t`, both in `[0, 1]`, and the log of the slope (Durkan et al., eq. 4 and 5).
    ///
    /// Every argument of a log is positive: the secant is a ratio of positive sizes; the weights of `n` are not negative and sum
    /// to 1 over three positive values; `d >= secant / 2`, because `t (1 - t) <= 1/4`.
    fn evaluate(&self, t: f32) -> (f32, f32) {
        let [d0, d1] = self.slopes;
        let (o, s) = (1.0 - t, self.height / self.width);
        let n = d1 * t * t + 2.0 * s * t * o + d0 * o * o;
        let d = s * (1.0 - 2.0 * t * o) + (d0 + d1) * t * o;
        ((s * t + d0 * o) * t / d, 2.0 * s.ln() + n.ln() - 2.0 * d.ln())
    }

    /// The position at which the bin has a value, both in `[0, 1]`: the root of `a t^2 + b t - c` in the form in which nothing
    /// cancels, for either sign of `b`. The discriminant is written as a sum of terms that are not negative.
    fn solve(&self, value: f32) -> f32 {
        let [d0, d1] = self.slopes;
        let (o, s) = (1.0 - value, self.height / self.width);
        let b = d0 - (d0 + d1 - 2.0 * s) * value;
        let ends = d0 * o - d1 * value;
        let root = (ends * ends + 4.0 * s * s * value * o).sqrt();
        let t = if b >= 0.0 { 2.0 * s * value / (b + root) } else { (root - b) / (2.0 * (s - b)) };
        t.clamp(0.0, 1.0)
    }
}

/// Softmax with a floor; the sizes sum to 1.
fn normalize_bin_sizes(logits: &[f32], sizes: &mut [f32]) {
    let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let mut sum = 0.0;
    for (size, logit) in sizes.iter_mut().zip(logits) {
        *size = (logit - largest).exp();
        sum += *size;
    }
    let scale = (1.0 - logits.len() as f32 * MIN_BIN) / sum;
    for size in sizes {
        *size = MIN_BIN + *size * scale;
    }
}

/// Softplus with a floor, 1 for a zero logit.
fn slope(logit: f32) -> f32 {
    let x = logit + SLOPE_OFFSET;
    MIN_SLOPE + if x > 20.0 { x } else { x.exp().ln_1p() }
}

/// Onto `[0, 1)`; the last step is needed because `x - floor(x)` rounds to 1 for a tiny negative `x`.
fn wrap(x: f32) -> f32 {
    let fraction = x - x.floor();
    if fraction >= 1.0 { 0.0 } else { fraction }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Stream};

    const BOTH: [Topology; 2] = [Topology::Interval, Topology::Circle];

    fn logits(random: &mut Stream, bins: usize, scale: f32) -> Vec<f32> {
        (0..3 * bins + 1).map(|_| scale * (random.uniform() + random.uniform() + random.uniform() - 1.5)).collect()
    }

    /// Distance on the circle, which serves on the interval too: its ends are never mistaken for each other below.
    fn distance(a: f32, b: f32) -> f32 {
        (a - b).abs().min(1.0 - (a - b).abs())
    }

    #[test]
    fn zero_logits_are_the_identity() {
        for topology in BOTH {
            let spline = Spline::new(topology, &[0.0; 13]);
            for k in 0..1000 {
                let y = k as f32 / 1000.0;
                for (value, log_slope) in [spline.inverse(y), spline.forward(y)] {
                    assert!(
                        (value - y).abs() < 1e-6 && log_slope.abs() < 2e-6,
                        "{topology:?} {y}: {value}, {log_slope}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_million_inversions_return_to_their_start() {
        let mut random = Stream::new(3, Purpose::Test, 0);
        for round in 0..20_000 {
            let bins = [2, 4, 8, 32][round % 4];
            let spline = Spline::new(BOTH[round % 2], &logits(&mut random, bins, 3.0));
            for _ in 0..50 {
                let z = random.uniform();
                let (y, log_slope) = spline.forward(z);
                let (back, log_density) = spline.inverse(y);
                assert!((0.0..1.0).contains(&y));
                // y is rounded to 1.2e-7 through the shift and the knots; the slope carries that to z.
                let tolerance = 2e-6 + 4e-7 * log_slope.exp();
                assert!(distance(back, z) < tolerance, "{z} -> {y} -> {back}, slope {}", log_slope.exp());
                assert!((log_density - log_slope).abs() < 1e-3 + 2.0 * tolerance / 1e-4, "{log_density} {log_slope}");
            }
        }
    }

    #[test]
    fn extreme_logits_stay_finite_and_inside() {
        let mut random = Stream::new(4, Purpose::Test, 0);
        for round in 0..20_000 {
            let spline = Spline::new(BOTH[round % 2], &logits(&mut random, 8, 100.0));
            for x in [0.0, f32::MIN_POSITIVE, random.uniform(), random.uniform(), BELOW_ONE, 1.0] {
                for (value, log_slope) in [spline.forward(x), spline.inverse(x)] {
                    assert!((0.0..=1.0).contains(&value) && log_slope.is_finite(), "{x}: {value} {log_slope}");
                }
            }
        }
    }

    #[test]
    fn the_circle_has_no_seam() {
        let mut random = Stream::new(5, Purpose::Test, 0);
        for _ in 0..2000 {
            let spline = Spline::new(Topology::Circle, &logits(&mut random, 6, 3.0));
            assert_eq!(spline.inverse(0.0), spline.inverse(1.0));
            let (left, right) = (spline.inverse(BELOW_ONE).1, spline.inverse(0.0).1);
            assert!((left - right).abs() < 0.02, "{left} {right}");
        }
    }

    #[test]
    fn the_density_integrates_to_one() {
        let mut random = Stream::new(6, Purpose::Test, 0);
        for round in 0..40 {
            let spline = Spline::new(BOTH[round % 2], &logits(&mut random, 6, 2.0));
            let n = 200_000;
            let sum: f64 = (0..n).map(|k| f64::from(spline.inverse((k as f32 + 0.5) / n as f32).1.exp())).sum();
            assert!((sum / f64::from(n) - 1.0).abs() < 1e-4, "{}", sum / f64::from(n));
        }
    }
}
