//! URIs of glTF files: embedded data or relative paths.

use std::path::{Component, PathBuf};

use base64::{
    Engine as _, alphabet,
    engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig},
};

/// Base64 with or without padding.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// The source of a URI's bytes.
#[derive(Debug, PartialEq)]
pub enum Source {
    /// The bytes are in the URI.
    Data(Vec<u8>),
    /// A file, relative to the folder of the glTF file and not outside of it.
    File(PathBuf),
}

/// Parses a URI; the error completes a sentence whose subject is the URI.
pub fn parse(uri: &str) -> Result<Source, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (kind, payload) = data.split_once(',').ok_or("has no data")?;
        if !kind.ends_with(";base64") {
            return percent_decode(payload).map(Source::Data);
        }
        return BASE64.decode(payload).map(Source::Data).map_err(|error| format!("is not base64 data: {error}"));
    }
    let path = String::from_utf8(percent_decode(uri)?).map_err(|_| "is not UTF-8")?;
    // A backslash is a separator on some systems, and a colon names a scheme or a drive.
    let inside = !path.contains([':', '\\', '\0'])
        && PathBuf::from(&path).components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    if path.is_empty() || !inside {
        return Err("is not a relative path inside the file's folder".into());
    }
    Ok(Source::File(path.into()))
}

/// Decodes percent escapes, such as `%41` for `A`.
fn percent_decode(text: &str) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        if byte != b'%' {
            bytes.push(byte);
            continue;
        }
        let digit = |b: Option<u8>| b.and_then(|b| char::from(b).to_digit(16));
        match (digit(rest.next()), digit(rest.next())) {
            (Some(high), Some(low)) => bytes.push((16 * high + low) as u8),
            _ => return Err("has a '%' without two digits".into()),
        }
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_and_data_uris_are_distinguished() {
        assert_eq!(parse("a%20b/./c.bin"), Ok(Source::File("a b/./c.bin".into())));
        assert_eq!(parse("data:application/octet-stream;base64,AQID"), Ok(Source::Data(vec![1, 2, 3])));
        assert_eq!(parse("data:;base64,AQI="), Ok(Source::Data(vec![1, 2])));
        assert_eq!(parse("data:application/gltf-buffer,a%00"), Ok(Source::Data(vec![b'a', 0])));
        assert_eq!(parse("data:;base64,AQI"), Ok(Source::Data(vec![1, 2])));
    }

    #[test]
    fn paths_outside_of_the_folder_and_invalid_uris_are_rejected() {
        for uri in [
            "../a",
            "a/../../b",
            "/etc/passwd",
            "%2e%2e/a",
            "%2Fetc",
            "file:///a",
            "http://a/b",
            "C:\\a",
            "..\\a",
            "",
            "a%00",
            "a%4",
            "a%ff",
            "data:;base64",
            "data:;base64,?",
        ] {
            assert!(parse(uri).is_err(), "{uri}");
        }
    }
}
