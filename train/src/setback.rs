//! Going back: long runs at a high learning rate can lose in a few steps what they have learned, and never find it again.
//!
//! AdamW divides by the root mean square of about the last thousand gradients, so that a single batch with a much larger gradient than those moves all
//! weights at once by several learning rates. Where validation finds such a fall, weights and moments go back to those of the best validation so
//! far, and the learning rate is halved from there on.

use crate::{
    Divergence, FitConfig,
    state::{Kept, TrainingState},
};

/// What a validation leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The best so far: it is kept.
    Best,
    /// Worse, as validations are now and then.
    Worse,
    /// A fall: the state is that of the best validation again.
    WentBack,
}

impl TrainingState {
    /// Takes note of a validation, and goes back where it was a fall.
    pub fn judge(&mut self, config: &FitConfig, divergence: Divergence) -> Verdict {
        if config.setback == 0.0 {
            return Verdict::Worse;
        }
        let found = divergence.relative_variance;
        let fell =
            |kept: &Kept| found.is_nan() || found > f64::from(config.setback) * kept.divergence.relative_variance;
        match &self.kept {
            Some(kept) if found < kept.divergence.relative_variance && divergence.kl.is_finite() => {}
            None if found.is_finite() && divergence.kl.is_finite() => {}
            Some(kept) if fell(kept) => {
                self.weights.clone_from(&kept.weights);
                self.average.clone_from(&kept.average);
                self.optimizer.clone_from(&kept.optimizer);
                self.rate_factor *= 0.5;
                return Verdict::WentBack;
            }
            _ => return Verdict::Worse,
        }
        let (weights, average, optimizer) = (self.weights.clone(), self.average.clone(), self.optimizer.clone());
        self.kept = Some(Kept { divergence, weights, average, optimizer });
        Verdict::Best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn divergence(relative_variance: f64) -> Divergence {
        Divergence { kl: 0.1, log_chi_square: 0.1, relative_variance }
    }

    #[test]
    fn a_fall_goes_back_to_the_best_and_halves_the_rate() {
        let config = FitConfig { setback: 2.0, ..FitConfig::default() };
        let mut state = TrainingState::new(&config, vec![0.0]);
        assert_eq!(state.judge(&config, divergence(1.0)), Verdict::Best);
        state.weights = vec![1.0];
        assert_eq!(state.judge(&config, divergence(0.1)), Verdict::Best);
        state.weights = vec![2.0];
        assert_eq!(state.judge(&config, divergence(0.15)), Verdict::Worse);
        assert_eq!((state.weights[0], state.rate_factor), (2.0, 1.0));
        for bad in [0.3, f64::NAN, f64::INFINITY] {
            state.weights = vec![3.0];
            assert_eq!(state.judge(&config, divergence(bad)), Verdict::WentBack);
            assert_eq!(state.weights, [1.0]);
        }
        assert_eq!(state.rate_factor, 0.125);
        assert_eq!(state.kept.unwrap().divergence.relative_variance, 0.1);
    }

    #[test]
    fn where_it_is_off_nothing_is_kept() {
        let config = FitConfig { setback: 0.0, ..FitConfig::default() };
        let mut state = TrainingState::new(&config, vec![0.0]);
        for variance in [0.1, 100.0] {
            assert_eq!(state.judge(&config, divergence(variance)), Verdict::Worse);
        }
        assert_eq!((state.kept, state.rate_factor), (None, 1.0));
    }
}
