//! What samplers need to know about a scene.

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
