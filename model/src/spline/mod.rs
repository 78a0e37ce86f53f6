//! The splines of [`headtail_render::spline`], where the meaning of logits is documented, in tensor operations. It shares no
//! mathematics with that form: each is the other's reference.

mod bins;
mod rational_quadratic;
#[cfg(test)]
mod tests;

pub use headtail_render::spline::{Topology, bin_count, logit_count};
pub use rational_quadratic::{forward, inverse};

/// Largest number of bins: the floors of all bins together then take less than a tenth of the square.
pub const MAX_BINS: usize = 512;
