//! Arguments that are text and may hold names of files, also such as are no Unicode.

use std::{error::Error, path::Path, str::FromStr};

use clap::builder::{OsStringValueParser, TypedValueParser};
use headtail_render::path_text::text_of;

/// Reads an argument as a text in which a path keeps every byte, see [`headtail_render::path_text`]. Unicode stays as it is, so that names
/// are taken as they were printed.
pub fn given<T>() -> impl TypedValueParser<Value = T>
where
    T: FromStr<Err: Into<Box<dyn Error + Send + Sync>>> + Clone + Send + Sync + 'static,
{
    OsStringValueParser::new().try_map(|argument| match argument.to_str() {
        Some(text) => text.parse::<T>(),
        None => text_of(Path::new(&argument)).parse(),
    })
}
