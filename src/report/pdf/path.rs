//! Outlines of shapes as operators of PDF.

use anyhow::{Result, bail, ensure};

use super::style::Element;

/// A quarter of a circle by a cubic curve: where its control points are, in radii.
const QUARTER: f64 = 0.552_285;

/// The outline of a path, a rectangle or a circle.
///
/// # Errors
/// If it is something else.
pub fn outline(element: &Element) -> Result<String> {
    match &*element.name {
        "path" => path(element.get("d").unwrap_or_default()),
        "rect" => {
            let side = |name: &str| element.number(name);
            Ok(format!("{} {} {} {} re\n", side("x")?, side("y")?, side("width")?, side("height")?))
        }
        "circle" => {
            let [x, y, r] = ["cx", "cy", "r"].map(|name| element.number(name));
            let (x, y, r) = (x?, y?, r?);
            let halves = half_circle((x - r, y), 2.0 * r) + &half_circle((x + r, y), -2.0 * r);
            Ok(format!("{:.2} {y:.2} m\n{halves}h\n", x - r))
        }
        name => bail!("<{name}> is unknown"),
    }
}

/// All numbers of a text.
pub fn numbers(text: &str) -> Vec<f64> {
    text.split(|c: char| !(c.is_ascii_digit() || ".-".contains(c))).filter_map(|part| part.parse().ok()).collect()
}

/// The commands M, L, H, V, h, v and Z, and halves of circles by a.
fn path(d: &str) -> Result<String> {
    let mut out = String::new();
    let (mut x, mut y) = (0.0, 0.0);
    let mut rest = d.trim();
    while let Some(command) = rest.chars().next() {
        let end = rest[1..].find(|c: char| c.is_ascii_alphabetic()).map_or(rest.len(), |at| at + 1);
        let values = numbers(&rest[1..end]);
        rest = &rest[end..];
        match (command, &values[..]) {
            ('M' | 'L', pairs) if !pairs.is_empty() && pairs.len() % 2 == 0 => {
                for (k, pair) in pairs.chunks(2).enumerate() {
                    (x, y) = (pair[0], pair[1]);
                    out += &format!("{x:.2} {y:.2} {}\n", if command == 'M' && k == 0 { 'm' } else { 'l' });
                }
            }
            ('H' | 'V' | 'h' | 'v', &[to]) => {
                match command {
                    'H' => x = to,
                    'V' => y = to,
                    'h' => x += to,
                    _ => y += to,
                }
                out += &format!("{x:.2} {y:.2} l\n");
            }
            ('a', &[r, _, _, _, _, dx, dy]) => {
                ensure!(dy == 0.0 && (dx.abs() - 2.0 * r).abs() < 1e-6, "only halves of circles are known, not '{d}'");
                // To the right below, to the left above: counter-clockwise where y runs down.
                out += &half_circle((x, y), dx);
                x += dx;
            }
            ('Z' | 'z', []) => out += "h\n",
            _ => bail!("the command {command} of the path '{d}' is unknown"),
        }
    }
    Ok(out)
}

/// The half of a circle from a point to that `dx` to the right of it: below for positive, above for negative.
fn half_circle((x, y): (f64, f64), dx: f64) -> String {
    let (r, middle) = (0.5 * dx, x + 0.5 * dx);
    let k = QUARTER * r;
    format!(
        "{x:.2} {:.2} {:.2} {:.2} {middle:.2} {:.2} c\n{:.2} {:.2} {:.2} {:.2} {:.2} {y:.2} c\n",
        y + k,
        middle - k,
        y + r,
        y + r,
        middle + k,
        y + r,
        x + dx,
        y + k,
        x + dx,
    )
}
