//! Checks of the sizes in DWA blocks of OpenEXR files, which the decoder allocates without limits.

use exr::block::chunk::{Chunk, CompressedBlock};
use exr::compression::Compression;
use exr::meta::header::Header;

/// The counters at the start of a block, 8 bytes each (`DataSizesSingle` in OpenEXR's
/// `internal_dwa_compressor.h`).
const COUNTERS: usize = 11;

/// Checks that a block states no size above what its pixels can need; the error names the size.
///
/// Blocks of other compressions, and damaged ones that the decoder rejects itself, pass.
pub(super) fn check_sizes(header: &Header, chunk: &Chunk) -> Result<(), String> {
    if !matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_)) {
        return Ok(());
    }
    let bytes = match &chunk.compressed_block {
        CompressedBlock::ScanLine(block) => &block.compressed_pixels_le,
        CompressedBlock::Tile(block) => &block.compressed_pixels_le,
        CompressedBlock::DeepScanLine(_) | CompressedBlock::DeepTile(_) => return Ok(()),
    };
    // Shorter blocks have no counters; the decoder rejects them.
    let Some(counters) = bytes.as_chunks::<8>().0.first_chunk::<COUNTERS>() else { return Ok(()) };
    let counters = counters.map(u64::from_le_bytes);

    let size = header.max_block_pixel_size();
    let raw = header.max_block_byte_size() as u64;
    let cosine_blocks = (size.width().div_ceil(8) * size.height().div_ceil(8) * header.channels.list.len()) as u64;
    let limits = [
        ("bytes of other channels", counters[1], raw),
        // Runs and literals take at most two bytes per decoded byte.
        ("bytes of run lengths", counters[6], 2 * raw),
        ("bytes of run-length coded channels", counters[7], raw),
        ("AC coefficients", counters[8], 64 * cosine_blocks),
        ("DC coefficients", counters[9], cosine_blocks),
    ];
    for (what, stated, most) in limits {
        if stated > most {
            return Err(format!("a DWA block states {stated} {what}; its pixels have at most {most}"));
        }
    }
    Ok(())
}
