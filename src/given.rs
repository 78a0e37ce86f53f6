//! Parsers of arguments: texts that may hold non-UTF-8 names of files, and choices among named values.

use std::{error::Error, path::Path, str::FromStr};

use clap::builder::{OsStringValueParser, PossibleValue, PossibleValuesParser, TypedValueParser};
use headtail_render::path_text::text_of;

/// Returns a parser of texts in which a path keeps every byte, see [`headtail_render::path_text`]. Unicode is
/// unchanged, so that printed names are accepted.
pub fn given<T>() -> impl TypedValueParser<Value = T>
where
    T: FromStr<Err: Into<Box<dyn Error + Send + Sync>>> + Clone + Send + Sync + 'static,
{
    OsStringValueParser::new().try_map(|argument| match argument.to_str() {
        Some(text) => text.parse::<T>(),
        None => text_of(Path::new(&argument)).parse(),
    })
}

/// Returns a parser of one of several values, each given with its name and its help.
pub fn one_of<T: Copy + Send + Sync>(
    values: &'static [(T, &'static str, &'static str)],
) -> impl TypedValueParser<Value = T> {
    let possible = values.iter().map(|(_, name, help)| PossibleValue::new(*name).help(*help));
    PossibleValuesParser::new(possible).map(|given| {
        let found = values.iter().find(|(_, name, _)| *name == given);
        found.expect("the parser accepts these names only").0
    })
}
