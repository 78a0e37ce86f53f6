//! An environment map together with the tail warp that samples it.

use std::sync::Arc;

use super::{Coverage, Draws};
use crate::{
    columns::{Arena, strips},
    environment::Environment,
    error::Result,
    latlong,
    simd::Lanes,
    tail::{Tail, TailKind, TailWarp},
};

/// An environment map and a tail warp; cheap to clone.
#[derive(Clone, Debug)]
pub struct EnvironmentLight {
    environment: Arc<Environment>,
    tail: Arc<Tail>,
    coverage: Coverage,
}

impl EnvironmentLight {
    /// Builds a tail for a map.
    ///
    /// # Errors
    /// See [`Tail::new`].
    pub fn new(environment: Arc<Environment>, kind: TailKind) -> Result<Self> {
        let tail = Tail::of_environment(kind, &environment)?;
        Ok(Self { environment, tail: Arc::new(tail), coverage: Coverage::Everything })
    }

    /// Combines a map with a tail that may have been built for a modified map. The coverage is
    /// [`Coverage::Part`] where the tail does not cover all light of the map.
    pub fn with_tail(environment: Arc<Environment>, tail: Arc<Tail>) -> Self {
        let coverage = if reaches(&tail, &environment) { Coverage::Everything } else { Coverage::Part };
        let light = environment.density();
        let tail =
            if tail.light().is_same(light) { Arc::new(Arc::unwrap_or_clone(tail).with_light(light)) } else { tail };
        Self { environment, tail, coverage }
    }

    /// Returns the map.
    pub fn environment(&self) -> &Arc<Environment> {
        &self.environment
    }

    /// Returns the tail warp.
    pub fn tail(&self) -> &Arc<Tail> {
        &self.tail
    }

    /// Returns [`Coverage::Everything`] if the tail covers all light of the map.
    pub fn coverage(&self) -> Coverage {
        self.coverage
    }

    /// Computes the directions of points `y` of Y. `out.pdf` holds their densities over Y, which become pdfs
    /// over solid angle.
    pub fn directions(&self, y: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena) {
        let mut columns = arena.columns::<3>(out.pdf.len());
        let [u, v, jacobian] = columns.get_mut();
        self.tail.forward_columns(y, [u, v], jacobian);
        let [u, v, jacobian] = columns.get();
        for (pdf, jacobian) in out.pdf.as_flattened_mut().iter_mut().zip(jacobian.as_flattened()) {
            *pdf /= jacobian;
        }
        latlong::directions([u, v], out.wi, out.pdf);
    }

    /// Computes the points of Y that map to `wi`, and the solid-angle pdfs of `wi` for uniform Y.
    pub fn pull_back(&self, wi: [&[Lanes]; 3], y: [&mut [Lanes]; 2], pdf: &mut [Lanes], arena: &Arena) {
        let mut x = arena.columns::<2>(pdf.len());
        latlong::squares(wi, x.get_mut());
        self.tail.inverse_columns(x.get(), y, pdf);
        latlong::to_solid_angle(x.get()[1], pdf);
    }

    /// Computes the solid-angle pdfs of `wi` for uniform Y.
    pub fn pdf(&self, wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        let mut x = arena.columns::<2>(out.len());
        latlong::squares(wi, x.get_mut());
        self.pdf_at(x.get(), out);
    }

    /// Computes [`Self::pdf`] for the directions of points of X.
    pub fn pdf_at(&self, x: [&[Lanes]; 2], out: &mut [Lanes]) {
        self.tail.density_columns(x, out);
        latlong::to_solid_angle(x[1], out);
    }

    /// Computes [`Self::pdf`] for a list of directions.
    pub fn pdfs(&self, wi: &[glam::Vec3A]) -> Vec<f32> {
        let arena = Arena::default();
        let mut columns = arena.columns::<4>(strips(wi.len()));
        let [x, y, z, _] = columns.get_mut().map(<[Lanes]>::as_flattened_mut);
        for (k, wi) in wi.iter().enumerate() {
            (x[k], y[k], z[k]) = (wi.x, wi.y, wi.z);
        }
        let mut out = vec![[0.0; crate::simd::LANES]; strips(wi.len())];
        let [x, y, z, _] = columns.get();
        self.pdf([x, y, z], &mut out, &arena);
        out.as_flattened()[..wi.len()].to_vec()
    }
}

/// Whether a tail's density is positive wherever a map is lit.
fn reaches(tail: &Tail, environment: &Environment) -> bool {
    if tail.kind() == TailKind::Flow {
        return true;
    }
    let (own, map) = (tail.light(), environment.density());
    let same_size = (own.columns(), own.rows()) == (map.columns(), map.rows());
    same_size && map.nodes().zip(own.nodes()).all(|(map, own)| map == 0.0 || own > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        image::Image,
        sampler::{BrdfSampler, Covering, EmitterSampler, OneSampleMis},
    };

    #[test]
    fn a_tail_that_misses_light_of_the_map_is_rejected_alone() {
        let white = Image { width: 8, height: 4, pixels: vec![[1.0; 3]; 32] };
        let map = Arc::new(Environment::from_image("white", white).unwrap());
        let light = |luminance: &[f32]| {
            let tail = Tail::new(TailKind::Hierarchical, 8, 4, luminance).unwrap();
            EnvironmentLight::with_tail(map.clone(), Arc::new(tail))
        };
        let mut luminance = vec![0.5; 32];
        assert!(Covering::new(EmitterSampler::new(light(&luminance))).is_ok());
        luminance[12] = 0.0;
        assert!(Covering::new(EmitterSampler::new(light(&luminance))).is_err());
        let mixture = OneSampleMis::new(EmitterSampler::new(light(&luminance)), BrdfSampler);
        assert!(Covering::new(mixture).is_ok());
    }
}
