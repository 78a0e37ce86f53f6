//! Linear Rec.709 images: reading radiance maps, writing results.

mod attributes;
mod compressed;
mod dwa;
mod layered;
mod layers;
mod layout;
mod openexr;
mod photograph;
mod primaries;
mod radiance;
mod read;
mod rgbe;
mod size;
mod without_panic;
mod write;

pub use attributes::text_attributes;
pub(crate) use compressed::decode_compressed;
pub use layered::{Channel, encode_layered_exr};
pub use layout::MapLayout;
pub(crate) use layout::to_lat_long;
pub use photograph::{Photograph, srgb_code};
pub use read::{Picture, read_picture, read_radiance};
pub use size::MAX_PIXELS;
pub(crate) use without_panic::without_panic;
pub use write::{Attribute, AttributeValue, encode_exr, encode_png, encode_png_rgb8, latin_1, write_exr, write_png};

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
    /// A black image.
    pub fn black(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![[0.0; 3]; width * height] }
    }

    /// The pixel at column `x`, row `y`.
    pub fn get(&self, x: usize, y: usize) -> Vec3A {
        Vec3A::from_array(self.pixels[y * self.width + x])
    }
}
