//! Texts in the fonts that every reader of PDF has.

use anyhow::{Context, Result};

use super::{
    super::number::unescape,
    style::{Element, Paint},
};

/// Widths of the letters from the blank to the tilde, in thousandths of the size (Adobe's font metrics).
const HELVETICA: [u16; 95] = [
    278, 278, 355, 556, 556, 889, 667, 191, 333, 333, 389, 584, 278, 333, 278, 278, 556, 556, 556, 556, 556, 556, 556,
    556, 556, 556, 278, 278, 584, 584, 584, 556, 1015, 667, 667, 722, 722, 667, 611, 778, 722, 278, 500, 667, 556, 833,
    722, 778, 667, 778, 722, 667, 611, 722, 667, 944, 667, 667, 611, 278, 278, 278, 469, 556, 333, 556, 556, 500, 556,
    556, 278, 556, 556, 222, 222, 500, 222, 833, 556, 556, 556, 556, 333, 500, 278, 556, 500, 722, 500, 500, 500, 334,
    260, 334, 584,
];
const BOLD: [u16; 95] = [
    278, 333, 474, 556, 556, 889, 722, 238, 333, 333, 389, 584, 278, 333, 278, 278, 556, 556, 556, 556, 556, 556, 556,
    556, 556, 556, 333, 333, 584, 584, 584, 611, 975, 722, 722, 722, 722, 667, 611, 778, 722, 278, 556, 722, 611, 833,
    722, 778, 667, 778, 722, 667, 611, 722, 667, 944, 667, 667, 611, 333, 278, 333, 584, 556, 333, 556, 611, 556, 611,
    556, 333, 611, 611, 278, 278, 556, 278, 889, 611, 611, 611, 611, 389, 556, 333, 611, 556, 778, 556, 556, 500, 389,
    280, 389, 584,
];
/// Signs of the text fonts beyond ASCII, apart from those of Latin-1, with their codes and widths.
const SIGNS: [(char, u8, u16); 8] = [
    ('\u{2026}', 0x85, 1000),
    ('\u{2018}', 0x91, 222),
    ('\u{2019}', 0x92, 222),
    ('\u{201c}', 0x93, 333),
    ('\u{201d}', 0x94, 333),
    ('\u{2022}', 0x95, 350),
    ('\u{2013}', 0x96, 556),
    ('\u{2014}', 0x97, 1000),
];
/// Signs of the font Symbol.
const SYMBOLS: [(char, u8, u16); 20] = [
    ('\u{2212}', 0x2d, 549),
    ('\u{2264}', 0xa3, 549),
    ('\u{2265}', 0xb3, 549),
    ('\u{221e}', 0xa5, 713),
    ('\u{221a}', 0xd6, 549),
    ('\u{2248}', 0xbb, 549),
    ('\u{2192}', 0xae, 987),
    ('\u{221d}', 0xb5, 713),
    ('α', 0x61, 631),
    ('β', 0x62, 549),
    ('γ', 0x67, 411),
    ('δ', 0x64, 494),
    ('θ', 0x71, 521),
    ('λ', 0x6c, 549),
    ('μ', 0x6d, 576),
    ('π', 0x70, 549),
    ('σ', 0x73, 603),
    ('φ', 0x66, 521),
    ('χ', 0x63, 549),
    ('ω', 0x77, 686),
];
/// Latin-1's letters, about.
const LATIN: u16 = 556;

/// A font of the page.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Font {
    Regular,
    Bold,
    Symbol,
}

impl Font {
    /// What the page calls it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Regular => "F1",
            Self::Bold => "F2",
            Self::Symbol => "F3",
        }
    }
}

/// Letters of one font and size.
#[derive(Debug, PartialEq)]
pub struct Run {
    pub font: Font,
    pub size: f64,
    /// By how much it is lower than what is before it.
    pub raised: f64,
    codes: Vec<u8>,
    thousandths: u32,
}

impl Run {
    /// In pixels.
    pub fn width(&self) -> f64 {
        f64::from(self.thousandths) * 1e-3 * self.size
    }

    /// The letters' codes.
    pub fn hexadecimal(&self) -> String {
        self.codes.iter().map(|code| format!("{code:02x}")).collect()
    }
}

/// The runs of a text, which may hold raised parts of another size. What the fonts lack is written as its number.
///
/// # Errors
/// If there is an element in it that is not understood.
pub fn runs(words: &str, paint: &Paint) -> Result<Vec<Run>> {
    let mut runs = Vec::new();
    let (mut rest, mut raised) = (words, 0.0);
    while let Some((before, after)) = rest.split_once("<tspan") {
        add(&mut runs, before, paint.font_size, raised, paint.is_bold);
        let (tag, after) = after.split_once('>').context("a part of a text has no end")?;
        let (inside, after) = after.split_once("</tspan>").context("a part of a text has no end")?;
        let part = Element::parse(&format!("tspan{tag}"));
        add(&mut runs, inside, part.number("font-size")?, part.number("dy")?, paint.is_bold);
        // The line goes on where the part was raised to, as in SVG.
        (rest, raised) = (after, 0.0);
    }
    add(&mut runs, rest, paint.font_size, raised, paint.is_bold);
    Ok(runs)
}

fn add(runs: &mut Vec<Run>, words: &str, size: f64, mut raised: f64, is_bold: bool) {
    let first = runs.len();
    for c in unescape(words).chars() {
        let letters = match glyph(c, is_bold) {
            Some(glyph) => vec![glyph],
            None => c.escape_unicode().filter_map(|c| glyph(c, is_bold)).collect(),
        };
        for (font, code, width) in letters {
            if runs[first..].last().is_none_or(|run| run.font != font) {
                runs.push(Run { font, size, raised, codes: Vec::new(), thousandths: 0 });
                raised = 0.0;
            }
            if let Some(run) = runs.last_mut() {
                run.codes.push(code);
                run.thousandths += u32::from(width);
            }
        }
    }
}

/// Font, code and width of a letter; `None` where no font has it.
fn glyph(c: char, is_bold: bool) -> Option<(Font, u8, u16)> {
    let font = if is_bold { Font::Bold } else { Font::Regular };
    let widths = if is_bold { &BOLD } else { &HELVETICA };
    match c {
        ' '..='~' => Some((font, c as u8, widths[c as usize - 32])),
        '\u{d7}' => Some((font, 0xd7, 584)),
        '\u{b0}' => Some((font, 0xb0, 400)),
        '\u{b2}' | '\u{b3}' | '\u{b9}' => Some((font, c as u8, 333)),
        '\u{b7}' => Some((font, 0xb7, 278)),
        '\u{a0}'..='\u{ff}' => Some((font, c as u8, LATIN)),
        _ => {
            let of = |signs: &[(char, u8, u16)], font| {
                signs.iter().find(|sign| sign.0 == c).map(|&(_, code, width)| (font, code, width))
            };
            of(&SIGNS, font).or_else(|| of(&SYMBOLS, Font::Symbol))
        }
    }
}
