//! Vector drawings: embedded in a page, where they follow its theme, or as SVG files.

use std::{
    fmt::{Arguments, Write},
    path::Path,
};

use anyhow::Result;
use base64::Engine;
use headtail_render::file;
use maud::{Markup, PreEscaped, html};

use super::number::escape;

/// Named colours, the light theme first.
pub const PALETTE: &str = include_str!("style/palette.css");
/// Style of drawings in terms of the palette.
pub const STYLE: &str = include_str!("style/chart.css");

/// A drawing under construction, in pixels with y down.
pub struct Drawing {
    class: &'static str,
    width: f64,
    height: f64,
    label: String,
    body: String,
}

impl Drawing {
    /// An empty drawing with a label for screen readers.
    pub fn new(class: &'static str, (width, height): (f64, f64), label: impl Into<String>) -> Self {
        Self { class, width, height, label: label.into(), body: String::new() }
    }

    /// Appends raw elements; their text must be escaped.
    pub fn raw(&mut self, elements: Arguments) {
        self.body.write_fmt(elements).expect("a String takes all that is written to it");
    }

    /// Wraps the output of `draw` in a group with a class.
    pub fn group(&mut self, class: &str, draw: impl FnOnce(&mut Self)) {
        self.raw(format_args!("<g class=\"{class}\">"));
        draw(self);
        self.body.push_str("</g>");
    }

    /// Appends a path.
    pub fn path(&mut self, class: &str, d: Arguments) {
        self.raw(format_args!("<path class=\"{class}\" d=\"{d}\"/>"));
    }

    /// Appends a line of text; `anchor` is `start`, `middle` or `end`.
    pub fn text(&mut self, class: &str, anchor: &str, (x, y): (f64, f64), words: &str) {
        let words = escape(words);
        self.raw(format_args!(
            "<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{words}</text>"
        ));
    }

    /// Appends a picture from a `data:` address.
    pub fn picture(&mut self, address: &str, (x, y): (f64, f64), (width, height): (f64, f64)) {
        self.raw(format_args!(
            "<image x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" preserveAspectRatio=\"none\" \
             image-rendering=\"pixelated\" href=\"{address}\"/>"
        ));
    }

    /// Returns SVG for a page that has [`PALETTE`] and [`STYLE`].
    pub fn svg(&self) -> String {
        let Self { class, width, height, label, body } = self;
        let label = escape(label);
        format!(
            "<svg class=\"chart {class}\" viewBox=\"0 0 {width:.0} {height:.0}\" role=\"img\" aria-label=\"{label}\">{body}</svg>"
        )
    }

    /// Returns a self-contained SVG file in the colours of the light theme.
    pub fn file(&self) -> String {
        let Self { width, height, label, body, .. } = self;
        let (label, style) = (escape(label), light(STYLE));
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"chart\" width=\"{width:.0}\" height=\"{height:.0}\" \
             viewBox=\"0 0 {width:.0} {height:.0}\" role=\"img\" aria-label=\"{label}\"><style>{style}\n\
             svg {{ font-family: system-ui, Helvetica, Arial, sans-serif; background: #fff; }}</style>{body}</svg>\n"
        )
    }
}

/// Replaces colour names in a style sheet by those of the light theme.
fn light(style: &str) -> String {
    let theme = PALETTE.split('}').next().unwrap_or_default();
    let colours = theme.lines().filter_map(|line| line.trim().strip_suffix(';')?.split_once(": "));
    colours.fold(style.to_owned(), |style, (name, colour)| style.replace(&format!("var({name})"), colour))
}

/// A chart of a page: a drawing for wide windows and, where text would become too small, one for narrow
/// windows.
pub struct Chart {
    /// Stem of its file name.
    pub name: String,
    /// From narrow to wide, or a single drawing.
    pub drawings: Vec<Drawing>,
}

impl Chart {
    /// Returns the drawing for files.
    pub fn widest(&self) -> Option<&Drawing> {
        self.drawings.last()
    }

    /// Writes the chart into a folder as SVG.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        if let Some(drawing) = self.widest() {
            file::replace(&folder.join(&self.name).with_extension("svg"), drawing.file().as_bytes())?;
        }
        Ok(())
    }

    /// Returns the chart with a link that saves it; empty without drawings.
    pub fn html(&self) -> Markup {
        let Some(widest) = self.widest() else { return PreEscaped(String::new()) };
        html! {
            @for drawing in &self.drawings { (PreEscaped(drawing.svg())) }
            p.save {
                "Save " (saved(&self.name, "svg", "image/svg+xml", widest.file().as_bytes()))
            }
        }
    }
}

/// Returns a link that saves bytes under a name.
pub fn saved(name: &str, extension: &str, kind: &str, bytes: &[u8]) -> Markup {
    link(name, extension, &format!("data:{kind};base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes)))
}

/// Returns a link that saves the resource at an address under a name.
pub fn link(name: &str, extension: &str, address: &str) -> Markup {
    let (file, words) = (format!("{name}.{extension}"), extension.to_uppercase());
    let label = format!("Save {name} as {words}");
    html! { a download=(file) href=(address) aria-label=(label) { (words) } }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawing() -> Drawing {
        let mut drawing = Drawing::new("wide", (200.0, 100.0), "a <test>");
        drawing.group("series s1 v0", |drawing| drawing.path("line", format_args!("M10 10L190 90")));
        drawing.text("label", "middle", (100.0, 50.0), "MSE & \u{d7}");
        drawing
    }

    #[test]
    fn svg_files_are_self_contained() {
        let file = drawing().file();
        assert!(file.contains("xmlns=\"http://www.w3.org/2000/svg\"") && !file.contains("var("), "{file}");
        assert!(file.contains("MSE &amp; \u{d7}") && file.contains("a &lt;test&gt;"));
        assert!(file.matches("http").count() == 1 && !file.contains("url("));
    }
}
