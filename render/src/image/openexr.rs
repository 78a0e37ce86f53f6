//! Reading OpenEXR files: scan lines or tiles, the largest level of mip and rip maps, 16- and 32-bit floats and integers.
//!
//! The first layer with channels R, G and B is taken, be they called so or with a layer prefix (`beauty.R`); failing
//! that, the first with a luminance channel Y, as grey. The image is the data window. Deep and subsampled images are
//! refused.

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
use exr::meta::attribute::{ChannelList, SampleType};
use exr::meta::header::Header;
use exr::prelude::f16;

use super::size::check_size;
use super::{Image, dwa};
use crate::error::{Error, Result};

/// The first bytes of every OpenEXR file.
pub(super) const MAGIC: &[u8] = &exr::meta::magic_number::BYTES;

/// The largest block (tile, or rows that are compressed together) that is read, in bytes.
const MAX_BLOCK_BYTES: usize = 1 << 30;

/// Reads the open `file` of `file_size` bytes; `path` is for the messages.
pub(super) fn read(path: &Path, file: File, file_size: u64) -> Result<Image> {
    let reader = exr::block::read(BufReader::new(file), false).map_err(|e| invalid(path, "header", &e))?;
    check_headers(path, reader.headers(), file_size)?;
    let source = choose_channels(path, reader.headers())?;
    let header = &reader.headers()[source.layer];
    if header.deep {
        return Err(Error::invalid(path, "type", "deep images cannot be read"));
    }
    if header.channels.list.iter().any(|channel| channel.sampling != Vec2(1, 1)) {
        return Err(Error::invalid(path, "channels", "subsampled channels cannot be read"));
    }
    let (channels, size) = (header.channels.clone(), header.layer_size);
    let mut image = Image::black(size.width(), size.height());

    let chunks = reader
        .filter_chunks(false, |_, _, block| block.layer == source.layer && block.level == Vec2(0, 0))
        .map_err(|e| invalid(path, "offset table", &e))?;
    let meta_data = chunks.meta_data().clone();
    let mut blocks_read = HashSet::new();
    for chunk in chunks {
        let chunk = chunk.map_err(|e| invalid(path, "pixels", &e))?;
        dwa::check_sizes(&meta_data.headers[chunk.layer_index], &chunk)
            .map_err(|reason| Error::invalid(path, "pixels", reason))?;
        let block = UncompressedBlock::decompress_chunk(chunk, &meta_data, false);
        let block = block.map_err(|e| invalid(path, "pixels", &e))?;
        // The table has one entry for each block that is wanted, so that none is missing if none comes twice.
        let wanted = block.index.layer == source.layer && block.index.level == Vec2(0, 0);
        if !wanted || !blocks_read.insert((block.index.pixel_position.x(), block.index.pixel_position.y())) {
            return Err(Error::invalid(path, "offset table", "an entry leads to a block of another place"));
        }
        for line in block.lines(&channels) {
            store(&mut image, &source, &channels, &line);
        }
    }
    Ok(image)
}

/// Where the colours of an image are: the layer, and the index of the channel of each colour.
struct Source {
    layer: usize,
    rgb: [usize; 3],
}

/// Copies a row of samples of one channel to every colour that is read from it.
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

/// Refuses what would make reading allocate, or loop, far beyond what the file can hold.
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
            let reason = format!("pixels of {bytes} bytes are promised by a file of {file_size}");
            return Err(Error::invalid(path, "dataWindow", reason));
        }
        blocks = blocks.saturating_add(header.chunk_count);
    }
    // Each block has 8 bytes in the offset table, then at least its row (4), its byte count (4) and a byte.
    let least = (blocks as u64).saturating_mul(17);
    if file_size < least {
        let reason = format!("{blocks} blocks of pixels take at least {least} bytes, the file has {file_size}");
        return Err(Error::invalid(path, "dataWindow", reason));
    }
    Ok(())
}

/// How many bytes of pixels a byte of a file can stand for.
///
/// Deflate, inside of most methods, codes 258 bytes by two bits at best: 1032 (<https://zlib.net/zlib_tech.html>); PXR24 leaves out a quarter
/// of each number before. A run of RLE takes two bytes
/// for 128, a flat block of B44A three for 32. DWA codes 64 pixels by one coefficient before deflate: a black picture of 8192 x 4096 takes
/// some 10 kB of 200 MB.
fn best_ratio(compression: Compression) -> u64 {
    match compression {
        Compression::Uncompressed => 1,
        Compression::RLE | Compression::B44 | Compression::B44A => 64,
        Compression::DWAA(_) | Compression::DWAB(_) => 1 << 16,
        _ => 2048,
    }
}

/// Finds the channels to read; R, G and B of any layer come before Y of any layer.
fn choose_channels(path: &Path, headers: &[Header]) -> Result<Source> {
    let names: Vec<Vec<String>> = headers
        .iter()
        .map(|header| header.channels.list.iter().map(|channel| channel.name.to_string()).collect())
        .collect();
    let find = |wanted: &[&str; 3]| {
        names.iter().enumerate().find_map(|(layer, names)| {
            prefixes(names).into_iter().find_map(|prefix| {
                let index = |colour: &str| {
                    names.iter().position(|name| name.eq_ignore_ascii_case(&format!("{prefix}{colour}")))
                };
                Some(Source { layer, rgb: [index(wanted[0])?, index(wanted[1])?, index(wanted[2])?] })
            })
        })
    };
    find(&["R", "G", "B"]).or_else(|| find(&["Y", "Y", "Y"])).ok_or_else(|| {
        let found: Vec<_> = names.iter().flatten().take(12).map(|name| name.escape_debug().to_string()).collect();
        let reason = format!("found only {}; R, G and B are needed, or Y", found.join(", "));
        Error::invalid(path, "channels", reason)
    })
}

/// The layer prefixes of channel names, with their dot, in order of appearance; no prefix comes first.
fn prefixes(names: &[String]) -> Vec<&str> {
    let mut prefixes = vec![""];
    for name in names {
        let prefix = &name[..name.rfind('.').map_or(0, |dot| dot + 1)];
        if !prefixes.contains(&prefix) {
            prefixes.push(prefix);
        }
    }
    prefixes
}

fn invalid(path: &Path, field: &str, error: &exr::error::Error) -> Error {
    use exr::error::Error as Exr;
    match error {
        // The crate's words for an unexpected end of file.
        Exr::Invalid(what) if what == "reference to missing bytes" => {
            Error::invalid(path, field, "the file ends too early")
        }
        Exr::Io(e) => Error::invalid(path, field, e.to_string()),
        Exr::NotSupported(what) | Exr::Invalid(what) => Error::invalid(path, field, what.to_string()),
        Exr::Aborted => Error::invalid(path, field, "reading was aborted"),
    }
}
