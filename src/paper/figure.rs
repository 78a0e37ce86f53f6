//! Parts of figures: rows of pictures and their colour scales.

use anyhow::Result;
use headtail_render::image::encode_png_rgb8;
use maud::html;

use crate::report::{
    chart::{Scale, wrap},
    colours::DENSITY,
    picture::data_address,
    vector::Drawing,
};

/// Styles for figures, in addition to those of all pages.
pub const STYLE: &str = include_str!("figure.css");

/// A picture with its caption.
pub struct Panel {
    /// A `data:` address.
    address: String,
    /// Its name.
    name: String,
    /// One or two figures; may be empty.
    note: String,
    /// Width divided by height.
    aspect: f64,
}

impl Panel {
    /// A panel from a PNG.
    pub fn new(png: &[u8], name: impl Into<String>, note: impl Into<String>) -> Self {
        // A PNG's header has its width at byte 16 and its height at byte 20.
        let size =
            |at: usize| png.get(at..at + 4).map_or(1.0, |b| f64::from(u32::from_be_bytes([b[0], b[1], b[2], b[3]])));
        Self { address: data_address(png), name: name.into(), note: note.into(), aspect: size(16) / size(20) }
    }
}

/// Layout of a row of pictures.
#[derive(Clone, Copy)]
pub enum Layout {
    /// Four side by side.
    Four,
    /// Five side by side.
    Five,
    /// All in one row.
    Wide,
    /// Small ones with visible pixels.
    Crops,
}

impl Layout {
    fn class(self) -> &'static str {
        match self {
            Self::Four => "fits",
            Self::Five => "five",
            Self::Wide => "wide",
            Self::Crops => "crops",
        }
    }

    fn columns(self, panels: usize) -> usize {
        let most = match self {
            Self::Four => 4,
            Self::Five => 5,
            Self::Wide => panels,
            Self::Crops => 6,
        };
        most.min(panels).max(1)
    }
}

/// A row of pictures with their colour scales.
pub struct Strip<'a> {
    /// The layout.
    pub layout: Layout,
    /// The pictures.
    pub panels: Vec<Panel>,
    /// Colour scales with their labels; empty for photographs and renderings.
    pub scales: Vec<(Scale, &'a str)>,
}

/// Width of the drawing of a strip.
const WIDTH: f64 = 1000.0;
/// Gap between pictures.
const GAP: f64 = 10.0;
/// Height of a line of text.
const LINE: f64 = 16.0;
/// Width of a letter.
const LETTER: f64 = 7.4;
/// Width of a colour scale's legend.
const LEGEND: f64 = 260.0;

impl Strip<'_> {
    /// Returns the strip as HTML for the page.
    pub fn html(&self) -> String {
        let strip = html! {
            div.figure.(self.layout.class()) {
                @for panel in &self.panels {
                    figure.card {
                        img src=(panel.address) alt=(panel.name);
                        figcaption { b { (panel.name) } @if !panel.note.is_empty() { span.number { (panel.note) } } }
                    }
                }
            }
            @if !self.scales.is_empty() {
                div.legends {
                    @for (scale, of) in &self.scales {
                        div.legend {
                            p { (of) }
                            div.gradient style={ "background:" (DENSITY.gradient()) } {}
                            div.colour-ticks { @for tick in scale.ticks() { span { (tick) } } }
                        }
                    }
                }
            }
        };
        strip.into_string()
    }

    /// Returns the strip as a separate drawing.
    ///
    /// # Errors
    /// If a picture cannot be encoded.
    pub fn drawing(&self) -> Result<Drawing> {
        let columns = self.layout.columns(self.panels.len());
        let width = (WIDTH + GAP) / columns as f64 - GAP;
        let letters = (width / LETTER) as usize;
        let lines = |words: &str| if words.is_empty() { Vec::new() } else { wrap(words, letters) };
        let text = |panel: &Panel| [lines(&panel.name), lines(&panel.note)];
        let height_of = |panel: &Panel| width / panel.aspect + LINE * text(panel).concat().len() as f64 + 14.0;
        let rows: Vec<&[Panel]> = self.panels.chunks(columns).collect();
        let heights: Vec<f64> = rows.iter().map(|row| row.iter().map(height_of).fold(0.0, f64::max)).collect();
        let legends = if self.scales.is_empty() { 0.0 } else { 60.0 };
        let names: Vec<&str> = self.panels.iter().map(|panel| panel.name.as_str()).collect();
        let size = (WIDTH, heights.iter().sum::<f64>() + legends);
        let mut drawing = Drawing::new("strip", size, names.join(", "));
        let mut top = 0.0;
        for (row, height) in rows.into_iter().zip(heights) {
            for (k, panel) in row.iter().enumerate() {
                let left = k as f64 * (width + GAP);
                drawing.picture(&panel.address, (left, top), (width, width / panel.aspect));
                let mut y = top + width / panel.aspect + LINE;
                for (class, lines) in ["heading", "label"].into_iter().zip(text(panel)) {
                    for line in lines {
                        drawing.text(class, "start", (left, y), line.trim_end());
                        y += LINE;
                    }
                }
            }
            top += height;
        }
        let gradient = data_address(&encode_png_rgb8(128, 1, &DENSITY.ramp(128))?);
        for (k, (scale, of)) in self.scales.iter().enumerate() {
            let left = k as f64 * (LEGEND + 30.0);
            drawing.text("small", "start", (left, top + 14.0), of);
            drawing.picture(&gradient, (left, top + 20.0), (LEGEND, 10.0));
            for (place, (anchor, tick)) in ["start", "middle", "end"].into_iter().zip(scale.ticks()).enumerate() {
                drawing.text("tick", anchor, (left + 0.5 * LEGEND * place as f64, top + 46.0), &tick);
            }
        }
        Ok(drawing)
    }
}

/// The title of a part of a section.
pub fn heading(title: &str) -> String {
    html! { h3 { (title) } }.into_string() + "\n"
}

/// A paragraph; `text` is HTML.
pub fn note(text: &str) -> String {
    format!("<p class=\"note\">{text}</p>\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strip_drawing_contains_all_captions_and_scales() {
        let values = [1.0, 0.1, 0.01, 0.5];
        let scale = Scale { top: 1.0, decades: 2.0 };
        let panel = |name: &str| {
            Panel::new(&scale.png(&values, 4).unwrap(), name, "KL 0.02 <nats>, and more that takes a second line")
        };
        let names = ["target", "intermediate", "final", "naive", "another"];
        let strip = Strip { layout: Layout::Four, panels: names.map(panel).into(), scales: vec![(scale, "density")] };
        assert_eq!(strip.panels[0].aspect, 4.0);
        let file = strip.drawing().unwrap().file();
        assert_eq!(file.matches("<image ").count(), 6, "five pictures and the colours");
        assert!(names.iter().all(|name| file.contains(&format!(">{name}<"))));
        assert!(
            file.contains("KL 0.02 &lt;nats&gt;,")
                && file.contains(">takes a second line<")
                && file.contains(">0.0100<"),
            "{file}"
        );
        assert_eq!(strip.html().matches("<img ").count(), 5);
    }
}
