//! OpenEXR files of several layers: channels `layer.R`, `layer.G`, … of one part, which compositing programs
//! read as layers.

use std::io::Cursor;

use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Layer, LayerAttributes, SmallVec, WritableImage};

use super::{
    Attribute,
    write::{header_attributes, sort_header},
};
use crate::error::{Error, Result};

/// A channel of an image.
#[derive(Clone, Debug)]
pub struct Channel {
    /// Name, prefixed with the layer's and a dot: `shadow.R`. Simple readers show R, G, B and A without a
    /// layer.
    pub name: String,
    /// `[height * width]` values from the top left.
    pub values: Vec<f32>,
}

/// Encodes an OpenEXR file of 32-bit float channels (scan lines, ZIP).
///
/// # Errors
/// [`Error::Argument`] if a channel does not have `width * height` values, two channels have the same name,
/// or an attribute is not allowed.
pub fn encode_layered_exr(
    width: usize,
    height: usize,
    channels: Vec<Channel>,
    attributes: &[Attribute],
) -> Result<Vec<u8>> {
    let mut list: Vec<AnyChannel<FlatSamples>> = Vec::new();
    for channel in channels {
        if channel.values.is_empty() || channel.values.len() != width * height {
            let reason = format!("{} values for {width} x {height}", channel.values.len());
            return Err(Error::argument(format!("channel {}", channel.name), reason));
        }
        if list.iter().any(|known| known.name.eq(&channel.name)) {
            return Err(Error::argument(format!("channel {}", channel.name), "it is given twice"));
        }
        list.push(AnyChannel::new(channel.name.as_str(), FlatSamples::F32(channel.values)));
    }
    let header = LayerAttributes { other: header_attributes(attributes)?, ..LayerAttributes::default() };
    let channels = AnyChannels::sort(SmallVec::from_vec(list));
    let layer = Layer::new((width, height), header, Encoding::SMALL_LOSSLESS, channels);
    let mut bytes = Cursor::new(Vec::new());
    exr::prelude::Image::from_layer(layer)
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(|error| Error::argument("OpenEXR layers", error.to_string()))?;
    let mut bytes = bytes.into_inner();
    sort_header(&mut bytes);
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::read_radiance;

    fn channel(name: &str, value: f32) -> Channel {
        Channel { name: name.into(), values: (0..6).map(|k| value + k as f32).collect() }
    }

    #[test]
    fn layers_are_read_back_by_name() {
        let names = ["R", "G", "B", "object.A", "object.R", "shadow.G"];
        let channels = names.iter().enumerate().map(|(k, name)| channel(name, 10.0 * k as f32)).collect();
        let bytes = encode_layered_exr(3, 2, channels, &[Attribute::new("headtail.version", "x")]).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("layers.exr");
        std::fs::write(&path, &bytes).unwrap();
        let read = exr::prelude::read_first_flat_layer_from_file(&path).unwrap();
        let found = &read.layer_data.channel_data.list;
        assert_eq!(found.len(), names.len());
        for (k, name) in names.iter().enumerate() {
            let own = found.iter().find(|channel| channel.name.eq(name)).unwrap();
            assert_eq!(own.sample_data.values_as_f32().collect::<Vec<_>>(), channel(name, 10.0 * k as f32).values);
        }
        // Readers without layers read R, G and B.
        assert_eq!(read_radiance(&path).unwrap().pixels[0], [0.0, 10.0, 20.0]);
    }

    #[test]
    fn wrong_sizes_and_duplicate_channels_are_rejected() {
        assert!(encode_layered_exr(3, 3, vec![channel("R", 0.0)], &[]).is_err());
        assert!(encode_layered_exr(3, 2, vec![channel("R", 0.0), channel("R", 1.0)], &[]).is_err());
    }
}
