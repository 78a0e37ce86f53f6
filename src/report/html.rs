//! `report.html`: one page that needs nothing but itself.

use std::fmt::Write;

use anyhow::Result;
use headtail_render::statistics::{MeanInterval, RELATIVE_EPSILON, TRIMMED_FRACTION};

use super::chart;
use super::chart::pareto::{self, Place};
use super::gallery::{Gallery, Panel, Picture};
use super::number::{amount, duration, ends, escape, html, html_digits, html_uncertainty, times};
use super::picture::{self, ErrorScale};
use super::reading;
use super::slider;
use super::summary::{BudgetKind, Group, Measure, Summary, in_order};
use super::{Comparison, State};

/// What the sampler of that name is; under shadows the density of least variance is another one.
const ORACLE: &str = "The exact product of light, BRDF and cosine, without visibility, tabulated at every shading point. Where \
                      shadows matter, other samplers can have less error.";

const STYLE: &str = include_str!("page.css");
/// What makes the pages' sliders and tables work.
pub const SCRIPT: &str = include_str!("page.js");

/// The whole page. The gallery is brought up to date with the comparison.
///
/// # Errors
/// If a picture is not of the size of the reference.
pub fn page(comparison: &Comparison, summary: &Summary, gallery: &mut Gallery) -> Result<String> {
    gallery.update(comparison, summary)?;
    let gallery = &*gallery;
    let title = format!("{} under {}", comparison.scene, comparison.env);
    let mut page = format!("{}<body>\n", head(&comparison.version, &format!("{title} \u{b7} headtail comparison")));
    page += &header(comparison, summary);
    page += "<main>\n";
    page += &incomplete(comparison);
    page += &reading_section(comparison, summary);
    page += &slider(comparison, summary, gallery);
    page += &multiples(comparison, summary, gallery);
    page += &charts(summary);
    page += &table(comparison, summary);
    page += &method(comparison, summary, gallery);
    page += "</main>\n";
    push(&mut page, format_args!("<script>\n{SCRIPT}</script>\n</body>\n</html>\n"));
    Ok(page)
}

/// The page up to its body: it asks for nothing from outside.
pub fn head(version: &str, title: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; \
         style-src 'unsafe-inline'; script-src 'unsafe-inline'\">\n\
         <meta name=\"generator\" content=\"headtail {}\">\n<link rel=\"icon\" href=\"data:,\">\n\
         <title>{}</title>\n<style>\n{STYLE}</style>\n</head>\n",
        escape(version),
        escape(title),
    )
}

/// The id of the `<img>` of a rendering; names are arbitrary, so positions are used.
fn image_id(summary: &Summary, sampler: &str, budget: &str) -> String {
    let sampler = summary.samplers.iter().position(|name| name == sampler).unwrap_or(0);
    let budget = summary.budgets.iter().position(|known| known.name == budget).unwrap_or(0);
    format!("image-{budget}-{sampler}")
}

fn header(comparison: &Comparison, summary: &Summary) -> String {
    let runs = || summary.groups.iter().map(|group| group.runs);
    let runs = match (runs().min().unwrap_or(0), runs().max().unwrap_or(0)) {
        (least, most) if least == most => count(most, "run"),
        (least, most) => format!("{least} to {most} runs"),
    };
    let facts = [
        format!("{} \u{d7} {} pixels", comparison.width, comparison.height),
        count(summary.samplers.len(), "sampler"),
        count(summary.budgets.len(), "budget"),
        format!("{runs} each"),
        format!("headtail {}", comparison.version),
    ];
    let facts: Vec<String> = facts.iter().map(|fact| format!("<li>{}</li>", escape(fact))).collect();
    format!(
        "<header>\n<p class=\"kicker\">headtail \u{b7} comparison of samplers</p>\n\
         <h1>{} <span>under</span> {}</h1>\n<ul class=\"facts\">{}</ul>\n\
         <pre class=\"command\" tabindex=\"0\" aria-label=\"Command\"><code>{}</code></pre>\n</header>\n",
        escape(&comparison.scene),
        escape(&comparison.env),
        facts.concat(),
        escape(&comparison.command),
    )
}

fn count(number: usize, thing: &str) -> String {
    format!("{number} {thing}{}", if number == 1 { "" } else { "s" })
}

/// That runs are missing, if so.
fn incomplete(comparison: &Comparison) -> String {
    let done = comparison.rows.iter().filter(|row| row.run.is_some()).count();
    let why = match comparison.state {
        State::Complete => return String::new(),
        State::Running { .. } => "This comparison was running when the page was written",
        State::Interrupted { .. } => "This comparison was interrupted",
    };
    let planned = comparison.state.planned().unwrap_or(done);
    format!(
        "<p class=\"incomplete\" role=\"status\"><b>{why}: {done} of {} are done.</b> \
         The table says how many each row has; ratios and p-values are of the runs that both samplers have.</p>\n",
        count(planned, "run")
    )
}

fn reading_section(comparison: &Comparison, summary: &Summary) -> String {
    let sentences = reading::sentences(summary, comparison.reference_luminance());
    let items: Vec<String> = sentences.iter().map(|sentence| format!("<li>{sentence}</li>\n")).collect();
    let mut section = format!("<section class=\"reading\">\n<h2>In short</h2>\n<ul>\n{}</ul>\n", items.concat());
    if !comparison.preparation.is_empty() {
        section += "<p class=\"note\">Times are of rendering only; what samplers need beforehand is ";
        section += "<a href=\"#preparation\">listed below</a>.</p>\n";
    }
    section + "</section>\n"
}

fn slider(comparison: &Comparison, summary: &Summary, gallery: &Gallery) -> String {
    let Some(panel) = gallery.shown_first(summary) else { return String::new() };
    let first = &panel.budget.name;
    let best = summary.ranking(first, Measure::Mse).into_iter().find(|group| group.sampler != summary.baseline);
    let id = |sampler: &str| gallery.has(sampler, first).then(|| image_id(summary, sampler, first));
    let left = id(&summary.baseline).unwrap_or_else(|| "image-reference".to_owned());
    let right = best.and_then(|group| id(&group.sampler)).unwrap_or_else(|| "image-reference".to_owned());
    let (width, height) = (comparison.width, comparison.height);
    slider::section((width, height), &options(summary, gallery, &left), &options(summary, gallery, &right))
}

/// The choices of a side of the slider: the reference, then every sampler at every budget.
fn options(summary: &Summary, gallery: &Gallery, selected: &str) -> String {
    let option = |id: &str, text: &str, note: &str| {
        let mark = if id == selected { " selected" } else { "" };
        format!("<option value=\"{id}\" data-note=\"{}\"{mark}>{}</option>", escape(note), escape(text))
    };
    let mut options = option("image-reference", "reference", "");
    for budget in &summary.budgets {
        push(&mut options, format_args!("<optgroup label=\"{}\">", escape(&budget.words())));
        for group in summary.at(&budget.name) {
            if gallery.has(&group.sampler, &group.budget) {
                let note = ratio_words(summary, group).unwrap_or_default();
                let text = format!("{}, {}", summary.name(&group.sampler), group.budget);
                options += &option(&image_id(summary, &group.sampler, &group.budget), &text, &note);
            }
        }
        options += "</optgroup>";
    }
    options
}

/// "4.7x lower MSE than mis", in plain text; `None` for the baseline itself and for what has no ratio.
fn ratio_words(summary: &Summary, group: &Group) -> Option<String> {
    let ratio = summary.ratio(group, Measure::Mse)?;
    if group.sampler == summary.baseline {
        return None;
    }
    let (ratio, word) = if ratio.ratio >= 1.0 { (ratio, "lower") } else { (ratio.inverse(), "higher") };
    let interval = match ends(&ratio) {
        ends if ends.is_empty() => ends,
        ends => format!(" ({ends})"),
    };
    Some(format!("MSE {}\u{d7}{interval} {word} than {}", times(ratio.ratio), summary.name(&summary.baseline)))
}

fn multiples(comparison: &Comparison, summary: &Summary, gallery: &Gallery) -> String {
    let Some(first) = gallery.shown_first(summary) else { return String::new() };
    let mut section = String::from("<section>\n<h2>Every sampler</h2>\n");
    section += "<fieldset class=\"budgets\" id=\"budgets\"><legend>Budget</legend>";
    for (index, panel) in gallery.panels.iter().enumerate() {
        let checked = if panel.budget == first.budget { " checked" } else { "" };
        push(
            &mut section,
            format_args!(
                "<label><input type=\"radio\" name=\"budget\" value=\"{index}\"{checked}><span>{}</span></label>",
                escape(&panel.budget.name)
            ),
        );
    }
    let bars: Vec<String> =
        gallery.panels.iter().enumerate().map(|(index, panel)| colour_bar(index, panel, comparison)).collect();
    push(
        &mut section,
        format_args!(
            "</fieldset>\n<div class=\"multiples\">\n<figure class=\"card\"><img id=\"image-reference\" src=\"{}\" \
             alt=\"Reference image\" width=\"{}\" height=\"{}\">{}<figcaption><b>reference</b><span>{}</span></figcaption>\
             </figure>\n",
            gallery.reference,
            comparison.width,
            comparison.height,
            bars.concat(),
            escape(&comparison.reference_note),
        ),
    );
    for (index, panel) in gallery.panels.iter().enumerate() {
        push(&mut section, format_args!("<div class=\"panel\" data-panel=\"{index}\">\n"));
        for picture in &panel.pictures {
            if let Some(group) = summary.group(&picture.sampler, &panel.budget.name) {
                section += &card(comparison, summary, picture, group);
            }
        }
        section += "</div>\n";
    }
    section + "</div>\n</section>\n"
}

/// A sampler's rendering, its error map, and its MSE.
fn card(comparison: &Comparison, summary: &Summary, picture: &Picture, group: &Group) -> String {
    let name = escape(summary.name(&group.sampler));
    let ratio = match ratio_words(summary, group) {
        Some(words) => escape(&words),
        None if group.sampler == summary.baseline => "the baseline of the ratios".to_owned(),
        None => String::new(),
    };
    let (width, height) = (comparison.width, comparison.height);
    format!(
        "<figure class=\"card\"><img id=\"{}\" src=\"{}\" alt=\"{name} at {}\" width=\"{width}\" height=\"{height}\">\
         <img class=\"errors\" src=\"{}\" alt=\"Error of {name}\" width=\"{width}\" height=\"{height}\">\
         <figcaption><b>{}{name}</b><span class=\"number\">MSE {} {}</span><span>{ratio}</span></figcaption></figure>\n",
        image_id(summary, &group.sampler, &group.budget),
        picture.rendering,
        escape(&group.budget),
        picture.errors,
        chart::swatch(summary, &group.sampler),
        html(group.mse.mean),
        html_uncertainty(&group.mse),
    )
}

/// What the colours of the error maps of a budget mean, in place of the reference's own error map.
fn colour_bar(index: usize, panel: &Panel, comparison: &Comparison) -> String {
    let (from, to) = (panel.scale.bottom(), panel.scale.top);
    let ticks = [from, 0.5 * (from + to), to].map(|power| format!("<span>{}</span>", html_power(power)));
    format!(
        "<div class=\"colour-bar\" data-panel=\"{index}\" style=\"aspect-ratio:{}/{}\">\
         <p>squared error relative to the reference, at {}</p>\
         <div class=\"gradient\" style=\"background:{}\"></div><div class=\"colour-ticks\">{}</div></div>",
        comparison.width,
        comparison.height,
        escape(&panel.budget.name),
        ErrorScale::gradient(),
        ticks.concat(),
    )
}

fn html_power(power: f64) -> String {
    match power as i32 {
        0 => "1".to_owned(),
        1 => "10".to_owned(),
        power => format!("10<sup>{}</sup>", power.to_string().replace('-', "\u{2212}")),
    }
}

fn charts(summary: &Summary) -> String {
    let svg = chart::error_over_time(summary);
    let error = if svg.is_empty() {
        "<p class=\"note\">There is no positive, finite error to draw.</p>".to_owned()
    } else {
        svg
    };
    let budget = &summary.shown_first();
    let places: Vec<Place> = summary.at(&budget.name).map(|group| Place::of(summary, group)).collect();
    let speed = pareto::scatter(&places, "rendering time in seconds", "mean squared error");
    let several = summary.groups.iter().any(|group| group.runs > 1);
    let intervals = if several { " Bars are 95\u{a0}% confidence intervals." } else { "" };
    let baseline = escape(&summary.baseline_words());
    format!(
        "<section>\n<h2>Error and time</h2>\n<div class=\"charts\">\n<figure>{error}<figcaption>MSE against rendering time, \
         one line per sampler over its budgets; lower and further left is better.{intervals} Along dotted lines MSE \u{d7} time stays the same, as it does for Monte Carlo.</figcaption></figure>\n\
         <figure>{}<figcaption>How many times lower the MSE is than that of {baseline}; bars to the right of 1 are better. \
         Logarithmic.{}</figcaption></figure>\n<figure>{speed}<figcaption>Speed and accuracy at {}: one point for each sampler, further down and left is \
         better. The broad line is the Pareto front; no other sampler is both faster and more accurate than those on it, whose names are bold.</figcaption></figure>\n</div>\n</section>\n",
        chart::ratio_bars(summary),
        if several { " Whiskers are 95\u{a0}% confidence intervals." } else { "" },
        escape(&budget.words()),
    )
}

/// A column of the table.
struct Column {
    title: &'static str,
    unit: &'static str,
    cell: fn(&Summary, &Group) -> Cell,
    /// Whether the smallest value of a budget is marked.
    marked: bool,
}

/// A number of the table: what is shown and what is sorted by.
struct Cell {
    html: String,
    value: f64,
}

impl Cell {
    fn number(value: f64) -> Self {
        Self { html: html(value), value }
    }

    /// Luminances of samplers agree in their first digits, so that one more is needed.
    fn luminance(interval: &MeanInterval) -> Self {
        Self { html: html_digits(interval.mean, 4) + &html_uncertainty(interval), value: interval.mean }
    }

    fn amount(value: f64) -> Self {
        Self { html: amount(value), value }
    }

    fn interval(interval: &MeanInterval) -> Self {
        Self { html: html(interval.mean) + &html_uncertainty(interval), value: interval.mean }
    }
}

const COLUMNS: [Column; 12] = [
    Column { title: "Runs", unit: "", cell: |_, group| Cell::amount(group.runs as f64), marked: false },
    Column { title: "spp", unit: "", cell: |_, group| Cell::amount(group.mean.spp), marked: false },
    Column {
        title: "Rays",
        unit: "/ sample",
        cell: |_, group| Cell::amount(group.mean.rays_per_sample),
        marked: false,
    },
    Column { title: "Time", unit: "s", cell: |_, group| Cell::number(group.mean.seconds), marked: false },
    Column { title: "MSE", unit: "", cell: |_, group| Cell::interval(&group.mse), marked: true },
    Column { title: "MSE ratio", unit: "\u{2191} better", cell: ratio_cell, marked: false },
    Column { title: "relMSE", unit: "", cell: |_, group| Cell::interval(&group.relmse), marked: true },
    Column { title: "relMSE", unit: "trimmed", cell: |_, group| Cell::interval(&group.relmse_trimmed), marked: true },
    Column { title: "TTUV", unit: "MSE \u{d7} s", cell: |_, group| Cell::interval(&group.ttuv), marked: true },
    Column {
        title: "Fireflies",
        unit: "% of relMSE",
        cell: |_, group| Cell::amount(firefly_share(group)),
        marked: false,
    },
    Column { title: "Luminance", unit: "mean", cell: |_, group| Cell::luminance(&group.mean_luminance), marked: false },
    Column { title: "Weight", unit: "largest", cell: |_, group| Cell::number(group.mean.max_weight), marked: false },
];

/// How much of the relative squared error the worst pixels have, in per cent.
fn firefly_share(group: &Group) -> f64 {
    if group.mean.relmse_trimmed == group.mean.relmse {
        return 0.0;
    }
    let kept = (1.0 - TRIMMED_FRACTION) * group.mean.relmse_trimmed / group.mean.relmse;
    (1000.0 * (1.0 - kept)).round() / 10.0
}

fn ratio_cell(summary: &Summary, group: &Group) -> Cell {
    match summary.ratio(group, Measure::Mse) {
        Some(ratio) => {
            let interval = format!("<span class=\"ci\">{}</span>", ends(&ratio));
            Cell { html: format!("{}\u{d7}{interval}", times(ratio.ratio)), value: ratio.ratio }
        }
        None => Cell { html: "\u{2013}".to_owned(), value: f64::NAN },
    }
}

fn table(comparison: &Comparison, summary: &Summary) -> String {
    let mut section = String::from(
        "<section>\n<h2>All numbers</h2>\n<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Table of results\">\n\
         <table id=\"results\">\n<thead><tr>",
    );
    section += "<th scope=\"col\" aria-sort=\"none\"><button type=\"button\">Sampler</button></th>";
    section += "<th scope=\"col\" aria-sort=\"none\"><button type=\"button\">Budget</button></th>";
    for column in &COLUMNS {
        push(
            &mut section,
            format_args!(
                "<th scope=\"col\" class=\"number\" aria-sort=\"none\"><button type=\"button\">{}<small>{}</small></button></th>",
                column.title, column.unit
            ),
        );
    }
    section += "</tr></thead>\n";
    for (order, budget) in summary.budgets.iter().enumerate() {
        let groups: Vec<&Group> = summary.at(&budget.name).collect();
        section += "<tbody>\n";
        for group in &groups {
            section += &table_row(summary, group, &groups, order);
        }
        section += "</tbody>\n";
    }
    push(
        &mut section,
        format_args!(
            "</table>\n</div>\n<p class=\"note\"><span class=\"best\">Marked</span> values are the lowest at their budget. Means over the runs\
             {}; the reference's mean luminance is {}. Every run is in <code>results.csv</code>.</p>\n",
            if summary.groups.iter().any(|group| group.runs > 1) { " with 95\u{a0}% confidence intervals" } else { "" },
            html_digits(comparison.reference_luminance(), 4),
        ),
    );
    section + "</section>\n"
}

fn table_row(summary: &Summary, group: &Group, rivals: &[&Group], order: usize) -> String {
    let mut row = format!(
        "<tr><th scope=\"row\" data-value=\"{0}\">{1}{0}</th><td data-value=\"{order}\">{2}</td>",
        escape(summary.name(&group.sampler)),
        chart::swatch(summary, &group.sampler),
        escape(&group.budget),
    );
    for column in &COLUMNS {
        let cell = (column.cell)(summary, group);
        let values = rivals.iter().map(|rival| (column.cell)(summary, rival).value);
        let lowest = values.filter(|value| value.is_finite()).fold(f64::INFINITY, f64::min);
        let best = column.marked && rivals.len() > 1 && cell.value == lowest;
        push(
            &mut row,
            format_args!(
                "<td class=\"number{}\" data-value=\"{}\">{}</td>",
                if best { " best" } else { "" },
                cell.value,
                cell.html
            ),
        );
    }
    row + "</tr>\n"
}

fn method(comparison: &Comparison, summary: &Summary, gallery: &Gallery) -> String {
    let mut section = String::new();
    if !comparison.preparation.is_empty() {
        section += "<section id=\"preparation\">\n<h2>Before the first sample</h2>\n<div class=\"scroll\"><table class=\"plain\">\n\
                    <thead><tr><th scope=\"col\">Sampler</th><th scope=\"col\" class=\"number\">Time</th><th scope=\"col\">What</th></tr></thead>\n<tbody>\n";
        for preparation in &comparison.preparation {
            push(
                &mut section,
                format_args!(
                    "<tr><th scope=\"row\">{}</th><td class=\"number\">{}</td><td>{}</td></tr>\n",
                    escape(&preparation.sampler),
                    duration(preparation.seconds),
                    escape(&preparation.text)
                ),
            );
        }
        section += "</tbody>\n</table></div>\n</section>\n";
    }
    let side = comparison.width.div_ceil(picture::ERROR_MAP_WIDTH).max(1);
    let timed = summary.largest(BudgetKind::Time).is_some();
    let measured = comparison.measured.iter().filter(|measured| **measured).count() as f64;
    let pixels = if comparison.measured.is_empty() {
        "all pixels".to_owned()
    } else {
        format!(
            "the measured pixels, {}\u{a0}% of the image",
            times(100.0 * measured / comparison.measured.len() as f64)
        )
    };
    let points = in_order(comparison.rows.iter().map(|row| row.points.as_str()));
    let independent = points.iter().all(|points| points == "independent");
    let facts = [
        ("Machine", escape(&comparison.machine)),
        ("Reference", escape(&comparison.reference_note)),
        ("Points", escape(&points.join(", "))),
        (
            "Runs",
            "Runs of a sampler differ only in their seed. Images are those of the first run; all other numbers are means \
             over the runs, with the 95\u{a0}% interval of Student\u{2019}s t distribution."
                .to_owned(),
        ),
        (
            "Pairs",
            "Run k of every sampler has the same seed, hence the same camera rays, so samplers are compared run by run: p-values \
             are of the paired t-test on the differences of n common runs (n \u{2212} 1 degrees of freedom). A ratio is that \
             of the means over the common runs; its 95\u{a0}% interval is of its logarithm, by the delta method for paired runs."
                .to_owned(),
        ),
        ("MSE", format!("Mean over {pixels}, and over channels of (x \u{2212} r)<sup>2</sup>, r the reference, in linear Rec.709.")),
        (
            "relMSE",
            format!(
                "Mean of (x \u{2212} r)<sup>2</sup> / (r<sup>2</sup> + {RELATIVE_EPSILON}); \u{201c}trimmed\u{201d} leaves out the worst \
                 {0}\u{a0}% of pixels, and \u{201c}fireflies\u{201d} is the share of the error that these have.",
                100.0 * TRIMMED_FRACTION
            ),
        ),
        (
            "Time",
            format!(
                "Rendering only. TTUV is MSE \u{d7} time: its ratio is the ratio of the times to the same error{}.{}",
                if independent { "" } else { " only where MSE falls inversely with time; with these points it falls faster, in favour of the slower sampler" },
                if timed { " At a budget of time, a sampler takes the samples that fit into it." } else { "" }
            ),
        ),
        (
            "Images",
            format!(
                "Exposure {}{} stops for all, extended Reinhard tone curve, sRGB. Error maps: relative squared error{}, \
                 logarithmic, one scale for all samplers at a budget; cyan is not a number{}.",
                if gallery.exposure < 0.0 { "\u{2212}" } else { "+" },
                gallery.exposure.abs(),
                if side > 1 { format!(", averaged over {side} \u{d7} {side} pixels") } else { String::new() },
                if comparison.measured.is_empty() { "" } else { ", grey is not measured" },
            ),
        ),
    ];
    let oracle = summary.samplers.iter().any(|sampler| sampler == "oracle").then(|| ("Oracle", ORACLE.to_owned()));
    section += "<section>\n<h2>How it was measured</h2>\n<dl class=\"method\">\n";
    for (term, text) in facts.into_iter().chain(oracle) {
        push(&mut section, format_args!("<div><dt>{term}</dt><dd>{text}</dd></div>\n"));
    }
    section + "</dl>\n</section>\n"
}

fn push(text: &mut String, arguments: std::fmt::Arguments) {
    text.write_fmt(arguments).expect("a String takes all that is written to it");
}

#[cfg(test)]
mod tests {
    use super::super::synthetic;
    use super::super::{Comparison, Row};
    use super::*;

    fn page_of(comparison: &Comparison) -> String {
        page(comparison, &Summary::of(&comparison.rows).unwrap(), &mut Gallery::default()).unwrap()
    }

    /// The values of an attribute, wherever it occurs.
    fn values<'a>(page: &'a str, attribute: &str) -> Vec<&'a str> {
        let starts = page.match_indices(attribute).map(|(at, _)| at + attribute.len());
        starts.map(|start| &page[start..start + page[start..].find('"').unwrap()]).collect()
    }

    #[test]
    fn the_page_asks_for_nothing_from_outside() {
        let page = page_of(&synthetic::comparison());
        assert!(values(&page, " src=\"").iter().all(|address| address.starts_with("data:image/png;base64,")));
        assert!(
            values(&page, " href=\"").iter().all(|address| address.starts_with("data:,") || address.starts_with('#'))
        );
        assert!(
            !page.contains("//www") && !page.contains("http:") && !page.contains("https:") && !page.contains("@import")
        );
    }

    #[test]
    fn every_choice_of_the_slider_has_its_image_and_each_is_embedded_once() {
        let comparison = synthetic::comparison();
        let page = page_of(&comparison);
        let ids = values(&page, " id=\"");
        let choices: Vec<&str> =
            values(&page, "<option value=\"").into_iter().filter(|id| id.starts_with("image")).collect();
        assert_eq!(choices.len(), 2 * (comparison.images.len() + 1));
        for choice in choices {
            assert_eq!(ids.iter().filter(|id| **id == choice).count(), 1, "{choice}");
        }
        let sources = values(&page, " src=\"");
        assert_eq!(sources.len(), 2 * comparison.images.len() + 1);
    }

    #[test]
    fn names_from_outside_cannot_become_markup() {
        let evil = "<script>alert('x')</script>\"onload=";
        let mut comparison = synthetic::comparison();
        (comparison.scene, comparison.env) = (evil.into(), evil.into());
        (comparison.command, comparison.machine, comparison.version) = (evil.into(), evil.into(), evil.into());
        comparison.reference_note = evil.into();
        for row in &mut comparison.rows {
            (row.sampler, row.budget) = (format!("{evil}{}", row.sampler), format!("{evil}{}", row.budget));
        }
        for image in &mut comparison.images {
            (image.sampler, image.budget) = (format!("{evil}{}", image.sampler), format!("{evil}{}", image.budget));
        }
        for preparation in &mut comparison.preparation {
            (preparation.sampler, preparation.text) = (evil.into(), evil.into());
        }
        let page = page_of(&comparison);
        assert_eq!(page.matches("<script>").count(), 1, "the page's own");
        assert!(!page.contains("\"onload=") && !page.contains("alert('x')"));
    }

    #[test]
    fn the_lowest_error_of_each_budget_is_marked() {
        let comparison = synthetic::comparison();
        let page = page_of(&comparison);
        // Four budgets; MSE, relMSE, trimmed relMSE and TTUV each have a lowest value.
        assert_eq!(page.matches("class=\"number best\"").count(), 16);
    }

    #[test]
    fn poor_comparisons_make_a_page_too() {
        let complete = synthetic::comparison();
        let poor = |rows: Vec<Row>| Comparison {
            rows,
            images: Vec::new(),
            preparation: Vec::new(),
            ..synthetic::comparison()
        };
        let broken = Row { mse: f64::NAN, relmse: f64::INFINITY, seconds: 0.0, ..synthetic::row("mis", "odd", 0) };
        for rows in [vec![synthetic::row("mis", "4spp", 0)], vec![broken], complete.rows[..3].to_vec()] {
            let page = page_of(&poor(rows));
            assert!(page.contains("All numbers") && !page.contains("id=\"slider\""));
            let drawings = page.split("<svg").skip(1).map(|rest| &rest[..rest.find("</svg>").unwrap()]);
            assert!(drawings.into_iter().all(|svg| !svg.contains("NaN") && !svg.contains("inf")));
        }
    }

    #[test]
    fn missing_runs_are_told_with_the_number_of_each_row() {
        let mut comparison = synthetic::comparison();
        assert!(!page_of(&comparison).contains("class=\"incomplete\""));
        comparison.rows.truncate(82);
        for (state, words) in [
            (State::Running { planned: 84 }, "was running when the page was written: 82 of 84 runs are done"),
            (State::Interrupted { planned: 84 }, "was interrupted: 82 of 84 runs are done"),
        ] {
            comparison.state = state;
            let page = page_of(&comparison);
            assert!(page.contains(words) && page.contains("<li>1 to 3 runs each</li>"), "{words}");
            let cells = |budget: &str, runs: u32| {
                page.matches(&format!("{budget}</td><td class=\"number\" data-value=\"{runs}\">{runs}</td>")).count()
            };
            assert_eq!((cells("spp", 3), cells("2s", 3), cells("2s", 1)), (21, 6, 1));
        }
    }

    #[test]
    fn tests_are_paired_and_ratios_have_intervals() {
        let page = page_of(&synthetic::comparison());
        assert!(page.contains("paired t-test") && !page.contains("Welch"));
        let summary = Summary::of(&synthetic::comparison().rows).unwrap();
        for group in summary.groups.iter().filter(|group| group.sampler != summary.baseline) {
            let (low, high) = summary.ratio(group, Measure::Mse).unwrap().ends().unwrap();
            assert!(page.contains(&format!("<span class=\"ci\">{} to {}</span>", times(low), times(high))));
        }
    }

    #[test]
    fn the_oracle_is_explained_where_it_is_shown() {
        let mut comparison = synthetic::comparison();
        assert!(!page_of(&comparison).contains("without visibility"));
        comparison.rows.push(synthetic::row("oracle", "4spp", 0));
        assert!(page_of(&comparison).contains("exact product of light, BRDF and cosine, without visibility"));
    }

    #[test]
    fn images_of_another_size_are_refused() {
        let mut comparison = synthetic::comparison();
        comparison.images[3].image = headtail_render::image::Image::black(3, 3);
        let summary = Summary::of(&comparison.rows).unwrap();
        assert!(page(&comparison, &summary, &mut Gallery::default()).is_err());
    }
}
