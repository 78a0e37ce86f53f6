//! Rejected input: truncated, damaged and inconsistent files, and paths that are not regular files.

use super::{openexr::*, *};

#[test]
fn invalid_maps_are_rejected_with_one_line_that_names_file_and_field() {
    let folder = tempfile::tempdir().unwrap();
    let message = |name: &str, bytes: &[u8]| {
        let error = read_radiance(&write(folder.path(), name, bytes)).unwrap_err().to_string();
        assert!(error.contains(name) && !error.contains('\n'), "{error}");
        error
    };
    assert!(message("empty.hdr", b"").contains("the file is empty"));
    assert!(message("text.hdr", b"hello, world").contains("first bytes"));
    assert!(message("short.exr", &[0x76, 0x2f, 0x31]).contains("first bytes"));
    assert!(message("magic.exr", &[0x76, 0x2f, 0x31, 0x01]).contains("header: the file ends too early"));
    assert!(message("magic.hdr", b"#?RADIANCE").contains("header"));
    assert!(message("size.hdr", &hdr_file(0, 4, &[])).contains("dimensions: 0 x 4 pixels"));
    assert!(message("huge.hdr", &hdr_file(4_000_000, 1_000, &[])).contains("dimensions: 4000000 x 1000"));
    assert!(message("oversized.hdr", &hdr_file(8192, 4096, &[])).contains("take at least 49152 bytes"));
    assert!(message("cut.hdr", &hdr_file(4, 4, &[[9; 4]; 15])).contains("pixels: the file ends too early"));
    assert!(message("flipped.hdr", b"#?RADIANCE\n\n+Y 2 +Y 2\n0123456789abcdef").contains("resolution"));
    let missing = read_radiance(&folder.path().join("missing.hdr")).unwrap_err();
    assert!(matches!(missing, Error::Io { .. }) && missing.to_string().contains("missing.hdr"));
    assert!(matches!(read_radiance(folder.path()), Err(Error::Io { .. })));
}

#[cfg(unix)]
#[test]
fn pipes_devices_and_folders_are_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    // The pipe has no writer: opening it would block forever.
    let pipe = folder.path().join("pipe.hdr");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    for (path, word) in [
        (pipe.as_path(), "pipe.hdr: it is a pipe or a device"),
        (Path::new("/dev/zero"), "/dev/zero: it is a pipe or a device"),
        (folder.path(), ": it is a folder"),
    ] {
        let error = read_radiance(path).unwrap_err();
        assert!(matches!(error, Error::Io { .. }) && error.to_string().contains(word), "{error}");
    }
}

/// Returns the position of a header attribute's value in a file.
fn attribute_value(bytes: &[u8], name_and_type: &[u8]) -> usize {
    let start = bytes.windows(name_and_type.len()).position(|window| window == name_and_type).unwrap();
    start + name_and_type.len() + 4
}

#[test]
fn exr_headers_with_excessive_sizes_are_rejected_before_allocation() {
    let folder = tempfile::tempdir().unwrap();
    let image = picture(16, 16);
    let files = [exr_file((16, 16), tiles(8, 8), f32_channels(&image)), encode_exr(&image, &[]).unwrap()];
    for bytes in files {
        let window = attribute_value(&bytes, b"dataWindow\0box2i\0");
        for last in [i32::MAX, i32::MAX - 1, 1 << 30, 1 << 20, 1 << 15] {
            let mut damaged = bytes.clone();
            for at in [window + 8, window + 12] {
                damaged[at..at + 4].copy_from_slice(&last.to_le_bytes());
            }
            let error = read_radiance(&write(folder.path(), "a.exr", &damaged)).unwrap_err().to_string();
            assert!(error.contains("dataWindow") || error.contains("header"), "{last}: {error}");
        }
    }
    // More than the limit, independently of the file's size.
    let mut damaged = encode_exr(&picture(16, 1), &[]).unwrap();
    let window = attribute_value(&damaged, b"dataWindow\0box2i\0");
    damaged[window + 8..window + 12].copy_from_slice(&(MAX_PIXELS as i32).to_le_bytes());
    let error = read_radiance(&write(folder.path(), "a.exr", &damaged)).unwrap_err().to_string();
    assert!(error.contains("dataWindow: 134217729 x 1 pixels"), "{error}");

    // A single tile, whose count does not change when it grows.
    let mut damaged = exr_file((16, 16), tiles(16, 16), f32_channels(&image));
    let tile = attribute_value(&damaged, b"tiles\0tiledesc\0");
    for at in [tile, tile + 4] {
        damaged[at..at + 4].copy_from_slice(&(1_i32 << 14).to_le_bytes());
    }
    let error = read_radiance(&write(folder.path(), "a.exr", &damaged)).unwrap_err().to_string();
    assert!(error.contains("tiles: a block of pixels is larger"), "{error}");
}

/// Returns small valid files of both formats in every coding.
fn small_files() -> Vec<(String, Vec<u8>)> {
    use exr::prelude::Compression::{B44, DWAA, PIZ, PXR24, RLE, Uncompressed, ZIP1, ZIP16};
    let image = picture(12, 9);
    let half = |c: usize| flat(FlatSamples::F16(channel(&image, c).iter().map(|&v| f16::from_f32(v)).collect()));
    let halves = || vec![("R", half(0)), ("G", half(1)), ("B", half(2))];
    let mut files: Vec<(String, Vec<u8>)> = [Uncompressed, RLE, ZIP1, ZIP16, PIZ, PXR24, B44, DWAA(None)]
        .into_iter()
        .map(|compression| (format!("{compression:?}"), exr_file((12, 9), scan_lines(compression), halves())))
        .collect();
    files.push(("DWA with every kind of channel".into(), dwa_file(DWAA(None)).0));
    files.push(("tiled".into(), exr_file((12, 9), tiles(5, 4), f32_channels(&image))));
    files.push(("flat hdr".into(), hdr_file(3, 2, &[[3, 4, 5, 129]; 6])));
    let pixels: Vec<_> = image.pixels.iter().map(|&pixel| image::Rgb(pixel)).collect();
    let mut coded = Vec::new();
    image::codecs::hdr::HdrEncoder::new(&mut coded).encode(&pixels, 12, 9).unwrap();
    files.push(("coded hdr".into(), coded));
    files
}

#[test]
fn files_cut_anywhere_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in small_files() {
        // Every length of small files, and 2000 of large ones.
        for length in (0..bytes.len()).step_by(1 + bytes.len() / 2000) {
            let path = write(folder.path(), "cut", &bytes[..length]);
            assert!(read_radiance(&path).is_err(), "{name} cut to {length} of {} bytes is taken as whole", bytes.len());
        }
    }
}

#[test]
fn damaged_files_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Stream::new(1, Purpose::Test, 0);
    let mut below = |bound: usize| (random.uniform() as f64 * bound as f64) as usize;
    for (name, bytes) in small_files() {
        // Sets every byte of the header region to values that break sizes and signs, then damages several
        // random bytes.
        let mut cases = Vec::new();
        for at in 0..bytes.len().min(600) {
            for value in [0, 0x7f, 0x80, 0xff] {
                cases.push(vec![(at, value)]);
            }
        }
        for _ in 0..1000 {
            cases.push((0..1 + below(4)).map(|_| (below(bytes.len()), below(256) as u8)).collect());
        }
        for case in cases {
            let mut damaged = bytes.clone();
            for &(at, value) in &case {
                damaged[at] = value;
            }
            let path = write(folder.path(), "damaged", &damaged);
            let outcome = std::panic::catch_unwind(|| read_radiance(&path).map(drop));
            assert!(outcome.is_ok(), "{name} panics with bytes {case:?}");
        }
    }
}

/// Returns a file of two DWA blocks with every kind of channel (cosines, run lengths, others), and the
/// positions of the blocks' counters.
fn dwa_file(compression: exr::prelude::Compression) -> (Vec<u8>, Vec<usize>) {
    let rows = compression.scan_lines_per_block();
    let image = picture(64, 2 * rows);
    let half = |c: usize| flat(FlatSamples::F16(channel(&image, c).iter().map(|&v| f16::from_f32(v)).collect()));
    let alpha = flat(FlatSamples::F16(vec![f16::ONE; image.pixels.len()]));
    let depth = flat(FlatSamples::F32(channel(&image, 0)));
    let channels = vec![("R", half(0)), ("G", half(1)), ("B", half(2)), ("A", alpha), ("Z", depth)];
    let bytes = exr_file((64, 2 * rows), scan_lines(compression), channels);
    let number = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
    // The first block follows the table of two offsets. A block starts with its row and its length, 4 bytes
    // each.
    let table = (8..bytes.len() - 16).find(|&at| number(at) == at + 16).unwrap();
    let counters = vec![number(table) + 8, number(table + 8) + 8];
    (bytes, counters)
}

#[test]
fn dwa_blocks_with_excessive_sizes_are_rejected_before_allocation() {
    use exr::prelude::Compression::{DWAA, DWAB};
    let folder = tempfile::tempdir().unwrap();
    for compression in [DWAA(None), DWAB(None)] {
        let (bytes, blocks) = dwa_file(compression);
        assert_eq!(read_radiance(&write(folder.path(), "a.exr", &bytes)).unwrap().width, 64);
        for start in blocks {
            // Counters 1 to 9 are sizes; 0 is the version, 10 the coding of cosines.
            for counter in 0..11 {
                for value in [0, 1, 5, 1 << 10, 1 << 20, 1 << 31, 1 << 41, i64::MAX as u64, u64::MAX] {
                    let mut damaged = bytes.clone();
                    let at = start + 8 * counter;
                    damaged[at..at + 8].copy_from_slice(&value.to_le_bytes());
                    let read = read_radiance(&write(folder.path(), "a.exr", &damaged));
                    if (1..10).contains(&counter) && value >= 1 << 20 {
                        let error = read.unwrap_err().to_string();
                        assert!(error.contains("a.exr: pixels: ") && !error.contains('\n'), "{error}");
                    }
                }
            }
        }
    }
}
