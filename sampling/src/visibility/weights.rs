//! Visibility weights, which multiply the masses of patches.

use super::division::CLUSTERS;
use crate::{
    simd::{LANES, Lanes},
    tile::Rows,
};

/// Weights of the patches from a cell, each above 0 and at most 1, in steps of 1/255.
#[derive(Clone, Debug)]
pub struct Weights {
    clusters: [u8; CLUSTERS],
    patches: [[u8; LANES]; CLUSTERS],
}

impl Weights {
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
            out.clusters[cluster] = if all > 0.0 { quantized(sum / (255.0 * all)) } else { 255 };
        }
        out
    }

    /// Returns the weight of a patch.
    #[inline(always)]
    pub fn of_patch(&self, patch: usize) -> f32 {
        f32::from(self.patches[patch / LANES][patch % LANES]) / 255.0
    }
}

fn quantized(weight: f32) -> u8 {
    (255.0 * weight + 0.5).clamp(1.0, 255.0) as u8
}

/// The weights of shading points. They are relative: samplers normalize by their sum.
pub trait Weighting: Send + Sync {
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

/// Weights of 1 everywhere.
#[derive(Clone, Copy, Debug)]
pub struct Unoccluded;

impl Weighting for Unoccluded {
    #[inline(always)]
    fn at(&self, _index: f32) -> Option<&Weights> {
        None
    }
}
