//! Patches of sky: product sampling without tables and without training.
//!
//! A map is divided into rectangles: clusters, leaves within each cluster, and twigs within each leaf. A
//! patch stores its energy and the first two moments of its directions; the light from it that a surface
//! reflects follows in closed form (`mass.rs`). A draw picks a cluster, then a leaf, then (for narrow lobes)
//! a twig in proportion to these masses, and the tail samples within it: the density over Y is constant on a
//! patch.
//!
//! A draw is a warp of the square of uniform points, so that a head can precede it: Z → U → Y → X by head,
//! patches and tail. The head then learns only the residual of the closed form.
//!
//! The square of uniform points is cut along the tree in which the map is halved, so that neighbouring points stay neighbours and
//! low-discrepancy points keep their strata.
//!
//! | file | concept |
//! | --- | --- |
//! | `hierarchy.rs` | clusters, leaves and twigs of a map |
//! | `sampler.rs` | the sampler, with a head or weights |
//! | `moments.rs` | moments of the light over rectangles of the map |
//! | `choice.rs` | where the map is divided |
//! | `mass.rs` | the light from a patch that a surface reflects |
//! | `tree.rs` | cutting the square along the tree of the map |
//! | `draw.rs` | preparation, sampling and density over columns |
//! | `lookup.rs` | the patch of a cell of the map |
//! | `small_lights.rs` | sample fractions of small lights |
//! | `rays.rs` | rays that visibility is learned from |
//! | `warp.rs` | the warp at one shading point, for training |
//! | `flat.rs` | patches as arrays, for other devices |

mod choice;
mod draw;
mod flat;
mod hierarchy;
mod lookup;
mod mass;
mod moments;
mod rays;
mod sampler;
mod small_lights;
mod tree;
mod warp;

pub use hierarchy::{Detail, Patches};
pub use rays::SkyRays;
pub use sampler::PatchSampler;
pub use warp::PatchWarp;
