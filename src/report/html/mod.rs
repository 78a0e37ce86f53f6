//! `report.html`, a self-contained page.
//!
//! | file | concept |
//! | --- | --- |
//! | `numbers.rs`, `pictures.rs` | tables and pictures |
//! | `method.rs` | how a comparison was measured |

mod method;
mod numbers;
mod pictures;

use anyhow::Result;
use maud::{Markup, PreEscaped, html};

use super::chart::pareto::{self, FRONT, MeasuredSampler};
use super::chart::{self};
use super::comparison::{Comparison, State};
use super::gallery::Gallery;
use super::reading;
use super::shell::{Page, count};
use super::summary::Summary;
use super::table::Table;
use super::vector::Chart;

/// Returns the page and updates the gallery.
///
/// # Errors
/// If a picture differs in size from the reference.
pub fn page(comparison: &Comparison, summary: &Summary, gallery: &mut Gallery) -> Result<String> {
    gallery.update(comparison, summary)?;
    let gallery = &*gallery;
    let main = html! {
        (incomplete(comparison))
        (reading(comparison, summary))
        (pictures::stage(comparison, summary, gallery))
        (pictures::multiples(comparison, summary, gallery))
        (charts(summary))
        (numbers::section(comparison, summary, gallery))
        (method::section(comparison, gallery))
    };
    let page = Page {
        kicker: "comparison of samplers",
        title: format!("{} under {}", comparison.scene, comparison.env),
        heading: html! { (comparison.scene) " " span { "under" } " " (comparison.env) },
        facts: facts(comparison, summary),
        command: &comparison.command,
        version: &comparison.version,
        style: "",
        script: "",
    };
    Ok(page.encode(&main))
}

/// Returns the charts and tables that are also written as files.
pub fn figures(comparison: &Comparison, summary: &Summary, gallery: &Gallery) -> (Vec<Chart>, Vec<Table>) {
    let charts = vec![chart::error_over_time(summary), chart::ratio_bars(summary), speed(summary)];
    (charts, vec![numbers::table(summary, gallery), numbers::preparation(comparison, summary)])
}

fn facts(comparison: &Comparison, summary: &Summary) -> Vec<String> {
    let runs = || summary.groups.iter().map(|group| group.runs);
    let runs = match (runs().min().unwrap_or(0), runs().max().unwrap_or(0)) {
        (least, most) if least == most => count(most, "run"),
        (least, most) => format!("{least} to {most} runs"),
    };
    vec![
        format!("{} \u{d7} {} pixels", comparison.width, comparison.height),
        count(summary.samplers.len(), "sampler"),
        count(summary.budgets.len(), "budget"),
        format!("{runs} each"),
        format!("headtail {}", comparison.version),
    ]
}

/// A note if runs are missing.
fn incomplete(comparison: &Comparison) -> Markup {
    let done = comparison.rows.len();
    let why = match comparison.state {
        State::Complete => return PreEscaped(String::new()),
        State::Running { .. } => "This comparison was running when the page was written",
        State::Interrupted { .. } => "This comparison was interrupted",
    };
    let planned = comparison.state.planned().unwrap_or(done);
    html! {
        p.incomplete role="status" {
            b { (why) ": " (done) " of " (count(planned, "run")) " are done." }
            " The table says how many each row has; ratios and p-values are of the runs that both samplers have."
        }
    }
}

fn reading(comparison: &Comparison, summary: &Summary) -> Markup {
    html! {
        section.reading {
            h2 { "In short" }
            ul {
                @for sentence in reading::sentences(summary, comparison.reference_luminance()) { li { (PreEscaped(sentence)) } }
            }
            @if !comparison.preparation.is_empty() {
                p.note {
                    "Times are of rendering only; what samplers need beforehand is " a href="#preparation" { "listed below" } "."
                }
            }
        }
    }
}

/// Speed and accuracy at the budget that is shown first.
fn speed(summary: &Summary) -> Chart {
    let samplers: Vec<MeasuredSampler> =
        summary.at(&summary.shown_first().name).map(|group| MeasuredSampler::of(summary, group)).collect();
    pareto::scatter("speed-accuracy", &samplers, ["rendering time in seconds", "mean squared error"])
}

fn charts(summary: &Summary) -> Markup {
    let error = chart::error_over_time(summary);
    let several = summary.groups.iter().any(|group| group.runs > 1);
    let bars = if several { " Bars are 95\u{a0}% confidence intervals, of error and of time." } else { "" };
    let whiskers = if several { " Whiskers are 95\u{a0}% confidence intervals." } else { "" };
    let budget = summary.shown_first().words();
    html! {
        section {
            h2 { "Error and time" }
            div.charts {
                figure {
                    @if error.drawings.is_empty() { p.note { "There is no positive, finite error to draw." } }
                    (error.html())
                    figcaption {
                        "MSE against rendering time, one line per sampler over its budgets; lower and further left is better." (bars)
                        " Along dotted lines MSE \u{d7} time stays the same, as it does for Monte Carlo."
                    }
                }
                figure {
                    (chart::ratio_bars(summary).html())
                    figcaption {
                        "How many times lower the MSE is than that of " (summary.baseline_words())
                        "; bars to the right of 1 are better. Logarithmic." (whiskers)
                    }
                }
                figure {
                    (speed(summary).html())
                    figcaption {
                        "Speed and accuracy at " (budget) ": one point for each sampler, further down and left is better." (bars) " " (FRONT)
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
