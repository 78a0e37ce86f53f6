//! Virtual objects in photographs: the light on an object, the shadow that it casts on the photographed
//! surface (the catcher), and the light that it reflects onto it, in one pass.
//!
//! The mask of a catcher is the fraction of its irradiance that the object does not block,
//! `tau = integral V L max(0, n . w) dw / integral L max(0, n . w) dw` (Litalien et al. 2024,
//! equation `ShadowCatcher`). A renderer that divides a picture with the object by one without it
//! (Debevec 1998) needs two passes. Samples of the product need one: see [`MaskForm`] for the estimators.
//!
//! | file | concept |
//! | --- | --- |
//! | `composition.rs` | input and settings |
//! | `catcher.rs` | object and catcher, and the photograph as the catcher's texture |
//! | `irradiance.rs` | the exact irradiance of a map |
//! | `mask.rs` | the mask and its estimators |
//! | `pass.rs`, `worker.rs`, `film.rs` | passes, one sample of a tile, the sums of all pixels |
//! | `layers.rs` | the layers of the result |
//! | `view.rs` | rectified views of a map |

mod catcher;
mod composition;
mod film;
mod irradiance;
mod layers;
mod mask;
mod pass;
mod view;
mod worker;

pub use catcher::{Backdrop, Catcher, Stage};
pub use composition::{Composition, Settings};
pub use film::{CatcherSums, Film};
pub use irradiance::Irradiance;
pub use layers::Layers;
pub use mask::{Mask, MaskForm};
pub use pass::compose;
pub use view::rectified_view;
