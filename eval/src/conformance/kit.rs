//! The files of a kit, and of answers to it.

use std::path::Path;

use glam::Vec3A;
use headtail_render::file::replace;
use serde_json::json;

use super::{Answer, Case, HEIGHT, POINTS, ROWS, Row, WIDTH, cases, map, table};
use crate::{Error, Result};

/// Inputs in a row of `NAME.f32`; results follow.
const INPUTS: [&str; 11] = ["n.x", "n.y", "n.z", "wo.x", "wo.y", "wo.z", "u.x", "u.y", "given.x", "given.y", "given.z"];
/// Results, which a row of `NAME.answers.f32` holds.
const RESULTS: [&str; 5] = ["wi.x", "wi.y", "wi.z", "pdf", "pdf_of_given"];

/// Returns the names of the files that [`write_kit`] writes.
///
/// # Errors
/// If memory is short.
pub fn kit_files() -> Result<Vec<String>> {
    let cases = cases(&map()?)?;
    let fixed = ["kit.json", "map.f32", "table.safetensors"].map(str::to_owned);
    Ok(fixed.into_iter().chain(cases.iter().map(|case| case_file(case.name))).collect())
}

/// Writes a kit into an existing folder.
///
/// # Errors
/// If a file cannot be written.
pub fn write_kit(folder: &Path) -> Result<()> {
    let map = map()?;
    replace(&folder.join("map.f32"), &bytes(map.to_image().pixels.as_flattened()))?;
    table(&map)?.write(&folder.join("table.safetensors"))?;
    let cases = cases(&map)?;
    for case in &cases {
        let numbers: Vec<f32> = case.rows()?.iter().flat_map(numbers).collect();
        replace(&folder.join(case_file(case.name)), &bytes(&numbers))?;
    }
    let list: Vec<_> = cases.iter().map(description).collect();
    let kit = json!({
        "map": {
            "file": "map.f32", "width": WIDTH, "height": HEIGHT,
            "texels": "red, green, blue; linear Rec.709; rows from the top, of which the first and the last are the poles",
        },
        "numbers": "32-bit floats, little-endian, row by row",
        "inputs": INPUTS,
        "results": RESULTS,
        "cases": list,
    });
    let text = serde_json::to_string_pretty(&kit).map_err(|error| Error::argument("kit", error.to_string()))?;
    Ok(replace(&folder.join("kit.json"), (text + "\n").as_bytes())?)
}

fn description(case: &Case) -> serde_json::Value {
    json!({
        "name": case.name,
        "sampler": case.what,
        "alpha": case.alpha,
        "f0": case.alpha.map(|_| 1.0),
        "rows": POINTS * ROWS,
        "file": case_file(case.name),
        "answers": answers_file(case.name),
    })
}

fn case_file(name: &str) -> String {
    format!("{name}.f32")
}

fn answers_file(name: &str) -> String {
    format!("{name}.answers.f32")
}

/// Returns the answers to a case in a folder; `None` if it has no file of them.
///
/// # Errors
/// The file cannot be read, or has another size.
pub fn read_answers(folder: &Path, name: &str) -> Result<Option<Vec<Answer>>> {
    let path = folder.join(answers_file(name));
    if !path.try_exists().unwrap_or(true) {
        return Ok(None);
    }
    let needed = POINTS * ROWS * RESULTS.len() * 4;
    let size = std::fs::metadata(&path).map_err(|error| Error::file(&path, error))?.len();
    if size != needed as u64 {
        return Err(Error::file(&path, format!("has {size} bytes, not {needed}: {RESULTS:?} for each row")));
    }
    let bytes = std::fs::read(&path).map_err(|error| Error::file(&path, error))?;
    let numbers: Vec<f32> = bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    let answer = |&[x, y, z, pdf, pdf_of_given]: &[f32; 5]| Answer { wi: Vec3A::new(x, y, z), pdf, pdf_of_given };
    Ok(Some(numbers.as_chunks().0.iter().map(answer).collect()))
}

/// Writes the answers to a case into an existing folder.
///
/// # Errors
/// If the file cannot be written.
pub fn write_answers(folder: &Path, name: &str, answers: &[Answer]) -> Result<()> {
    let numbers: Vec<f32> = answers.iter().flat_map(results).collect();
    Ok(replace(&folder.join(answers_file(name)), &bytes(&numbers))?)
}

fn numbers(row: &Row) -> Vec<f32> {
    let inputs = [row.n.to_array().as_slice(), &row.wo.to_array(), &row.u.to_array(), &row.given.to_array()].concat();
    [inputs.as_slice(), &results(&row.answer)].concat()
}

fn results(answer: &Answer) -> [f32; 5] {
    let [x, y, z] = answer.wi.to_array();
    [x, y, z, answer.pdf, answer.pdf_of_given]
}

fn bytes(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}
