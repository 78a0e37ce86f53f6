//! Reading OpenEXR files: scan lines or tiles, the largest level of mip and rip maps, 16- and 32-bit
//! floats and integers.
//!
//! [`super::layers`] chooses the channels. The image is the display window: texels outside the data
//! window are black, and data outside the display window is cropped. Luminance and chroma, and colours of
//! other spaces ([`super::color_space`]), are converted to Rec.709. Deep and subsampled images are rejected.

use std::collections::HashSet;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use exr::block::UncompressedBlock;
use exr::block::lines::LineRef;
use exr::block::reader::ChunksReader;
use exr::compression::Compression;
use exr::math::Vec2;
use exr::meta::BlockDescription;
use exr::meta::attribute::{ChannelList, EnvironmentMap, IntegerBounds, SampleType};
use exr::meta::header::Header;
use exr::prelude::f16;

use super::color_space::{INTEROP_ID, color_space};
use super::conversion::{Conversion, Transfer};
use super::layers::{self, Source};
use super::size::check_size;
use super::{Image, MapLayout, Picture, dwa};
use crate::error::{Error, Result};
use crate::remark::Remark;

/// Maximum size of a block (a tile, or rows that are compressed together), in bytes.
const MAX_BLOCK_BYTES: usize = 1 << 30;
/// Display windows of more pixels (200 MB) are accepted up to [`MAX_MARGIN`] times the pixels of the
/// data window.
const FREE_DISPLAY_PIXELS: usize = 1 << 24;
/// See [`FREE_DISPLAY_PIXELS`]; larger black margins around a crop are treated as damage.
const MAX_MARGIN: usize = 1024;

/// Reads the open `file` of `file_size` bytes; `path` is for messages, `layer` names the layer if it is
/// not the default.
pub(super) fn read(path: &Path, file: File, file_size: u64, layer: Option<&str>) -> Result<Picture> {
    let reader = exr::block::read(BufReader::new(file), false).map_err(|e| invalid(path, "header", &e))?;
    check_headers(path, reader.headers(), file_size)?;
    let chosen = layers::choose(reader.headers(), layer);
    let (source, remark) = chosen.map_err(|reason| Error::invalid(path, "channels", reason))?;
    let header = reader.headers()[source.part].clone();
    if header.deep {
        return Err(Error::invalid(path, "type", "deep images cannot be read"));
    }
    if let Some(channel) = header.channels.list.iter().find(|channel| channel.sampling != Vec2(1, 1)) {
        let reason = format!("{} is subsampled; write all channels at full resolution", channel.name);
        return Err(Error::invalid(path, "channels", reason));
    }
    let mut remarks: Vec<Remark> = remark.into_iter().collect();
    let has_chroma = source.has_chroma;
    let space = color_space(reader.headers(), source.part, &mut remarks);
    let space = space.map_err(|reason| Error::invalid(path, INTEROP_ID, reason))?;
    let matrix = space.primaries.to_rec_709().map_err(|reason| Error::invalid(path, "chromaticities", reason))?;
    let luminance = has_chroma.then(|| space.primaries.luminance().ok_or("the primaries have no luminance"));
    let luminance = luminance.transpose().map_err(|reason| Error::invalid(path, "chromaticities", reason))?;
    let conversion = Conversion { luminance, transfer: space.transfer, matrix };
    let is_half = source.rgb.iter().all(|&index| header.channels.list[index].sample_type == SampleType::F16);
    let mut decoder = Decoder {
        image: Image::black(header.layer_size.width(), header.layer_size.height()),
        source,
        channels: header.channels.clone(),
    };
    decoder.decode(path, reader)?;
    let mut image = displayed(path, decoder.image, &header, &mut remarks)?;
    if has_chroma {
        remarks.push(Remark::Note("converted luminance and chroma to colours".into()));
    }
    if matrix.is_some() || space.transfer != Transfer::Linear {
        remarks.push(Remark::Note(format!("converted colours from {} to Rec.709", space.name)));
    }
    let repair = conversion.apply(&mut image, is_half, &mut remarks);
    let layout = header.own_attributes.environment_map.map(|map| match map {
        EnvironmentMap::LatitudeLongitude => MapLayout::LatLong,
        EnvironmentMap::Cube => MapLayout::Cube,
    });
    Ok(Picture { image, layout, remarks, repair, is_converted: conversion.is_needed() })
}

/// Converts the data window to the display window.
fn displayed(path: &Path, data: Image, header: &Header, remarks: &mut Vec<Remark>) -> Result<Image> {
    let IntegerBounds { position: origin, size } = header.shared_attributes.display_window;
    let position = header.own_attributes.layer_position;
    let (width, height) = (size.width(), size.height());
    if position == origin && (width, height) == (data.width, data.height) {
        return Ok(data);
    }
    check_size(path, "displayWindow", width, height)?;
    if width * height > FREE_DISPLAY_PIXELS.max(MAX_MARGIN * data.pixels.len()) {
        let reason = format!("{width} x {height} pixels for a data window of {} x {}", data.width, data.height);
        return Err(Error::invalid(path, "displayWindow", reason));
    }
    let mut image = Image::black(width, height);
    let left = i64::from(position.x()) - i64::from(origin.x());
    let top = i64::from(position.y()) - i64::from(origin.y());
    // Columns of the data inside the display window.
    let first = (-left).clamp(0, data.width as i64) as usize;
    let last = (width as i64 - left).clamp(first as i64, data.width as i64) as usize;
    for (row, pixels) in data.pixels.chunks_exact(data.width).enumerate() {
        let y = top + row as i64;
        if first < last && (0..height as i64).contains(&y) {
            let start = y as usize * width + (left + first as i64) as usize;
            image.pixels[start..start + last - first].copy_from_slice(&pixels[first..last]);
        }
    }
    remarks.push(Remark::Note(format!(
        "placed the {}x{} data window in the {width}x{height} display window",
        data.width, data.height
    )));
    Ok(image)
}

/// A picture that is filled block by block.
struct Decoder {
    /// The data window.
    image: Image,
    source: Source,
    /// All channels of the part.
    channels: ChannelList,
}

impl Decoder {
    /// Reads all blocks of the largest level.
    fn decode<R: std::io::Read + std::io::Seek>(
        &mut self,
        path: &Path,
        reader: exr::block::reader::Reader<R>,
    ) -> Result<()> {
        let part = self.source.part;
        let chunks = reader
            .filter_chunks(false, |_, _, block| block.layer == part && block.level == Vec2(0, 0))
            .map_err(|e| invalid(path, "offset table", &e))?;
        let meta_data = chunks.meta_data().clone();
        let mut blocks_read = HashSet::new();
        for chunk in chunks {
            let chunk = chunk.map_err(|e| invalid(path, "pixels", &e))?;
            dwa::check_sizes(&meta_data.headers[chunk.layer_index], &chunk)
                .map_err(|reason| Error::invalid(path, "pixels", reason))?;
            let block = UncompressedBlock::decompress_chunk(chunk, &meta_data, false);
            let block = block.map_err(|e| invalid(path, "pixels", &e))?;
            // The table has one entry per wanted block, so none is missing if none is repeated.
            let wanted = block.index.layer == part && block.index.level == Vec2(0, 0);
            if !wanted || !blocks_read.insert((block.index.pixel_position.x(), block.index.pixel_position.y())) {
                return Err(Error::invalid(path, "offset table", "an entry leads to a block of another place"));
            }
            for line in block.lines(&self.channels) {
                store(&mut self.image, &self.source, &self.channels, &line);
            }
        }
        Ok(())
    }
}

/// Copies a row of samples of one channel to every colour that uses it.
fn store(image: &mut Image, source: &Source, channels: &ChannelList, line: &LineRef) {
    let Vec2(x, y) = line.location.position;
    let start = y * image.width + x;
    let row = &mut image.pixels[start..start + line.location.sample_count];
    for colour in 0..3 {
        if source.rgb[colour] != line.location.channel {
            continue;
        }
        let stored = row.iter_mut().map(|pixel| &mut pixel[colour]);
        match channels.list[line.location.channel].sample_type {
            SampleType::F16 => {
                let samples = line.value.as_chunks().0.iter();
                stored.zip(samples).for_each(|(to, &from)| *to = f16::from_ne_bytes(from).to_f32());
            }
            SampleType::F32 => {
                let samples = line.value.as_chunks().0.iter();
                stored.zip(samples).for_each(|(to, &from)| *to = f32::from_ne_bytes(from));
            }
            SampleType::U32 => {
                let samples = line.value.as_chunks().0.iter();
                stored.zip(samples).for_each(|(to, &from)| *to = u32::from_ne_bytes(from) as f32);
            }
        }
    }
}

/// Rejects headers that would make reading allocate or loop far beyond what the file can hold.
fn check_headers(path: &Path, headers: &[Header], file_size: u64) -> Result<()> {
    let mut blocks = 0_usize;
    for header in headers {
        let most = file_size.saturating_mul(best_ratio(header.compression));
        check_size(path, "dataWindow", header.layer_size.width(), header.layer_size.height())?;
        let block_pixels = match header.blocks {
            BlockDescription::Tiles(tiles) => tiles.tile_size.width().checked_mul(tiles.tile_size.height()),
            BlockDescription::ScanLines => {
                header.layer_size.width().checked_mul(header.compression.scan_lines_per_block())
            }
        };
        let block_bytes = block_pixels.and_then(|pixels| pixels.checked_mul(header.channels.bytes_per_pixel));
        if block_bytes.is_none_or(|bytes| bytes > MAX_BLOCK_BYTES) {
            let reason = format!("a block of pixels is larger than {MAX_BLOCK_BYTES} bytes");
            return Err(Error::invalid(path, "tiles", reason));
        }
        let pixels = header.layer_size.width() as u64 * header.layer_size.height() as u64;
        let bytes = pixels.saturating_mul(header.channels.bytes_per_pixel as u64).max(block_bytes.unwrap_or(0) as u64);
        if bytes > most {
            let reason = format!("the header declares {bytes} bytes of pixels in a file of {file_size}");
            return Err(Error::invalid(path, "dataWindow", reason));
        }
        blocks = blocks.saturating_add(header.chunk_count);
    }
    // Each block has 8 bytes in the offset table, and at least its row (4), its byte count (4) and a byte.
    let least = (blocks as u64).saturating_mul(17);
    if file_size < least {
        let reason = format!("{blocks} blocks of pixels take at least {least} bytes, the file has {file_size}");
        return Err(Error::invalid(path, "dataWindow", reason));
    }
    Ok(())
}

/// Upper bound on the bytes of pixels per byte of a file.
///
/// Deflate, used by most methods, codes 258 bytes in at least two bits: 1032
/// (<https://zlib.net/zlib_tech.html>); PXR24 first drops 25 % of each number. A run of RLE takes two
/// bytes for 128, a flat block of B44A three for 32. DWA codes 64 pixels by one coefficient before
/// deflate: a black picture of 8192 x 4096 takes about 10 kB instead of 200 MB.
fn best_ratio(compression: Compression) -> u64 {
    match compression {
        Compression::Uncompressed => 1,
        Compression::RLE | Compression::B44 | Compression::B44A => 64,
        Compression::DWAA(_) | Compression::DWAB(_) => 1 << 16,
        _ => 2048,
    }
}

fn invalid(path: &Path, field: &str, error: &exr::error::Error) -> Error {
    use exr::error::Error as Exr;
    match error {
        // The crate's message for an unexpected end of file.
        Exr::Invalid(what) if what == "reference to missing bytes" => {
            Error::invalid(path, field, "the file ends too early")
        }
        Exr::Io(e) => Error::invalid(path, field, e.to_string()),
        Exr::NotSupported(what) | Exr::Invalid(what) => Error::invalid(path, field, what.to_string()),
        Exr::Aborted => Error::invalid(path, field, "reading was aborted"),
    }
}
