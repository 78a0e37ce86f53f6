//! Parts of figures: false colour with a legend, crops, rows of pictures.

use anyhow::Result;
use headtail_render::image::{Image, encode_png, encode_png_rgb8};
use plotters::style::colors::colormaps::{ColorMap, ViridisRGB};

use crate::report::{
    number::{escape, text},
    picture::data_address,
};

/// What figures need beyond the style of all pages.
pub const STYLE: &str = include_str!("figure.css");

/// A picture with what stands under it.
pub struct Panel {
    /// A `data:` address.
    pub address: String,
    /// Its name.
    pub name: String,
    /// A figure or two; may be empty.
    pub note: String,
}

impl Panel {
    /// A panel.
    pub fn new(png: &[u8], name: impl Into<String>, note: impl Into<String>) -> Self {
        Self { address: data_address(png), name: name.into(), note: note.into() }
    }
}

/// Panels side by side.
pub fn strip(class: &str, panels: &[Panel]) -> String {
    let figure = |panel: &Panel| {
        let (name, note) = (escape(&panel.name), escape(&panel.note));
        let note = if note.is_empty() { note } else { format!("<span class=\"number\">{note}</span>") };
        format!(
            "<figure class=\"card\"><img src=\"{}\" alt=\"{name}\"><figcaption><b>{name}</b>{note}</figcaption></figure>\n",
            panel.address
        )
    };
    format!("<div class=\"figure {class}\">\n{}</div>\n", panels.iter().map(figure).collect::<String>())
}

/// A logarithmic scale of colours.
#[derive(Clone, Copy)]
pub struct Scale {
    /// The brightest value.
    pub top: f64,
    /// Powers of ten below it.
    pub decades: f64,
}

impl Scale {
    /// The scale that ends at the 99.8th percentile of values: a single lamp would leave nothing else to be seen.
    pub fn of(values: &[f32], decades: f64) -> Self {
        let mut sorted: Vec<f32> = values.iter().copied().filter(|value| value.is_finite() && *value > 0.0).collect();
        sorted.sort_by(f32::total_cmp);
        let top = sorted.get((sorted.len() * 998 / 1000).min(sorted.len().saturating_sub(1))).copied().unwrap_or(1.0);
        Self { top: f64::from(top), decades }
    }

    /// A PNG of `[height * width]` values.
    pub fn png(self, values: &[f32], width: usize) -> Result<Vec<u8>> {
        let color = |value: &f32| {
            let level = 1.0 + (f64::from(*value).max(f64::MIN_POSITIVE) / self.top).log10() / self.decades;
            let color = ViridisRGB.get_color(level.clamp(0.0, 1.0) as f32);
            [color.0, color.1, color.2]
        };
        let pixels: Vec<[u8; 3]> = values.iter().map(color).collect();
        Ok(encode_png_rgb8(width, values.len() / width, &pixels)?)
    }

    /// What the colours mean.
    pub fn legend(self, of: &str) -> String {
        let stops = (0..=8).map(|k| {
            let color = ViridisRGB.get_color(k as f32 / 8.0);
            format!("#{:02x}{:02x}{:02x}", color.0, color.1, color.2)
        });
        let ticks = [self.decades, 0.5 * self.decades, 0.0]
            .map(|down| format!("<span>{}</span>", text(self.top * 10_f64.powf(-down))));
        format!(
            "<div class=\"legend\"><p>{}</p><div class=\"gradient\" style=\"background:linear-gradient(to right,{})\"></div>\
             <div class=\"colour-ticks\">{}</div></div>\n",
            escape(of),
            stops.collect::<Vec<_>>().join(","),
            ticks.concat()
        )
    }
}

/// A rectangle of pixels.
#[derive(Clone, Copy)]
pub struct Crop {
    /// Its left column.
    pub left: usize,
    /// Its top row.
    pub top: usize,
    /// Columns and rows.
    pub side: usize,
}

impl Crop {
    /// The square of a fifth of the width in which an image differs most from a reference.
    pub fn worst(image: &Image, reference: &Image, measured: &[bool]) -> Self {
        let side = (image.width / 5).min(image.height).max(1);
        let step = (side / 4).max(1);
        let mut best = (0.0, Self { left: 0, top: 0, side });
        for top in (0..=image.height - side).step_by(step) {
            for left in (0..=image.width - side).step_by(step) {
                let crop = Self { left, top, side };
                let inside = crop.pixels(image.width).filter(|&k| measured[k]).count();
                let error = crop.error(image, reference, measured) * inside as f64;
                if error > best.0 {
                    best = (error, crop);
                }
            }
        }
        best.1
    }

    fn pixels(self, width: usize) -> impl Iterator<Item = usize> {
        (self.top..self.top + self.side)
            .flat_map(move |y| (self.left..self.left + self.side).map(move |x| y * width + x))
    }

    /// The mean squared error over the measured pixels of the crop.
    pub fn error(self, image: &Image, reference: &Image, measured: &[bool]) -> f64 {
        let (mut sum, mut count) = (0.0, 0_u32);
        for k in self.pixels(image.width).filter(|&k| measured[k]) {
            for (a, b) in image.pixels[k].iter().zip(&reference.pixels[k]) {
                sum += f64::from(a - b).powi(2);
                count += 1;
            }
        }
        sum / f64::from(count.max(1))
    }

    /// The crop as a PNG.
    pub fn png(self, image: &Image, exposure: f32) -> Result<Vec<u8>> {
        let pixels = self.pixels(image.width).map(|k| image.pixels[k]).collect();
        Ok(encode_png(&Image { width: self.side, height: self.side, pixels }, exposure)?)
    }

    /// The image as a PNG with the crop's frame in it.
    pub fn framed(self, image: &Image, exposure: f32) -> Result<Vec<u8>> {
        let mut pixels: Vec<[u8; 3]> = image
            .pixels
            .iter()
            .map(|&pixel| headtail_render::color::tone_map(glam::Vec3A::from_array(pixel) * exposure.exp2()))
            .collect();
        let (right, bottom) = (self.left + self.side - 1, self.top + self.side - 1);
        for k in 0..self.side {
            for (x, y) in
                [(self.left + k, self.top), (self.left + k, bottom), (self.left, self.top + k), (right, self.top + k)]
            {
                pixels[y * image.width + x] = [0xff, 0xb0, 0x00];
            }
        }
        Ok(encode_png_rgb8(image.width, image.height, &pixels)?)
    }
}

/// A table. Cells are HTML.
pub fn table(head: &[&str], rows: &[Vec<String>]) -> String {
    let cell = |tag: &str, k: usize, text: &str| {
        let class = if k == 0 { "" } else { " class=\"number\"" };
        format!("<{tag}{class}>{text}</{tag}>")
    };
    let line = |tag: &str, cells: &mut dyn Iterator<Item = &str>| {
        let cells: String = cells.enumerate().map(|(k, text)| cell(tag, k, text)).collect();
        format!("<tr>{cells}</tr>\n")
    };
    let head = line("th", &mut head.iter().copied());
    let body: String = rows.iter().map(|row| line("td", &mut row.iter().map(String::as_str))).collect();
    format!(
        "<div class=\"scroll\"><table class=\"plain\"><thead>{head}</thead>\n<tbody>\n{body}</tbody></table></div>\n"
    )
}
