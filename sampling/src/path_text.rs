//! Paths as text: non-UTF-8 file names in arguments and settings that also accept other names.
//!
//! A UTF-8 path is its own text. In other paths, each byte that is not part of UTF-8 becomes a character of a
//! private range, as does each byte of characters of that range itself, so the mapping is invertible.

#[cfg(unix)]
use std::os::unix::ffi::OsStringExt;
use std::{
    borrow::Cow,
    path::{Path, PathBuf},
};

/// The character of byte 0; only bytes from 128 on have one.
const FIRST: u32 = 0xF700;

/// The byte that a character encodes.
fn byte_of(c: char) -> Option<u8> {
    u8::try_from(u32::from(c).wrapping_sub(FIRST)).ok().filter(|&byte| byte >= 0x80)
}

/// Decodes a text to its path.
pub fn path_of(text: &str) -> PathBuf {
    if !text.chars().any(|c| byte_of(c).is_some()) {
        return text.into();
    }
    let mut bytes = Vec::with_capacity(text.len());
    for c in text.chars() {
        match byte_of(c) {
            Some(byte) => bytes.push(byte),
            None => bytes.extend(c.encode_utf8(&mut [0; 4]).bytes()),
        }
    }
    #[cfg(unix)]
    return std::ffi::OsString::from_vec(bytes).into();
    #[cfg(not(unix))]
    return String::from_utf8_lossy(&bytes).into_owned().into();
}

/// Encodes a path as text: the inverse of [`path_of`].
pub fn text_of(path: &Path) -> Cow<'_, str> {
    if let Some(text) = path.to_str()
        && !text.chars().any(|c| byte_of(c).is_some())
    {
        return text.into();
    }
    let mut text = String::new();
    for chunk in path.as_os_str().as_encoded_bytes().utf8_chunks() {
        for c in chunk.valid().chars() {
            match byte_of(c) {
                Some(_) => text.extend(c.encode_utf8(&mut [0; 4]).bytes().map(character)),
                None => text.push(c),
            }
        }
        text.extend(chunk.invalid().iter().copied().map(character));
    }
    text.into()
}

fn character(byte: u8) -> char {
    char::from_u32(FIRST + u32::from(byte)).expect("a private character")
}

#[cfg(all(test, unix))]
mod tests {
    use std::{ffi::OsStr, os::unix::ffi::OsStrExt};

    use super::*;
    use crate::random::{Purpose, Stream};

    #[test]
    fn every_path_survives_the_round_trip() {
        let private = "caf\u{f7e9}".as_bytes();
        let mut names: Vec<Vec<u8>> =
            vec![b"caf\xe9.hdr".to_vec(), "caf\u{e9}.hdr".into(), private.to_vec(), Vec::new()];
        let mut random = Stream::new(3, Purpose::Test, 0);
        names.extend((0..500).map(|_| (0..12).map(|_| 1 + (255.0 * random.uniform()) as u8).collect()));
        // Bytes of characters of the private range, whole and truncated.
        names.extend((0..6).map(|k| [&private[..private.len() - k % 4], b"\xff", private].concat()));
        for name in names {
            let path = Path::new(OsStr::from_bytes(&name));
            let text = text_of(path);
            assert_eq!(path_of(&text), path, "{text}");
        }
    }

    #[test]
    fn unicode_names_are_unchanged() {
        for name in ["studio", "a b/\u{e9}\u{4e2d}.exr", "C:\\maps"] {
            assert_eq!(text_of(Path::new(name)), name);
            assert_eq!(path_of(name), Path::new(name));
        }
    }
}
