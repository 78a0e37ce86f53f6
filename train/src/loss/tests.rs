//! Values and derivatives of the losses of one condition.

use super::{Loss, LossDerivatives, NormalizedTarget, Objective};
use crate::integrand::ConditionPoints;

const DENSITIES: [f32; 6] = [0.0, 1.0, 3.0, 0.5, 0.0, 2.0];
/// The last point is excluded.
const WEIGHTS: [f32; 6] = [1.0, 0.5, 2.0, 1.0, 0.3, 0.0];
const BRDF: [f32; 6] = [0.0, 0.3, 2.0, 5.0, 1.0, 0.0];
const TAILS: [f32; 6] = [0.5, 1.0, 3.0, 0.1, 1.0, 0.0];
const LOG_Q: [f32; 6] = [0.3, -0.2, 0.8, -1.0, 0.1, 0.4];

const POINTS: ConditionPoints<'static> =
    ConditionPoints { densities: &DENSITIES, weights: &WEIGHTS, brdf: &BRDF, tails: &TAILS, mixture_weight_logit: 0.7 };
const UNIFORM: ConditionPoints<'static> = ConditionPoints { weights: &[1.0; 6], ..POINTS };

fn objectives() -> Vec<Objective> {
    let with = |entropic| Loss::ALL.map(|loss| Objective { loss, entropic });
    [with(0.0), with(0.03)].concat()
}

fn evaluate(
    objective: Objective,
    points: &ConditionPoints<'_>,
    log_q: &[f32],
    logit: Option<f32>,
) -> (f32, Vec<f32>, f32) {
    let mut d_log_q = vec![f32::NAN; log_q.len()];
    let mut out = LossDerivatives { d_log_q: &mut d_log_q, d_mixture_weight_logit: f32::NAN };
    let loss = objective.evaluate(points, log_q, logit, &mut out).unwrap();
    let d_mixture_weight_logit = out.d_mixture_weight_logit;
    (loss, d_log_q, d_mixture_weight_logit)
}

#[test]
fn every_loss_is_zero_for_the_target_itself() {
    for points in [POINTS, UNIFORM] {
        let target = NormalizedTarget::new(&points).unwrap();
        let log_q: Vec<f32> = target.log_densities.iter().map(|log| log.max(-20.0)).collect();
        for loss in Loss::ALL {
            let (value, ..) = evaluate(loss.into(), &points, &log_q, None);
            assert!(value.abs() < 1e-5, "{loss}: {value}");
        }
    }
}

#[test]
fn log_chi_square_of_the_uniform_density_is_the_log_of_the_second_moment() {
    let (sum, squares): (f32, f32) = (6.5, 1.0 + 9.0 + 0.25 + 4.0);
    let expected = (6.0 * squares / (sum * sum)).ln();
    let (value, ..) = evaluate(Loss::LogChiSquare.into(), &UNIFORM, &[0.0; 6], None);
    assert!((value - expected).abs() < 1e-6);
}

#[test]
fn the_entropic_term_is_the_mean_of_q_ln_q_under_the_target() {
    let (plain, ..) = evaluate(Loss::ForwardKl.into(), &POINTS, &LOG_Q, None);
    let (regularised, ..) = evaluate(Objective { loss: Loss::ForwardKl, entropic: 0.5 }, &POINTS, &LOG_Q, None);
    let (mut sum, mut total) = (0.0, 0.0);
    for i in 0..6 {
        let (mass, q) = (DENSITIES[i] * WEIGHTS[i], LOG_Q[i].exp() * TAILS[i]);
        total += mass;
        sum += if mass > 0.0 { mass * q * q.ln() } else { 0.0 };
    }
    assert!((regularised - plain - 0.5 * sum / total).abs() < 1e-5);
}

#[test]
fn a_mixture_with_brdf_sampling_has_the_loss_of_its_density() {
    // Logits that sum to 0 give mixture weight 1/2.
    let mixed: Vec<f32> = LOG_Q.iter().zip(BRDF).map(|(log_q, b)| (0.5 * log_q.exp() + 0.5 * b).ln()).collect();
    for objective in objectives() {
        let (expected, ..) = evaluate(objective, &POINTS, &mixed, None);
        let (found, ..) = evaluate(objective, &POINTS, &LOG_Q, Some(-POINTS.mixture_weight_logit));
        assert!((expected - found).abs() < 1e-5, "{objective:?}: {expected} {found}");
    }
}

#[test]
fn derivatives_match_central_differences() {
    for objective in objectives() {
        for logit in [None, Some(-0.7), Some(1.3)] {
            let (_, d_log_q, d_mixture_weight_logit) = evaluate(objective, &POINTS, &LOG_Q, logit);
            // f32 differences over 0.04: rounding 4e-7 / 0.04, truncation 0.02^2 / 6 times a third derivative
            // of up to 4.
            let close = |found: f32, high: f32, low: f32, what: &str| {
                let difference = (high - low) / 0.04;
                assert!((found - difference).abs() < 3e-4, "{objective:?} {logit:?} {what}: {found} {difference}");
            };
            for i in 0..6 {
                let at = |step: f32| {
                    let mut moved = LOG_Q;
                    moved[i] += step;
                    evaluate(objective, &POINTS, &moved, logit).0
                };
                close(d_log_q[i], at(0.02), at(-0.02), &format!("point {i}"));
            }
            if let Some(logit) = logit {
                let at = |step: f32| evaluate(objective, &POINTS, &LOG_Q, Some(logit + step)).0;
                close(d_mixture_weight_logit, at(0.02), at(-0.02), "mixture weight");
                assert!(d_mixture_weight_logit.abs() > 1e-3, "{d_mixture_weight_logit} tests nothing");
            } else {
                assert_eq!(d_mixture_weight_logit, 0.0);
            }
        }
    }
}

#[test]
fn a_condition_without_light_has_no_loss() {
    let dark = ConditionPoints { densities: &[0.0; 6], ..POINTS };
    let lost = ConditionPoints { weights: &[0.0; 6], ..POINTS };
    for points in [dark, lost] {
        let mut out = LossDerivatives { d_log_q: &mut [0.0; 6], d_mixture_weight_logit: 0.0 };
        assert!(Objective::from(Loss::ForwardKl).evaluate(&points, &LOG_Q, None, &mut out).is_none());
    }
}

#[test]
fn huge_log_densities_do_not_overflow() {
    for objective in objectives() {
        for logit in [None, Some(50.0)] {
            let extreme = [-300.0, -200.0, 50.0, 3.0, 1.0, 100.0];
            let (loss, d_log_q, d_mixture_weight_logit) = evaluate(objective, &POINTS, &extreme, logit);
            assert!(loss.is_finite() && d_log_q.iter().all(|d| d.is_finite()), "{objective:?} {logit:?}");
            assert!(d_mixture_weight_logit.is_finite(), "{objective:?} {logit:?}");
        }
    }
}
