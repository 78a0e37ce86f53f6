//! Maps in files, and the settings that can follow their names.

use std::{fmt, path::Path};

use super::{BUILT_IN_NAMES, Environment, built_in};
use crate::{
    error::{Error, Result},
    image::{MapLayout, Picture, read_picture},
    path_text::path_of,
    remark::Remark,
};

/// A map by name: a built-in one, or a file with optional settings.
///
/// Written `FILE`, or `FILE#layout=cross,layer=beauty` with one or both settings. An existing file
/// whose name is the whole text takes precedence.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MapSpec {
    /// The name of a built-in map, or a path as in [`crate::path_text`].
    pub name: String,
    /// The layout of directions in the picture; by default the file's, else latitude-longitude.
    pub layout: Option<MapLayout>,
    /// The layer of an OpenEXR file; see [`read_picture`].
    pub layer: Option<String>,
}

impl MapSpec {
    /// Parses a text.
    ///
    /// # Errors
    /// [`Error::Argument`] if the text after `#` is neither a layout nor a layer.
    pub fn parse(text: &str) -> Result<Self> {
        let mut spec = Self { name: text.to_owned(), ..Self::default() };
        let Some((name, settings)) = text.rsplit_once('#') else { return Ok(spec) };
        if path_of(text).exists() {
            return Ok(spec);
        }
        spec.name = name.to_owned();
        for setting in settings.split(',') {
            let wrong = |reason: String| Error::argument(format!("environment '{text}'"), reason);
            match setting.split_once('=') {
                Some(("layout", layout)) => {
                    spec.layout = Some(layout.parse().map_err(|reason| wrong(format!("layout '{layout}': {reason}")))?);
                }
                Some(("layer", layer)) if !layer.is_empty() => spec.layer = Some(layer.to_owned()),
                _ => return Err(wrong(format!("'{setting}' is neither layout=NAME nor layer=NAME"))),
            }
        }
        Ok(spec)
    }

    fn is_file_alone(&self) -> bool {
        self.layout.is_none() && self.layer.is_none()
    }
}

impl fmt::Display for MapSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let layout = self.layout.map(|layout| format!("layout={layout}"));
        let layer = self.layer.as_ref().map(|layer| format!("layer={layer}"));
        let settings: Vec<String> = layout.into_iter().chain(layer).collect();
        match settings.is_empty() {
            true => f.write_str(&self.name),
            false => write!(f, "{}#{}", self.name, settings.join(",")),
        }
    }
}

impl Environment {
    /// Opens a built-in environment by name, or else a map from a file; see [`MapSpec`] for the syntax.
    ///
    /// # Errors
    /// The name is neither, or the file is invalid; see [`Self::load`].
    pub fn open(name_or_path: &str) -> Result<Self> {
        let spec = MapSpec::parse(name_or_path)?;
        if let Some(environment) = built_in(&spec.name) {
            return match spec.is_file_alone() {
                true => Ok(environment),
                false => Err(Error::argument(
                    format!("environment '{name_or_path}'"),
                    "built-in maps have no layers and one layout",
                )),
            };
        }
        let path = &path_of(&spec.name);
        if !path.exists() {
            let names = BUILT_IN_NAMES.join(", ");
            return Err(Error::argument(
                format!("environment '{}'", spec.name),
                format!("there is no such file; name a .hdr or .exr file or one of {names}"),
            ));
        }
        Self::load(path, &spec)
    }

    /// Reads a Radiance .hdr or OpenEXR map with the layout and layer of a spec.
    ///
    /// # Errors
    /// The file is not such an image, is damaged, has a size that does not match its layout, or holds
    /// no light.
    pub fn load(path: &Path, spec: &MapSpec) -> Result<Self> {
        let Picture { image, layout, mut remarks, repair, .. } = read_picture(path, spec.layer.as_deref())?;
        let name = path.file_stem().map_or_else(|| "map".into(), |stem| stem.to_string_lossy().into_owned());
        let (width, height) = (image.width, image.height);
        let (own, asked) = (layout, spec.layout);
        if let Some(layout) = asked.or(own).filter(|&layout| layout != MapLayout::LatLong) {
            remarks.push(Remark::Note(format!("converted {width}x{height} pixels from layout {layout}")));
        } else if own.or(asked).is_none() && width != 2 * height {
            remarks.push(Remark::Note(format!(
                "read {width}x{height} pixels as a latitude-longitude map although their aspect is not 2:1; layouts are {}",
                MapLayout::names().collect::<Vec<_>>().join(", ")
            )));
        }
        let environment = Self::repaired(&name, image, asked.or(own).unwrap_or_default(), &repair);
        let mut environment = environment.map_err(|error| match error {
            Error::Argument { what, reason } if what == "layout" => Error::invalid(path, what, reason),
            Error::Argument { reason, .. } => Error::invalid(path, "pixels", reason),
            other => other,
        })?;
        environment.remarks.splice(0..0, remarks);
        Ok(environment)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn specs_round_trip() {
        for text in ["studio", "a b.exr", "a.exr#layout=cube", "a#b.exr#layer=View.Combined", "x#layout=cross,layer=y"]
        {
            assert_eq!(MapSpec::parse(text).unwrap().to_string(), text);
        }
        let spec = MapSpec::parse("a#b.exr#layer=N").unwrap();
        assert_eq!((spec.name.as_str(), spec.layer.as_deref()), ("a#b.exr", Some("N")));
        for (wrong, said) in [("a.exr#", "''"), ("a.exr#layout=sphere", "equal-area"), ("a.exr#cube", "'cube'")] {
            let error = MapSpec::parse(wrong).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
        assert!(Environment::open("studio#layout=cube").unwrap_err().to_string().contains("built-in"));
    }
}
