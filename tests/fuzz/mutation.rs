//! Nearly valid inputs: a corpus with a few mutations, as a function of a seed.

use headtail_render::random::{Purpose, Stream};

/// Boundary values of sizes.
const NUMBERS: [u64; 14] = [
    0,
    1,
    0x7f,
    0xff,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x7fff_ffff_ffff_ffff,
    u64::MAX,
    // Infinite and NaN as f32, and infinite as f64.
    0x7f80_0000,
    0x7fc0_0000,
    0x7ff0_0000_0000_0000,
];
/// Words that are inserted into texts.
const WORDS: [&str; 20] = [
    "-1",
    "0",
    "1e400",
    "-1e400",
    "nan",
    "inf",
    "4294967296",
    "18446744073709551616",
    "null",
    "[]",
    "{}",
    "\"\"",
    "true",
    "..",
    ":",
    ",",
    "+",
    "\u{0}",
    "\u{1b}[2J",
    "\u{1f600}",
];
/// Maximum size of an input, which bounds repeated duplication.
const LARGEST: usize = 1 << 16;

/// A source of mutations.
pub struct Mutation(Stream);

impl Mutation {
    /// Mutations of an input.
    pub fn new(seed: u64, input: u64) -> Self {
        Self(Stream::new(seed, Purpose::Bake, input))
    }

    /// Returns a number below `end`; 0 if `end` is 0.
    pub fn below(&mut self, end: usize) -> usize {
        ((self.0.uniform() * end as f32) as usize).min(end.saturating_sub(1))
    }

    /// Returns an input of the corpus with one to six mutations.
    pub fn of(&mut self, corpus: &[Vec<u8>]) -> Vec<u8> {
        let mut bytes = corpus[self.below(corpus.len())].clone();
        for _ in 0..=self.below(6) {
            let other = &corpus[self.below(corpus.len())];
            self.change(&mut bytes, other);
            bytes.truncate(LARGEST.max(corpus.iter().map(Vec::len).max().unwrap_or(0)));
        }
        bytes
    }

    fn change(&mut self, bytes: &mut Vec<u8>, other: &[u8]) {
        // Headers and tables of contents come first.
        let reach = if self.below(2) == 0 { bytes.len().min(400) } else { bytes.len() };
        let at = self.below(reach);
        match self.below(10) {
            _ if bytes.is_empty() => bytes.extend_from_slice(other),
            0 => bytes[at] ^= 1 << self.below(8),
            1 => bytes[at] = self.below(256) as u8,
            2 => self.number(bytes, at),
            3 => bytes.truncate(at),
            4 => drop(bytes.drain(at..(at + 1 + self.below(16)).min(bytes.len()))),
            5 => {
                let part = bytes[at..(at + 1 + self.below(64)).min(bytes.len())].to_vec();
                bytes.splice(at..at, part);
            }
            6 => {
                let from = self.below(other.len());
                let part = &other[from..(from + 1 + self.below(64)).min(other.len())];
                let end = (at + part.len()).min(bytes.len());
                bytes.splice(at..end, part.iter().copied());
            }
            7 => {
                let word = WORDS[self.below(WORDS.len())].bytes();
                bytes.splice(at..at, word);
            }
            8 => self.decimal(bytes, at),
            _ => bytes[at] = bytes[at].wrapping_add(1),
        }
    }

    /// Overwrites 1, 2, 4 or 8 bytes with a number.
    fn number(&mut self, bytes: &mut [u8], at: usize) {
        let number = NUMBERS[self.below(NUMBERS.len())];
        let width = 1 << self.below(4);
        let end = (at + width).min(bytes.len());
        let text = if self.below(4) == 0 { number.to_be_bytes() } else { number.to_le_bytes() };
        bytes[at..end].copy_from_slice(&text[..end - at]);
    }

    /// Replaces the next decimal number.
    fn decimal(&mut self, bytes: &mut Vec<u8>, at: usize) {
        let is_digit = |byte: &u8| byte.is_ascii_digit();
        let Some(start) = bytes[at..].iter().position(is_digit).map(|offset| at + offset) else { return };
        let end = bytes[start..].iter().position(|byte| !is_digit(byte)).map_or(bytes.len(), |offset| start + offset);
        let word = WORDS[self.below(8)].bytes();
        bytes.splice(start..end, word);
    }
}
