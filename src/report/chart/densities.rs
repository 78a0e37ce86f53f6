//! Labelled pictures side by side, densities in false colour with their scale.

use anyhow::Result;
use headtail_render::image::encode_png_rgb8;

use super::{Chart, Drawing, text};
use crate::report::{
    colours::{Colours, DENSITY},
    picture::data_address,
};

/// A colour scale.
#[derive(Clone, Copy)]
pub struct Scale {
    /// The brightest value.
    pub top: f64,
    spacing: Spacing,
}

/// The values between the ends of a scale.
#[derive(Clone, Copy)]
enum Spacing {
    /// From 0.
    Linear,
    /// From this many powers of ten below the brightest value.
    Decades(f64),
}

impl Scale {
    /// The logarithmic scale up to the 99.8th percentile of the values, so that a single lamp does not darken
    /// everything else.
    pub fn of(values: &[f32], decades: f64) -> Self {
        Self { top: top(values), spacing: Spacing::Decades(decades) }
    }

    /// The scale from 0 up to the 99.8th percentile, for values of one magnitude.
    pub fn linear(values: &[f32]) -> Self {
        Self { top: top(values), spacing: Spacing::Linear }
    }

    /// Converts values to colours.
    pub fn pixels(self, values: &[f32]) -> Vec<[u8; 3]> {
        let level = |value: &f32| {
            let part = f64::from(*value).max(f64::MIN_POSITIVE) / self.top;
            match self.spacing {
                Spacing::Linear => part,
                Spacing::Decades(decades) => 1.0 + part.log10() / decades,
            }
        };
        values.iter().map(|value| DENSITY.at(level(value))).collect()
    }

    /// Encodes `[height * width]` values as a PNG.
    pub fn png(self, values: &[f32], width: usize) -> Result<Vec<u8>> {
        Ok(encode_png_rgb8(width, values.len() / width, &self.pixels(values))?)
    }

    /// Returns the labels at both ends and the middle of the scale, from dark to bright.
    pub fn ticks(self) -> [String; 3] {
        match self.spacing {
            Spacing::Linear => [0.0, 0.5, 1.0].map(|part| text(part * self.top)),
            Spacing::Decades(decades) => [1.0, 0.5, 0.0].map(|part| text(self.top * 10_f64.powf(-part * decades))),
        }
    }
}

/// The 99.8th percentile of the positive values.
fn top(values: &[f32]) -> f64 {
    let mut sorted: Vec<f32> = values.iter().copied().filter(|value| value.is_finite() && *value > 0.0).collect();
    sorted.sort_by(f32::total_cmp);
    let place = (sorted.len() * 998 / 1000).min(sorted.len().saturating_sub(1));
    f64::from(sorted.get(place).copied().unwrap_or(1.0))
}

/// The axes of a picture.
#[derive(Clone, Copy, PartialEq)]
pub enum Sides {
    /// Azimuth and elevation.
    Sphere,
    /// The unit square.
    Square,
    /// A camera's image plane.
    View,
}

/// The width of a picture.
const WIDTH: f64 = 360.0;
/// Room to the left of a picture for its numbers.
const LEFT: f64 = 46.0;
/// Room to the right of a picture.
const GAP: f64 = 18.0;
/// Room above a picture for its title.
const LABEL: f64 = 26.0;
/// Room below a picture for its numbers.
const BELOW: f64 = 22.0;
/// Height of a colour scale.
const COLOURS: f64 = 44.0;

/// A labelled picture.
pub struct Panel {
    title: String,
    address: String,
    /// Width divided by height.
    aspect: f64,
    sides: Sides,
    /// The colour scale and its unit.
    scale: Option<(Scale, &'static str)>,
}

impl Panel {
    /// A picture of `[height * width]` values in false colour.
    pub fn density(
        title: impl Into<String>,
        (values, width): (&[f32], usize),
        sides: Sides,
        (scale, unit): (Scale, &'static str),
    ) -> Result<Self> {
        let rows = values.len() / width;
        let address = data_address(&scale.png(values, width)?);
        let aspect = width as f64 / rows as f64;
        Ok(Self { title: title.into(), address, aspect, sides, scale: Some((scale, unit)) })
    }

    /// A picture of `[height * width]` colours.
    pub fn plain(title: impl Into<String>, (pixels, width): (&[[u8; 3]], usize), sides: Sides) -> Result<Self> {
        let rows = pixels.len() / width;
        let address = data_address(&encode_png_rgb8(width, rows, pixels)?);
        Ok(Self { title: title.into(), address, aspect: width as f64 / rows as f64, sides, scale: None })
    }
}

/// Lays out panels of equal width, `per_row` to a row, under lines of text.
///
/// # Errors
/// If a picture cannot be encoded.
pub fn densities(name: &str, lines: &[String], panels: &[Panel], per_row: usize) -> Result<Chart> {
    let columns = per_row.min(panels.len()).max(1);
    let head = 10.0 + 22.0 * lines.len() as f64;
    let tallest = panels.iter().map(|panel| WIDTH / panel.aspect).fold(0.0, f64::max);
    let has_colours = panels.iter().any(|panel| panel.scale.is_some());
    let row = LABEL + tallest + BELOW + if has_colours { COLOURS } else { 6.0 };
    let rows = panels.len().div_ceil(columns);
    let size = (columns as f64 * (WIDTH + LEFT + GAP), head + rows as f64 * row + 6.0);
    let mut drawing = Drawing::new("densities", size, lines.join("; "));
    for (k, line) in lines.iter().enumerate() {
        let class = if k == 0 { "heading" } else { "label" };
        drawing.text(class, "start", (6.0, 22.0 + 22.0 * k as f64), line);
    }
    let gradient = gradient(&DENSITY)?;
    for (k, panel) in panels.iter().enumerate() {
        let (left, top) =
            (LEFT + (k % columns) as f64 * (WIDTH + LEFT + GAP), head + (k / columns) as f64 * row + LABEL);
        let height = WIDTH / panel.aspect;
        drawing.text("label", "start", (left, top - 8.0), &panel.title);
        drawing.picture(&panel.address, (left, top), (WIDTH, height));
        sides(&mut drawing, panel.sides, (left, top), (WIDTH, height));
        if let Some((scale, unit)) = panel.scale {
            let below = top + height + BELOW + 6.0;
            drawing.picture(&gradient, (left, below), (WIDTH, 9.0));
            let [low, middle, high] = scale.ticks();
            for (x, anchor, words) in [
                (left, "start", low),
                (left + 0.5 * WIDTH, "middle", middle),
                (left + WIDTH, "end", format!("{high} {unit}")),
            ] {
                drawing.text("tick", anchor, (x, below + 24.0), &words);
            }
        }
    }
    Ok(Chart { name: name.into(), drawings: vec![drawing] })
}

/// The frame of a picture and the numbers along it.
fn sides(drawing: &mut Drawing, sides: Sides, (left, top): (f64, f64), (width, height): (f64, f64)) {
    drawing.path("frame", format_args!("M{left:.1} {top:.1}h{width:.1}v{height:.1}h-{width:.1}Z"));
    let (across, down) = match sides {
        Sides::Sphere => (["0\u{b0}", "azimuth 180\u{b0}", "360\u{b0}"], ["90\u{b0}", "0\u{b0}", "\u{2212}90\u{b0}"]),
        Sides::Square => (["0", "u", "1"], ["0", "v", "1"]),
        Sides::View => return,
    };
    for (k, (anchor, words)) in ["start", "middle", "end"].into_iter().zip(across).enumerate() {
        drawing.text("tick", anchor, (left + 0.5 * width * k as f64, top + height + 15.0), words);
    }
    for (k, words) in down.into_iter().enumerate() {
        let y = top + 0.5 * height * k as f64 + [10.0, 4.5, 0.0][k];
        drawing.text("tick", "end", (left - 6.0, y), words);
    }
}

fn gradient(colours: &Colours) -> Result<String> {
    Ok(data_address(&encode_png_rgb8(128, 1, &colours.ramp(128))?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panels_have_titles_axes_and_colour_scales() {
        let values: Vec<f32> = (0..32).map(|k| k as f32).collect();
        let scale = Scale::of(&values, 2.0);
        let panels = [
            Panel::density("target <1>", (&values, 8), Sides::Sphere, (scale, "1/sr")).unwrap(),
            Panel::density("head", (&values, 8), Sides::Square, (scale, "per unit of Y")).unwrap(),
        ];
        let chart = densities("x", &["a".into(), "b".into()], &panels, 2).unwrap();
        let svg = chart.drawings[0].svg();
        assert_eq!(svg.matches("<image ").count(), 4);
        assert!(svg.contains("target &lt;1&gt;") && svg.contains("31.0 1/sr") && svg.contains(">azimuth 180\u{b0}<"));
        assert!(svg.contains(">0.310<") && svg.contains(">3.10<"), "two powers of ten below 31: {svg}");
    }

    #[test]
    fn the_scale_excludes_a_single_lamp() {
        let mut values = vec![1.0; 10_000];
        values[0] = 1e9;
        assert_eq!(Scale::of(&values, 2.0).top, 1.0);
        assert_eq!(Scale::of(&[], 2.0).top, 1.0);
    }

    #[test]
    fn a_linear_scale_begins_at_0() {
        let scale = Scale::linear(&[0.5, 2.0]);
        assert_eq!(scale.ticks(), ["0.00", "1.00", "2.00"]);
        let [low, middle, high] = <[_; 3]>::try_from(scale.pixels(&[0.0, 1.0, 2.0])).unwrap();
        assert_eq!((low, middle, high), (DENSITY.at(0.0), DENSITY.at(0.5), DENSITY.at(1.0)));
    }
}
