//! Pictures of a target and of what a head has learned of it.

use std::path::Path;

use headtail_model::{
    Head,
    burn::prelude::{Tensor, TensorData},
    head::selection_probability,
};
use headtail_render::{
    file,
    image::encode_png_rgb8,
    random::{Purpose, Stream},
};

use crate::{Error, FitConfig, Result, Target};

/// Pixels along each side of the square.
const SIDE: usize = 192;
/// Pixels between target and head.
const GAP: usize = 4;

/// Writes `condition-0.png`, ... into `folder`, which is made: left the target over Y (for a naive head over X), right what the
/// head gives (with a learned selection the mixture with BRDF sampling). Elevation runs down, azimuth to the right;
/// both have one scale, on which white is the density that a hundredth of the target's pixels exceeds.
///
/// Conditions are drawn with the run's seed; one that sees no light is drawn again.
///
/// # Errors
/// If the backend is not in this build or a file cannot be written.
pub fn density_pictures(head: &Head, config: &FitConfig, target: &dyn Target, count: u64, folder: &Path) -> Result<()> {
    let failed = |reason: std::io::Error| Error::Output { path: folder.to_owned(), reason: reason.to_string() };
    std::fs::create_dir_all(folder).map_err(failed)?;
    let points: Vec<[f32; 2]> = points().collect();
    for index in 0..count {
        let mut stream = Stream::new(config.seed, Purpose::Validation, 1 + index);
        let mut condition = vec![0.0; target.condition().length()];
        let mut wanted = Vec::new();
        // Nearly every condition sees light: a run with none that does has ended before.
        for _ in 0..100 {
            target.draw_condition(&mut stream, &mut condition);
            wanted = normalized(target.at_points(&condition, &points).iter().map(|values| values.target).collect());
            if wanted.iter().any(|&value| value > 0.0) {
                break;
            }
        }
        let learned = learned_density(head, config, target, &condition)?;
        let png = side_by_side(&wanted, &learned)?;
        file::replace(&folder.join(format!("condition-{index}.png")), &png)?;
    }
    Ok(())
}

/// Centres of the pixels, row by row.
fn points() -> impl Iterator<Item = [f32; 2]> {
    let centre = |index: usize| (index as f32 + 0.5) / SIDE as f32;
    (0..SIDE * SIDE).map(move |index| [centre(index % SIDE), centre(index / SIDE)])
}

/// Divided by the mean; zeros stay.
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
    if let Some(logit) = head.selection_logits(c) {
        let p = selection_probability(logit.into_scalar::<f32>());
        let values = target.at_points(condition, &points().collect::<Vec<_>>());
        for (density, values) in densities.iter_mut().zip(values) {
            *density = p * *density + (1.0 - p) * values.brdf;
        }
    }
    Ok(densities)
}

fn side_by_side(left: &[f32], right: &[f32]) -> Result<Vec<u8>> {
    let mut sorted = left.to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    let white = sorted[sorted.len() * 99 / 100].max(1e-6);
    let grey = |value: f32| [(255.0 * (value / white).clamp(0.0, 1.0).powf(1.0 / 2.2)).round() as u8; 3];
    let mut pixels = Vec::with_capacity((2 * SIDE + GAP) * SIDE);
    for (left, right) in left.chunks_exact(SIDE).zip(right.chunks_exact(SIDE)) {
        pixels.extend(left.iter().map(|&value| grey(value)));
        pixels.extend([[90, 140, 200]; GAP]);
        pixels.extend(right.iter().map(|&value| grey(value)));
    }
    Ok(encode_png_rgb8(2 * SIDE + GAP, SIDE, &pixels)?)
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
        let folder = tempfile::tempdir().unwrap();
        density_pictures(&head, &config, &target, 2, &folder.path().join("pictures")).unwrap();
        for name in ["condition-0.png", "condition-1.png"] {
            let bytes = std::fs::read(folder.path().join("pictures").join(name)).unwrap();
            assert!(bytes.starts_with(b"\x89PNG") && bytes.len() > 1000);
        }
    }

    #[test]
    fn densities_have_the_mean_one() {
        let values = normalized(vec![0.0, 3.0, 1.0]);
        assert_eq!(values, [0.0, 2.25, 0.75]);
        assert_eq!(normalized(vec![0.0; 2]), [0.0; 2]);
    }
}
