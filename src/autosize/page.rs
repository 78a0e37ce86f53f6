//! `autosize.html`: error against time of all candidates, and the choice.

use serde::Serialize;

use super::contest::{Choice, Contest};
use crate::{
    compare::machine,
    report::{
        chart::pareto::{Place, scatter},
        html,
        number::{duration, ends, escape, text},
    },
};

/// The figures of a candidate.
#[derive(Serialize)]
pub struct Record {
    /// Its name.
    name: String,
    /// As `--sampler` takes it.
    sampler: String,
    /// Seconds of preparation.
    prepared_seconds: f64,
    /// Of its file.
    bytes: u64,
    /// Seconds of a sample of every pixel.
    sample_seconds: f64,
    /// Trial pictures.
    pictures: usize,
    /// Mean squared error of a trial picture times its samples per pixel.
    error_of_sample: f64,
    /// Error once the time is up over the winner's.
    behind: Option<f64>,
    /// Its 95 % interval in words.
    interval: String,
    /// Whether it was measured to the end.
    finalist: bool,
    winner: bool,
    cheapest: bool,
}

/// The figures of all candidates, the winner first.
pub fn records(contest: &Contest<'_>, choice: &Choice) -> Vec<Record> {
    let record = |(index, entry): (usize, &super::contest::Entry)| {
        let errors = entry.measurement.errors();
        let behind = contest.behind(index, choice.winner);
        let (prepared_seconds, bytes) = contest.cost(index);
        Record {
            name: entry.name.clone(),
            sampler: contest.spec(index),
            prepared_seconds,
            bytes,
            sample_seconds: contest.sample_seconds(&entry.measurement),
            pictures: errors.len(),
            error_of_sample: errors.iter().sum::<f64>() / errors.len() as f64 * f64::from(entry.measurement.spp),
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

/// The page; times are those for preparation and rendering, and what the choice took.
pub fn page(title: &str, (prepare, render, took): (f64, f64, f64), records: &[Record], why_not: &str) -> String {
    let name = |record: &Record| match (record.winner, record.cheapest) {
        (true, _) => format!("best: {}", record.name),
        (_, true) => format!("cheap: {}", record.name),
        _ => record.name.clone(),
    };
    let places: Vec<Place> = records
        .iter()
        .filter(|record| record.pictures > 1)
        .enumerate()
        .map(|(index, record)| Place::new(name(record), index, record.sample_seconds, record.error_of_sample))
        .collect();
    let row = |record: &Record| {
        let behind = record.behind.map_or("\u{2013}".to_owned(), text);
        let mark = if record.winner || record.cheapest { " class=\"best\"" } else { "" };
        format!(
            "<tr><th scope=\"row\"{mark}>{}</th><td class=\"number\">{}</td><td class=\"number\">{}</td><td class=\"number\">{}</td>\
             <td class=\"number\">{behind}<span class=\"ci\">{}</span></td><td class=\"number\">{}</td></tr>\n",
            escape(&name(record)),
            duration(record.prepared_seconds),
            text(1e3 * record.sample_seconds),
            text(record.error_of_sample),
            record.interval,
            record.pictures,
        )
    };
    let no_preparation = records.iter().any(|record| record.winner && record.bytes == 0);
    let verdict = if no_preparation {
        format!(
            "<p class=\"incomplete\">No preparation pays within {render} s of rendering: {}.</p>\n",
            escape(why_not)
        )
    } else {
        String::new()
    };
    format!(
        "{}<body>\n<header>\n<p class=\"kicker\">headtail \u{b7} autosize</p>\n<h1>{}</h1>\n<ul class=\"facts\"><li>at most {prepare} s of preparation</li>\
         <li>{render} s in all</li><li>chosen in {}</li><li>{}</li></ul>\n{verdict}</header>\n<main>\n<section>\n<h2>Error against time</h2>\n\
         <figure>{}<figcaption class=\"note\">A sample of every pixel: its time, and the mean squared error of trial pictures times their samples. The broad line \
         is the Pareto front. Preparation is not in it.</figcaption></figure>\n</section>\n<section>\n<h2>Candidates</h2>\n<div class=\"scroll\"><table class=\"plain\">\
         <thead><tr><th scope=\"col\">Sampler</th><th scope=\"col\" class=\"number\">Preparation</th><th scope=\"col\" class=\"number\">Sample (ms)</th>\
         <th scope=\"col\" class=\"number\">Error</th><th scope=\"col\" class=\"number\">Behind</th><th scope=\"col\" class=\"number\">Pictures</th></tr></thead>\n\
         <tbody>{}</tbody></table></div>\n<p class=\"note\">Behind: the error once the time is up, preparation counted in, over that of the best, with its 95\u{a0}% \
         interval over pictures that are paired by their seeds. Few pictures: dropped early.</p>\n</section>\n</main>\n</body>\n</html>\n",
        html::head(env!("CARGO_PKG_VERSION"), &format!("{title} \u{b7} headtail autosize")),
        escape(title),
        duration(took),
        escape(&machine()),
        scatter(&places, "seconds of a sample of every pixel", "mean squared error of a sample"),
        records.iter().map(row).collect::<String>(),
    )
}
