//! The splines of [`headtail_render::spline`], which documents the logits, in tensor operations. The two
//! implementations share no mathematics: each is the other's reference.

mod bins;
mod rational_quadratic;
#[cfg(test)]
mod tests;

pub use headtail_render::spline::{Topology, bin_count, logit_count};
pub use rational_quadratic::{forward, inverse};

/// Largest number of bins: the minimum sizes of all bins then take less than 10 % of the square.
pub const MAX_BINS: usize = 512;
