//! The colour space of an OpenEXR file, from its header.
//!
//! As the Color Interop Forum recommends (Identifying the Color Space of OpenEXR Files, 2026),
//! `acesImageContainerFlag` takes precedence over `colorInteropID`, and that over `chromaticities`.

use exr::math::Vec2;
use exr::meta::attribute::{AttributeValue, Chromaticities, Text};
use exr::meta::header::Header;

use super::conversion::Transfer;
use super::primaries::Primaries;
use crate::remark::Remark;

/// The header field with the name of a colour space.
pub(super) const INTEROP_ID: &str = "colorInteropID";

/// A colour space and the words for it.
pub(super) struct ColorSpace {
    pub primaries: Primaries,
    pub transfer: Transfer,
    pub name: String,
}

impl ColorSpace {
    fn of(primaries: Primaries, name: &str) -> Self {
        Self { primaries, transfer: Transfer::Linear, name: name.to_owned() }
    }
}

/// Returns the colour space of a part. The error is a clause about [`INTEROP_ID`].
pub(super) fn color_space(headers: &[Header], part: usize, remarks: &mut Vec<Remark>) -> Result<ColorSpace, String> {
    let own = &headers[part];
    let chromaticities = own.shared_attributes.chromaticities.as_ref().map(primaries_of);
    let is_aces = attribute(own, "acesImageContainerFlag") == Some(&AttributeValue::I32(1));
    // A part without a name has that of the others, unless they hold data.
    let others = headers.iter().filter_map(interop_id).filter(|id| id != "data");
    let id = interop_id(own).or_else(|| others.into_iter().next());
    let named = match &id {
        Some(id) if !is_aces => named(id)?,
        _ => is_aces.then(|| ColorSpace::of(Primaries::ACES_2065_1, "ACES2065-1 (acesImageContainerFlag)")),
    };
    let id = id.map(|id| id.escape_debug().to_string());
    if let (Some(id), true) = (id.as_deref().filter(|id| *id != "lin_ap0_scene"), is_aces) {
        remarks.push(Remark::Warning(format!("ignored {INTEROP_ID} {id}: acesImageContainerFlag is set")));
    }
    let Some(named) = named else {
        let stated = chromaticities.filter(|_| id.as_deref() != Some("data"));
        if let Some(id) = id {
            let instead = if stated.is_some() { "by their chromaticities" } else { "as linear Rec.709" };
            remarks.push(Remark::Warning(format!("{INTEROP_ID} {id} names no known colours: read {instead}")));
        }
        return Ok(ColorSpace::of(stated.unwrap_or(Primaries::REC_709), "the primaries of the file"));
    };
    if chromaticities.is_some_and(|stated| !stated.is_near(&named.primaries)) {
        remarks
            .push(Remark::Warning(format!("ignored the chromaticities of the file: they differ from {}", named.name)));
    }
    Ok(named)
}

/// Returns the colour space of a name of the Color Interop Forum, `CURVE_PRIMARIES_scene` or
/// `CURVE_PRIMARIES_display`; `None` for other names.
fn named(id: &str) -> Result<Option<ColorSpace>, String> {
    let mut words = id.split('_');
    let (Some(curve), Some(colors), Some("scene" | "display"), None) =
        (words.next(), words.next(), words.next(), words.next())
    else {
        return Ok(None);
    };
    let primaries = match colors {
        "rec709" => Primaries::REC_709,
        "rec2020" => Primaries::REC_2020,
        "p3d65" => Primaries::P3_D65,
        "adobergb" => Primaries::ADOBE_RGB,
        "ap0" => Primaries::ACES_2065_1,
        "ap1" => Primaries::ACES_CG,
        "ciexyzd65" | "xyzd65" => Primaries::XYZ,
        _ => return Ok(None),
    };
    let transfer = match curve {
        "lin" => Transfer::Linear,
        "srgb" | "srgbe" => Transfer::Srgb,
        "g18" => Transfer::Power(1.8),
        // Adobe RGB (1998), 4.3.4.2.
        "g22" if colors == "adobergb" => Transfer::Power(563.0 / 256.0),
        "g22" => Transfer::Power(2.2),
        "g24" => Transfer::Power(2.4),
        "g26" => Transfer::Power(2.6),
        "pq" | "hlg" => return Err(format!("{id}: values on the {curve} curve cannot be read; write linear ones")),
        _ => return Ok(None),
    };
    Ok(Some(ColorSpace { primaries, transfer, name: format!("{id} ({INTEROP_ID})") }))
}

fn interop_id(header: &Header) -> Option<String> {
    match attribute(header, INTEROP_ID)? {
        AttributeValue::Text(text) => Some(text.to_string()),
        _ => None,
    }
}

fn attribute<'a>(header: &'a Header, name: &str) -> Option<&'a AttributeValue> {
    let name = Text::new_or_none(name)?;
    header.own_attributes.other.get(&name).or_else(|| header.shared_attributes.other.get(&name))
}

fn primaries_of(chromaticities: &Chromaticities) -> Primaries {
    let of = |Vec2(x, y): Vec2<f32>| [f64::from(x), f64::from(y)];
    let Chromaticities { red, green, blue, white } = *chromaticities;
    Primaries { colors: [of(red), of(green), of(blue)], white: of(white) }
}
