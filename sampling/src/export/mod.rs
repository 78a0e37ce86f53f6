//! The exported sampler: one `.safetensors` file with everything that a renderer needs.
//!
//! Tensors are row-major little-endian f32: `tail.luminance` `[height, width]` (what the tail warp is
//! built from), with a flow tail `tail.map` `[cells + 1, cells, 2]` (its table, see
//! [`crate::tail::WarpMap::new`]), and either the head's layers (`layer0.linear0.weight` `[out, in]`,
//! `layer0.linear0.bias` `[out]`, ...) or `table.masses` `[polar, azimuth, rows, columns]`. The
//! metadata has one entry, `headtail`, which holds a JSON object, [`Description`]. Unknown fields and
//! tensors are rejected.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | the format; samplers of a file |
//! | `read.rs`, `write.rs` | reading and writing |
//! | `check.rs` | check that weights give a density |
//! | `flat.rs` | samplers as arrays, for other devices |

mod check;
mod flat;
mod read;
mod write;

pub use flat::{flat_exported, flat_patches, flat_portals};

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::{
    bake::BakedTable,
    environment::Environment,
    error::{Error, Result},
    head::{Condition, Head, Mode},
    patches::{Detail, PatchSampler},
    sampler::{BrdfSampler, Covering, EnvironmentLight, OneSampleMis, ProductSampler, Sampler},
    tail::{Tail, TailKind},
};

/// The newest version of the format. Files have the lowest version that supports their content: 4 with
/// a head over patches of sky, else 3 with the settings of their run, else 2 with a flow tail, else 1.
pub const FORMAT_VERSION: u32 = 4;

/// The metadata of an exported file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// At most [`FORMAT_VERSION`].
    pub format_version: u32,
    /// The version of the program that wrote the file.
    pub program_version: String,
    /// Kind of the intermediate density.
    pub intermediate: IntermediateDescription,
    /// Condition of the intermediate density.
    pub condition: Condition,
    /// The tail warp.
    pub tail: TailKind,
    /// The patches of sky between head and tail; absent if the head is directly over the tail.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub patches: Option<Detail>,
    /// Name of the environment map.
    pub environment: String,
    /// [`Environment::hash`] of the map.
    pub environment_hash: String,
    /// Summary of the training; absent for a direct bake.
    pub training: Option<TrainingSummary>,
    /// All settings of the run that made the file, as a TOML text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run: Option<String>,
}

/// The intermediate density's kind and architecture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum IntermediateDescription {
    /// A head warp.
    Head {
        /// How the coupling layers are joined.
        mode: Mode,
        /// Slope of the leaky ReLU for negative arguments.
        leaky_slope: f32,
        /// Number of layers of the encoder, 0 without one.
        encoder_layers: usize,
        /// Number of layers of each spline network, the last one included.
        network_layers: usize,
        /// Number of layers of the network of the learned mixture weight, 0 without one;
        /// `selection_layers` in files.
        #[serde(rename = "selection_layers")]
        #[serde(default)]
        mixture_weight_layers: usize,
    },
    /// A table over normals, baked from a head.
    Bake,
    /// A table over normals, baked from the target itself.
    DirectBake,
}

/// Summary of a head's training; by default untrained.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingSummary {
    /// Optimiser steps.
    pub steps: u64,
    /// Seed of weights and batches.
    pub seed: u64,
    /// The loss.
    pub loss: String,
    /// The backend that trained.
    pub backend: String,
    /// KL(q* || head) on the validation set, mean over conditions, in nats.
    pub final_kl: f64,
    /// Variance of one sample relative to the squared mean (unshadowed), mean over the validation conditions.
    pub relative_variance: f64,
    /// Wall-clock seconds of the training loop; `None` if files must be reproducible.
    pub seconds: Option<f64>,
    /// Wall-clock seconds of tabulating the head; `None` for a head itself, and if files must be
    /// reproducible.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tabulated_seconds: Option<f64>,
}

/// The intermediate density of an exported file.
// There is only one per file, so boxing the larger variant would save nothing.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Debug)]
pub enum Intermediate {
    /// A head warp.
    Head(Head),
    /// A table baked from a head.
    Bake(BakedTable),
    /// A table baked from the target itself.
    DirectBake(BakedTable),
}

/// An exported sampler in memory.
#[derive(Clone, Debug)]
pub struct ExportedSampler {
    /// The intermediate density.
    pub intermediate: Intermediate,
    /// The tail warp.
    pub tail: Arc<Tail>,
    /// The patches of sky between a head and the tail. The head is trained for the residual of the
    /// patches, and is noisy without them.
    pub patches: Option<Detail>,
    /// Columns, rows and values `[height, width]` of the luminance that the tail was built from.
    pub luminance: (usize, usize, Vec<f32>),
    /// Name of the environment map.
    pub environment: String,
    /// [`Environment::hash`] of the map.
    pub environment_hash: String,
    /// Summary of the training.
    pub training: Option<TrainingSummary>,
    /// All settings of the run that made the file, as a TOML text, which this crate does not parse.
    pub run: Option<String>,
}

impl ExportedSampler {
    /// Makes a sampler for a map, for writing.
    ///
    /// # Errors
    /// See [`Tail::of_environment`].
    pub fn new(
        intermediate: Intermediate,
        kind: TailKind,
        environment: &Environment,
        training: Option<TrainingSummary>,
    ) -> Result<Self> {
        let tail = Arc::new(Tail::of_environment(kind, environment)?);
        Ok(Self::of_tail(intermediate, tail, environment, training))
    }

    /// Makes a sampler for a map with a tail that was built from, or fitted to, the map's luminance.
    pub fn of_tail(
        intermediate: Intermediate,
        tail: Arc<Tail>,
        environment: &Environment,
        training: Option<TrainingSummary>,
    ) -> Self {
        Self {
            intermediate,
            tail,
            patches: None,
            luminance: (environment.width(), environment.height(), environment.luminance()),
            environment: environment.name().to_owned(),
            environment_hash: environment.hash().to_owned(),
            training,
            run: None,
        }
    }

    /// Adds the settings of the run that made the sampler.
    #[must_use]
    pub fn with_run(self, settings: String) -> Self {
        Self { run: Some(settings), ..self }
    }

    /// Marks the head as one over patches of sky.
    #[must_use]
    pub fn over_patches(self, detail: Detail) -> Self {
        Self { patches: Some(detail), ..self }
    }

    /// Whether the file holds a head with a learned mixture weight against BRDF sampling.
    pub fn has_mixture_weight(&self) -> bool {
        matches!(&self.intermediate, Intermediate::Head(head) if head.has_mixture_weight())
    }

    /// Builds the file's complete sampler: in a mixture with BRDF sampling if the mixture weight is
    /// learned or the head is over patches, which have one.
    ///
    /// # Errors
    /// As [`Self::sampler`].
    pub fn open(self, environment: &Arc<Environment>) -> Result<Covering<Arc<dyn Sampler>>> {
        let mixed = self.has_mixture_weight() || self.patches.is_some();
        Covering::new(self.sampler(environment, mixed)?)
    }

    /// Builds the file's sampler, alone or in a mixture with BRDF sampling.
    ///
    /// # Errors
    /// [`Error::Argument`] if the sampler was made for another map, see [`Self::check_environment`].
    pub fn sampler(self, environment: &Arc<Environment>, mixed: bool) -> Result<Arc<dyn Sampler>> {
        self.check_environment(environment)?;
        let light = EnvironmentLight::with_tail(environment.clone(), self.tail);
        let product: Arc<dyn Sampler> = match (self.intermediate, self.patches) {
            (Intermediate::Head(head), Some(detail)) => Arc::new(PatchSampler::with_head(light, detail, head)?),
            (Intermediate::Head(head), None) => Arc::new(ProductSampler::new(light, head)),
            (Intermediate::Bake(table) | Intermediate::DirectBake(table), _) => {
                Arc::new(ProductSampler::new(light, table))
            }
        };
        Ok(if mixed { Arc::new(OneSampleMis::new(product, BrdfSampler)) } else { product })
    }

    /// Returns the head if it is a density over Y, which can be tabulated.
    ///
    /// # Errors
    /// The file holds a table, or a head over patches.
    pub fn head_over_tail(&self) -> Result<&Head> {
        match &self.intermediate {
            Intermediate::Head(_) if self.patches.is_some() => {
                let reason = "the file holds a head over patches of sky, which gives no density over Y alone; name a head over the tail";
                Err(Error::argument("patches", reason))
            }
            Intermediate::Head(head) => Ok(head),
            Intermediate::Bake(_) | Intermediate::DirectBake(_) => {
                Err(Error::argument("intermediate.kind", "the file holds a table already; name a trained head"))
            }
        }
    }

    /// Builds the patches of a file with their head, for samplers that learn during rendering.
    ///
    /// # Errors
    /// The file holds no head over patches, or as [`Self::sampler`].
    pub fn patch_sampler(self, environment: &Arc<Environment>) -> Result<PatchSampler> {
        self.check_environment(environment)?;
        let (Intermediate::Head(head), Some(detail)) = (self.intermediate, self.patches) else {
            return Err(Error::argument("intermediate.kind", "the file holds no head over patches of sky"));
        };
        let light = EnvironmentLight::with_tail(environment.clone(), self.tail);
        PatchSampler::with_head(light, detail, head)
    }

    /// Checks that the sampler was made for this map: with another one it would be biased.
    ///
    /// # Errors
    /// [`Error::Argument`] that names the field if the hash is that of another map, or the luminance of
    /// the tail is not the map's.
    pub fn check_environment(&self, environment: &Environment) -> Result<()> {
        if self.environment_hash != environment.hash() {
            let reason = format!(
                "was made for the environment '{}', not for '{}': its texels differ; fit or bake it for this map",
                self.environment,
                environment.name()
            );
            return Err(Error::argument("environment_hash", reason));
        }
        let (width, height, luminance) = &self.luminance;
        let same_size = (*width, *height) == (environment.width(), environment.height());
        // Up to rounding: processors may sum the three channels in different orders.
        let near = |(own, map): (&f32, f32)| (own - map).abs() <= 1e-5 * map;
        if !same_size || !luminance.iter().zip(environment.luminance()).all(near) {
            let reason = format!(
                "is not that of the environment '{}', though the hash is: the file is damaged",
                self.environment
            );
            return Err(Error::argument("tail.luminance", reason));
        }
        Ok(())
    }

    /// Makes the metadata of the file.
    pub fn description(&self) -> Description {
        let intermediate = match &self.intermediate {
            Intermediate::Head(head) => {
                let count = |part: &str| head.layers().iter().filter(|(name, _)| name.starts_with(part)).count();
                IntermediateDescription::Head {
                    mode: head.mode(),
                    leaky_slope: head.leaky_slope(),
                    encoder_layers: count("encoder."),
                    network_layers: count("layer0."),
                    mixture_weight_layers: count("selection."),
                }
            }
            Intermediate::Bake(_) => IntermediateDescription::Bake,
            Intermediate::DirectBake(_) => IntermediateDescription::DirectBake,
        };
        Description {
            format_version: match (self.patches, &self.run, self.tail.kind()) {
                (Some(_), ..) => FORMAT_VERSION,
                (None, Some(_), _) => 3,
                (None, None, TailKind::Flow) => 2,
                (None, None, TailKind::RowColumn | TailKind::Hierarchical) => 1,
            },
            program_version: env!("CARGO_PKG_VERSION").to_owned(),
            intermediate,
            condition: match &self.intermediate {
                Intermediate::Head(head) => head.condition(),
                Intermediate::Bake(_) | Intermediate::DirectBake(_) => Condition::Normal,
            },
            tail: self.tail.kind(),
            patches: self.patches,
            environment: self.environment.clone(),
            environment_hash: self.environment_hash.clone(),
            training: self.training.clone(),
            run: self.run.clone(),
        }
    }
}
