//! SPECs as shaders: the arrays of a source of directions, and how directions are combined.

use std::sync::Arc;

use headtail_render::{
    environment::Environment,
    export::{ExportedSampler, Intermediate, flat_exported, flat_patches, flat_portals},
    flat::FlatArray,
    head::Condition,
    points::Dimension,
    sampler::{EmitterSampler, EnvironmentLight},
    spec::{BuildContext, Combiner, Companion, FileKind, SamplerSpec, Source, Visibility},
    tail::TailKind,
};
use headtail_shaders::UNOCCLUDED;

use crate::error::{Error, Result};

const BRDF_ALONE: &str = include_str!("../wgsl/brdf_alone.wgsl");
const PREPARE_POINT: &str = include_str!("../wgsl/prepare_point.wgsl");
const SOURCE_ALONE: &str = include_str!("../wgsl/source_alone.wgsl");
const ONE_SAMPLE_MIS: &str = include_str!("../wgsl/one_sample_mis.wgsl");
const MEAN: &str = include_str!("../wgsl/mean.wgsl");
const TWO_SAMPLE_MIS: &str = include_str!("../wgsl/two_sample_mis.wgsl");
const RIS: &str = include_str!("../wgsl/ris.wgsl");
const VISIBILITY: &str = include_str!("../wgsl/visibility.wgsl");
const NO_CELLS: &str = include_str!("../wgsl/no_cells.wgsl");
const OWN_WEIGHT: &str = include_str!("../wgsl/own_weight.wgsl");
const HALF_WEIGHT: &str = include_str!("../wgsl/half_weight.wgsl");
const TELL_MATERIAL: &str = include_str!("../wgsl/tell_material.wgsl");
const TELL_NOTHING: &str = include_str!("../wgsl/tell_nothing.wgsl");

/// A SPEC for a map.
pub struct DeviceSampler {
    /// Arrays of the source; none for BRDF sampling.
    pub arrays: Vec<FlatArray>,
    /// WGSL with `headtail_estimate`.
    pub sources: Vec<&'static str>,
    /// WGSL of the weights of patches.
    pub weights: &'static str,
    combiner: Combiner,
    /// Whether weights of learned visibility are read.
    pub has_visibility: bool,
}

impl DeviceSampler {
    /// Makes the arrays of a SPEC for a map, a scene with or without measured and neural materials, and what else is known
    /// of it.
    ///
    /// # Errors
    /// If devices do not have the SPEC, or its file is for another map.
    pub fn new(
        spec: &SamplerSpec,
        (environment, has_fitted): (&Arc<Environment>, bool),
        context: BuildContext<'_>,
    ) -> Result<Self> {
        let not_covered = |instead| Error::NotCovered { what: format!("sampler '{spec}'"), instead };
        let combiner = spec.combiner();
        if matches!(combiner, Combiner::Ris(_)) && environment.has_extreme_lamps() {
            return Err(not_covered("under a map with such lamps, choose mis2-comp or patches"));
        }
        let light = || EnvironmentLight::new(environment.clone(), TailKind::Hierarchical);
        let mut sees_material = false;
        let (arrays, mut is_mixed, has_own_weight) = match spec.source() {
            Source::Brdf | Source::Cosine => (Vec::new(), false, false),
            Source::Emitter => (light()?.tail().flat(), false, false),
            Source::Compensated => {
                let sampler = EmitterSampler::compensated(environment, TailKind::Hierarchical)?;
                (sampler.light().tail().flat(), false, false)
            }
            Source::Patches(detail) => (flat_patches(light()?.tail(), *detail)?, true, true),
            Source::File(kind, file) => {
                let exported = kind.read(file)?;
                exported.check_environment(environment).map_err(|error| error.in_file(file))?;
                let is_head = matches!(kind, FileKind::Head | FileKind::HeadOverPatches);
                sees_material = is_told_of_material(&exported);
                let arrays = flat_exported(&exported).map_err(|error| error.in_file(file))?;
                (arrays, *kind == FileKind::HeadOverPatches, is_head)
            }
            Source::Auto => return Err(not_covered("choose split:3:mis2-comp or split:4:patches+vis")),
            Source::Portals(_) => (flat_portals(&spec.portals(context)?, environment)?, false, false),
            Source::Oracle | Source::Rival(..) => {
                return Err(not_covered("choose mis2-comp, patches, or a head"));
            }
        };
        is_mixed |= spec.companion() == Companion::Brdf;
        let weight = if has_own_weight { OWN_WEIGHT } else { HALF_WEIGHT };
        // Without these materials, what heads are told of them stays 0.
        let tell = if sees_material && has_fitted { TELL_MATERIAL } else { TELL_NOTHING };
        let mut sources = match (arrays.is_empty(), is_mixed) {
            (true, _) => vec![BRDF_ALONE],
            (false, false) => vec![PREPARE_POINT, tell, SOURCE_ALONE],
            (false, true) => vec![PREPARE_POINT, tell, weight, ONE_SAMPLE_MIS],
        };
        sources.push(match combiner {
            Combiner::One | Combiner::Split(_) => MEAN,
            Combiner::TwoSampleMis(_) => TWO_SAMPLE_MIS,
            Combiner::Ris(_) => RIS,
        });
        let has_visibility = *spec.visibility() != Visibility::None;
        sources.extend((!has_visibility).then_some(NO_CELLS));
        Ok(Self {
            arrays,
            weights: if has_visibility { VISIBILITY } else { UNOCCLUDED },
            sources,
            combiner,
            has_visibility,
        })
    }

    /// Returns the number of directions, of pairs of them, or of candidates.
    pub fn directions(&self) -> u32 {
        match self.combiner {
            Combiner::One => 1,
            Combiner::Split(count) | Combiner::TwoSampleMis(count) | Combiner::Ris(count) => count,
        }
    }

    /// Returns the groups of numbers of a light estimate, in the order in which it reads them.
    pub fn groups(&self) -> Vec<Dimension> {
        let count = self.directions();
        let candidate = |index: u32| {
            let (technique, of) = if index.is_multiple_of(2) { (0, count - count / 2) } else { (1, count / 2) };
            Dimension::Candidate { technique, index: index / 2, of }
        };
        let pair = |index| [0, 1].map(|technique| Dimension::of_several(technique, index, count));
        match self.combiner {
            Combiner::One | Combiner::Split(_) => {
                (0..count).map(|index| Dimension::of_several(0, index, count)).collect()
            }
            Combiner::TwoSampleMis(_) => (0..count).flat_map(pair).collect(),
            Combiner::Ris(_) => (0..count).map(candidate).collect(),
        }
    }
}

/// Whether it is a head that is told of measured or neural materials.
fn is_told_of_material(exported: &ExportedSampler) -> bool {
    match &exported.intermediate {
        Intermediate::Head(head) => matches!(head.condition(), Condition::Family | Condition::Texture),
        Intermediate::Bake(_) | Intermediate::DirectBake(_) => false,
    }
}
