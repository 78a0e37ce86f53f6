//! The configuration of a training run. Default values are in `preset.rs`.

use headtail_model::{Condition, HeadConfig};
use headtail_render::{patches::Detail, scene::MaterialSpec, tail::TailKind};
use serde::{Deserialize, Serialize};

use crate::{
    Backend, Error, FlowSettings, GradientForm, Loss, Objective, Preset, Result,
    integrand::BatchShape,
    material::{check_scale, condition_of},
};

/// A training run. Missing keys of a file take the defaults, unknown keys are errors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitConfig {
    /// The material to sample for.
    pub material: MaterialSpec,
    /// The tail under the head: `hierarchical`, `row-column` or `flow`.
    pub tail: TailKind,
    /// Whether to discard a head whose relative variance is not below that of the untrained head, and to use
    /// that one instead. With a learned mixture weight, the untrained head is one-sample MIS.
    pub fall_back: bool,
    /// Training returns to the best weights, with half the learning rate, if validation finds more than this
    /// factor of the least relative variance so far; 0 for never. Unless it is 0, the best weights of all
    /// validations are used at the end.
    pub setback: f32,
    /// What the head is composed with: the `tail`, or `patches` (`fine-patches`) between it and the tail.
    pub over: Over,
    /// How training points are drawn: `strata` of Y, or `tabulated` as in the paper.
    pub points: Points,
    /// Fit the head to the product in X, without a tail: the paper's naive baseline.
    pub naive: bool,
    /// Where tensors live: `ndarray`, `flex` or `wgpu`.
    pub backend: Backend,
    /// How gradients are computed: `auto`, `fused`, `in-graph` or `device`.
    pub gradient: GradientForm,
    /// Seed of weights, batches and validation.
    pub seed: u64,
    /// Optimiser steps.
    pub steps: usize,
    /// Conditions per step.
    pub conditions: usize,
    /// Strata per side of the intermediate square: each condition has `strata^2` jittered points.
    pub strata: usize,
    /// Points per condition from BRDF sampling, combined with the strata by the balance heuristic: required
    /// for narrow lobes.
    pub brdf_samples: usize,
    /// The loss: `forward-kl`, `reverse-kl`, `chi-square` or `log-chi-square`.
    pub loss: Loss,
    /// Factor of the paper's entropic term. See [`Objective::entropic`].
    pub entropic: f32,
    /// Peak learning rate: rises linearly over `warmup` and falls to zero along a half cosine.
    pub learning_rate: f64,
    /// Fraction of the steps over which the learning rate rises.
    pub warmup: f64,
    /// AdamW's first-moment decay.
    pub beta_1: f32,
    /// AdamW's second-moment decay.
    pub beta_2: f32,
    /// AdamW's denominator floor.
    pub epsilon: f32,
    /// AdamW's decoupled weight decay.
    pub weight_decay: f32,
    /// Largest norm of the gradient over all weights; larger gradients are scaled down.
    pub clip_norm: f64,
    /// Decay of the moving average of the weights, which validation and export then use; 0 disables it.
    pub ema_decay: f32,
    /// Training stops with an error when more steps than this were skipped because loss or gradient was not
    /// finite.
    pub max_skipped: usize,
    /// Steps between validations; 0 validates only at the end.
    pub validate_every: usize,
    /// Conditions of the validation set.
    pub validation_conditions: usize,
    /// Strata per side for each validation condition.
    pub validation_strata: usize,
    /// The head's shape.
    pub head: HeadConfig,
    /// The flow tail, if `tail` is a flow.
    pub flow: FlowSettings,
}

/// What a head is composed with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Over {
    /// The tail: the head learns BRDF x cosine.
    Tail,
    /// Patches of sky, `patches`: the head learns the residual of their closed form.
    Patches,
    /// Finer patches, `patches:fine`.
    FinePatches,
}

impl Over {
    /// Returns the detail of the patches, if there are any.
    pub fn detail(self) -> Option<Detail> {
        match self {
            Self::Tail => None,
            Self::Patches => Some(Detail::Leaves),
            Self::FinePatches => Some(Detail::Twigs),
        }
    }
}

/// How training points are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Points {
    /// One point in each stratum of Y, combined with BRDF samples, with weights.
    Strata,
    /// From a table of the product with 512 x 1024 cells of X for each condition, as in the paper: the slow
    /// reference.
    Tabulated,
}

impl Default for FitConfig {
    /// Returns [`Preset::FastCosine`].
    fn default() -> Self {
        Preset::FastCosine.config()
    }
}

impl FitConfig {
    /// Returns the sizes of a step's batch.
    pub fn batch_shape(&self) -> BatchShape {
        BatchShape { conditions: self.conditions, strata: self.strata, brdf_samples: self.brdf_samples }
    }

    /// Returns the sizes of the validation set, with the same fraction of BRDF samples as a step.
    pub fn validation_shape(&self) -> BatchShape {
        let strata = self.validation_strata;
        let brdf_samples = self.brdf_samples * strata * strata / (self.strata * self.strata);
        BatchShape { conditions: self.validation_conditions, strata, brdf_samples }
    }

    /// Returns the objective.
    pub fn objective(&self) -> Objective {
        Objective { loss: self.loss, entropic: self.entropic }
    }

    /// Checks that a step's batch and the validation set fit into memory.
    ///
    /// # Errors
    /// Naming the keys that determine the sizes, the memory needed and the memory available.
    pub fn check_memory(&self) -> Result<()> {
        for (shape, keys) in [
            (self.batch_shape(), "conditions, strata and brdf_samples"),
            (self.validation_shape(), "validation_conditions and validation_strata"),
        ] {
            let points = shape.conditions as u64 * shape.samples() as u64;
            let what = || format!("{keys}: {} conditions of {} points", shape.conditions, shape.samples());
            headtail_render::memory::require(BYTES_PER_POINT * points, what)?;
        }
        Ok(())
    }

    /// Returns the configuration with a head over patches. A head for diffuse surfaces then learns no mixture
    /// weight: patches need no BRDF sampling beside them.
    #[must_use]
    pub fn over(mut self, over: Over) -> Self {
        self.over = over;
        self.head.share &= over == Over::Tail || !self.material.is_lambert();
        self
    }

    /// Checks the requirements of a head over patches.
    fn validate_over(&self) -> Result<()> {
        if self.over == Over::Tail {
            return Ok(());
        }
        let refused = |field, value, requirement| Err(Error::Config { field, value, requirement });
        if self.tail != TailKind::Hierarchical {
            return refused("tail", name_of(self.tail), "`hierarchical` under patches");
        }
        if self.points != Points::Strata {
            return refused("points", name_of(self.points), "`strata` over patches");
        }
        if self.naive {
            return refused("naive", "true".into(), "false over patches");
        }
        if !self.material.is_lambert() && !self.head.share {
            return refused(
                "head.share",
                "false".into(),
                "true over patches, which are beside BRDF sampling where surfaces are glossy",
            );
        }
        Ok(())
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`Error::Config`] or [`Error::Model`] naming the first field that is out of range.
    pub fn validate(&self) -> Result<()> {
        self.head.validate()?;
        self.flow.validate()?;
        check_scale(&self.material)?;
        if self.head.condition != condition_of(&self.material) {
            let value = name_of(self.head.condition);
            let requirement = match condition_of(&self.material) {
                Condition::Normal => "`normal` for this material",
                Condition::Ggx => "`ggx` for this material",
                Condition::GgxRoughness => "`ggx-roughness` for this material",
                Condition::Family => "`family` for these materials",
                Condition::Texture => "`texture` for this material",
            };
            return Err(Error::Config { field: "head.condition", value, requirement });
        }
        self.validate_over()?;
        within("steps", self.steps, 1..=100_000_000, "in 1..=1e8")?;
        within("conditions", self.conditions, 1..=1 << 16, "in 1..=65536")?;
        within("strata", self.strata, 1..=1024, "in 1..=1024")?;
        within("brdf_samples", self.brdf_samples, 0..=1 << 20, "in 0..=1048576")?;
        within("entropic", self.entropic, 0.0..=1.0, "in [0, 1]")?;
        if self.setback != 0.0 {
            within("setback", self.setback, 1.0..=1e6, "0 or in 1..=1e6")?;
        }
        within("ema_decay", self.ema_decay, 0.0..=0.999_999, "in [0, 1)")?;
        within("validation_conditions", self.validation_conditions, 1..=1 << 16, "in 1..=65536")?;
        within("validation_strata", self.validation_strata, 1..=1024, "in 1..=1024")?;
        within("learning_rate", self.learning_rate, f64::MIN_POSITIVE..=1.0, "in (0, 1]")?;
        within("warmup", self.warmup, 0.0..=1.0, "in [0, 1]")?;
        within("beta_1", self.beta_1, 0.0..=0.999_999, "in [0, 1)")?;
        within("beta_2", self.beta_2, 0.0..=0.999_999, "in [0, 1)")?;
        within("epsilon", self.epsilon, f32::MIN_POSITIVE..=1.0, "in (0, 1]")?;
        within("weight_decay", self.weight_decay, 0.0..=1.0, "in [0, 1]")?;
        within("clip_norm", self.clip_norm, f64::MIN_POSITIVE..=f64::MAX, "positive and finite")
    }
}

/// Minimum memory of a batch point: its position in two squares, target, densities and gradient, in f32.
const BYTES_PER_POINT: u64 = 48;

/// Returns the name of an enum value, as in files.
pub(crate) fn name_of<T: Serialize>(value: T) -> String {
    let name = serde_json::to_value(value).expect("a name can be written as JSON");
    name.as_str().expect("it is written by its name").to_owned()
}

/// Checks that a field is in its range.
pub(crate) fn within<T: Copy + PartialOrd + std::fmt::Display>(
    field: &'static str,
    value: T,
    range: std::ops::RangeInclusive<T>,
    requirement: &'static str,
) -> Result<()> {
    if range.contains(&value) { Ok(()) } else { Err(Error::Config { field, value: value.to_string(), requirement }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_round_trip() {
        let config = FitConfig::default();
        config.validate().unwrap();
        let text = serde_json::to_string(&config).unwrap();
        assert_eq!(serde_json::from_str::<FitConfig>(&text).unwrap(), config);
    }

    #[test]
    fn missing_keys_take_defaults_and_unknown_keys_are_errors() {
        let config: FitConfig = serde_json::from_str(r#"{"steps": 7, "loss": "forward-kl"}"#).unwrap();
        assert_eq!(config, FitConfig { steps: 7, loss: Loss::ForwardKl, ..FitConfig::default() });
        let error = serde_json::from_str::<FitConfig>(r#"{"step": 7}"#).unwrap_err();
        assert!(error.to_string().contains("step"), "{error}");
    }

    #[test]
    fn values_out_of_range_are_rejected_by_name() {
        let refused = |config: FitConfig| match config.validate() {
            Err(Error::Config { field, .. }) => field,
            other => panic!("{other:?}"),
        };
        let good = FitConfig::default;
        assert_eq!(refused(FitConfig { steps: 0, ..good() }), "steps");
        let over = || good().over(Over::Patches);
        over().validate().unwrap();
        assert_eq!(refused(FitConfig { tail: TailKind::RowColumn, ..over() }), "tail");
        assert_eq!(refused(FitConfig { points: Points::Tabulated, ..over() }), "points");
        assert_eq!(refused(FitConfig { naive: true, ..over() }), "naive");
        assert_eq!(refused(over().for_material(MaterialSpec::ggx(0.4, 0.4))), "head.share");
        assert_eq!(refused(FitConfig { learning_rate: f64::NAN, ..good() }), "learning_rate");
        assert_eq!(refused(FitConfig { beta_2: 1.0, ..good() }), "beta_2");
        assert_eq!(refused(FitConfig { entropic: -1e-4, ..good() }), "entropic");
        assert_eq!(refused(FitConfig { ema_decay: 1.0, ..good() }), "ema_decay");
        assert_eq!(refused(FitConfig { strata: 0, ..good() }), "strata");
        assert_eq!(refused(FitConfig { clip_norm: f64::INFINITY, ..good() }), "clip_norm");
    }
}
