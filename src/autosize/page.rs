//! `autosize.html`: error against time of all candidates, and the choice.

use anyhow::Result;
use headtail_eval::machine;
use headtail_render::{file, statistics::MeanInterval};
use maud::html;
use serde::Serialize;

use super::{choice::Choice, contest::Contest};
use crate::report::{
    chart::{
        Extent,
        pareto::{FRONT, MeasuredSampler, scatter},
    },
    kind::Look,
    number::{duration, ends},
    shell::Page,
    table::{Cell, Column, Table, Value},
};

/// The figures of a candidate.
#[derive(Serialize)]
pub struct Record {
    /// Name.
    name: String,
    /// SPEC for `--sampler`.
    sampler: String,
    /// The candidate whose file it uses, or from which its file was made.
    base: Option<String>,
    /// Seconds of preparation.
    prepared_seconds: f64,
    /// Size of its file.
    bytes: u64,
    /// Seconds of one sample per pixel.
    sample_seconds: f64,
    /// Number of trial pictures.
    pictures: usize,
    /// Mean squared error of a trial picture times its samples per pixel.
    error_of_sample: f64,
    /// `error_of_sample` with its interval over pictures.
    #[serde(skip)]
    error: Extent,
    /// Error at the end of the time, relative to the winner's.
    behind: Option<f64>,
    /// 95 % interval of `behind`, as text.
    interval: String,
    /// Whether it was measured to the end.
    finalist: bool,
    winner: bool,
    cheapest: bool,
}

/// Writes all figures and the page of a contest that took `seconds`, and returns the figures.
pub fn write(contest: &Contest<'_>, choice: &Choice, seconds: f64) -> Result<Vec<Record>> {
    let records = records(contest, choice);
    let folder = &contest.arguments.out;
    file::replace(&folder.join("autosize.json"), (serde_json::to_string_pretty(&records)? + "\n").as_bytes())?;
    let title = format!("{} under {}", contest.opened.scene_name(), contest.opened.environment.name());
    let times = (contest.arguments.prepare_seconds, contest.arguments.render_seconds, seconds);
    let notes: Vec<String> = contest.left_out.iter().map(|(_, sentence)| sentence.clone()).collect();
    let page = page(&title, times, &records, &notes, &contest.why_not());
    file::replace(&folder.join("autosize.html"), page.as_bytes())?;
    Ok(records)
}

/// Returns the figures of all candidates, the winner first.
fn records(contest: &Contest<'_>, choice: &Choice) -> Vec<Record> {
    let record = |(index, entry): (usize, &super::contest::Entry)| {
        let errors = entry.measurement.errors();
        let spp = f64::from(entry.measurement.samples);
        let samples: Vec<f64> = errors.iter().map(|error| error * spp).collect();
        let error = MeanInterval::of(&samples).map_or(Extent::exact(f64::NAN), |interval| Extent::from(&interval));
        let behind = contest.behind(index, choice.winner);
        let (prepared_seconds, bytes) = contest.cost(index);
        Record {
            name: entry.name.clone(),
            sampler: contest.spec(index),
            base: contest.base(&entry.recipe).map(|base| base.name.clone()),
            prepared_seconds,
            bytes,
            sample_seconds: contest.sample_seconds(&entry.measurement),
            pictures: errors.len(),
            error_of_sample: error.value,
            error,
            behind: behind.map(|ratio| ratio.ratio),
            interval: behind.filter(|_| index != choice.winner).map_or(String::new(), |ratio| ends(&ratio)),
            finalist: entry.is_in,
            winner: index == choice.winner,
            cheapest: index == choice.cheapest,
        }
    };
    let mut records: Vec<Record> = contest.entries.iter().enumerate().map(record).collect();
    records.sort_by(|a, b| a.behind.unwrap_or(f64::INFINITY).total_cmp(&b.behind.unwrap_or(f64::INFINITY)));
    records
}

/// Returns the page; times are those for preparation, for rendering and of the contest; notes are sentences
/// on candidates that were skipped.
fn page(
    title: &str,
    (prepare, render, took): (f64, f64, f64),
    records: &[Record],
    notes: &[String],
    why_not: &str,
) -> String {
    let name = |record: &Record| match (record.winner, record.cheapest) {
        (true, _) => format!("best: {}", record.name),
        (_, true) => format!("cheap: {}", record.name),
        _ => record.name.clone(),
    };
    let shown = || records.iter().filter(|record| record.pictures > 1);
    let looks = Look::of_all(shown().map(|record| record.sampler.as_str()));
    let samplers: Vec<MeasuredSampler> = shown()
        .zip(looks)
        .map(|(record, look)| MeasuredSampler {
            name: name(record),
            look,
            time: Extent::exact(1e3 * record.sample_seconds),
            error: record.error,
        })
        .collect();
    let row = |record: &Record| {
        let behind = record.behind.map_or(Value::Missing.into(), Cell::number).beside(&record.interval);
        vec![
            Cell::text(name(record)).marked(record.winner || record.cheapest),
            Value::Duration(record.prepared_seconds).into(),
            Cell::number(1e3 * record.sample_seconds),
            Cell::number(record.error_of_sample),
            behind,
            Value::Amount(record.pictures as f64).into(),
        ]
    };
    let no_preparation = records.iter().any(|record| record.winner && record.bytes == 0);
    let columns = ["Preparation", "Sample (ms)", "Error", "Behind", "Pictures"].map(|title| Column::number(title, ""));
    let columns = [vec![Column::text("Sampler")], columns.to_vec()].concat();
    let titles = ["milliseconds of a sample of every pixel", "mean squared error of a sample"];
    let main = html! {
        @if no_preparation { p.incomplete { "No preparation pays within " (render) " s of rendering: " (why_not) "." } }
        @for note in notes { p.note { (note) "." } }
        section {
            h2 { "Error against time" }
            figure {
                (scatter("candidates", &samplers, titles).html())
                figcaption.note {
                    "A sample of every pixel: its time, and the mean squared error of trial pictures times their samples, with the 95\u{a0}% interval over \
                     pictures. Preparation is not in it. " (FRONT)
                }
            }
        }
        section {
            h2 { "Candidates" }
            (Table::new("candidates", columns, records.iter().map(row).collect()).html(false))
            p.note {
                "Behind: the error once the time is up, preparation counted in, over that of the best, with its 95\u{a0}% interval over pictures that are \
                 paired by their seeds. Few pictures: dropped early."
            }
        }
    };
    let page = Page {
        kicker: "autosize",
        title: title.to_owned(),
        heading: html! { (title) },
        facts: vec![
            format!("at most {prepare} s of preparation"),
            format!("{render} s in all"),
            format!("chosen in {}", duration(took)),
            machine(),
        ],
        command: "",
        version: env!("CARGO_PKG_VERSION"),
        style: "",
        script: "",
    };
    page.encode(&main)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(name: &str, sample_seconds: f64, error: f64, bytes: u64) -> Record {
        Record {
            name: name.to_owned(),
            sampler: name.to_owned(),
            base: None,
            prepared_seconds: 0.0,
            bytes,
            sample_seconds,
            pictures: 4,
            error_of_sample: error,
            error: Extent::exact(error),
            behind: Some(1.0),
            interval: String::new(),
            finalist: true,
            winner: false,
            cheapest: false,
        }
    }

    #[test]
    fn chart_shows_the_front_and_the_choice() {
        let mut records =
            vec![record("table", 2.0, 0.5, 900), record("mis", 1.0, 2.0, 0), record("ris:4", 3.0, 3.0, 0)];
        (records[0].winner, records[1].cheapest) = (true, true);
        let of = |records: &[Record]| page("room", (30.0, 60.0, 5.0), records, &[], "heads are behind");
        let text = of(&records);
        let groups = || text.split("on-front\">").skip(1).filter_map(|rest| rest.split("</g>").next());
        for (name, is_on_front) in [("best: table", true), ("cheap: mis", true), ("ris:4", false)] {
            assert_eq!(groups().any(|group| group.contains(name)), is_on_front, "{name}");
        }
        assert!(text.contains("class=\"front\"") && !text.contains("No preparation pays"));
        (records[0].winner, records[1].winner) = (false, true);
        let text = of(&records);
        assert!(text.contains("No preparation pays within 60 s of rendering: heads are behind."), "{text}");
    }
}
