//! Builds SPECs: estimators and samplers for a map and a scene.

use std::sync::Arc;

use super::{Combiner, SamplerSpec, Source, Visibility, context::BuildContext};
use crate::{
    environment::Environment,
    error::{Error, Result},
    estimator::{Estimator, LearnedVisibility, Ris, SingleSample, Split, TwoSampleMis},
    portals::Portal,
    sampler::{BrdfSampler, Covering, Sampler},
    visibility::SceneVisibility,
};

impl SamplerSpec {
    /// Builds the estimator for a map without a scene: [`Self::build_in`].
    ///
    /// # Errors
    /// As [`Self::build_in`]; precomputed visibility needs a scene.
    pub fn build(&self, environment: &Arc<Environment>) -> Result<Box<dyn Estimator>> {
        self.build_in(environment, BuildContext::default())
    }

    /// Builds the estimator for a map and a scene.
    ///
    /// # Errors
    /// A file cannot be read, is of another kind, or was made for another map or another scene.
    pub fn build_in(&self, environment: &Arc<Environment>, context: BuildContext<'_>) -> Result<Box<dyn Estimator>> {
        if self.source == Source::Auto {
            return self.resolved(context.scene.is_some()).build_in(environment, context);
        }
        if self.visibility != Visibility::None {
            return Ok(Box::new(self.build_learned(environment, context)?));
        }
        let (sampler, environment) = (self.source.build(self.companion, environment, context)?, environment.clone());
        Ok(match self.combiner {
            Combiner::One => Box::new(SingleSample::new(Covering::new(sampler)?, environment)),
            Combiner::Split(directions) => Box::new(Split::new(Covering::new(sampler)?, directions, environment)?),
            Combiner::TwoSampleMis(pairs) => {
                Box::new(TwoSampleMis::new(sampler, BrdfSampler, environment)?.with_pairs(pairs)?)
            }
            Combiner::Ris(candidates) => {
                Box::new(Ris::new(Covering::new(sampler)?, Covering::new(BrdfSampler)?, candidates, environment)?)
            }
        })
    }

    /// Builds the sampler of a SPEC that has a pdf, for a map without a scene. Precomputed visibility and portals are in
    /// the coordinates of the scene that they were made for: in another one, samples are noisy, not biased.
    ///
    /// # Errors
    /// [`Error::Argument`] if it has none ([`Self::has_pdf`]); otherwise as [`Self::build_in`].
    pub fn build_sampler(&self, environment: &Arc<Environment>) -> Result<Arc<dyn Sampler>> {
        if !self.has_pdf() {
            return Err(Error::argument(format!("sampler '{self}'"), "has no pdf of its own"));
        }
        let context = BuildContext::default();
        if let Visibility::File(file) = &self.visibility {
            let visibility = SceneVisibility::open(file, None, environment)?;
            let estimator = self.build_unlearned(environment, context.memory)?;
            return estimator.sampler_with(&visibility).map_err(|error| error.in_file(file));
        }
        let sampler = self.source.build(self.companion, environment, context)?;
        Ok(Covering::new(sampler)?.into_inner())
    }

    /// Returns the portals of a SPEC of portals in a scene, at least one; none for other SPECs.
    ///
    /// # Errors
    /// [`Error::Argument`] if there are none; the file cannot be read.
    pub fn portals(&self, context: BuildContext<'_>) -> Result<Vec<Portal>> {
        if matches!(self.source, Source::Portals(_)) { self.source.portals(context) } else { Ok(Vec::new()) }
    }

    /// Builds the estimator of a SPEC with visibility.
    ///
    /// # Errors
    /// [`Error::Argument`] if the SPEC has none; otherwise as [`Self::build_in`].
    pub fn build_learned(
        &self,
        environment: &Arc<Environment>,
        context: BuildContext<'_>,
    ) -> Result<LearnedVisibility> {
        if self.visibility == Visibility::None {
            return Err(Error::argument(format!("sampler '{self}'"), "has no visibility"));
        }
        let estimator = self.build_unlearned(environment, context.memory)?.with_directions(self.directions())?;
        let estimator = match &self.visibility {
            Visibility::File(file) => {
                let scene = context
                    .scene
                    .ok_or_else(|| Error::invalid(file, "visibility", "belongs to a scene, and no scene is given"))?;
                let visibility = SceneVisibility::open(file, Some(&scene.geometry_hash()), environment)?;
                estimator.with_precomputed(&visibility).map_err(|error| error.in_file(file))?
            }
            _ => estimator,
        };
        Ok(if context.always { estimator.always() } else { estimator })
    }

    /// Builds the estimator of a SPEC with visibility, of which nothing is known yet.
    fn build_unlearned(&self, environment: &Arc<Environment>, memory: usize) -> Result<LearnedVisibility> {
        match &self.source {
            Source::File(kind, file) => kind
                .read(file)?
                .patch_sampler(environment)
                .and_then(|sampler| LearnedVisibility::of_sampler(sampler, environment.clone(), memory))
                .map_err(|error| error.in_file(file)),
            Source::Patches(detail) => LearnedVisibility::new(environment.clone(), *detail, memory),
            _ => unreachable!("SamplerSpec::fault rejects visibility of other sources"),
        }
    }
}
