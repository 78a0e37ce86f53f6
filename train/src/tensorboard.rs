//! Event files for TensorBoard: scalars by step.
//!
//! A file is a sequence of records (length, masked CRC of the length, data, masked CRC of the data), each an
//! `Event` message of `tensorflow/core/util/event.proto` in the wire format of protocol buffers. The required
//! parts of both are implemented here.

use std::{
    fs::{File, create_dir_all},
    io::{BufWriter, Write},
    path::{Path, PathBuf},
    time::{SystemTime, UNIX_EPOCH},
};

use crate::{Error, Progress, Result};

/// An event file.
pub struct TensorBoard {
    path: PathBuf,
    file: BufWriter<File>,
    has_begun: bool,
}

impl TensorBoard {
    /// Creates the folder and an event file in it.
    ///
    /// # Errors
    /// [`Error::Output`] if they cannot be written.
    pub fn create(folder: &Path) -> Result<Self> {
        let now = now();
        // The name must be new: readers follow a file from their last position.
        let name = format!("events.out.tfevents.{:010}.headtail.{}", now as u64, std::process::id());
        let path = folder.join(name);
        let create = || {
            create_dir_all(folder)?;
            File::create(&path)
        };
        let file = BufWriter::new(create().map_err(|error| output_error(folder, &error))?);
        let mut board = Self { path, file, has_begun: false };
        let mut event = Vec::new();
        double(1, now, &mut event);
        bytes(3, b"brain.Event:2", &mut event);
        board.record(&event)?;
        Ok(board)
    }

    /// Adds the scalars of a step. The first one begins a session: readers discard its step and later ones in
    /// earlier files of the folder, which an interrupted run wrote after its last checkpoint.
    ///
    /// # Errors
    /// [`Error::Output`] if the file cannot be written.
    pub fn add(&mut self, progress: &Progress) -> Result<()> {
        if !std::mem::replace(&mut self.has_begun, true) {
            let event = session_start(now(), progress.step as u64);
            self.record(&event)?;
        }
        let mut scalars =
            vec![("train/loss", f64::from(progress.loss)), ("train/learning_rate", progress.learning_rate)];
        if let Some(divergence) = progress.divergence {
            scalars.extend([
                ("validation/kl", divergence.kl),
                ("validation/log_chi_square", divergence.log_chi_square),
                ("validation/relative_variance", divergence.relative_variance),
                ("speed/samples_per_second", progress.samples_per_second),
            ]);
        }
        let mut summary = Vec::new();
        for (tag, value) in scalars.into_iter().filter(|(_, value)| value.is_finite()) {
            let mut entry = Vec::new();
            bytes(1, tag.as_bytes(), &mut entry);
            float(2, value as f32, &mut entry);
            bytes(1, &entry, &mut summary);
        }
        let mut event = Vec::new();
        double(1, now(), &mut event);
        integer(2, progress.step as u64, &mut event);
        bytes(5, &summary, &mut event);
        self.record(&event)?;
        if progress.divergence.is_some() {
            self.file.flush().map_err(|error| output_error(&self.path, &error))?;
        }
        Ok(())
    }

    fn record(&mut self, data: &[u8]) -> Result<()> {
        let length = (data.len() as u64).to_le_bytes();
        let mut write = || {
            self.file.write_all(&length)?;
            self.file.write_all(&masked_crc(&length).to_le_bytes())?;
            self.file.write_all(data)?;
            self.file.write_all(&masked_crc(data).to_le_bytes())
        };
        write().map_err(|error| output_error(&self.path, &error))
    }
}

/// Returns an event with `SessionLog.START`.
fn session_start(now: f64, step: u64) -> Vec<u8> {
    let (mut log, mut event) = (Vec::new(), Vec::new());
    integer(1, 1, &mut log);
    double(1, now, &mut event);
    integer(2, step, &mut event);
    bytes(7, &log, &mut event);
    event
}

fn output_error(path: &Path, error: &std::io::Error) -> Error {
    Error::Output { path: path.to_owned(), reason: error.to_string() }
}

/// Returns the seconds since 1970.
fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |time| time.as_secs_f64())
}

/// Encodes seven bits per byte, the lowest first.
fn varint(mut value: u64, out: &mut Vec<u8>) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn integer(field: u64, value: u64, out: &mut Vec<u8>) {
    varint(field << 3, out);
    varint(value, out);
}

fn double(field: u64, value: f64, out: &mut Vec<u8>) {
    varint(field << 3 | 1, out);
    out.extend(value.to_le_bytes());
}

fn bytes(field: u64, value: &[u8], out: &mut Vec<u8>) {
    varint(field << 3 | 2, out);
    varint(value.len() as u64, out);
    out.extend(value);
}

fn float(field: u64, value: f32, out: &mut Vec<u8>) {
    varint(field << 3 | 5, out);
    out.extend(value.to_le_bytes());
}

/// Returns the CRC as stored by the record format: rotated and shifted, since a CRC of data that contains
/// CRCs is weak.
fn masked_crc(data: &[u8]) -> u32 {
    crc32c(data).rotate_right(15).wrapping_add(0xa282_ead8)
}

/// Returns the CRC-32C (Castagnoli), bit by bit: events are few and short.
fn crc32c(data: &[u8]) -> u32 {
    let step = |crc: u32, _| (crc >> 1) ^ (0x82f6_3b78 & (crc & 1).wrapping_neg());
    !data.iter().fold(!0, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), step))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The check value of the CRC catalogue.
    #[test]
    fn the_checksum_is_crc_32c() {
        assert_eq!(crc32c(b"123456789"), 0xe306_9283);
        assert_eq!(crc32c(b""), 0);
    }

    #[test]
    fn a_session_starts_at_its_first_step() {
        // Field 1 as 64 bits, field 2 as a varint, field 7 as a message of two bytes: status START.
        let mut expected = vec![0x09];
        expected.extend(2.5_f64.to_le_bytes());
        expected.extend([0x10, 0xac, 0x02, 0x3a, 0x02, 0x08, 0x01]);
        assert_eq!(session_start(2.5, 300), expected);
    }

    /// The examples in the documentation of the protocol buffers encoding.
    #[test]
    fn fields_are_encoded_as_documented() {
        let mut out = Vec::new();
        integer(1, 150, &mut out);
        assert_eq!(out, [0x08, 0x96, 0x01]);
        out.clear();
        bytes(2, b"testing", &mut out);
        assert_eq!(out, [0x12, 0x07, 0x74, 0x65, 0x73, 0x74, 0x69, 0x6e, 0x67]);
    }
}
