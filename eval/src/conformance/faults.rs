//! Common faults of implementations, by which wrong pdfs are explained.

use std::f32::consts::PI;

use glam::{Quat, Vec3A};

use super::{Case, HEIGHT, Row, WIDTH, sine};
use crate::Result;

/// A fault: the pdf of a direction is that of another direction at a surface that is moved likewise, times a factor.
struct Fault {
    /// What is wrong.
    text: &'static str,
    moved: fn(Vec3A) -> Vec3A,
    factor: fn(Vec3A) -> f32,
}

const fn moved(text: &'static str, moved: fn(Vec3A) -> Vec3A) -> Fault {
    Fault { text, moved, factor: |_| 1.0 }
}

const fn scaled(text: &'static str, factor: fn(Vec3A) -> f32) -> Fault {
    Fault { text, moved: |w| w, factor }
}

/// Turns a direction around the vertical axis, towards larger columns of the map.
fn turned(w: Vec3A, radians: f32) -> Vec3A {
    Quat::from_rotation_y(-radians) * w
}

const TEXEL: f32 = 2.0 * PI / WIDTH as f32;

static FAULTS: [Fault; 14] = [
    moved("the map is half a texel too far left: texel centres lie at (column + 0.5) / width", |w| {
        turned(w, 0.5 * TEXEL)
    }),
    moved("the map is half a texel too far right: texel centres lie at (column + 0.5) / width", |w| {
        turned(w, -0.5 * TEXEL)
    }),
    moved("the map is a texel too far left", |w| turned(w, TEXEL)),
    moved("the map is a texel too far right", |w| turned(w, -TEXEL)),
    moved("the map is mirrored: azimuth runs the other way", |w| Vec3A::new(-w.x, w.y, w.z)),
    moved("the map is mirrored and turned by 180 degrees: azimuth runs the other way", |w| Vec3A::new(w.x, w.y, -w.z)),
    moved("the map is turned by 90 degrees", |w| turned(w, 0.5 * PI)),
    moved("the map is turned by 180 degrees", |w| turned(w, PI)),
    moved("the map is turned by 270 degrees", |w| turned(w, -0.5 * PI)),
    moved("the map is upside down", |w| Vec3A::new(w.x, -w.y, w.z)),
    moved("the vertical axis is z, not y", |w| Vec3A::new(w.x, w.z, -w.y)),
    moved("the vertical axis is z, not y, and the map is mirrored", |w| Vec3A::new(w.x, w.z, w.y)),
    scaled("the pdf is over the map's square: divide by 2 pi^2 sin(theta)", |w| 2.0 * PI * PI * sine(w)),
    scaled("the pdf lacks the sine: divide by sin(theta)", sine),
];

/// Fraction of rows that an explanation must explain.
const EXPLAINED: f64 = 0.9;

/// Returns what explains wrong pdfs of given directions, if anything that is known does. `differs` compares a pdf with
/// the correct one.
///
/// # Errors
/// If the sampler cannot be evaluated.
pub fn explain(
    case: &Case,
    rows: &[Row],
    pdfs: &[f32],
    differs: impl Fn(f32, f32) -> bool,
) -> Result<Option<&'static str>> {
    let wrong: Vec<usize> = (0..rows.len()).filter(|&k| differs(pdfs[k], rows[k].answer.pdf_of_given)).collect();
    // Within one and a half rows of a pole.
    let at_pole = |k: &usize| sine(rows[*k].given) < (1.5 * PI / (HEIGHT - 1) as f32).sin();
    if wrong.iter().all(at_pole) {
        return Ok(Some("only directions beside a pole are wrong: the first and the last row of texels are the poles"));
    }
    for Fault { text, moved, factor } in &FAULTS {
        let elsewhere: Vec<Row> = rows
            .iter()
            .map(|row| Row { n: moved(row.n), wo: moved(row.wo), given: moved(row.given), ..*row })
            .collect();
        let expected = case.pdfs(&elsewhere)?;
        let explains = |&&k: &&usize| !differs(pdfs[k], expected[k] * factor(rows[k].given));
        if wrong.iter().filter(explains).count() as f64 >= EXPLAINED * wrong.len() as f64 {
            return Ok(Some(text));
        }
    }
    Ok(None)
}
