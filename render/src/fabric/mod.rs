//! Reflectance of cloth from its micro-geometry, and of layered surfaces: the ground truth that neural
//! materials are fitted to.
//!
//! A fabric is a periodic tile over the unit square: triangulated yarns or fibres over an opaque lining,
//! so that no light path escapes downwards. The tile's x and y are the texture coordinates u and v, +z is
//! the visible side, and all lengths are in tiles. A [`Query`] asks for the bidirectional texture
//! function: the mean of `f_r cos`, path-traced through the yarns, over a Gaussian footprint on the
//! reference plane.
//!
//! | file | concept |
//! | --- | --- |
//! | `kinds.rs` | sources by name |
//! | `yarn.rs` | yarns and fibres as triangles |
//! | `weave.rs`, `knit.rs`, `pile.rs` | woven, knitted and pile fabrics |
//! | `reflect.rs` | path tracing of a fabric |
//! | `layered.rs` | path tracing between a coat and a base |

mod kinds;
mod knit;
mod layered;
mod pile;
mod reflect;
mod weave;
mod yarn;

pub use kinds::SourceKind;
pub use layered::Layered;
pub use reflect::{Fabric, MIN_COSINE};

use glam::{Vec2, Vec3};

/// The arguments of a bidirectional texture function. Directions are unit vectors that point away from
/// the surface, in its local frame: x along u, y along v, z along the normal.
#[derive(Clone, Copy, Debug)]
pub struct Query {
    /// Point on the reference plane, in tiles, with period 1.
    pub uv: Vec2,
    /// Standard deviation of the Gaussian footprint along u and v, in tiles.
    pub width: f32,
    /// Direction to the viewer.
    pub wo: Vec3,
    /// Direction to the light.
    pub wi: Vec3,
}

/// A source of bidirectional texture samples.
pub trait Source: Send + Sync {
    /// Returns an unbiased estimate of `f_r max(0, cos)` in 1/sr per query and channel, the mean of
    /// `samples` light paths. Equal seeds give equal numbers on any number of threads.
    fn reflect(&self, queries: &[Query], samples: u32, seed: u64) -> Vec<Vec3>;
}
