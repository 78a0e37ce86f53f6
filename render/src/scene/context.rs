//! The scene as samplers see it.

use super::Scene;
use crate::{brdf::BrdfTable, spec::SceneContext};

impl SceneContext for Scene {
    fn geometry_hash(&self) -> String {
        self.geometry_hash()
    }

    fn brdfs(&self) -> &BrdfTable {
        self.brdfs()
    }
}
