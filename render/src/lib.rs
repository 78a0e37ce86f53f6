//! Scenes, images and an integrator of direct light and of paths, over the samplers of
//! `headtail-sampling`, which it re-exports.
//!
//! This crate reads files that headtail exports and does not depend on the library that trains them.
//!
//! | file | concept |
//! | --- | --- |
//! | `scene/` | scenes, glTF, materials, ray tracing |
//! | `integrator/` | renderings of a view with an estimator |
//! | `composite/` | objects in photographs |
//! | `portals/` | rectangles through which light enters a room |
//! | `image/` | photographs, and writing results |
//! | `statistics/` | errors, intervals and tests |
//! | `fabric/` | reference materials that neural materials are fitted to |

pub mod composite;
pub mod fabric;
pub mod image;
pub mod integrator;
pub mod portals;
pub mod scene;
pub mod statistics;

#[doc(no_inline)]
pub use headtail_sampling::*;
