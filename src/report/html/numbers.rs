//! The tables of the page: all numbers, and preparation.

use headtail_render::statistics::{MeanInterval, TRIMMED_FRACTION};
use maud::{Markup, html};

use super::super::comparison::Comparison;
use super::super::gallery::Gallery;
use super::super::number::{ends, html_digits, percent};
use super::super::summary::{Group, Measure, Summary};
use super::super::table::{Cell, Column, Table, Value};
use maud::PreEscaped;

/// A column of the table.
struct Figure {
    title: &'static str,
    unit: &'static str,
    cell: fn(&Summary, &Gallery, &Group) -> Cell,
    /// Whether the lowest value of a budget is highlighted.
    marked: bool,
}

const fn figure(
    title: &'static str,
    unit: &'static str,
    marked: bool,
    cell: fn(&Summary, &Gallery, &Group) -> Cell,
) -> Figure {
    Figure { title, unit, cell, marked }
}

const FIGURES: [Figure; 14] = [
    figure("Runs", "", false, |_, _, group| Value::Amount(group.runs as f64).into()),
    figure("spp", "", false, |_, _, group| Value::Amount(group.mean.spp).into()),
    figure("Rays", "/ sample", false, |_, _, group| Value::Amount(group.mean.rays_per_sample).into()),
    figure("Time", "s", false, |_, _, group| interval(&group.seconds)),
    figure("MSE", "", true, |_, _, group| interval(&group.mse)),
    figure("MSE ratio", "\u{2191} better", false, |summary, _, group| ratio(summary, group)),
    figure("relMSE", "", true, |_, _, group| interval(&group.relmse)),
    figure("relMSE", "trimmed", true, |_, _, group| interval(&group.relmse_trimmed)),
    figure("FLIP", "first run", true, |_, gallery, group| flip(gallery, group, 0)),
    figure("HDR-FLIP", "first run", true, |_, gallery, group| flip(gallery, group, 1)),
    figure("TTUV", "MSE \u{d7} s", true, |_, _, group| interval(&group.ttuv)),
    figure("Fireflies", "% of relMSE", false, |_, _, group| Value::Amount(firefly_percentage(group)).into()),
    // Luminances of samplers agree in their first digits, so one more is printed.
    figure("Luminance", "mean", false, |_, _, group| {
        Cell::from(Value::Number(group.mean_luminance.mean, 4)).beside(percent(&group.mean_luminance))
    }),
    figure("Weight", "largest", false, |_, _, group| Cell::number(group.mean.max_weight)),
];

/// FLIP (`which` 0) or HDR-FLIP (1).
fn flip(gallery: &Gallery, group: &Group, which: usize) -> Cell {
    gallery.flips(&group.sampler, &group.budget).map_or(Value::Missing.into(), |flips| Cell::number(flips[which]))
}

fn interval(interval: &MeanInterval) -> Cell {
    Cell::number(interval.mean).beside(percent(interval))
}

/// Returns the percentage of relative squared error in the worst pixels.
fn firefly_percentage(group: &Group) -> f64 {
    if group.mean.relmse_trimmed == group.mean.relmse {
        return 0.0;
    }
    let kept = (1.0 - TRIMMED_FRACTION) * group.mean.relmse_trimmed / group.mean.relmse;
    (1000.0 * (1.0 - kept)).round() / 10.0
}

fn ratio(summary: &Summary, group: &Group) -> Cell {
    match summary.ratio(group, Measure::Mse) {
        Some(ratio) => Cell::from(Value::Times(ratio.ratio)).beside(ends(&ratio)),
        None => Value::Missing.into(),
    }
}

/// All numbers, one group of rows per budget.
pub fn table(summary: &Summary, gallery: &Gallery) -> Table {
    let mut columns = vec![Column::text("Sampler"), Column::text("Budget")];
    columns.extend(FIGURES.iter().map(|figure| Column::number(figure.title, figure.unit)));
    let mut groups = Vec::new();
    for (order, budget) in summary.budgets.iter().enumerate() {
        let rivals: Vec<&Group> = summary.at(&budget.name).collect();
        groups.push(rivals.iter().map(|group| row(summary, gallery, group, &rivals, order)).collect());
    }
    Table { name: "results".into(), columns, groups }
}

fn row(summary: &Summary, gallery: &Gallery, group: &Group, rivals: &[&Group], order: usize) -> Vec<Cell> {
    let swatch = summary.look(&group.sampler).swatch();
    let name = Cell { swatch, ..Cell::text(&group.sampler) };
    let mut cells = vec![name, Cell { order: Some(order as f64), ..Cell::text(&group.budget) }];
    cells.extend(FIGURES.iter().map(|figure| {
        let cell = (figure.cell)(summary, gallery, group);
        let values = rivals.iter().map(|rival| (figure.cell)(summary, gallery, rival).amount());
        let lowest = values.filter(|value| value.is_finite()).fold(f64::INFINITY, f64::min);
        let best = figure.marked && rivals.len() > 1 && cell.amount() == lowest;
        cell.marked(best)
    }));
    cells
}

/// Work that samplers need once before rendering.
pub fn preparation(comparison: &Comparison, summary: &Summary) -> Table {
    let row = |preparation: &super::super::comparison::Preparation| {
        let known = summary.samplers.contains(&preparation.sampler);
        let swatch = if known { summary.look(&preparation.sampler).swatch() } else { String::new() };
        let name = Cell { swatch, ..Cell::text(&preparation.sampler) };
        vec![name, Value::Duration(preparation.seconds).into(), Cell::text(&preparation.text)]
    };
    let columns = vec![Column::text("Sampler"), Column::number("Time", ""), Column::text("What")];
    Table::new("preparation", columns, comparison.preparation.iter().map(row).collect())
}

/// Both tables.
pub fn section(comparison: &Comparison, summary: &Summary, gallery: &Gallery) -> Markup {
    let several = summary.groups.iter().any(|group| group.runs > 1);
    html! {
        section {
            h2 { "All numbers" }
            (table(summary, gallery).html(true))
            p.note {
                span.best { "Marked" } " values are the lowest at their budget. Means over the runs"
                @if several { " with 95\u{a0}% confidence intervals" }
                "; the reference's mean luminance is " (PreEscaped(html_digits(comparison.reference_luminance(), 4)))
                ". Every run is in " code { "results.csv" } "."
            }
        }
        @if !comparison.preparation.is_empty() {
            section #preparation {
                h2 { "Before the first sample" }
                (preparation(comparison, summary).html(false))
            }
        }
    }
}
