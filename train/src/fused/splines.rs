//! Splines of many samples with their derivatives, over matrices `[logits, samples]`.

use headtail_render::{
    simd::{LANES, Lanes},
    spline::{self, Evaluation, Gradient, Logits, Topology},
};

use super::matrix::lanes_mut;

/// Values and log-slopes of splines, and the derivatives of both.
#[derive(Default)]
pub(super) struct Splines {
    /// `[3K + 1, samples]`: logits; after [`evaluate`](Self::evaluate), derivatives of the log-slopes with
    /// respect to them.
    pub logits: Vec<f32>,
    /// `[3K + 1, samples]`: derivatives of the values with respect to the logits, if requested.
    pub d_values: Vec<f32>,
    pub values: Vec<f32>,
    pub log_slopes: Vec<f32>,
    /// Derivatives of values and log-slopes with respect to the points, if those for the logits were
    /// requested.
    pub d_points: [Vec<f32>; 2],
    scratch: Vec<Lanes>,
}

impl Splines {
    /// Evaluates the splines at `points`, a whole number of [`LANES`], in the density direction.
    #[inline(always)]
    pub fn evaluate(&mut self, topology: Topology, bins: usize, points: &[f32], with_values: bool) {
        let samples = points.len();
        self.values.resize(samples, 0.0);
        self.log_slopes.resize(samples, 0.0);
        self.scratch.resize(2 * bins, [0.0; LANES]);
        if with_values {
            self.d_values.resize(self.logits.len(), 0.0);
            self.d_points[0].resize(samples, 0.0);
            self.d_points[1].resize(samples, 0.0);
        }
        let (strips, _) = points.as_chunks::<LANES>();
        for (strip, points) in strips.iter().enumerate() {
            let first = strip * LANES;
            let logits = Logits { bins, values: &self.logits, stride: samples, first };
            let found = spline::inverse_with_gradient(topology, logits, &mut self.scratch, points);
            self.store(&found, first, samples, with_values);
        }
    }

    #[inline(always)]
    fn store(&mut self, found: &Evaluation<f32, LANES>, first: usize, samples: usize, with_values: bool) {
        *lanes_mut(&mut self.values, first) = found.values;
        *lanes_mut(&mut self.log_slopes, first) = found.log_slopes;
        found.write(Gradient::LogSlope, &self.scratch, &mut self.logits, samples, first);
        if with_values {
            found.write(Gradient::Value, &self.scratch, &mut self.d_values, samples, first);
            *lanes_mut(&mut self.d_points[0], first) = found.d_point(Gradient::Value);
            *lanes_mut(&mut self.d_points[1], first) = found.d_point(Gradient::LogSlope);
        }
    }

    /// Propagates derivatives of a loss from the log-slopes, and the values if any, to the logits; overwrites
    /// `logits`.
    #[inline(always)]
    pub fn backward(&mut self, d_log_slopes: &[f32], d_values: Option<&[f32]>) {
        let samples = d_log_slopes.len();
        for (row, out) in self.logits.chunks_exact_mut(samples).enumerate() {
            match d_values {
                None => {
                    for (out, factor) in out.iter_mut().zip(d_log_slopes) {
                        *out *= factor;
                    }
                }
                Some(d_values) => {
                    let d_logit = &self.d_values[row * samples..][..samples];
                    for (((out, d_logit), d_value), d_log) in
                        out.iter_mut().zip(d_logit).zip(d_values).zip(d_log_slopes)
                    {
                        *out = *out * d_log + d_logit * d_value;
                    }
                }
            }
        }
    }
}
