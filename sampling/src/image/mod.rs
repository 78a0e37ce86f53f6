//! Linear Rec.709 images, and reading them from Radiance and (with the feature `exr`) OpenEXR files.
//!
//! | file | concept |
//! | --- | --- |
//! | `read.rs` | the format of a file, from its first bytes |
//! | `radiance.rs`, `rgbe.rs` | Radiance pictures, and their scan lines |
//! | `openexr.rs`, `layers.rs` | OpenEXR, and the choice of channels |
//! | `dwa.rs` | checks of sizes in DWA blocks of OpenEXR files |
//! | `layout.rs` | cubes, crosses, probes and equal-area squares to lat-long |
//! | `color_space.rs` | the colour space that an OpenEXR header names |
//! | `conversion.rs`, `primaries.rs` | other colour spaces, luminance and chroma to Rec.709; other primaries |
//! | `repair.rs` | values that light cannot have |
//! | `size.rs` | the largest image |
//! | `without_panic.rs` | panics of decoders as errors |

#[cfg(feature = "exr")]
mod color_space;
mod conversion;
#[cfg(feature = "exr")]
mod dwa;
#[cfg(feature = "exr")]
mod layers;
mod layout;
#[cfg(feature = "exr")]
mod openexr;
mod primaries;
mod radiance;
mod read;
mod repair;
mod rgbe;
mod size;
mod without_panic;

pub use layout::MapLayout;
pub(crate) use layout::to_lat_long;
pub use read::{Format, Picture, read_picture, read_radiance};
pub use repair::Repair;
pub use size::MAX_PIXELS;
#[doc(hidden)]
pub use without_panic::without_panic;

use glam::Vec3A;

/// A linear Rec.709 image, row-major from the top left, `pixels[y * width + x]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height * width]` linear radiance.
    pub pixels: Vec<[f32; 3]>,
}

impl Image {
    /// Makes a black image.
    pub fn black(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![[0.0; 3]; width * height] }
    }

    /// The pixel at column `x`, row `y`.
    pub fn get(&self, x: usize, y: usize) -> Vec3A {
        Vec3A::from_array(self.pixels[y * self.width + x])
    }
}
