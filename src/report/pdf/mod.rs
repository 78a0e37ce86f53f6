//! Drawings as PDF files of one page: what LaTeX takes as it is.
//!
//! Only what [`super::vector::Drawing`] writes is understood: groups, paths, rectangles, circles, texts and pictures, styled by classes. That is a
//! twentieth of SVG, so that no library of SVG and fonts is needed: texts are in the fonts that every reader of PDF has (Helvetica and Symbol), whatever
//! is installed.

mod document;
mod font;
mod path;
mod style;

use anyhow::{Context, Result, bail};
use base64::Engine;

use document::Document;
use font::Run;
use style::{Element, Paint, Sheet};

/// Points to a pixel: 72 against 96 to an inch.
const POINTS: f64 = 0.75;

/// The PDF of a drawing's SVG file ([`super::vector::Drawing::file`]).
///
/// # Errors
/// If the drawing has something that is not understood.
pub fn pdf(svg: &str) -> Result<Vec<u8>> {
    let (style, body) =
        svg.split_once("<style>").and_then(|(_, rest)| rest.split_once("</style>")).context("no style")?;
    let head = Element::parse(svg.split_once('>').context("no drawing")?.0.trim_start_matches('<'));
    let size = [head.number("width")?, head.number("height")?];
    let mut page = Page { document: Document::default(), sheet: Sheet::parse(style), content: String::new() };
    // y runs down, in pixels.
    page.say(format_args!("{POINTS} 0 0 -{POINTS} 0 {:.2} cm", POINTS * size[1]));
    page.elements(head, body.trim_end().trim_end_matches("</svg>"))?;
    let content = page.content;
    page.document.finish(size.map(|side| side * POINTS), &content)
}

/// A page that is being written.
struct Page {
    document: Document,
    sheet: Sheet,
    content: String,
}

impl Page {
    fn say(&mut self, operators: std::fmt::Arguments) {
        use std::fmt::Write;
        writeln!(self.content, "{operators}").expect("a String takes all that is written to it");
    }

    /// The elements inside of `root`.
    fn elements(&mut self, root: Element, mut rest: &str) -> Result<()> {
        let mut open = vec![root];
        while let Some((before, after)) = rest.split_once('<') {
            if !before.trim().is_empty() {
                bail!("the text '{}' stands outside of texts", before.trim());
            }
            let (tag, after) = after.split_once('>').context("an element has no end")?;
            rest = after;
            if let Some(name) = tag.strip_prefix('/') {
                let closed = open.pop().context("an element is closed that is not open")?;
                anyhow::ensure!(closed.name == name && !open.is_empty(), "</{name}> closes <{}>", closed.name);
                continue;
            }
            let element = Element::parse(tag.trim_end_matches('/'));
            match &*element.name {
                "g" => open.push(element),
                "title" => rest = rest.split_once("</title>").context("a title has no end")?.1,
                "text" => {
                    let (words, after) = rest.split_once("</text>").context("a text has no end")?;
                    rest = after;
                    let paint = self.sheet.paint(&open, &element)?;
                    self.text(&element, &paint, words)?;
                }
                "image" => self.image(&element)?,
                _ => {
                    let outline = path::outline(&element)?;
                    let paint = self.sheet.paint(&open, &element)?;
                    self.shape(&paint, &outline);
                }
            }
        }
        anyhow::ensure!(open.len() == 1 && rest.trim().is_empty(), "an element is not closed");
        Ok(())
    }

    fn shape(&mut self, paint: &Paint, outline: &str) {
        let operator = match (paint.fill.is_some(), paint.stroke.is_some()) {
            (true, true) => "B",
            (true, false) => "f",
            (false, true) => "S",
            (false, false) => return,
        };
        let state = self.document.opacity(paint.opacity);
        let mut lines = format!("q /{state} gs {} w {} j", paint.stroke_width, if paint.is_round { 1 } else { 0 });
        if let Some([r, g, b]) = paint.fill {
            lines += &format!(" {r:.3} {g:.3} {b:.3} rg");
        }
        if let Some([r, g, b]) = paint.stroke {
            lines += &format!(" {r:.3} {g:.3} {b:.3} RG [{}] 0 d", paint.dashes);
        }
        self.say(format_args!("{lines}\n{outline}{operator} Q"));
    }

    fn text(&mut self, element: &Element, paint: &Paint, words: &str) -> Result<()> {
        let Some([r, g, b]) = paint.fill else { return Ok(()) };
        let runs = font::runs(words, paint)?;
        let width: f64 = runs.iter().map(Run::width).sum();
        let shift = match element.get("text-anchor") {
            Some("middle") => -0.5 * width,
            Some("end") => -width,
            _ => 0.0,
        };
        let state = self.document.opacity(paint.opacity);
        self.say(format_args!("q /{state} gs {r:.3} {g:.3} {b:.3} rg"));
        match element.get("transform") {
            Some(transform) => {
                let [x, y, angle] = path::numbers(transform)[..] else {
                    bail!("the transform '{transform}' is unknown")
                };
                let (sin, cos) = angle.to_radians().sin_cos();
                self.say(format_args!("{cos:.4} {sin:.4} {:.4} {cos:.4} {x:.2} {y:.2} cm", -sin));
            }
            None => self.say(format_args!("1 0 0 1 {:.2} {:.2} cm", element.number("x")?, element.number("y")?)),
        }
        let mut x = shift;
        let mut y = element.get("dy").map_or(Ok(0.0), str::parse)?;
        for run in &runs {
            y += run.raised;
            let (font, size) = (run.font.name(), run.size);
            self.say(format_args!("BT /{font} {size} Tf 1 0 0 -1 {x:.2} {y:.2} Tm <{}> Tj ET", run.hexadecimal()));
            x += run.width();
        }
        self.say(format_args!("Q"));
        Ok(())
    }

    fn image(&mut self, element: &Element) -> Result<()> {
        let address = element.get("href").and_then(|address| address.strip_prefix("data:image/png;base64,"));
        let png = base64::engine::general_purpose::STANDARD.decode(address.context("a picture is no PNG")?)?;
        let name = self.document.picture(&png)?;
        let [x, y, width, height] = ["x", "y", "width", "height"].map(|name| element.number(name));
        // A picture fills the unit square, upwards.
        let (height, y) = (height?, y?);
        self.say(format_args!("q {} 0 0 -{height} {} {} cm /{name} Do Q", width?, x?, y + height));
        Ok(())
    }
}

#[cfg(test)]
mod tests;
