//! Selection of the channels of an OpenEXR file that form its picture.

use exr::meta::header::Header;

use crate::remark::Remark;

/// The channels of an image's colours.
pub(super) struct Source {
    /// The part of the file.
    pub part: usize,
    /// Indices of the red, green and blue channels; three times the same index for luminance; RY, Y and BY
    /// for luminance and chroma.
    pub rgb: [usize; 3],
    pub has_chroma: bool,
}

/// Channels of a part with a common prefix.
struct Layer {
    part: usize,
    /// The prefix without its dot, after the part's name if there are several parts; empty for channels
    /// without prefix.
    name: String,
    rgb: Option<[usize; 3]>,
    luminance: Option<usize>,
    /// RY and BY.
    chroma: [Option<usize>; 2],
}

/// Names of layers that hold the whole picture, in lower case.
const PICTURES: [&str; 10] =
    ["combined", "beauty", "rgba", "rgb", "color", "colour", "composite", "image", "main", "final"];

/// Parts of names of layers that hold data instead of light, in lower case.
const DATA: [&str; 16] = [
    "normal",
    "ambientocclusion",
    "ambient_occlusion",
    "position",
    "depth",
    "mist",
    "vector",
    "velocity",
    "motion",
    "shadow",
    "crypto",
    "index",
    "denoising",
    "albedo",
    "diffcol",
    "glosscol",
];

/// Whole names of layers that hold data instead of light.
const DATA_NAMES: [&str; 8] = ["ao", "n", "p", "z", "uv", "st", "transcol", "id"];

/// Priority of a layer as the picture; the least is chosen.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Rank {
    Plain,
    Picture,
    Color,
    PlainLuminance,
    Luminance,
}

impl Layer {
    /// The last part of the name, in lower case.
    fn last(&self) -> String {
        self.name.rsplit('.').next().unwrap_or_default().to_lowercase()
    }

    /// The priority; `None` for layers that are only read on request.
    fn rank(&self) -> Option<Rank> {
        let last = self.last();
        let is_picture = PICTURES.contains(&&*last) || ["combined", "beauty"].iter().any(|word| last.contains(word));
        let is_data = DATA_NAMES.contains(&&*last) || DATA.iter().any(|word| last.contains(word));
        match (self.rgb.is_some(), self.luminance.is_some()) {
            (true, _) if self.name.is_empty() => Some(Rank::Plain),
            (true, _) if is_picture => Some(Rank::Picture),
            (_, true) if self.name.is_empty() => Some(Rank::PlainLuminance),
            _ if is_data => None,
            (true, _) => Some(Rank::Color),
            (false, true) => Some(Rank::Luminance),
            (false, false) => None,
        }
    }

    /// The error is a clause.
    fn source(&self) -> Result<Source, String> {
        let (rgb, has_chroma) = match (self.rgb, self.luminance, self.chroma) {
            (Some(rgb), ..) => (rgb, false),
            (None, Some(y), [None, None]) => ([y; 3], false),
            (None, Some(y), [Some(red), Some(blue)]) => ([red, y, blue], true),
            (None, Some(_), _) => return Err("of the chroma channels RY and BY, one is missing".into()),
            (None, None, _) => return Err(format!("the layer '{}' has neither R, G and B nor Y", self.name)),
        };
        Ok(Source { part: self.part, rgb, has_chroma })
    }
}

/// Finds the picture: the layer called `wanted` (or whose name ends with it), else R, G and B without a
/// layer, then layers with names of whole pictures, then the first layer of colours, then luminance.
/// The error is a clause.
pub(super) fn choose(headers: &[Header], wanted: Option<&str>) -> Result<(Source, Option<Remark>), String> {
    let layers = layers(headers);
    if let Some(wanted) = wanted {
        return named(&layers, wanted)?.source().map(|source| (source, None));
    }
    let ranked = layers.iter().filter_map(|layer| Some((layer.rank()?, layer)));
    let Some((rank, chosen)) = ranked.clone().min_by_key(|&(rank, _)| rank) else {
        return Err(format!("found only {}; R, G and B are needed, or Y", channel_names(headers)));
    };
    let source = chosen.source()?;
    let rivals: Vec<String> = ranked
        .filter(|&(other, _)| other == rank)
        .map(|(_, layer)| format!("'{}'", layer.name.escape_debug()))
        .collect();
    let remark = match rank {
        Rank::Plain | Rank::PlainLuminance => None,
        _ if layers.len() == 1 => None,
        Rank::Color | Rank::Luminance if rivals.len() > 1 => Some(Remark::Warning(format!(
            "read the first of the layers {}; select another by its name",
            rivals.join(", ")
        ))),
        _ => Some(Remark::Note(format!("read layer '{}'", chosen.name.escape_debug()))),
    };
    Ok((source, remark))
}

/// Finds a layer by its name, or the part of it after a dot; case is ignored.
fn named<'a>(layers: &'a [Layer], wanted: &str) -> Result<&'a Layer, String> {
    let lower = wanted.to_lowercase();
    let is_named = |layer: &&Layer| {
        let name = layer.name.to_lowercase();
        name == lower || name.ends_with(&format!(".{lower}"))
    };
    let all = || {
        let names: Vec<String> = layers.iter().map(|layer| format!("'{}'", layer.name.escape_debug())).collect();
        names.join(", ")
    };
    layers.iter().find(is_named).ok_or_else(|| format!("no layer is called '{wanted}'; there are {}", all()))
}

/// All layers in file order; channels without a layer come first in their part.
fn layers(headers: &[Header]) -> Vec<Layer> {
    let mut layers = Vec::new();
    for (part, header) in headers.iter().enumerate() {
        let names: Vec<String> = header.channels.list.iter().map(|channel| channel.name.to_string()).collect();
        let part_name = match headers.len() {
            1 => String::new(),
            _ => header.own_attributes.layer_name.as_ref().map(ToString::to_string).unwrap_or_default(),
        };
        for prefix in prefixes(&names) {
            let index = |endings: &[&str]| {
                let is_one =
                    |name: &String| endings.iter().any(|end| name.eq_ignore_ascii_case(&format!("{prefix}{end}")));
                names.iter().position(is_one)
            };
            let rgb = [["R", "red"], ["G", "green"], ["B", "blue"]].map(|endings| index(&endings));
            let rgb = if let [Some(r), Some(g), Some(b)] = rgb { Some([r, g, b]) } else { None };
            // Together with X, Y is a coordinate of a vector.
            let luminance = index(&["Y"]).filter(|_| index(&["X"]).is_none());
            let chroma = [index(&["RY"]), index(&["BY"])];
            let name = layer_name(&part_name, prefix.trim_end_matches('.'));
            layers.push(Layer { part, name, rgb, luminance, chroma });
        }
    }
    layers
}

/// A layer's name in a file of several parts; the prefix may repeat the part's name.
fn layer_name(part: &str, prefix: &str) -> String {
    match (part.is_empty(), prefix.is_empty()) {
        (true, _) => prefix.to_owned(),
        (false, true) => part.to_owned(),
        (false, false) if prefix == part || prefix.starts_with(&format!("{part}.")) => prefix.to_owned(),
        (false, false) => format!("{part}.{prefix}"),
    }
}

/// The prefixes of channel names, with their dot, in file order; the empty prefix comes first if a
/// channel has none.
fn prefixes(names: &[String]) -> Vec<&str> {
    let mut prefixes: Vec<&str> = Vec::new();
    let plain = names.iter().any(|name| !name.contains('.')).then_some("");
    for prefix in plain.into_iter().chain(names.iter().map(|name| &name[..name.rfind('.').map_or(0, |dot| dot + 1)])) {
        if !prefixes.contains(&prefix) {
            prefixes.push(prefix);
        }
    }
    prefixes
}

fn channel_names(headers: &[Header]) -> String {
    let names = headers.iter().flat_map(|header| &header.channels.list);
    let shown: Vec<String> =
        names.take(12).map(|channel| channel.name.to_string().escape_debug().to_string()).collect();
    shown.join(", ")
}
