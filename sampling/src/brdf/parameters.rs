//! Numbers of parameters of a BRDF.

/// Numbers that describe a measured BRDF.
pub const LATENTS: usize = 6;

/// Maximum number of parameters of a BRDF.
pub const MAX_PARAMETERS: usize = 11;
