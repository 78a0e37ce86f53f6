//! A teaser figure: a picture, and insets of all samplers with their numbers.

use anyhow::Result;

use super::{
    comparison::{Comparison, RenderedImage},
    crop::Crop,
    number::{text, times},
    picture::{ErrorMap, data_address, rendering},
    summary::{BudgetKind, Group, Measure, Summary},
    vector::{Chart, Drawing},
};

/// Height of the large picture: text is legible at the width of a page.
const HEIGHT: f64 = 280.0;
/// Gap between insets.
const GAP: f64 = 5.0;
/// Height above the pictures for names.
const HEAD: f64 = 40.0;
/// Height below the pictures for numbers.
const FOOT: f64 = 64.0;
/// Colours of the inset frames, visible on any picture.
const FRAMES: [&str; 2] = ["#ffb000", "#4cc3ff"];

/// A column of insets.
struct Column<'a> {
    name: String,
    image: &'a headtail_render::image::Image,
    numbers: [String; 3],
}

/// Draws the figure at the largest budget of time, else at the budget that is shown first. Empty without
/// pictures.
///
/// # Errors
/// If a picture differs in size from the reference.
pub fn teaser(comparison: &Comparison, summary: &Summary, exposure: f32) -> Result<Chart> {
    let name = "pictures".to_owned();
    let budget = summary.largest(BudgetKind::Time).unwrap_or(summary.shown_first());
    let image = |sampler: &str| -> Option<&RenderedImage> {
        comparison.images.iter().find(|image| image.sampler == sampler && image.budget == budget.name)
    };
    let mut columns = Vec::new();
    let is_unique = |name: &str| summary.samplers.iter().filter(|other| short(other) == short(name)).count() == 1;
    let label = |name: &'_ str| if is_unique(name) { short(name).to_owned() } else { name.to_owned() };
    for group in summary.at(&budget.name) {
        if let Some(shown) = image(&group.sampler) {
            let numbers = numbers(comparison, summary, group, shown, exposure)?;
            columns.push(Column { name: label(&group.sampler), image: &shown.image, numbers });
        }
    }
    let Some(worst) = image(&summary.baseline).or_else(|| summary.samplers.iter().find_map(|sampler| image(sampler)))
    else {
        return Ok(Chart { name, drawings: Vec::new() });
    };
    let crops = Crop::two_worst(&worst.image, &comparison.reference, &comparison.measured);
    let numbers = ["MSE".to_owned(), "times lower".to_owned(), "FLIP".to_owned()];
    columns.push(Column { name: "reference".to_owned(), image: &comparison.reference, numbers });
    let best = summary.ranking(&budget.name, Measure::Mse).into_iter().find_map(|group| image(&group.sampler));
    let large = best.unwrap_or(worst);
    let view = format!("{} under {}", comparison.scene, comparison.env);
    let caption = [view, format!("{}: {}", budget.words(), label(&large.sampler))];
    let drawings = vec![draw(comparison, large, &caption, (&columns, crops), exposure)?];
    Ok(Chart { name, drawings })
}

/// Returns the name of a sampler without the path of its file, which is wider than an inset.
fn short(sampler: &str) -> &str {
    match sampler.rsplit_once(':') {
        Some((form, file)) if file.contains(['/', '\\', '.']) => form,
        _ => sampler,
    }
}

/// MSE, its ratio to the baseline's, and FLIP.
fn numbers(
    comparison: &Comparison,
    summary: &Summary,
    group: &Group,
    shown: &RenderedImage,
    exposure: f32,
) -> Result<[String; 3]> {
    let ratio = summary.ratio(group, Measure::Mse);
    let ratio = ratio.map_or("\u{2013}".to_owned(), |ratio| format!("{}\u{d7}", times(ratio.ratio)));
    let (_, flip) = ErrorMap::of_flip(&shown.image, comparison, exposure)?;
    Ok([text(group.mse.mean), ratio, text(flip)])
}

fn draw(
    comparison: &Comparison,
    large: &RenderedImage,
    caption: &[String; 2],
    (columns, crops): (&[Column], [Crop; 2]),
    exposure: f32,
) -> Result<Drawing> {
    let scale = HEIGHT / comparison.height as f64;
    let width = scale * comparison.width as f64;
    let side = 0.5 * (HEIGHT - GAP);
    let size = (width + columns.len() as f64 * (side + GAP), HEAD + HEIGHT + FOOT);
    let mut drawing = Drawing::new("teaser", size, caption.join(", "));
    for (line, words) in caption.iter().enumerate() {
        drawing.text("label", "start", (0.0, HEAD + HEIGHT + 19.0 + 18.0 * line as f64), words);
    }
    drawing.picture(&rendering(&large.image, exposure)?, (0.0, HEAD), (width, HEIGHT));
    for (crop, colour) in crops.iter().zip(FRAMES) {
        let [left, top, side] = [crop.left, crop.top, crop.side].map(|pixels| scale * pixels as f64);
        frame(&mut drawing, (left, HEAD + top), side, colour);
    }
    for (k, column) in columns.iter().enumerate() {
        let left = width + GAP + k as f64 * (side + GAP);
        let middle = left + 0.5 * side;
        drawing.text("heading", "middle", (middle, 26.0), &column.name);
        for (row, (crop, colour)) in crops.iter().zip(FRAMES).enumerate() {
            let place = (left, HEAD + row as f64 * (side + GAP));
            drawing.picture(&data_address(&crop.png(column.image, exposure)?), place, (side, side));
            frame(&mut drawing, (place.0 + 1.5, place.1 + 1.5), side - 3.0, colour);
        }
        for (line, words) in column.numbers.iter().enumerate() {
            let y = HEAD + HEIGHT + 19.0 + 18.0 * line as f64;
            drawing.text(if line == 1 { "heading" } else { "label" }, "middle", (middle, y), words);
        }
    }
    Ok(drawing)
}

fn frame(drawing: &mut Drawing, (x, y): (f64, f64), side: f64, colour: &str) {
    for (width, colour) in [(4.5, "#000000"), (2.5, colour)] {
        drawing.raw(format_args!(
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{side:.1}\" height=\"{side:.1}\" fill=\"none\" stroke=\"{colour}\" \
             stroke-width=\"{width}\"/>"
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::super::synthetic;
    use super::*;

    #[test]
    fn every_sampler_has_its_insets_and_numbers_at_equal_time() {
        let comparison = synthetic::comparison();
        let summary = Summary::of(&comparison.rows).unwrap();
        let chart = teaser(&comparison, &summary, 0.0).unwrap();
        let svg = chart.drawings[0].svg();
        assert_eq!(svg.matches("<image ").count(), 1 + 2 * (summary.samplers.len() + 1));
        assert!(svg.contains("2 seconds") && svg.contains(">1.0\u{d7}<") && svg.contains(">reference<"), "{svg}");
        assert_eq!(["head+mis:out/a.safetensors", "split:4:patches"].map(short), ["head+mis", "split:4:patches"]);
        let bare = Comparison { images: Vec::new(), ..comparison };
        assert!(teaser(&bare, &summary, 0.0).unwrap().drawings.is_empty());
    }
}
