//! Losses of one condition: value, and derivatives with respect to each log-density and to the mixture
//! weight's logit.

mod in_graph;
#[cfg(test)]
mod tests;

use headtail_model::head::{MIXTURE_WEIGHT_FLOOR, mixture_weight_of_logit};
use headtail_render::statistics::relative_variance_of_log_moment;
use serde::{Deserialize, Serialize};

use crate::{
    config::name_of,
    integrand::{Batch, ConditionPoints},
};

/// A training loss, averaged over the conditions whose target is not zero everywhere.
///
/// At `n` points with weights `v_i` (one over their density) let `g_i` be the target,
/// `w_i = v_i g_i / sum v g`, and `p_i = n g_i / sum v g` the target's density. All losses are 0 for a
/// perfect head, up to the noise of the points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Loss {
    /// Forward Kullback-Leibler divergence in nats, `sum_i w_i ln(p_i / q_i)`: weighted maximum likelihood,
    /// as in the paper.
    ForwardKl,
    /// `ln sum_i w_i p_i / q_i = ln(1 + chi-square) = ln(1 + relative variance)`: the renderer's cost, with
    /// gradients bounded by the logarithm.
    #[default]
    LogChiSquare,
    /// The chi-square divergence itself, `sum_i w_i p_i / q_i - 1`: its gradients scale with the largest
    /// weights. For comparison.
    ChiSquare,
    /// Reverse Kullback-Leibler divergence `E_q[ln q - ln p]` in nats, by self-normalised importance sampling
    /// with the given points: `sum_i u_i ln(u_i / w_i)`, `u_i = v_i q_i / sum v q`. Its derivative with
    /// respect to `ln q_i` is `u_i (ln(u_i / w_i) - loss)`, the score-function estimator of the gradient with
    /// the loss as its baseline. Unstable, as the paper found: it misses concentrations of `q` between the
    /// points, and fits one mode of the target. For comparison.
    ReverseKl,
}

/// [`Loss::ReverseKl`] clamps the target to at least this fraction of its mean: the logarithm of 0 has no
/// useful gradient.
const REVERSE_TARGET_FLOOR: f64 = 1e-4;

/// [`Objective::entropic`] clamps the log-density to this range, where its exponential is finite.
const ENTROPIC_RANGE: f32 = 60.0;

/// [`Loss::ChiSquare`] is clamped to the exponential of this.
const LARGEST_LOG_CHI_SQUARE: f32 = 60.0;

impl Loss {
    /// All losses.
    pub const ALL: [Self; 4] = [Self::ForwardKl, Self::LogChiSquare, Self::ChiSquare, Self::ReverseKl];
}

impl std::fmt::Display for Loss {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&name_of(self))
    }
}

/// A loss and its regularisation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Objective {
    /// The loss.
    pub loss: Loss,
    /// Factor `lambda` of the paper's entropic term `E_{x ~ p*}[q_X(x) ln q_X(x)]`, where `q_X` is the
    /// density over the sample square X, the tail's Jacobian included (section 4.3 of the paper writes it
    /// with the density of the whole warp). It is `integral p* q_X ln q_X`: a penalty on high density where
    /// the target is high, which grows faster than `q_X`, so that the highest peaks are lowered and their
    /// mass moves to where the target is low. It opposes the likelihood instead of adding another minimum,
    /// and hence has a small factor. In Y it would be another regulariser: the tail's density multiplies it
    /// pointwise, and a sun counts more than a sky.
    pub entropic: f32,
}

impl From<Loss> for Objective {
    fn from(loss: Loss) -> Self {
        Self { loss, entropic: 0.0 }
    }
}

/// The target at one condition's points, normalised by the points themselves.
pub struct NormalizedTarget {
    /// `ln w_i`; `-inf` where the target or the point's weight is zero.
    pub log_weights: Vec<f32>,
    /// `ln p_i`; `-inf` where the target is zero.
    pub log_densities: Vec<f32>,
}

impl NormalizedTarget {
    /// Normalises the target; `None` if it is zero at all points that are not excluded.
    pub fn new(points: &ConditionPoints<'_>) -> Option<Self> {
        let products = || points.densities.iter().zip(points.weights).map(|(&g, &v)| f64::from(g) * f64::from(v));
        let total: f64 = products().sum();
        if total <= 0.0 {
            return None;
        }
        let mean = total / points.densities.len() as f64;
        Some(Self {
            log_weights: products().map(|product| (product / total).ln() as f32).collect(),
            log_densities: points.densities.iter().map(|&g| (f64::from(g) / mean).ln() as f32).collect(),
        })
    }
}

/// Derivatives of one condition's loss.
pub struct LossDerivatives<'a> {
    /// With respect to the head's log-density at each point; overwritten.
    pub d_log_q: &'a mut [f32],
    /// With respect to the mixture weight's logit.
    pub d_mixture_weight_logit: f32,
}

impl Objective {
    /// Returns the loss of one condition and its derivatives; `None` if the target is zero at all its points.
    ///
    /// `log_q` is the head's log-density. With a mixture weight logit, the loss is that of the mixture
    /// `q_mix = p q + (1 - p) b` with BRDF sampling `b`, and the derivatives propagate through it.
    pub fn evaluate(
        &self,
        points: &ConditionPoints<'_>,
        log_q: &[f32],
        mixture_weight_logit: Option<f32>,
        out: &mut LossDerivatives<'_>,
    ) -> Option<f32> {
        let target = NormalizedTarget::new(points)?;
        out.d_mixture_weight_logit = 0.0;
        let Some(logit) = mixture_weight_logit else {
            return Some(self.of_density(&target, points, log_q, out.d_log_q));
        };
        let mixture = Mixture::new(logit + points.mixture_weight_logit);
        let log_mixed: Vec<f32> = log_q.iter().zip(points.brdf).map(|(&log_q, &b)| mixture.log(log_q, b)).collect();
        let loss = self.of_density(&target, points, &log_mixed, out.d_log_q);
        let mut d_mixture_weight = 0.0;
        for ((d, &log_q), &log_mixed) in out.d_log_q.iter_mut().zip(log_q).zip(&log_mixed) {
            let d_mixed = *d;
            let part = mixture.head_part(log_q, log_mixed);
            *d = d_mixed * part;
            d_mixture_weight +=
                d_mixed * (part / mixture.mixture_weight - (1.0 - part) / (1.0 - mixture.mixture_weight));
        }
        out.d_mixture_weight_logit = d_mixture_weight * mixture.d_logit;
        Some(loss)
    }

    /// Returns the sum of the losses of lit conditions from `first` on. Of the derivatives, `d_log_q` is
    /// overwritten, `d_mixture_weight_logits` only for lit conditions.
    ///
    /// `log_q` has the log-densities of all their points; `mixture_weight_logits` is empty without learned mixture
    /// weight.
    pub fn evaluate_conditions(
        &self,
        batch: &Batch,
        first: usize,
        log_q: &[f32],
        mixture_weight_logits: &[f32],
        d_log_q: &mut [f32],
        d_mixture_weight_logits: &mut [f32],
    ) -> f32 {
        let mut sum = 0.0;
        let rows = d_log_q.chunks_exact_mut(batch.samples).zip(log_q.chunks_exact(batch.samples));
        for (index, (d_log_q, log_q)) in rows.enumerate() {
            d_log_q.fill(0.0);
            let mut out = LossDerivatives { d_log_q, d_mixture_weight_logit: 0.0 };
            let (points, logit) = (batch.condition(first + index), mixture_weight_logits.get(index).copied());
            let Some(loss) = self.evaluate(&points, log_q, logit, &mut out) else { continue };
            sum += loss;
            if let Some(d_mixture_weight_logit) = d_mixture_weight_logits.get_mut(index) {
                *d_mixture_weight_logit = out.d_mixture_weight_logit;
            }
        }
        sum
    }

    /// Returns the loss for the log-density of samples, and its derivatives.
    fn of_density(
        &self,
        target: &NormalizedTarget,
        points: &ConditionPoints<'_>,
        log_q: &[f32],
        derivatives: &mut [f32],
    ) -> f32 {
        let loss = match self.loss {
            Loss::ForwardKl => forward_kl(target, log_q, derivatives),
            Loss::LogChiSquare => log_chi_square(target, log_q, derivatives),
            Loss::ChiSquare => chi_square(target, log_q, derivatives),
            Loss::ReverseKl => reverse_kl(target, points.weights, log_q, derivatives),
        };
        if self.entropic == 0.0 {
            return loss;
        }
        let mut entropic = 0.0;
        for (((&log_w, &log_q), &tail), d) in
            target.log_weights.iter().zip(log_q).zip(points.tails).zip(derivatives.iter_mut())
        {
            let (w, log_x) = (log_w.exp(), log_q + tail.ln());
            let held = log_x.clamp(-ENTROPIC_RANGE, ENTROPIC_RANGE);
            if w > 0.0 {
                entropic += w * held.exp() * held;
                *d += if held == log_x { self.entropic * w * held.exp() * (held + 1.0) } else { 0.0 };
            }
        }
        loss + self.entropic * entropic
    }
}

fn forward_kl(target: &NormalizedTarget, log_q: &[f32], derivatives: &mut [f32]) -> f32 {
    let mut loss = 0.0;
    for (((&log_w, &log_p), &log_q), d) in
        target.log_weights.iter().zip(&target.log_densities).zip(log_q).zip(derivatives)
    {
        let w = log_w.exp();
        *d = -w;
        if w > 0.0 {
            loss += w * (log_p - log_q);
        }
    }
    loss
}

fn log_chi_square(target: &NormalizedTarget, log_q: &[f32], derivatives: &mut [f32]) -> f32 {
    for (((&log_w, &log_p), &log_q), d) in
        target.log_weights.iter().zip(&target.log_densities).zip(log_q).zip(derivatives.iter_mut())
    {
        *d = if log_w == f32::NEG_INFINITY { f32::NEG_INFINITY } else { log_w + log_p - log_q };
    }
    // Finite: at least one weight is positive.
    let largest = derivatives.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let sum: f32 = derivatives.iter().map(|term| (term - largest).exp()).sum();
    for d in derivatives {
        *d = -(*d - largest).exp() / sum;
    }
    largest + sum.ln()
}

fn chi_square(target: &NormalizedTarget, log_q: &[f32], derivatives: &mut [f32]) -> f32 {
    let log = log_chi_square(target, log_q, derivatives).min(LARGEST_LOG_CHI_SQUARE);
    derivatives.iter_mut().for_each(|d| *d *= log.exp());
    relative_variance_of_log_moment(f64::from(log)) as f32
}

fn reverse_kl(target: &NormalizedTarget, weights: &[f32], log_q: &[f32], derivatives: &mut [f32]) -> f32 {
    let log_u = |(&v, &log_q): (&f32, &f32)| v.ln() + log_q;
    let largest = weights.iter().zip(log_q).map(log_u).fold(f32::NEG_INFINITY, f32::max);
    let sum: f32 = weights.iter().zip(log_q).map(|point| (log_u(point) - largest).exp()).sum();
    let log_sum = largest + sum.ln();
    let count = (log_q.len() as f32).ln();
    let floor = REVERSE_TARGET_FLOOR.ln() as f32;
    let mut loss = 0.0;
    for ((point, &log_p), d) in weights.iter().zip(log_q).zip(&target.log_densities).zip(derivatives.iter_mut()) {
        let log_u = log_u(point) - log_sum;
        // ln(u / w), with w clamped where the target is zero.
        *d = log_u - (log_p.max(floor) + point.0.ln() - count);
        if *point.0 > 0.0 {
            loss += log_u.exp() * *d;
        }
    }
    for (point, d) in weights.iter().zip(log_q).zip(derivatives) {
        *d = if *point.0 > 0.0 { (log_u(point) - log_sum).exp() * (*d - loss) } else { 0.0 };
    }
    loss
}

/// The mixture `q_mix = p q + (1 - p) b`, where `p` is the mixture weight.
struct Mixture {
    mixture_weight: f32,
    /// Derivative of the mixture weight with respect to its logit.
    d_logit: f32,
}

impl Mixture {
    fn new(logit: f32) -> Self {
        let mixture_weight = mixture_weight_of_logit(logit);
        let floor = MIXTURE_WEIGHT_FLOOR;
        Self {
            mixture_weight,
            d_logit: (mixture_weight - floor) * (1.0 - floor - mixture_weight) / (1.0 - 2.0 * floor),
        }
    }

    /// Returns `ln q_mix`.
    fn log(&self, log_q: f32, b: f32) -> f32 {
        let (head, brdf) = (self.mixture_weight.ln() + log_q, (1.0 - self.mixture_weight).ln() + b.ln());
        let largest = head.max(brdf);
        largest + ((head - largest).exp() + (brdf - largest).exp()).ln()
    }

    /// Returns the head's part of `q_mix`, `p q / q_mix`.
    fn head_part(&self, log_q: f32, log_mixed: f32) -> f32 {
        (self.mixture_weight.ln() + log_q - log_mixed).exp().min(1.0)
    }
}
