//! The BRDFs that surfaces refer to.

use std::sync::Arc;

use super::{Brdf, Ggx, Kernel, Lambert, MetallicRoughness, OfKernel, parameters::MAX_PARAMETERS};

/// Number of analytic BRDFs.
pub(super) const ANALYTIC: usize = 3;

/// The BRDFs that points of a tile refer to by index.
#[derive(Clone, Debug)]
pub struct BrdfTable(Arc<[Arc<dyn Brdf>]>);

impl BrdfTable {
    /// Index of [`Lambert`].
    pub const LAMBERT: u32 = 0;
    /// Index of [`Ggx`].
    pub const GGX: u32 = 1;
    /// Index of [`MetallicRoughness`].
    pub const METALLIC_ROUGHNESS: u32 = 2;

    /// The BRDF of an index.
    ///
    /// # Panics
    /// If the index is out of range.
    pub fn get(&self, index: u32) -> &dyn Brdf {
        &*self.0[index as usize]
    }

    /// Number of BRDFs.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether the table is empty.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// All but the analytic BRDFs, in order.
    pub fn added(&self) -> impl Iterator<Item = &Arc<dyn Brdf>> {
        self.0.iter().skip(ANALYTIC)
    }

    /// Returns the table with one more BRDF, and its index.
    pub fn with(&self, brdf: Arc<dyn Brdf>) -> (Self, u32) {
        let all = self.0.iter().cloned().chain([brdf]).collect();
        (Self(all), self.0.len() as u32)
    }
}

impl Default for BrdfTable {
    /// The analytic BRDFs, in the order of the constants.
    fn default() -> Self {
        let all: [Arc<dyn Brdf>; ANALYTIC] = [
            Arc::new(OfKernel::<Lambert>::NEW),
            Arc::new(OfKernel::<Ggx>::NEW),
            Arc::new(OfKernel::<MetallicRoughness>::NEW),
        ];
        Self(Arc::new(all))
    }
}

/// The BRDF of one point: an index into a [`BrdfTable`] and parameters, with textures looked up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Index of the BRDF.
    pub brdf: u32,
    /// Parameters, followed by zeros.
    pub parameters: [f32; MAX_PARAMETERS],
}

impl From<Lambert> for Surface {
    fn from(lambert: Lambert) -> Self {
        Self { brdf: BrdfTable::LAMBERT, parameters: lambert.parameters() }
    }
}

impl From<Ggx> for Surface {
    fn from(ggx: Ggx) -> Self {
        Self { brdf: BrdfTable::GGX, parameters: ggx.parameters() }
    }
}

impl From<MetallicRoughness> for Surface {
    fn from(mixture: MetallicRoughness) -> Self {
        Self { brdf: BrdfTable::METALLIC_ROUGHNESS, parameters: mixture.parameters() }
    }
}
