//! Pictures of a target and of a head's learned density over the square.

use burn::prelude::{Tensor, TensorData};
use headtail_model::{Head, head::mixture_weight_of_logit};
use headtail_render::random::{Purpose, Stream};

use crate::{FitConfig, Result, Target};

/// Values along each side of the square.
const SIDE: usize = 192;

/// Densities over Y (for a naive head over X) at one condition.
pub struct DensityPair {
    /// Values along each side of the square.
    pub side: usize,
    /// The target, `[side, side]`, elevation down and azimuth to the right; of mean 1 if there is light under
    /// the condition.
    pub target: Vec<f32>,
    /// The head's density, `[side, side]`; with a learned mixture weight, the mixture with BRDF sampling.
    pub learned: Vec<f32>,
}

/// Returns targets and learned densities at `count` conditions.
///
/// Conditions are drawn with the run's seed; one without light is drawn again.
///
/// # Errors
/// If the backend is not in this build.
pub fn density_pairs(head: &Head, config: &FitConfig, target: &dyn Target, count: u64) -> Result<Vec<DensityPair>> {
    let points: Vec<[f32; 2]> = points().collect();
    let pair = |index: u64| {
        let mut stream = Stream::new(config.seed, Purpose::Validation, 1 + index);
        let mut condition = vec![0.0; target.condition().length()];
        let mut wanted = Vec::new();
        // Nearly every condition has light: training rejects targets without.
        for _ in 0..100 {
            target.draw_condition(&mut stream, &mut condition);
            wanted = normalized(target.at_points(&condition, &points).iter().map(|values| values.target).collect());
            if wanted.iter().any(|&value| value > 0.0) {
                break;
            }
        }
        let learned = learned_density(head, config, target, &condition)?;
        Ok(DensityPair { side: SIDE, target: wanted, learned })
    };
    (0..count).map(pair).collect()
}

/// Iterates over the pixel centres, row by row.
fn points() -> impl Iterator<Item = [f32; 2]> {
    let centre = |index: usize| (index as f32 + 0.5) / SIDE as f32;
    (0..SIDE * SIDE).map(move |index| [centre(index % SIDE), centre(index / SIDE)])
}

/// Divides by the mean; all-zero values stay.
fn normalized(values: Vec<f32>) -> Vec<f32> {
    let mean = values.iter().map(|&value| f64::from(value)).sum::<f64>() / values.len() as f64;
    if mean > 0.0 { values.into_iter().map(|value| (f64::from(value) / mean) as f32).collect() } else { values }
}

fn learned_density(head: &Head, config: &FitConfig, target: &dyn Target, condition: &[f32]) -> Result<Vec<f32>> {
    let device = config.backend.device()?;
    let y = TensorData::new(points().flatten().collect::<Vec<f32>>(), [1, SIDE * SIDE, 2]);
    let c = Tensor::<2>::from_data(TensorData::new(condition.to_vec(), [1, condition.len()]), &device);
    let readable = "densities are readable and convert to f32";
    let logs = head.log_density(&Tensor::from_data(y, &device), c.clone()).try_into_vec_as::<f32>().expect(readable);
    let mut densities: Vec<f32> = logs.into_iter().map(f32::exp).collect();
    if let Some(logit) = head.mixture_weight_logits(c) {
        let mixture_weight =
            mixture_weight_of_logit(logit.into_scalar::<f32>() + target.mixture_weight_logit(condition));
        let values = target.at_points(condition, &points().collect::<Vec<_>>());
        for (density, values) in densities.iter_mut().zip(values) {
            *density = mixture_weight * *density + (1.0 - mixture_weight) * values.brdf;
        }
    }
    Ok(densities)
}

#[cfg(test)]
mod tests {
    use headtail_model::HeadConfig;

    use super::*;
    use crate::{CosineTarget, test_support::sky};

    #[test]
    fn a_new_head_is_uniform_and_the_target_is_not() {
        let config = FitConfig { head: HeadConfig::COSINE, ..FitConfig::default() };
        let device = config.backend.device().unwrap();
        let head = Head::new(config.head, 0, &device).unwrap();
        let target = CosineTarget::new(&sky);
        let learned = learned_density(&head, &config, &target, &[0.0, 1.0, 0.0]).unwrap();
        assert!(learned.iter().all(|density| (density - 1.0).abs() < 1e-5));
        let pairs = density_pairs(&head, &config, &target, 2).unwrap();
        for pair in &pairs {
            let mean = pair.target.iter().map(|&value| f64::from(value)).sum::<f64>() / (SIDE * SIDE) as f64;
            assert!((mean - 1.0).abs() < 1e-6 && pair.target.len() == pair.learned.len());
        }
        assert_ne!(pairs[0].target, pairs[1].target);
    }

    #[test]
    fn densities_have_the_mean_one() {
        let values = normalized(vec![0.0, 3.0, 1.0]);
        assert_eq!(values, [0.0, 2.25, 0.75]);
        assert_eq!(normalized(vec![0.0; 2]), [0.0; 2]);
    }
}
