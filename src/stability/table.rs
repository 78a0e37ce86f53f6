//! `stability.csv`: one row per regime and method, in full precision; and all of them as a matrix of colours.

use anyhow::Result;
use headtail_eval::{DirectionStatistics, variance_ratio};
use serde_json::Value;

use super::method::{METHODS, MIS, Row};
use crate::report::{
    chart::{Cell, Matrix, matrix},
    vector::Drawing,
};

/// The columns in order.
const COLUMNS: [&str; 22] = [
    "regime",
    "method",
    "state",
    "message",
    "skipped_steps",
    "kl",
    "chi_square",
    "integral_error",
    "largest_weight",
    "weight_9999",
    "effective_sample_share",
    "uncovered",
    "bias",
    "bias_half_width",
    "variance_over_mis",
    "variance_over_mis_low",
    "variance_over_mis_high",
    "ns_per_sample",
    "seed",
    "version",
    "machine",
    "command",
];

/// Returns the variance relative to one-sample MIS, with its interval.
pub fn ratio(rows: &[Row], row: &Row) -> Option<(f64, f64, f64)> {
    let baseline = rows.iter().find(|other| other.regime == row.regime && other.method == MIS)?;
    match (&row.outcome, &baseline.outcome) {
        (Ok(figures), Ok(mis)) => Some(variance_ratio(&figures.variances, &mis.variances)),
        _ => None,
    }
}

/// Whether the variance is at most that of one-sample MIS.
pub fn is_no_worse(rows: &[Row], row: &Row) -> bool {
    // Another order of summation changes the last digits.
    row.method == MIS || ratio(rows, row).is_some_and(|(ratio, ..)| ratio <= 1.001)
}

/// Draws the ratios of variance, regimes by methods.
pub fn chart(rows: &[Row]) -> Drawing {
    let cell = |regime: &str, method: &str| {
        let row = rows.iter().find(|row| row.regime == regime && row.method == method);
        row.map_or(Cell::Empty, |row| ratio(rows, row).map_or(Cell::Failed, |(ratio, ..)| Cell::Ratio(ratio)))
    };
    let mut regimes: Vec<&str> = rows.iter().map(|row| row.regime.as_str()).collect();
    regimes.dedup();
    let methods = || METHODS.iter().map(|(method, _)| *method);
    let line = |name: &str| (name.to_owned(), methods().map(|method| cell(name, method)).collect());
    matrix(&Matrix {
        label: "Variance over that of one-sample MIS, regimes by methods".into(),
        columns: methods().map(str::to_owned).collect(),
        rows: regimes.into_iter().map(line).collect(),
    })
}

/// Encodes the file. Methods that failed have a message and no figures.
pub fn encode(rows: &[Row], missing: &[(String, String)], machine: &str, command: &str) -> Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(COLUMNS)?;
    let tail = ["0".to_owned(), env!("CARGO_PKG_VERSION").to_owned(), machine.to_owned(), command.to_owned()];
    for row in rows {
        let (state, message) = match &row.outcome {
            Ok(_) => ("finished", &row.note),
            Err(message) => ("stopped", message),
        };
        let head = [row.regime.clone(), row.method.into(), state.into(), message.clone(), row.skipped.to_string()];
        let figures = row.outcome.as_ref().ok().map_or_else(|| vec![String::new(); 9], numbers);
        let ratio = ratio(rows, row).map_or([const { String::new() }; 3], |(a, b, c)| [a, b, c].map(|x| x.to_string()));
        let time = row.outcome.as_ref().map_or(String::new(), |figures| figures.nanoseconds.to_string());
        writer.write_record(head.iter().chain(&figures).chain(&ratio).chain([&time]).chain(&tail))?;
    }
    for (regime, file) in missing {
        let message = format!("give --maps DIR with {file}");
        let mut record = vec![regime.clone(), String::new(), "not run".into(), message];
        record.resize(COLUMNS.len() - tail.len(), String::new());
        writer.write_record(record.iter().chain(&tail))?;
    }
    Ok(writer.into_inner()?)
}

/// Parses the file into objects: numbers as numbers, empty cells as null.
pub fn objects(csv: &[u8]) -> Result<Vec<serde_json::Map<String, Value>>> {
    // Numeric cells become numbers except in text columns.
    let is_text =
        |name: &str| matches!(name, "regime" | "method" | "state" | "message" | "version" | "machine" | "command");
    let value = |name: &str, text: &str| match text.parse::<f64>() {
        Ok(number) if !is_text(name) => Value::from(number),
        _ if text.is_empty() => Value::Null,
        _ => Value::from(text),
    };
    let mut reader = csv::Reader::from_reader(csv);
    let names = reader.headers()?.clone();
    let object = |record: csv::StringRecord| {
        names.iter().zip(&record).map(|(name, text)| (name.to_owned(), value(name, text))).collect()
    };
    reader.records().map(|record| Ok(object(record?))).collect()
}

fn numbers(figures: &DirectionStatistics) -> Vec<String> {
    let DirectionStatistics {
        kl,
        chi_square,
        integral_error,
        largest_weight,
        weight_9999,
        effective,
        uncovered,
        bias,
        ..
    } = figures;
    [kl, chi_square, integral_error, largest_weight, weight_9999, effective, uncovered, &bias.0, &bias.1]
        .map(f64::to_string)
        .to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(method: &'static str, outcome: Result<f64, &str>) -> Row {
        let figures = |variance: f64| DirectionStatistics {
            kl: 0.1,
            chi_square: variance,
            integral_error: 0.0,
            largest_weight: 2.0,
            weight_9999: 1.5,
            effective: 0.9,
            uncovered: 0.0,
            bias: (0.0, 0.01),
            variances: vec![variance, 2.0 * variance],
            nanoseconds: 100.0,
        };
        let outcome = outcome.map(figures).map_err(str::to_owned);
        Row { regime: "r".into(), method, outcome, skipped: 0, note: String::new() }
    }

    #[test]
    fn every_row_has_every_column() {
        let rows = [row(MIS, Ok(2.0)), row("head", Ok(1.0)), row("share", Err("diverged, \"badly\""))];
        let missing = [("noon".to_owned(), "noon.hdr".to_owned())];
        let bytes = encode(&rows, &missing, "a, b", "headtail stability").unwrap();
        let mut reader = csv::Reader::from_reader(bytes.as_slice());
        let records: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        assert_eq!(records.len(), 4);
        assert_eq!(&records[1][14], "0.5");
        assert_eq!((&records[2][2], &records[2][3], &records[2][14]), ("stopped", "diverged, \"badly\"", ""));
        assert_eq!(&records[3][2], "not run");
        let objects = objects(&bytes).unwrap();
        assert_eq!((objects.len(), objects[0].len()), (4, COLUMNS.len()));
        assert_eq!((&objects[1]["variance_over_mis"], &objects[1]["regime"]), (&Value::from(0.5), &Value::from("r")));
        assert_eq!((&objects[2]["message"], &objects[2]["kl"]), (&Value::from("diverged, \"badly\""), &Value::Null));
    }
}
