//! Text attributes of OpenEXR headers.

use std::io::BufReader;
use std::path::Path;

use exr::meta::MetaData;
use exr::meta::attribute::AttributeValue;

use super::without_panic;
use crate::error::{Error, Result};
use crate::file::open_regular;

/// Returns the non-standard text and number attributes of an OpenEXR file's first layer, sorted by name.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read, [`Error::Invalid`] if it has no valid header.
pub fn text_attributes(path: &Path) -> Result<Vec<(String, String)>> {
    let (file, _) = open_regular(path).map_err(|source| Error::io(path, source))?;
    let read = || MetaData::read_from_buffered(BufReader::new(file), false);
    let invalid = |reason: String| Error::invalid(path, "header", reason);
    let meta = without_panic(read).ok_or_else(|| invalid("it is damaged".into()))?;
    let meta = meta.map_err(|error| invalid(error.to_string()))?;
    let header = meta.headers.first().ok_or_else(|| invalid("there is no layer".into()))?;
    let own = header.own_attributes.other.iter().chain(&header.shared_attributes.other);
    let mut found: Vec<(String, String)> =
        own.filter_map(|(name, value)| Some((name.to_string(), text(value)?))).collect();
    found.sort();
    found.dedup();
    Ok(found)
}

fn text(value: &AttributeValue) -> Option<String> {
    match value {
        AttributeValue::Text(text) => Some(text.to_string()),
        AttributeValue::I32(number) => Some(number.to_string()),
        AttributeValue::F32(number) => Some(number.to_string()),
        AttributeValue::F64(number) => Some(number.to_string()),
        _ => None,
    }
}
