//! A table of ratios in colours: blue below 1, red above.

use super::{Drawing, legend::wrap, times};

/// Ratios by row and column; lower is better.
pub struct Matrix {
    /// Label for screen readers.
    pub label: String,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Names of the rows with one cell per column.
    pub rows: Vec<(String, Vec<Cell>)>,
}

/// A cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cell {
    /// Not measured.
    Empty,
    /// No result.
    Failed,
    /// The ratio.
    Ratio(f64),
}

/// Decades from white to full colour.
const REACH: f64 = 1.5;

/// Returns the fill of a ratio: white at 1, blue below, red above.
fn fill(ratio: f64) -> String {
    let t = (ratio.log10() / REACH).clamp(-1.0, 1.0);
    let end: [f64; 3] = if t < 0.0 { [67.0, 147.0, 195.0] } else { [214.0, 96.0, 77.0] };
    let [r, g, b] = end.map(|end| (255.0 + t.abs() * (end - 255.0)).round() as u8);
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Draws the matrix.
pub fn matrix(matrix: &Matrix) -> Drawing {
    const LEFT: f64 = 216.0;
    const CELL: f64 = 68.0;
    const ROW: f64 = 25.0;
    let heads: Vec<Vec<String>> = matrix.columns.iter().map(|name| wrap(name, 10)).collect();
    let head = 10.0 + 15.0 * heads.iter().map(Vec::len).max().unwrap_or(1) as f64;
    let names: Vec<Vec<String>> = matrix.rows.iter().map(|(name, _)| wrap(name, 30)).collect();
    let heights: Vec<f64> = names.iter().map(|lines| ROW.max(15.0 * lines.len() as f64 + 6.0)).collect();
    let size = (LEFT + CELL * heads.len() as f64 + 4.0, head + heights.iter().sum::<f64>() + 4.0);
    let mut drawing = Drawing::new("matrix", size, matrix.label.clone());
    for (k, lines) in heads.iter().enumerate() {
        let x = LEFT + CELL * (k as f64 + 0.5);
        for (line, words) in lines.iter().rev().enumerate() {
            drawing.text("cell-text", "middle", (x, head - 7.0 - 14.0 * line as f64), words.trim());
        }
    }
    let mut y = head;
    for ((lines, (_, cells)), height) in names.iter().zip(&matrix.rows).zip(heights) {
        let first = y + 0.5 * height + 4.5 - 7.5 * (lines.len() - 1) as f64;
        for (k, words) in lines.iter().enumerate() {
            drawing.text("label", "start", (4.0, first + 15.0 * k as f64), words);
        }
        for (k, cell) in cells.iter().enumerate() {
            let (x, middle) = (LEFT + CELL * k as f64, y + 0.5 * height + 4.5);
            let (fill, words) = match *cell {
                Cell::Empty => continue,
                Cell::Failed => ("#3a3a3a".to_owned(), "stopped".to_owned()),
                Cell::Ratio(ratio) => (fill(ratio), times(ratio)),
            };
            let ink = if *cell == Cell::Failed { "#ffffff" } else { "#15171a" };
            let (width, height) = (CELL - 2.0, height - 2.0);
            drawing.raw(format_args!(
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{fill}\"/>\
                 <text class=\"cell-text\" x=\"{:.1}\" y=\"{middle:.1}\" text-anchor=\"middle\" style=\"fill:{ink}\">{words}</text>",
                x + 0.5 * width
            ));
        }
        y += height;
    }
    drawing
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn better_is_blue_and_worse_is_red_by_powers_of_ten() {
        assert_eq!(fill(1.0), "#ffffff");
        let channel = |ratio: f64, at: usize| u8::from_str_radix(&fill(ratio)[at..at + 2], 16).unwrap();
        assert!(channel(0.1, 1) < channel(0.1, 5) && channel(10.0, 1) > channel(10.0, 5));
        assert_eq!(fill(0.0), fill(1e-9));
    }

    #[test]
    fn every_cell_shows_its_number() {
        let svg = matrix(&Matrix {
            label: "a & b".into(),
            columns: vec!["mis".into(), "head and brdf by halves".into()],
            rows: vec![
                ("hard sun".into(), vec![Cell::Ratio(1.0), Cell::Ratio(0.25)]),
                ("one lit texel".into(), vec![Cell::Empty, Cell::Failed]),
            ],
        })
        .svg();
        assert!(svg.contains(">0.25<") && svg.contains(">stopped<") && svg.matches("<rect").count() == 3);
    }
}
