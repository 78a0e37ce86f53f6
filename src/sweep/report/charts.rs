//! Sections of the page, with the charts and tables common to all pages.

use maud::{Markup, html};

use super::configuration::Configuration;
use crate::{
    report::{
        chart::{self, Bar, Curve, Extent, Spot},
        number,
        shell::count,
        table::{Cell, Column, Table, Value},
    },
    sweep::effect::Effect,
};

/// Number of configurations in the table besides those of the front: the best ones.
const LISTED: usize = 20;

/// Name of the work of configurations, which is shown beside the objectives.
const WORK: &str = "seconds of work";

/// Charts every objective against every other, and against the work; the script shows one chart at a time.
pub fn to_be_had(objectives: &[String], configurations: &[Configuration]) -> Markup {
    let figure = |configuration: &Configuration, index: usize| {
        configuration.figures.get(index).copied().unwrap_or(configuration.seconds)
    };
    let titles: Vec<&str> = objectives.iter().map(String::as_str).chain([WORK]).collect();
    let pairs = || (0..objectives.len()).flat_map(|up| (up + 1..titles.len()).map(move |across| (across, up)));
    let spots = |(across, up): (usize, usize)| -> Vec<Spot> {
        let spot = |(index, own): (usize, &Configuration)| Spot {
            index,
            at: [figure(own, across), figure(own, up)],
            is_marked: own.front,
        };
        configurations.iter().enumerate().map(spot).collect()
    };
    html! {
        @if !configurations.is_empty() {
            section {
                h2 { "Trade-offs" }
                div.controls { label {
                    "show "
                    select #pair {
                        @for (k, (across, up)) in pairs().enumerate() {
                            option value=(k) { (titles[up]) " against " (titles[across]) }
                        }
                    }
                } }
                figure #pareto {
                    @for (k, (across, up)) in pairs().enumerate() {
                        div data-pair=(k) hidden[k > 0] {
                            (chart::spots(&format!("front-{k}"), &spots((across, up)), [titles[across], titles[up]]).html())
                        }
                    }
                    figcaption.note {
                        "One point for each configuration whose trials are all done; its figures are aggregated over them. Filled points are those that no \
                         other beats in every objective; the broad line joins those that none beats in the two that are shown. Choose a point to see its runs, with commands for the folder that the sweep was run from."
                    }
                }
                div #detail.detail hidden {}
                (table_of(objectives, configurations).html(true))
            }
        }
    }
}

/// Table of the front and the best configurations.
fn table_of(objectives: &[String], configurations: &[Configuration]) -> Table {
    let mut order: Vec<&Configuration> = configurations.iter().collect();
    order.sort_by(|a, b| a.figures[0].total_cmp(&b.figures[0]));
    let shown = order.iter().enumerate().filter(|(place, own)| *place < LISTED || own.front).map(|(_, own)| own);
    let row = |own: &&Configuration| {
        let figures = own.figures.iter().map(|&figure| Cell::number(figure));
        let name = if own.name.is_empty() { "the fixed settings" } else { &own.name };
        let first = Cell::text(name).marked(own.front);
        let last = [Value::Duration(own.seconds).into(), Value::Amount(own.trials.len() as f64).into()];
        [first].into_iter().chain(figures).chain(last).collect()
    };
    let columns = objectives.iter().map(|name| Column::number(name, ""));
    let last = [Column::number("work", ""), Column::number("trials", "")];
    let columns = [Column::text("configuration")].into_iter().chain(columns).chain(last);
    Table::new("configurations", columns.collect(), shown.map(row).collect())
}

/// Placeholder for the script's parallel coordinates.
pub fn interactive() -> Markup {
    html! {
        section {
            h2 { "Settings and figures" }
            figure.wide-only {
                svg #parallel.chart viewBox="0 0 1120 360" role="img" aria-label="Parallel coordinates, one line for each trial" {}
            }
            p.note #parallel-note {
                "One line for each trial. Drag along an axis to keep the trials that pass there, click on it to let go; the table of trials follows."
            }
        }
    }
}

/// Charts the effect of each value of a setting.
pub fn effects(objective: &str, effects: &[(String, Vec<Effect>)], has_seeds: bool) -> Markup {
    let bar = |effect: &Effect| Bar {
        name: effect.value.rsplit('/').next().unwrap_or_default().to_owned(),
        extent: Extent { value: effect.ratio, ends: effect.ends },
    };
    let groups: Vec<(String, Vec<Bar>)> =
        effects.iter().map(|(key, effects)| (key.clone(), effects.iter().map(bar).collect())).collect();
    let row = |key: &str, effect: &Effect| {
        let interval =
            effect.ends.map_or(String::new(), |(low, high)| format!("{} to {}", number::text(low), number::text(high)));
        let trials = Value::Amount(effect.trials as f64).into();
        vec![Cell::text(key), Cell::text(&effect.value), Cell::number(effect.ratio).beside(interval), trials]
    };
    let columns =
        vec![Column::text("setting"), Column::text("value"), Column::number("ratio", ""), Column::number("trials", "")];
    let mut table = Table::new("effects", columns, Vec::new());
    table.groups = effects.iter().map(|(key, effects)| effects.iter().map(|own| row(key, own)).collect()).collect();
    let over = if has_seeds { "seeds" } else { "trials" };
    html! {
        @if !effects.is_empty() {
            section {
                h2 { "What each setting does" }
                figure {
                    (chart::effects("effects", &groups, &format!("{objective} under each value over that of all trials")).html())
                    figcaption.note {
                        (objective) " under each value over that of all trials, geometric means: less than 1 is better. Lines are 95\u{a0}% intervals over "
                        (over) ". Trials are compared with those of the same map, and of the same seed where all seeds have the same settings. Ranges are divided into parts with equally many trials."
                    }
                }
                (table.html(true))
            }
        }
    }
}

/// Charts validation over steps.
pub fn learning(objective: &str, curves: &[Curve]) -> Markup {
    html! {
        @if !curves.is_empty() {
            section {
                h2 { "Learning curves" }
                figure {
                    (chart::curves("curves", curves, ["steps", "relative variance"]).html())
                    figcaption.note {
                        "Validation of the best " (count(curves.len(), "trial")) " by " (objective) "; the best one is marked."
                    }
                }
            }
        }
    }
}

/// Placeholder for the table that the script makes, sorts and filters.
pub fn trials() -> Markup {
    html! {
        section {
            h2 { "Trials" }
            div.controls {
                label for="filter" { "show" }
                input #filter type="search" placeholder="head.bins=8 relative_variance<0.1 failed" aria-describedby="filter-note";
                span #shown {}
            }
            p.note #filter-note { "Words that a row must have; NAME=VALUE, NAME<NUMBER and NAME>NUMBER compare a column." }
            div.scroll tabindex="0" role="region" aria-label="Trials" { table #trials { thead {} tbody {} } }
            p { button #more type="button" hidden { "Show more" } }
            p.save { "Save this chart: " button #save-tex type="button" { "TEX" } " " button #save-csv type="button" { "CSV" } }
        }
    }
}
