//! The context that samplers are built for.

use glam::Affine3A;

use crate::{brdf::BrdfTable, estimator::LearnedVisibility, portals::Portal};

/// The properties of a scene that samplers need.
pub trait SceneContext: Sync {
    /// Returns a hash of all geometry that blocks light.
    fn geometry_hash(&self) -> String;

    /// Returns the BRDFs that shading points refer to.
    fn brdfs(&self) -> &BrdfTable;
}

/// The context that an estimator is built for, besides its map.
#[derive(Clone, Copy)]
pub struct BuildContext<'a> {
    /// The scene; precomputed visibility must be of it.
    pub scene: Option<&'a dyn SceneContext>,
    /// Largest size of learned visibility, in bytes.
    pub memory: usize,
    /// Whether learned visibility is used even where its predicted gain is below its cost.
    pub always: bool,
    /// The rigid motion of the scene since the portals of files were placed.
    pub motion: Affine3A,
    /// The portals found in the scene, for SPECs that name no file of portals.
    pub portals: &'a [Portal],
}

impl Default for BuildContext<'_> {
    /// No scene, not moved; 64 MiB of visibility, used where it pays off.
    fn default() -> Self {
        let (memory, motion) = (LearnedVisibility::MEMORY, Affine3A::IDENTITY);
        Self { scene: None, memory, always: false, motion, portals: &[] }
    }
}
