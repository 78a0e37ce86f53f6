//! Opening safetensors files, with the checks that all their readers share.

use std::{collections::HashSet, fmt};

use safetensors::{SafeTensors, tensor::Metadata};
use serde::{
    Deserialize, Deserializer,
    de::{IgnoredAny, MapAccess, Visitor},
};

/// Parses the header and the tensors of a file; the error is a clause.
///
/// Duplicate keys in the header are rejected: programs differ in which of the two they use.
pub fn open(bytes: &[u8]) -> Result<(Metadata, SafeTensors<'_>), String> {
    if bytes.starts_with(b"version https://git-lfs") {
        return Err("is a Git LFS pointer; run `git lfs pull` to fetch the file".into());
    }
    let (length, metadata) = SafeTensors::read_metadata(bytes).map_err(|error| error.to_string())?;
    // The first eight bytes are the length of the header.
    if let Some(header) = bytes.get(8..8 + length) {
        serde_json::from_slice::<UniqueKeys>(header).map_err(|error| error.to_string())?;
    }
    let tensors = SafeTensors::deserialize(bytes).map_err(|error| error.to_string())?;
    Ok((metadata, tensors))
}

/// An object without duplicate keys, at its first level and in `__metadata__`.
struct UniqueKeys;

impl<'de> Deserialize<'de> for UniqueKeys {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Keys;
        impl<'de> Visitor<'de> for Keys {
            type Value = UniqueKeys;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<UniqueKeys, A::Error> {
                let mut seen = HashSet::new();
                while let Some(key) = map.next_key::<String>()? {
                    if key == "__metadata__" {
                        map.next_value::<UniqueKeys>()?;
                    } else {
                        map.next_value::<IgnoredAny>()?;
                    }
                    if let Some(key) = seen.replace(key) {
                        return Err(serde::de::Error::custom(format!("it has the key '{}' twice", key.escape_debug())));
                    }
                }
                Ok(UniqueKeys)
            }
        }
        deserializer.deserialize_map(Keys)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file with a header and `bytes` zero bytes.
    fn file(header: &str, bytes: usize) -> Vec<u8> {
        let header = header.as_bytes();
        [&(header.len() as u64).to_le_bytes()[..], header, &vec![0; bytes]].concat()
    }

    const TENSOR: &str = r#"{"dtype":"F32","shape":[1],"data_offsets":[0,4]}"#;

    #[test]
    fn headers_in_any_order_and_with_spaces_are_read() {
        let pretty =
            format!("{{\n  \"a\": {TENSOR},\n  \"__metadata__\": {{ \"headtail\": \"x\", \"other\": \"y\" }}\n}}   ");
        let bytes = file(&pretty, 4);
        let (metadata, tensors) = open(&bytes).unwrap();
        assert_eq!(metadata.metadata().as_ref().unwrap()["headtail"], "x");
        assert_eq!(tensors.tensor("a").unwrap().shape(), [1]);
    }

    #[test]
    fn duplicate_keys_are_rejected() {
        for header in [
            format!(r#"{{"a":{TENSOR},"a":{TENSOR}}}"#),
            format!(r#"{{"a":{TENSOR},"__metadata__":{{"headtail":"x","headtail":"y"}}}}"#),
            format!(r#"{{"a":{TENSOR},"__metadata__":{{}},"__metadata__":{{}}}}"#),
        ] {
            let bytes = file(&header, 4);
            let error = open(&bytes).err().unwrap();
            assert!(error.contains("twice") || error.contains("duplicate"), "{error}");
        }
    }

    #[test]
    fn git_lfs_pointers_are_reported() {
        assert!(open(b"version https://git-lfs.github.com/spec/v1\n").err().unwrap().contains("Git LFS"));
    }
}
