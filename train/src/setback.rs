//! Setbacks: at a high learning rate, a few steps of a long run can raise the loss for good.
//!
//! AdamW divides by the root mean square of about the last thousand gradients, so a single batch with a much
//! larger gradient moves all weights at once by several learning rates. When validation finds such a setback,
//! weights and moments are reset to those of the best validation so far, and the learning rate is halved from
//! there on.

use crate::{
    Divergence, FitConfig,
    state::{BestValidation, TrainingState},
};

impl TrainingState {
    /// Stores a validation that is the best so far; after a setback, resets to the best one.
    pub fn judge(&mut self, config: &FitConfig, divergence: Divergence) {
        if config.setback == 0.0 {
            return;
        }
        let found = divergence.relative_variance;
        let least = self.best.as_ref().map_or(f64::INFINITY, |best| best.divergence.relative_variance);
        if found < least && divergence.kl.is_finite() {
            self.best = Some(BestValidation { divergence, parameters: self.parameters.clone() });
        } else if let Some(best) = &self.best
            && (found.is_nan() || found > f64::from(config.setback) * least)
        {
            self.parameters.clone_from(&best.parameters);
            self.rate_factor *= 0.5;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn divergence(relative_variance: f64) -> Divergence {
        Divergence { kl: 0.1, log_chi_square: 0.1, relative_variance }
    }

    #[test]
    fn a_setback_resets_to_the_best_and_halves_the_rate() {
        let config = FitConfig { setback: 2.0, ..FitConfig::default() };
        let mut state = TrainingState::new(&config, vec![0.0]);
        let mut after = |weight, relative_variance| {
            state.parameters.weights = vec![weight];
            state.judge(&config, divergence(relative_variance));
            let best = state.best.as_ref().unwrap().divergence.relative_variance;
            (state.parameters.weights[0], best, state.rate_factor)
        };
        assert_eq!(after(0.0, 1.0), (0.0, 1.0, 1.0));
        assert_eq!(after(1.0, 0.1), (1.0, 0.1, 1.0));
        assert_eq!(after(2.0, 0.15), (2.0, 0.1, 1.0));
        for (bad, rate_factor) in [(0.3, 0.5), (f64::NAN, 0.25), (f64::INFINITY, 0.125)] {
            assert_eq!(after(3.0, bad), (1.0, 0.1, rate_factor));
        }
    }

    #[test]
    fn a_factor_of_zero_disables_resets() {
        let config = FitConfig { setback: 0.0, ..FitConfig::default() };
        let mut state = TrainingState::new(&config, vec![0.0]);
        for variance in [0.1, 100.0] {
            state.judge(&config, divergence(variance));
            assert_eq!((&state.best, state.rate_factor), (&None, 1.0));
        }
    }
}
