//! Linear Rec.709 images: reading photographs and textures, writing results. The crate headtail-sampling
//! reads radiance maps.
//!
//! | file | concept |
//! | --- | --- |
//! | `photograph.rs`, `compressed.rs` | photographs; PNG and JPEG in memory |
//! | `color_profile.rs` | colours of PNG and JPEG files: ICC profiles, `cICP`, `gAMA` |
//! | `write.rs`, `layered.rs` | results as OpenEXR and PNG; OpenEXR of several layers |
//! | `attributes.rs` | text attributes of OpenEXR headers |

mod attributes;
mod color_profile;
mod compressed;
mod layered;
mod photograph;
mod write;

pub use attributes::text_attributes;
pub(crate) use compressed::decode_compressed;
pub use headtail_sampling::image::*;
pub use layered::{Channel, encode_layered_exr};
pub use photograph::{Photograph, srgb_code};
pub use write::{Attribute, AttributeValue, encode_exr, encode_png, encode_png_rgb8, latin_1, write_exr, write_png};
