//! The sampling direction of a spline in double precision, lifted to the line.

use headtail_render::spline::{self, Logits, Topology, bin_count};

/// Maps `z -> y` by the spline with `3 K + 1` logits. On the circle `z` and `y` are lifted to the line:
/// `z + 1` maps to `y + 1`, and the shift is not wrapped, so that `y` is continuous in the logits.
pub fn invert(topology: Topology, logits: &[f32], z: f64) -> f64 {
    let bins = bin_count(logits.len());
    let mut logits: Vec<f64> = logits.iter().map(|&logit| f64::from(logit)).collect();
    let (mut turns, mut shift) = (0.0, 0.0);
    if topology == Topology::Circle {
        // A circle is an interval with equal slopes at both ends.
        turns = z.floor();
        shift = logits[3 * bins];
        logits[3 * bins] = logits[2 * bins];
    }
    let logits = Logits { bins, values: &logits, stride: 1, first: 0 };
    let ([y], _) = spline::forward(Topology::Interval, logits, &mut vec![[0.0]; 2 * bins], &[z - turns]);
    turns + y - shift
}

#[cfg(test)]
mod tests {
    use headtail_render::random::{Purpose, Stream};

    use super::*;

    #[test]
    fn it_inverts_the_density_direction() {
        let mut random = Stream::new(3, Purpose::Test, 0);
        for topology in [Topology::Interval, Topology::Circle] {
            for bins in [2, 8, 128] {
                let logits: Vec<f32> = (0..=3 * bins).map(|_| 3.0 * random.uniform() - 1.5).collect();
                let columns = Logits { bins, values: &logits, stride: 1, first: 0 };
                for _ in 0..200 {
                    let y = random.uniform();
                    let ([z], [slope]) = spline::inverse(topology, columns, &mut vec![[0.0]; 2 * bins], &[y]);
                    let apart = invert(topology, &logits, f64::from(z)) - f64::from(y);
                    let apart = if topology == Topology::Circle { apart - apart.round() } else { apart };
                    // z has an error of 1e-7, which one over the slope magnifies.
                    assert!(apart.abs() < 3e-6 * (1.0 + 1.0 / f64::from(slope)), "{topology:?} {bins}: {y} {apart}");
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
