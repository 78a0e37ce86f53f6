//! Emitter sampling: directions in proportion to the map's luminance, the tail warp alone.

use std::sync::Arc;

use super::{Coverage, Draws, EnvironmentLight, Sampler};
use crate::{
    columns::Arena,
    environment::{Environment, solid_angle_means},
    error::Result,
    simd::Lanes,
    tail::{Tail, TailKind},
    tile::Rows,
};

/// Samples the environment map, without regard to the surface.
#[derive(Clone, Debug)]
pub struct EmitterSampler {
    light: EnvironmentLight,
    coverage: Coverage,
}

impl EmitterSampler {
    /// A sampler of a light.
    pub fn new(light: EnvironmentLight) -> Self {
        Self { coverage: light.coverage(), light }
    }

    /// Returns the map and the tail that directions are drawn through.
    pub fn light(&self) -> &EnvironmentLight {
        &self.light
    }

    /// Emitter sampling for use with BRDF sampling: MIS compensation (Karlik et al. 2019).
    ///
    /// The mean luminance is subtracted from the map and negative values are clipped: dim regions are left to
    /// the other sampler, so that this one covers only a part. A constant map, of which nothing would remain,
    /// is not changed.
    ///
    /// # Errors
    /// See [`Tail::new`].
    pub fn compensated(environment: &Arc<Environment>, kind: TailKind) -> Result<Self> {
        let (width, height) = (environment.width(), environment.height());
        let luminance = environment.luminance();
        let mean_of = |values: &[f32]| solid_angle_means(width, height, values, |value| [value])[0] as f32;
        let mean = mean_of(&luminance);
        let compensated: Vec<f32> = luminance.iter().map(|value| (value - mean).max(0.0)).collect();
        // The remainder of a constant map is rounding noise.
        let left = mean_of(&compensated);
        let kept = if left > 1e-4 * mean { &compensated } else { &luminance };
        let tail = Tail::new(kind, width, height, kept)?;
        let light = EnvironmentLight::with_tail(environment.clone(), Arc::new(tail));
        Ok(Self { light, coverage: Coverage::Part })
    }
}

impl Sampler for EmitterSampler {
    fn sample(&self, _at: &Rows<'_>, _state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena) {
        out.pdf.as_flattened_mut().fill(1.0);
        self.light.directions(u, out, arena);
    }

    fn pdf(&self, _at: &Rows<'_>, _state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        self.light.pdf(wi, out, arena);
    }

    fn coverage(&self) -> Coverage {
        self.coverage
    }
}
