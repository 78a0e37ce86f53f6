//! URIs of glTF files: embedded data or relative paths.

use std::{
    ffi::OsStr,
    path::{Component, Path, PathBuf},
};

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
    /// A file relative to the folder of the glTF file, below it or below its parent.
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
    if path.is_empty() || path.contains([':', '\\', '\0']) {
        return Err("is not a relative path".into());
    }
    without_dots(Path::new(&path)).map(Source::File)
}

/// Resolves the dots of a relative path, as URIs define them (RFC 3986, section 5.2.4): before links are
/// followed. Files beside the folder of the glTF file may be shared with others of the project; farther ones,
/// and hidden ones outside of the folder, are not expected to be part of it.
fn without_dots(path: &Path) -> Result<PathBuf, String> {
    let (mut names, mut is_outside) = (Vec::new(), false);
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::Normal(name) => names.push(name),
            Component::ParentDir if names.pop().is_some() => {}
            Component::ParentDir if !is_outside => is_outside = true,
            Component::ParentDir => return Err("is outside of the parent of the file's folder; copy it there".into()),
            Component::RootDir | Component::Prefix(_) => return Err("is not a relative path".into()),
        }
    }
    if is_outside && names.iter().any(|name| name.as_encoded_bytes().starts_with(b".")) {
        return Err("is a hidden file outside of the file's folder".into());
    }
    let start = if is_outside { ".." } else { "" };
    Ok(std::iter::once(OsStr::new(start)).chain(names).collect())
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
        assert_eq!(parse("a%20b/./c.bin"), Ok(Source::File("a b/c.bin".into())));
        assert_eq!(parse("../shared/wood%20%C3%A9.png"), Ok(Source::File("../shared/wood é.png".into())));
        assert_eq!(parse("./../chair/../shared/a"), Ok(Source::File("../shared/a".into())));
        assert_eq!(parse("%2e%2e/a"), Ok(Source::File("../a".into())));
        assert_eq!(parse("a/../.b"), Ok(Source::File(".b".into())));
        assert_eq!(parse("data:application/octet-stream;base64,AQID"), Ok(Source::Data(vec![1, 2, 3])));
        assert_eq!(parse("data:;base64,AQI="), Ok(Source::Data(vec![1, 2])));
        assert_eq!(parse("data:application/gltf-buffer,a%00"), Ok(Source::Data(vec![b'a', 0])));
        assert_eq!(parse("data:;base64,AQI"), Ok(Source::Data(vec![1, 2])));
    }

    #[test]
    fn paths_beyond_the_parent_folder_and_invalid_uris_are_rejected() {
        for uri in [
            "../../a",
            "../a/../../b",
            "a/../../../b",
            "../.ssh/id_rsa",
            "../a/.b",
            "/etc/passwd",
            "%2e%2e/%2e./a",
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
