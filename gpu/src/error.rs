//! Errors.

/// Why a picture cannot be rendered on a device.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The shaders do not cover a part of the scene, the sampler or the points.
    #[error("{what}: not rendered on a device; {instead}")]
    NotCovered {
        /// What is not covered.
        what: String,
        /// What to do instead.
        instead: &'static str,
    },
    /// The scene is too large for the words that refer to it.
    #[error("the scene has {count} {what}, and a device takes {most}")]
    TooMany {
        /// Number of them.
        count: usize,
        /// What there are too many of.
        what: &'static str,
        /// Largest number.
        most: usize,
    },
    /// A sampler cannot be made, or memory is missing.
    #[error(transparent)]
    Render(#[from] headtail_render::error::Error),
    /// The device failed.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Device(#[from] headtail_shaders::gpu::GpuError),
}

/// A result of this crate.
pub type Result<T> = std::result::Result<T, Error>;
