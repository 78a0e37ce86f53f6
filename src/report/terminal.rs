//! The means of a comparison as lines of text for a terminal.

use std::fmt::Write;

use anyhow::Result;

use super::summary::{Measure, Summary};
use headtail_eval::Measurement;

/// Returns a heading, then a line per sampler and budget: number of runs, mean MSE, its ratio to the
/// baseline's with the 95 % interval, samples per pixel, seconds.
///
/// # Errors
/// If there are no runs.
pub fn lines(rows: &[Measurement]) -> Result<String> {
    let summary = Summary::of(rows)?;
    let mut lines = format!(
        "{:10} {:44} {:>5} {:>10} {:>8} {:16} {:>9} {:>9}",
        "budget", "sampler", "runs", "MSE", "ratio", "95 % interval", "spp", "seconds"
    );
    for group in &summary.groups {
        let ratio = summary.ratio(group, Measure::Mse);
        let value = ratio.map_or("-".to_owned(), |ratio| format!("{:.2}", ratio.ratio));
        let ends = ratio.and_then(|ratio| ratio.ends()).filter(|(low, high)| low < high);
        let ends = ends.map_or(String::new(), |(low, high)| format!("{low:.2} to {high:.2}"));
        write!(
            lines,
            "\n{:10} {:44} {:>5} {:>10.3e} {value:>8} {ends:16} {:>9.1} {:>9.3}",
            group.budget, group.sampler, group.runs, group.mean.mse, group.mean.spp, group.mean.seconds
        )?;
    }
    Ok(lines)
}

#[cfg(test)]
mod tests {
    use super::super::synthetic;
    use super::*;

    #[test]
    fn every_row_has_its_runs_and_its_ratio() {
        let run = |sampler: &str, run: u32, mse: f64| Measurement { mse, ..synthetic::row(sampler, "4spp", run) };
        let rows =
            [run("mis", 0, 1.0), run("mis", 1, 1.1), run("ris:4", 0, 0.5), run("ris:4", 1, 0.56), run("odd", 0, 0.0)];
        let text = lines(&rows).unwrap();
        let fields: Vec<Vec<&str>> = text.lines().map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(fields[1][..5], ["4spp", "mis", "2", "1.050e0", "1.00"]);
        assert_eq!(fields[2][..8], ["4spp", "ris:4", "2", "5.300e-1", "1.98", "1.77", "to", "2.22"]);
        assert_eq!(fields[3][..5], ["4spp", "odd", "1", "0.000e0", "-"]);
        assert!(lines(&[]).is_err());
    }
}
