//! `report.html`: one page that needs nothing but itself.

use std::fmt::Write;

use anyhow::Result;
use glam::Vec3A;
use headtail_render::color::luminance;
use headtail_render::image::Image;
use headtail_render::statistics::{MeanInterval, RELATIVE_EPSILON, TRIMMED_FRACTION};

use super::chart;
use super::number::{duration, escape, html, html_interval, times};
use super::picture::{self, ErrorMap, ErrorScale};
use super::reading;
use super::summary::{BudgetKind, Group, Measure, Summary};
use super::{Comparison, RenderedImage};

const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

/// The whole page.
pub fn page(comparison: &Comparison, summary: &Summary) -> Result<String> {
    let gallery = Gallery::of(comparison, summary)?;
    let title = format!("{} under {}", comparison.scene, comparison.env);
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; \
         style-src 'unsafe-inline'; script-src 'unsafe-inline'\">\n\
         <meta name=\"generator\" content=\"headtail {}\">\n<link rel=\"icon\" href=\"data:,\">\n\
         <title>{} \u{b7} headtail comparison</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n",
        escape(&comparison.version),
        escape(&title),
    );
    page += &header(comparison, summary);
    page += "<main>\n";
    page += &reading_section(comparison, summary);
    page += &slider(comparison, summary, &gallery);
    page += &multiples(comparison, summary, &gallery);
    page += &charts(summary);
    page += &table(comparison, summary);
    page += &method(comparison, summary, &gallery);
    page += "</main>\n";
    push(&mut page, format_args!("<script>\n{SCRIPT}</script>\n</body>\n</html>\n"));
    Ok(page)
}

/// The mean luminance of an image.
pub fn mean_luminance(image: &Image) -> f64 {
    let sum: f64 = image.pixels.iter().map(|&pixel| f64::from(luminance(Vec3A::from_array(pixel)))).sum();
    sum / image.pixels.len() as f64
}

/// The pictures of the page, each embedded once.
struct Gallery {
    exposure: f32,
    scale: ErrorScale,
    reference: String,
    pictures: Vec<Picture>,
}

/// A rendering and its error map as `data:` addresses.
struct Picture {
    sampler: String,
    budget: String,
    rendering: String,
    errors: String,
}

impl Gallery {
    fn of(comparison: &Comparison, summary: &Summary) -> Result<Self> {
        let exposure = picture::exposure(&comparison.reference);
        let known = |image: &&RenderedImage| summary.group(&image.sampler, &image.budget).is_some();
        let images: Vec<&RenderedImage> = comparison.images.iter().filter(known).collect();
        let maps = images
            .iter()
            .map(|rendered| ErrorMap::of(&rendered.image, &comparison.reference))
            .collect::<Result<Vec<_>>>()?;
        let scale = ErrorScale::of(&maps);
        let pictures = images
            .iter()
            .zip(&maps)
            .map(|(rendered, map)| {
                Ok(Picture {
                    sampler: rendered.sampler.clone(),
                    budget: rendered.budget.clone(),
                    rendering: picture::rendering(&rendered.image, exposure)?,
                    errors: map.picture(&scale)?,
                })
            })
            .collect::<Result<Vec<_>>>()?;
        let reference = picture::rendering(&comparison.reference, exposure)?;
        Ok(Self { exposure, scale, reference, pictures })
    }

    fn picture(&self, sampler: &str, budget: &str) -> Option<&Picture> {
        self.pictures.iter().find(|picture| picture.sampler == sampler && picture.budget == budget)
    }
}

/// The id of the `<img>` of a rendering; names are arbitrary, so positions are used.
fn image_id(summary: &Summary, sampler: &str, budget: &str) -> String {
    let sampler = summary.samplers.iter().position(|name| name == sampler).unwrap_or(0);
    let budget = summary.budgets.iter().position(|known| known.name == budget).unwrap_or(0);
    format!("image-{budget}-{sampler}")
}

fn header(comparison: &Comparison, summary: &Summary) -> String {
    let runs = summary.groups.iter().map(|group| group.runs).max().unwrap_or(0);
    let facts = [
        format!("{} \u{d7} {} pixels", comparison.width, comparison.height),
        count(summary.samplers.len(), "sampler"),
        count(summary.budgets.len(), "budget"),
        format!("{} each", count(runs, "run")),
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

fn reading_section(comparison: &Comparison, summary: &Summary) -> String {
    let sentences = reading::sentences(summary, mean_luminance(&comparison.reference));
    let items: Vec<String> = sentences.iter().map(|sentence| format!("<li>{sentence}</li>\n")).collect();
    let mut section = format!("<section class=\"reading\">\n<h2>In short</h2>\n<ul>\n{}</ul>\n", items.concat());
    if !comparison.preparation.is_empty() {
        section += "<p class=\"note\">Times are of rendering only; what samplers need beforehand is ";
        section += "<a href=\"#preparation\">listed below</a>.</p>\n";
    }
    section + "</section>\n"
}

fn slider(comparison: &Comparison, summary: &Summary, gallery: &Gallery) -> String {
    if gallery.pictures.is_empty() {
        return String::new();
    }
    let first = &summary.shown_first().name;
    let best = summary.ranking(first, Measure::Mse).into_iter().find(|group| group.sampler != summary.baseline);
    let id = |sampler: &str| gallery.picture(sampler, first).map(|_| image_id(summary, sampler, first));
    let left = id(&summary.baseline).unwrap_or_else(|| "image-reference".to_owned());
    let right = best.and_then(|group| id(&group.sampler)).unwrap_or_else(|| "image-reference".to_owned());
    let (width, height) = (comparison.width, comparison.height);
    format!(
        "<section>\n<h2>Side by side</h2>\n<div class=\"slider\" id=\"slider\">\n<div class=\"controls\">\n\
         <label>Left <select id=\"left\">{}</select></label>\n<label>Right <select id=\"right\">{}</select></label>\n\
         <label>Zoom <select id=\"zoom\"><option value=\"1\">fit</option><option value=\"2\">2\u{d7}</option>\
         <option value=\"4\">4\u{d7}</option><option value=\"8\">8\u{d7}</option><option value=\"16\">16\u{d7}</option></select></label>\n\
         <label class=\"check\"><input type=\"checkbox\" id=\"pixelated\" checked> Sharp pixels</label>\n</div>\n\
         <div class=\"stage\" id=\"stage\" tabindex=\"0\" role=\"group\" aria-label=\"Images; arrow keys move the zoomed part\" \
         style=\"aspect-ratio:{width}/{height};--ratio:{}\">\n\
         <img id=\"after\" alt=\"\" draggable=\"false\">\n<img id=\"before\" alt=\"\" draggable=\"false\">\n\
         <div class=\"divider\" id=\"divider\" aria-hidden=\"true\"></div>\n\
         <p class=\"tag tag-left\" id=\"tag-left\" aria-live=\"polite\"></p>\n\
         <p class=\"tag tag-right\" id=\"tag-right\" aria-live=\"polite\"></p>\n</div>\n\
         <input type=\"range\" id=\"position\" min=\"0\" max=\"100\" step=\"0.5\" value=\"50\" aria-label=\"Position of the divider\">\n\
         <p class=\"note\">Drag on the picture, or use the arrow keys on the bar below it. When zoomed in, drag the \
         divider, and the picture to move it.</p>\n</div>\n\
         <noscript><p class=\"note\">The slider needs JavaScript; all images are below.</p></noscript>\n</section>\n",
        options(summary, gallery, &left),
        options(summary, gallery, &right),
        width as f64 / height as f64,
    )
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
            if gallery.picture(&group.sampler, &group.budget).is_some() {
                let note = ratio_words(summary, group).unwrap_or_default();
                let text = format!("{}, {}", group.sampler, group.budget);
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
    let (value, word) = if ratio.value >= 1.0 { (ratio.value, "lower") } else { (1.0 / ratio.value, "higher") };
    Some(format!("MSE {}\u{d7} {word} than {}", times(value), summary.baseline))
}

fn multiples(comparison: &Comparison, summary: &Summary, gallery: &Gallery) -> String {
    if gallery.pictures.is_empty() {
        return String::new();
    }
    let budgets: Vec<_> =
        summary.budgets.iter().filter(|budget| gallery.pictures.iter().any(|p| p.budget == budget.name)).collect();
    let first = &summary.shown_first().name;
    let mut section = String::from("<section>\n<h2>Every sampler</h2>\n");
    section += "<fieldset class=\"budgets\" id=\"budgets\"><legend>Budget</legend>";
    for (index, budget) in budgets.iter().enumerate() {
        let checked = if budget.name == *first { " checked" } else { "" };
        push(
            &mut section,
            format_args!(
                "<label><input type=\"radio\" name=\"budget\" value=\"panel-{index}\"{checked}><span>{}</span></label>",
                escape(&budget.name)
            ),
        );
    }
    section += "</fieldset>\n<div class=\"multiples\">\n";
    push(
        &mut section,
        format_args!(
            "<figure class=\"card\"><img id=\"image-reference\" src=\"{}\" alt=\"Reference image\" width=\"{}\" height=\"{}\">{}\
             <figcaption><b>reference</b><span class=\"number\">{}</span></figcaption></figure>\n",
            gallery.reference,
            comparison.width,
            comparison.height,
            colour_bar(&gallery.scale, comparison),
            escape(&comparison.reference_note),
        ),
    );
    for (index, budget) in budgets.iter().enumerate() {
        push(&mut section, format_args!("<div class=\"panel\" id=\"panel-{index}\">\n"));
        for group in summary.at(&budget.name) {
            section += &card(comparison, summary, gallery, group);
        }
        section += "</div>\n";
    }
    section + "</div>\n</section>\n"
}

/// A sampler's rendering, its error map, and its MSE.
fn card(comparison: &Comparison, summary: &Summary, gallery: &Gallery, group: &Group) -> String {
    let Some(picture) = gallery.picture(&group.sampler, &group.budget) else { return String::new() };
    let name = escape(&group.sampler);
    let ratio = match ratio_words(summary, group) {
        Some(words) => escape(&words),
        None if group.sampler == summary.baseline => "the baseline of the ratios".to_owned(),
        None => String::new(),
    };
    let (width, height) = (comparison.width, comparison.height);
    format!(
        "<figure class=\"card\"><img id=\"{}\" src=\"{}\" alt=\"{name} at {}\" width=\"{width}\" height=\"{height}\">\
         <img class=\"errors\" src=\"{}\" alt=\"Error of {name}\" width=\"{width}\" height=\"{height}\">\
         <figcaption><b>{}{name}</b><span class=\"number\">MSE {}</span><span>{ratio}</span></figcaption></figure>\n",
        image_id(summary, &group.sampler, &group.budget),
        picture.rendering,
        escape(&group.budget),
        picture.errors,
        chart::swatch(summary, &group.sampler),
        html_interval(&group.mse),
    )
}

/// What the colours of the error maps mean, in place of the reference's own error map.
fn colour_bar(scale: &ErrorScale, comparison: &Comparison) -> String {
    let (from, to) = (scale.bottom(), scale.top);
    let ticks: Vec<String> = [from, from + 2.0, to].map(|power| format!("<span>{}</span>", html_power(power))).into();
    format!(
        "<div class=\"colour-bar\" style=\"aspect-ratio:{}/{}\"><p>squared error relative to the reference</p>\
         <div class=\"gradient\" style=\"background:{}\"></div><div class=\"colour-ticks\">{}</div></div>",
        comparison.width,
        comparison.height,
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
    let several = summary.groups.iter().any(|group| group.runs > 1);
    let intervals = if several { " Bars are 95\u{a0}% confidence intervals." } else { "" };
    let baseline = escape(&summary.baseline_words());
    format!(
        "<section>\n<h2>Error and time</h2>\n<div class=\"charts\">\n<figure>{error}<figcaption>MSE against rendering time, \
         one line per sampler over its budgets; lower and further left is better.{intervals} On a line parallel to the \
         dashed one, MSE falls inversely with time, as Monte Carlo must.</figcaption></figure>\n\
         <figure>{}<figcaption>How many times lower the MSE is than that of {baseline}; bars to the right of 1 are better. \
         Logarithmic.{}</figcaption></figure>\n</div>\n</section>\n",
        chart::ratio_bars(summary),
        if several { " Whiskers are 95\u{a0}% confidence intervals." } else { "" },
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

    fn interval(interval: &MeanInterval) -> Self {
        Self { html: html_interval(interval), value: interval.mean }
    }
}

const COLUMNS: [Column; 10] = [
    Column { title: "spp", unit: "", cell: |_, group| Cell::number(group.mean.spp), marked: false },
    Column {
        title: "Rays",
        unit: "per sample",
        cell: |_, group| Cell::number(group.mean.rays_per_sample),
        marked: false,
    },
    Column { title: "Time", unit: "s", cell: |_, group| Cell::number(group.mean.seconds), marked: false },
    Column { title: "MSE", unit: "", cell: |_, group| Cell::interval(&group.mse), marked: true },
    Column { title: "MSE ratio", unit: "higher is better", cell: ratio_cell, marked: false },
    Column { title: "relMSE", unit: "", cell: |_, group| Cell::interval(&group.relmse), marked: true },
    Column { title: "relMSE", unit: "trimmed", cell: |_, group| Cell::interval(&group.relmse_trimmed), marked: true },
    Column { title: "TTUV", unit: "MSE \u{d7} s", cell: |_, group| Cell::interval(&group.ttuv), marked: true },
    Column { title: "Luminance", unit: "mean", cell: |_, group| Cell::interval(&group.mean_luminance), marked: false },
    Column { title: "Weight", unit: "largest", cell: |_, group| Cell::number(group.mean.max_weight), marked: false },
];

fn ratio_cell(summary: &Summary, group: &Group) -> Cell {
    match summary.ratio(group, Measure::Mse) {
        Some(ratio) => Cell { html: format!("{}\u{d7}", times(ratio.value)), value: ratio.value },
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
            html(mean_luminance(&comparison.reference)),
        ),
    );
    section + "</section>\n"
}

fn table_row(summary: &Summary, group: &Group, rivals: &[&Group], order: usize) -> String {
    let mut row = format!(
        "<tr><th scope=\"row\" data-value=\"{0}\">{1}{0}</th><td data-value=\"{order}\">{2}</td>",
        escape(&group.sampler),
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
    let facts = [
        ("Machine", escape(&comparison.machine)),
        ("Reference", escape(&comparison.reference_note)),
        (
            "Runs",
            "Runs of a sampler differ only in their seed. Images are those of the first run; all other numbers are means \
             over the runs, with the 95\u{a0}% interval of Student\u{2019}s t distribution. p-values are of Welch\u{2019}s t-test."
                .to_owned(),
        ),
        ("MSE", "Mean over pixels and channels of (x \u{2212} r)<sup>2</sup>, r the reference, in linear Rec.709.".to_owned()),
        (
            "relMSE",
            format!(
                "Mean of (x \u{2212} r)<sup>2</sup> / (r<sup>2</sup> + {RELATIVE_EPSILON}); \u{201c}trimmed\u{201d} leaves out the worst \
                 {}\u{a0}% of pixels.",
                100.0 * TRIMMED_FRACTION
            ),
        ),
        (
            "Time",
            format!(
                "Rendering only. TTUV is MSE \u{d7} time: its ratio is the ratio of the times to the same error.{}",
                if timed { " At a budget of time, a sampler takes the samples that fit into it." } else { "" }
            ),
        ),
        (
            "Images",
            format!(
                "Exposure {}{} stops for all, extended Reinhard tone curve, sRGB. Error maps: relative squared error{}, \
                 logarithmic, one scale for all; cyan is not a number.",
                if gallery.exposure < 0.0 { "\u{2212}" } else { "+" },
                gallery.exposure.abs(),
                if side > 1 { format!(", averaged over {side} \u{d7} {side} pixels") } else { String::new() },
            ),
        ),
    ];
    section += "<section>\n<h2>How it was measured</h2>\n<dl class=\"method\">\n";
    for (term, text) in facts {
        push(&mut section, format_args!("<div><dt>{term}</dt><dd>{text}</dd></div>\n"));
    }
    section + "</dl>\n</section>\n"
}

fn push(text: &mut String, arguments: std::fmt::Arguments) {
    text.write_fmt(arguments).expect("a String takes all that is written to it");
}
