//! The patches of a map that visibility is learned for.

use crate::simd::LANES;

/// Number of clusters of patches.
pub const CLUSTERS: usize = 32;
/// Number of patches, [`LANES`] per cluster.
pub const PATCHES: usize = CLUSTERS * LANES;

/// The fraction of the map's light in each patch.
#[derive(Clone, Debug)]
pub struct Division {
    energies: Vec<f32>,
}

impl Division {
    /// Creates a division from the energy of each patch; 0 for patches that do not exist.
    ///
    /// # Panics
    /// If `energies` does not have [`PATCHES`] elements.
    pub fn new(energies: Vec<f32>) -> Self {
        assert_eq!(energies.len(), PATCHES, "an energy for each patch");
        Self { energies }
    }

    /// Returns the energies of the patches.
    pub fn energies(&self) -> &[f32] {
        &self.energies
    }
}
