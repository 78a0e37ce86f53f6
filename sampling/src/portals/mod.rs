//! Portals: rectangles through which the light of an environment enters a room, and the sampler of that light.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | portals |
//! | `file.rs` | the file format |
//! | `image.rs` | the map in the angles of a portal, and sums over its rectangles |
//! | `flat.rs` | portals as arrays, for other devices |
//! | `sampler.rs` | portal-masked sampling (Bitterli, Novák and Jarosz 2015) |

mod file;
mod flat;
mod image;
mod sampler;
#[cfg(test)]
mod tests;

pub use file::{read, to_json};
pub use sampler::PortalSampler;

use glam::{Affine3A, Vec3A};

/// A rectangle through which light enters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Portal {
    /// Its middle, in metres.
    pub center: Vec3A,
    /// Unit normal, into the room.
    pub normal: Vec3A,
    /// Unit direction of its height; `up x normal` is that of its width.
    pub up: Vec3A,
    /// Size in metres.
    pub width: f32,
    /// Size in metres.
    pub height: f32,
}

impl Portal {
    /// Returns the unit direction of its width.
    pub fn right(&self) -> Vec3A {
        self.up.cross(self.normal)
    }

    /// Returns the corners in metres, counter-clockwise as seen from inside the room.
    pub fn corners(&self) -> [Vec3A; 4] {
        let (x, y) = (0.5 * self.width * self.right(), 0.5 * self.height * self.up);
        [self.center - x - y, self.center + x - y, self.center + x + y, self.center - x + y]
    }

    /// Returns whether a ray leaves the room through the rectangle.
    pub fn is_crossed(&self, origin: Vec3A, direction: Vec3A) -> bool {
        let along = -direction.dot(self.normal);
        let t = (origin - self.center).dot(self.normal) / along;
        let at = origin + t * direction - self.center;
        along > 0.0
            && t > 0.0
            && at.dot(self.right()).abs() <= 0.5 * self.width
            && at.dot(self.up).abs() <= 0.5 * self.height
    }

    /// Returns the portal after a rigid motion.
    #[must_use]
    pub fn moved(&self, motion: &Affine3A) -> Self {
        Self {
            center: motion.transform_point3a(self.center),
            normal: motion.transform_vector3a(self.normal),
            up: motion.transform_vector3a(self.up),
            ..*self
        }
    }
}
