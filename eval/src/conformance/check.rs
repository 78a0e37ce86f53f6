//! The comparison of answers with correct results.

use std::{fmt, path::Path};

use headtail_render::statistics::SphereChiSquare;

use serde::Serialize;

use super::{Answer, Case, POINTS, ROWS, Row, cases, faults::explain, kit::read_answers, map};
use crate::{Error, Result};

/// Largest relative difference of a pdf: divisions and roots of other devices are off by a few units in the last place,
/// and a direction by 1e-7, over which pdfs change by up to 1e-3 where the density of a 64 x 32 map is steep.
const PDF_TOLERANCE: f32 = 2e-3;
/// Largest difference of a drawn direction: draws pass through up to ten cuts of an interval, each rounded.
const DIRECTION_TOLERANCE: f32 = 1e-4;
/// Largest fraction of rows beyond a tolerance: directions that rounding moves across the border of a cell or patch.
const BEYOND: f64 = 0.02;
/// Probability of rejecting correct draws in any test of a case.
const SIGNIFICANCE: f64 = 0.001;

/// The result of a case.
#[derive(Clone, Debug, Serialize)]
pub struct Verdict {
    /// The case.
    pub name: &'static str,
    /// Fraction of given directions with a wrong pdf.
    pub wrong_pdfs: f64,
    /// Fraction of draws whose pdf is not that of their direction.
    pub wrong_draws: f64,
    /// Fraction of draws in another direction, which is right if they follow the pdf.
    pub other_directions: f64,
    /// What is wrong, and where known why; empty if the case passed.
    pub faults: Vec<String>,
}

impl Verdict {
    /// Whether the answers are right.
    pub fn passed(&self) -> bool {
        self.faults.is_empty()
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |fraction: f64| format!("{:.1} %", 100.0 * fraction);
        let verdict = if self.passed() { "right" } else { "wrong" };
        write!(
            f,
            "{}: {verdict}; {} of given directions and {} of draws have another pdf, {} of draws another direction",
            self.name,
            percent(self.wrong_pdfs),
            percent(self.wrong_draws),
            percent(self.other_directions)
        )?;
        self.faults.iter().try_for_each(|fault| write!(f, "\n  {fault}"))
    }
}

/// Compares the answers in a folder, one file per case, with the correct results. Cases without a file are left out.
///
/// # Errors
/// A file cannot be read or has another size, or there is none.
pub fn check(folder: &Path) -> Result<Vec<Verdict>> {
    let (cases, mut verdicts) = (cases(&map()?)?, Vec::new());
    for case in &cases {
        if let Some(answers) = read_answers(folder, case.name)? {
            verdicts.push(verdict(case, &answers)?);
        }
    }
    if verdicts.is_empty() {
        let names = cases.iter().map(|case| case.name).collect::<Vec<_>>().join(", ");
        return Err(Error::file(folder, format!("has no answers: write NAME.answers.f32 for one or more of {names}")));
    }
    Ok(verdicts)
}

/// Whether a pdf differs from the correct one.
fn differs(pdf: f32, correct: f32) -> bool {
    let is_close = (pdf - correct).abs() <= PDF_TOLERANCE * correct.max(1e-3);
    // NaN is not.
    !is_close
}

fn verdict(case: &Case, answers: &[Answer]) -> Result<Verdict> {
    let rows = case.rows()?;
    let mut faults = Vec::new();
    let fraction =
        |is_wrong: &dyn Fn(usize) -> bool| (0..rows.len()).filter(|&k| is_wrong(k)).count() as f64 / rows.len() as f64;
    let wrong_pdfs = fraction(&|k| differs(answers[k].pdf_of_given, rows[k].answer.pdf_of_given));
    if wrong_pdfs > BEYOND {
        let pdfs: Vec<f32> = answers.iter().map(|answer| answer.pdf_of_given).collect();
        let reason = explain(case, &rows, &pdfs, differs)?;
        faults.push(format!("pdfs of given directions: {}", reason.unwrap_or("no known fault explains them")));
    }
    let is_draw = |answer: &Answer| answer.pdf > 0.0;
    if answers.iter().any(|answer| is_draw(answer) && !answer.wi.is_normalized()) {
        faults.push("draws: a direction is not of unit length".to_owned());
        return Ok(Verdict { name: case.name, wrong_pdfs, wrong_draws: 1.0, other_directions: 1.0, faults });
    }
    let at = |k: usize| if is_draw(&answers[k]) { answers[k].wi } else { rows[k].n };
    let drawn: Vec<Row> = (0..rows.len()).map(|k| Row { given: at(k), ..rows[k] }).collect();
    let of_draws = case.pdfs(&drawn)?;
    let wrong_draws =
        fraction(&|k| answers[k].pdf.is_nan() || is_draw(&answers[k]) && differs(answers[k].pdf, of_draws[k]));
    if wrong_draws > BEYOND {
        faults.push("draws: their pdf is not that of their direction".to_owned());
    }
    let is_same = |k: usize| {
        let (own, correct) = (&answers[k], &rows[k].answer);
        is_draw(own) == is_draw(correct) && (own.wi - correct.wi).abs().max_element() <= DIRECTION_TOLERANCE
    };
    let other_directions = fraction(&|k| !is_same(k));
    if other_directions > BEYOND
        && let Some(fault) = distribution_fault(case, &rows, answers)
    {
        faults.push(fault);
    }
    Ok(Verdict { name: case.name, wrong_pdfs, wrong_draws, other_directions, faults })
}

/// Says how draws differ from the density, where they are not those of the same warp.
fn distribution_fault(case: &Case, rows: &[Row], answers: &[Answer]) -> Option<String> {
    for point in 0..POINTS {
        let part = point * ROWS..(point + 1) * ROWS;
        let test = SphereChiSquare {
            rows: 9,
            subcells: 16,
            samples: ROWS,
            significance: SIGNIFICANCE,
            tests: POINTS,
            // The quadrature at the edges of lamps, and the number of rejected draws among 512.
            mass_tolerance: 0.05,
            ..SphereChiSquare::default()
        };
        let directions =
            || answers[part.clone()].iter().map(|answer| (answer.pdf > 0.0).then_some(answer.wi)).collect();
        let row = rows[part.start];
        let pdf = |wi: &[glam::Vec3A]| {
            let at: Vec<Row> = wi.iter().map(|&given| Row { given, ..row }).collect();
            case.pdfs(&at).expect("directions of unit length")
        };
        let report = test.run(|_, _| directions(), pdf);
        if !report.passed() {
            return Some(format!("draws at point {} do not follow the pdf: {report}", point + 1));
        }
    }
    None
}
