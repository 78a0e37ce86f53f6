//! Lists of samplers on the command line.

use std::str::FromStr;

use headtail_render::{Error, path_text::path_of, spec::SamplerSpec};

/// SPECs separated by commas. Names of existing files may also contain commas.
#[derive(Clone, Debug)]
pub struct SamplerList(pub Vec<SamplerSpec>);

impl FromStr for SamplerList {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let parts: Vec<&str> = text.split(',').collect();
        let (mut specs, mut begin) = (Vec::new(), 0);
        while begin < parts.len() {
            // The longest text that names a file, else up to the next comma.
            let joined = |end: usize| parts[begin..end].join(",");
            let is_file = |end: &usize| names_a_file(&joined(*end));
            let end = (begin + 2..=parts.len()).rev().find(is_file).unwrap_or(begin + 1);
            specs.push(joined(end).parse()?);
            begin = end;
        }
        Ok(Self(specs))
    }
}

/// Whether the text after one of the colons before the first comma names an existing file.
fn names_a_file(spec: &str) -> bool {
    let before = spec.find(',').unwrap_or(spec.len());
    spec[..before].match_indices(':').any(|(colon, _)| path_of(&spec[colon + 1..]).exists())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_may_contain_commas() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a,b,mis").display().to_string();
        let list = |text: &str| -> Result<Vec<String>, Error> {
            Ok(text.parse::<SamplerList>()?.0.iter().map(ToString::to_string).collect())
        };
        let text = format!("mis,ris:4:direct:{file},patches");
        assert!(list(&text).unwrap_err().to_string().contains("'b'"), "no file is there");
        std::fs::write(&file, "").unwrap();
        let expected: Vec<String> = vec!["mis".into(), format!("ris:4:direct:{file}"), "patches".into()];
        assert_eq!(list(&text).unwrap(), expected);
        assert!(list("mis,").is_err() && list("").is_err());
    }
}
