//! Micro-geometry of cloth, and what it reflects: the ground truth that neural materials are fitted to.
//!
//! A fabric is a periodic tile of the unit square of yarns or fibres as triangles, over an opaque lining, so that no light path misses
//! it. The tile's x and y are the texture coordinates u and v, z is the side that is seen, and all lengths are in tiles. A [`Query`] asks for the bidirectional texture
//! function: the mean over a Gaussian footprint on the reference plane of `f_r cos`, as path tracing through the yarns finds it.
//!
//! | file | concept |
//! | --- | --- |
//! | `kinds.rs` | sources by name |
//! | `yarn.rs` | yarns and fibres as triangles |
//! | `weave.rs`, `knit.rs`, `pile.rs` | woven, knitted and pile fabrics |
//! | `reflect.rs` | light paths through a fabric |
//! | `layered.rs` | light paths between a coat and a base |

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

/// What a bidirectional texture is asked for. Directions are unit vectors that point away from the surface, in its local frame: x
/// along u, y along v, z along the normal.
#[derive(Clone, Copy, Debug)]
pub struct Query {
    /// The point of the reference plane, in tiles; the tile repeats.
    pub uv: Vec2,
    /// Standard deviation of the Gaussian footprint along u and v, in tiles.
    pub width: f32,
    /// Direction to the viewer.
    pub wo: Vec3,
    /// Direction to the light.
    pub wi: Vec3,
}

/// Where samples of a bidirectional texture come from.
pub trait Source: Send + Sync {
    /// An estimate without bias of `f_r max(0, cos)` per channel in 1/sr for each query, the mean of `samples` light paths. Equal seeds
    /// give equal numbers on any number of threads.
    fn reflect(&self, queries: &[Query], samples: u32, seed: u64) -> Vec<Vec3>;
}
