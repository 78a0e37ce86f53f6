//! The trainable part of headtail in burn: rational-quadratic splines, spline networks, coupling layers,
//! heads.
//!
//! A head warp `h: Z -> Y` (Litalien et al., "Neural Product Importance Sampling via Warp Composition",
//! SIGGRAPH Asia 2024) maps uniform points of the base square Z to the intermediate square Y under a
//! condition `c`. Coordinate 0 of both squares (`u`, azimuth) is a circle, coordinate 1 (`v`, elevation) an
//! interval; every density here is per unit area of Y.
//!
//! The *inverse* direction `y -> z` is closed form and gives the density; the *forward* direction `z -> y`
//! samples and solves a quadratic. No type names a backend: the caller's [`burn::prelude::Device`] selects it
//! at run time.
//!
//! | file | concept |
//! | --- | --- |
//! | `head/`, `flow/` | the head; the flow tail |
//! | `coupling.rs` | a coupling layer |
//! | `spline_network.rs` | the network that predicts a spline's logits |
//! | `spline/` | splines in tensor operations |
//! | `linear.rs` | affine layers whose initial values are equal on every backend |
//! | `weights.rs` | named weights, for export |

pub mod coupling;
pub mod error;
pub mod flow;
pub mod head;
pub mod linear;
pub mod spline;
pub mod spline_network;
pub mod weights;

pub use error::{Error, Result};
pub use flow::{Flow, FlowConfig, FlowForm};
pub use head::{EncoderConfig, Head, HeadConfig};
pub use headtail_render::head::{Condition, Mode};
pub use weights::NamedTensor;

/// The device of tests.
#[cfg(test)]
#[allow(deprecated)] // By burn 0.22, the last version with this backend.
pub(crate) fn host() -> burn::prelude::Device {
    burn::prelude::Device::ndarray()
}
