//! Visibility weights, which multiply the masses of patches.

use std::ops::Deref;

use super::division::CLUSTERS;
use crate::{
    simd::{LANES, Lanes},
    tile::Rows,
};

/// Weights of the patches from a cell, each above 0 and at most 1, in steps of 1/255.
#[derive(Clone, Debug)]
pub struct Weights {
    pub(super) clusters: [u8; CLUSTERS],
    pub(super) patches: [[u8; LANES]; CLUSTERS],
}

impl Weights {
    /// The number that stands for 1.
    pub const UNIT: f32 = 255.0;

    /// Returns weights of 1.
    pub fn unknown() -> Self {
        Self { clusters: [255; CLUSTERS], patches: [[255; LANES]; CLUSTERS] }
    }

    /// Creates weights from those of patches; weights of clusters are their means by energy.
    pub fn new(weights: impl Fn(usize) -> f32, energies: &[f32]) -> Self {
        let mut out = Self::unknown();
        for (cluster, own) in out.patches.iter_mut().enumerate() {
            let (mut sum, mut all) = (0.0, 0.0);
            for (k, byte) in own.iter_mut().enumerate() {
                let patch = cluster * LANES + k;
                *byte = quantized(weights(patch));
                sum += energies[patch] * f32::from(*byte);
                all += energies[patch];
            }
            out.clusters[cluster] = if all > 0.0 { quantized(sum / (Self::UNIT * all)) } else { 255 };
        }
        out
    }

    /// Returns the weight of a patch.
    #[inline(always)]
    pub fn of_patch(&self, patch: usize) -> f32 {
        f32::from(self.patches[patch / LANES][patch % LANES]) / Self::UNIT
    }
}

fn quantized(weight: f32) -> u8 {
    (Weights::UNIT * weight + 0.5).clamp(1.0, Weights::UNIT) as u8
}

/// The weights of shading points. Samplers normalize masses by their sum, but the mixture weight of BRDF
/// sampling depends on that sum: divided by the unit, it is the light that the point sees.
pub trait Weighting: Send + Sync {
    /// What weights are multiples of.
    const UNIT: f32;

    /// Computes the indices of the weights of points, as the bits of lanes.
    fn indices(&self, _at: &Rows<'_>, _out: &mut [Lanes]) {}

    /// Returns the weights with an index; `None` for every index if all weights are 1.
    fn at(&self, index: f32) -> Option<&Weights>;

    /// Computes the weights of the clusters at the points of a strip.
    #[inline(always)]
    fn of_clusters(&self, indices: &Lanes, out: &mut [Lanes; CLUSTERS]) {
        let first = indices[0].to_bits();
        match self.at(indices[0]) {
            None => *out = [[1.0; LANES]; CLUSTERS],
            Some(weights) => {
                for (out, weight) in out.iter_mut().zip(&weights.clusters) {
                    *out = [f32::from(*weight); LANES];
                }
            }
        }
        // Points of a strip are neighbours: most are in the same cell.
        for k in 1..LANES {
            if indices[k].to_bits() != first
                && let Some(weights) = self.at(indices[k])
            {
                for (out, weight) in out.iter_mut().zip(&weights.clusters) {
                    out[k] = f32::from(*weight);
                }
            }
        }
    }

    /// Returns the weights of the patches of a cluster at a point.
    #[inline(always)]
    fn of_parts(&self, index: f32, cluster: usize) -> Lanes {
        let mut out = [1.0; LANES];
        if let Some(weights) = self.at(index) {
            for (out, weight) in out.iter_mut().zip(&weights.patches[cluster]) {
                *out = f32::from(*weight);
            }
        }
        out
    }
}

impl<P: Deref<Target: Weighting> + Send + Sync> Weighting for P {
    const UNIT: f32 = P::Target::UNIT;

    fn indices(&self, at: &Rows<'_>, out: &mut [Lanes]) {
        (**self).indices(at, out);
    }

    #[inline(always)]
    fn at(&self, index: f32) -> Option<&Weights> {
        (**self).at(index)
    }
}

/// Weights of 1 everywhere.
#[derive(Clone, Copy, Debug)]
pub struct Unoccluded;

impl Weighting for Unoccluded {
    const UNIT: f32 = 1.0;

    #[inline(always)]
    fn at(&self, _index: f32) -> Option<&Weights> {
        None
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{Vec3, Vec3A};

    use super::*;
    use crate::{
        brdf::Ggx,
        columns::Arena,
        environment::built_in,
        patches::{Detail, PatchSampler},
        random::{Purpose, Stream},
        sampler::{EnvironmentLight, Sampler},
        tail::TailKind,
        tile::{ShadingPoint, Tile},
    };

    /// Cells without rays.
    struct Unknown(Weights);

    impl Weighting for Unknown {
        const UNIT: f32 = Weights::UNIT;

        fn at(&self, _index: f32) -> Option<&Weights> {
            Some(&self.0)
        }
    }

    #[test]
    fn weights_of_1_change_neither_pdfs_nor_mixture_weights() {
        let light = EnvironmentLight::new(Arc::new(built_in("studio").unwrap()), TailKind::Hierarchical).unwrap();
        let (patches, unknown) = (PatchSampler::new(light, Detail::Leaves).unwrap(), Unknown(Weights::unknown()));
        let (mut random, mut tile) = (Stream::new(1, Purpose::Test, 0), Tile::default());
        for key in 0..100 {
            let n = random.direction();
            let wo = (n + 0.7 * n.any_orthonormal_vector()).normalize();
            let surface = Ggx::new(0.02 + 0.5 * random.uniform(), Vec3::ONE).into();
            tile.push(&ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface }, key);
        }
        let (at, arena) = (tile.rows(), Arena::default());
        let wi: [Vec<Lanes>; 3] = std::array::from_fn(|axis| {
            let mut column = vec![[0.0; LANES]; at.strips()];
            for (place, out) in column.as_flattened_mut()[..at.len()].iter_mut().enumerate() {
                let point = tile.point(place);
                *out = (2.0 * point.wo.dot(point.ns) * point.ns - point.wo)[axis];
            }
            column
        });
        let densities = |sampler: &dyn Sampler| {
            let mut state = vec![[0.0; LANES]; sampler.columns() * at.strips()];
            let mut out = [vec![[0.0; LANES]; at.strips()], vec![[0.0; LANES]; at.strips()]];
            sampler.prepare(&at, &mut state, &arena);
            sampler.pdf(&at, &state, wi.each_ref().map(|axis| &**axis), &mut out[0], &arena);
            sampler.mixture_weight(&at, &state, &mut out[1], &arena);
            out
        };
        let [equal, none] = [densities(&patches.weighted(&unknown)), densities(&patches)];
        assert!(none.iter().all(|column| column.as_flattened()[..at.len()].iter().all(|&number| number > 0.0)));
        for (equal, none) in
            equal.iter().flat_map(|own| own.as_flattened()).zip(none.iter().flat_map(|own| own.as_flattened()))
        {
            // Sums of 255 times the masses round otherwise.
            assert!((equal - none).abs() <= 2e-5 * none, "{equal} {none}");
        }
    }
}
