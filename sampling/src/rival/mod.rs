//! Published samplers for neural materials, as baselines: they depend on the material and not on the light.
//!
//! - [`Lobes`]: two Gaussians and a cosine lobe on the projected disk (the analytic mixture of NeuSample, Xu et al. 2023);
//! - [`Flow`]: two coupling layers of rational-quadratic splines on the disk over a conditional Gaussian (NeuSample's flow);
//! - [`Reparameterised`]: a network from a disk of uniform numbers to directions, with its Jacobian (after Wu et al. 2025).
//!
//! All of them have an exact density. A draw below the surface is rejected and counts as 0, so that the
//! density integrates to the fraction of accepted draws. Each is for one material, identified by
//! [`Brdf::identity`]; points of other materials use BRDF sampling.
//!
//! | file | concept |
//! | --- | --- |
//! | `lobes.rs`, `flow.rs`, `reparam.rs` | the three samplers |
//! | `encoding.rs` | the inputs of their networks |
//! | `columns.rs`, `sampler.rs` | rivals over columns; in scenes |
//! | `file.rs` | the file format |
//! | `trace.rs` | derivatives for training the reparameterised sampler |

mod columns;
mod encoding;
mod file;
mod flow;
mod lobes;
mod reparam;
mod sampler;
#[cfg(test)]
mod tests;
mod trace;

pub use encoding::{COORDINATE, DISK_CONDITION, OCTAVES_OF_COORDINATE, OCTAVES_OF_VIEW, VIEW_CONDITION};
pub use file::{FORMAT_VERSION, RivalFile};
pub use flow::{BINS, FLOW_SIZES, Flow, LOG_WIDTH, PRIOR_SIZES, SPLINE_OUTPUTS};
pub use lobes::{LEAKY_SLOPE, LEAST_COSINE_WEIGHT, LEAST_WIDTH, LOBES_SIZES, Lobes, WIDTH_RANGE};
pub use reparam::{COSINE_WEIGHT, LARGEST_LOG_SCALE, LARGEST_SHIFT, REPARAM_SIZES, Reparameterised};
pub use sampler::RivalSampler;
pub use trace::Traced;

use crate::{
    brdf::{Brdf, Surfaces},
    columns::Arena,
    error::Result,
    head::Linear,
    simd::Lanes,
};
use columns::{density_columns, sample_columns};

/// The kinds of these samplers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RivalKind {
    /// NeuSample's analytic mixture.
    Lobes,
    /// NeuSample's flow.
    Flow,
    /// The reparameterised sampler.
    Reparam,
}

impl RivalKind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Lobes, Self::Flow, Self::Reparam];

    /// Returns its name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lobes => "lobes",
            Self::Flow => "flow",
            Self::Reparam => "reparam",
        }
    }

    /// Returns the names and sizes of its networks, from input to output.
    pub fn networks(self) -> &'static [(&'static str, &'static [usize])] {
        match self {
            Self::Lobes => &[("lobes", &LOBES_SIZES)],
            Self::Flow => &[("prior", &PRIOR_SIZES), ("second", &FLOW_SIZES), ("first", &FLOW_SIZES)],
            Self::Reparam => &[("warp", &REPARAM_SIZES)],
        }
    }
}

impl std::str::FromStr for RivalKind {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        Self::ALL.into_iter().find(|kind| kind.name() == text).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            format!("'{text}' is not one of {names}")
        })
    }
}

/// A sampler of one material.
#[derive(Clone, Debug)]
pub enum Rival {
    /// [`RivalKind::Lobes`].
    Lobes(Lobes),
    /// [`RivalKind::Flow`].
    Flow(Box<Flow>),
    /// [`RivalKind::Reparam`].
    Reparam(Reparameterised),
}

impl Rival {
    /// Creates a sampler from the layers of its networks, in the order of [`RivalKind::networks`].
    ///
    /// # Errors
    /// A network has other sizes.
    pub fn new(kind: RivalKind, networks: Vec<Vec<Linear>>) -> Result<Self> {
        Ok(match kind {
            RivalKind::Lobes => Self::Lobes(Lobes::new(networks)?),
            RivalKind::Flow => Self::Flow(Box::new(Flow::new(networks)?)),
            RivalKind::Reparam => Self::Reparam(Reparameterised::new(networks)?),
        })
    }

    /// Returns its kind.
    pub fn kind(&self) -> RivalKind {
        match self {
            Self::Lobes(_) => RivalKind::Lobes,
            Self::Flow(_) => RivalKind::Flow,
            Self::Reparam(_) => RivalKind::Reparam,
        }
    }

    /// Returns the layers of its networks, in the order of [`RivalKind::networks`].
    pub fn networks(&self) -> Vec<&[Linear]> {
        match self {
            Self::Lobes(lobes) => lobes.networks(),
            Self::Flow(flow) => flow.networks(),
            Self::Reparam(reparam) => reparam.networks(),
        }
    }

    /// Samples directions at surfaces of a material, with their solid-angle pdfs; pdf 0 means "no sample".
    pub fn sample(
        &self,
        brdf: &dyn Brdf,
        at: &Surfaces<'_>,
        u: [&[Lanes]; 2],
        wi: [&mut [Lanes]; 3],
        pdf: &mut [Lanes],
        arena: &Arena,
    ) {
        match self {
            Self::Lobes(lobes) => sample_columns(lobes, brdf, at, u, wi, pdf, arena),
            Self::Flow(flow) => sample_columns(&**flow, brdf, at, u, wi, pdf, arena),
            Self::Reparam(reparam) => sample_columns(reparam, brdf, at, u, wi, pdf, arena),
        }
    }

    /// Computes the solid-angle pdfs of [`Self::sample`].
    pub fn pdf(&self, brdf: &dyn Brdf, at: &Surfaces<'_>, wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        match self {
            Self::Lobes(lobes) => density_columns(lobes, brdf, at, wi, out, arena),
            Self::Flow(flow) => density_columns(&**flow, brdf, at, wi, out, arena),
            Self::Reparam(reparam) => density_columns(reparam, brdf, at, wi, out, arena),
        }
    }
}
