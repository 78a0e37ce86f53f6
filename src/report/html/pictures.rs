//! The pictures of the page: two with a divider, and all of them with insets and error maps.

use headtail_render::statistics::RatioInterval;
use maud::{Markup, PreEscaped, html};

use super::super::colours::ERROR;
use super::super::comparison::Comparison;
use super::super::gallery::{Gallery, Panel, Picture};
use super::super::number::{self, ends, html_uncertainty, times};
use super::super::stage::{self, Choice};
use super::super::summary::{Group, Measure, Summary};

const REFERENCE: &str = "image-reference";

/// The id of a rendering's `<img>`. Names are arbitrary, so indices are used.
fn image_id(summary: &Summary, sampler: &str, budget: &str) -> String {
    let sampler = summary.samplers.iter().position(|name| name == sampler).unwrap_or(0);
    let budget = summary.budgets.iter().position(|known| known.name == budget).unwrap_or(0);
    format!("image-{budget}-{sampler}")
}

/// The baseline and the best other sampler with a divider.
pub fn stage(comparison: &Comparison, summary: &Summary, gallery: &Gallery) -> Markup {
    let Some(panel) = gallery.shown_first(summary) else { return PreEscaped(String::new()) };
    let first = &panel.budget.name;
    let best = summary.ranking(first, Measure::Mse).into_iter().find(|group| group.sampler != summary.baseline);
    let id = |sampler: &str| gallery.has(sampler, first).then(|| image_id(summary, sampler, first));
    let left = id(&summary.baseline).unwrap_or_else(|| REFERENCE.to_owned());
    let right = best.and_then(|group| id(&group.sampler)).unwrap_or_else(|| REFERENCE.to_owned());
    let reference = Choice { id: REFERENCE.into(), name: "reference".into(), note: String::new() };
    let mut choices = vec![(String::new(), vec![reference])];
    for budget in &summary.budgets {
        let groups = summary.at(&budget.name).filter(|group| gallery.has(&group.sampler, &group.budget));
        let own = groups.map(|group| Choice {
            id: image_id(summary, &group.sampler, &group.budget),
            name: format!("{}, {}", group.sampler, group.budget),
            note: ratio_words(summary, group).unwrap_or_default(),
        });
        choices.push((budget.words(), own.collect()));
    }
    stage::section((comparison.width, comparison.height), &choices, [&left, &right])
}

/// Every sampler's picture, one budget at a time.
pub fn multiples(comparison: &Comparison, summary: &Summary, gallery: &Gallery) -> Markup {
    let Some(first) = gallery.shown_first(summary) else { return PreEscaped(String::new()) };
    let size = (comparison.width, comparison.height);
    // Including the reference.
    let most = 1 + gallery.panels.iter().map(|panel| panel.pictures.len()).max().unwrap_or(0);
    html! {
        section {
            h2 { "Every sampler" }
            div.choices {
                fieldset.choice #budgets {
                    legend { "Budget" }
                    @for (index, panel) in gallery.panels.iter().enumerate() {
                        label {
                            input type="radio" name="budget" value=(index) checked[panel.budget == first.budget];
                            span { (panel.budget.name) }
                        }
                    }
                }
                fieldset.choice #maps {
                    legend { "Below" }
                    label { input type="radio" name="map" value="error" checked; span { "error" } }
                    label { input type="radio" name="map" value="flip"; span title="how different a picture looks" { "FLIP" } }
                    label { input type="radio" name="map" value="none"; span { "nothing" } }
                }
                fieldset.choice #inset-choice {
                    legend { "Insets" }
                    label.inset-0 { input type="radio" name="inset" value="0" checked; span { "1" } }
                    label.inset-1 { input type="radio" name="inset" value="1"; span { "2" } }
                    label { input type="radio" name="inset" value="none"; span { "none" } }
                }
            }
            p.note #inset-help {
                "Click or drag on any picture to move the chosen inset on all of them; with the keyboard, go to a picture: arrow keys move the \
                 inset, + and \u{2212} change its size, 1 and 2 choose. The address of the page keeps where they are."
            }
            div.multiples #multiples data-pictures=(most) data-insets=(gallery.insets) {
                figure.card {
                    (picture(REFERENCE, "Reference image", size, (&gallery.reference, gallery.reference_radiance.as_deref())))
                    @for (index, panel) in gallery.panels.iter().enumerate() { (colour_bars(index, panel, size)) }
                    figcaption { b { "reference" } span { (comparison.reference_note) } }
                }
                @for (index, panel) in gallery.panels.iter().enumerate() {
                    div.panel data-panel=(index) {
                        @for picture in &panel.pictures {
                            @if let Some(group) = summary.group(&picture.sampler, &panel.budget.name) { (card(size, summary, picture, group)) }
                        }
                    }
                }
            }
        }
    }
}

/// A picture for choosing insets, with its linear values for the page's script.
fn picture(id: &str, alt: &str, (width, height): (usize, usize), (address, radiance): (&str, Option<&str>)) -> Markup {
    html! {
        div.picture tabindex="0" role="group" aria-describedby="inset-help" aria-label=(alt) {
            img #(id) src=(address) alt=(alt) width=(width) height=(height);
            @if let Some(radiance) = radiance { script type="text/plain" data-of=(id) { (PreEscaped(radiance)) } }
        }
    }
}

/// A sampler's rendering, its error maps and its MSE.
fn card(size: (usize, usize), summary: &Summary, shown: &Picture, group: &Group) -> Markup {
    let name = &group.sampler;
    let ratio = match ratio_words(summary, group) {
        Some(words) => words,
        None if *name == summary.baseline => "the baseline of the ratios".to_owned(),
        None => String::new(),
    };
    let id = image_id(summary, name, &group.budget);
    let map = |kind: &str, what: &str, address: &str| {
        html! { img.errors data-map=(kind) src=(address) alt={ (what) " of " (name) } width=(size.0) height=(size.1); }
    };
    html! {
        figure.card {
            (picture(&id, &format!("{name} at {}", group.budget), size, (&shown.rendering, shown.radiance.as_deref())))
            (map("error", "Error", &shown.errors))
            (map("flip", "FLIP", &shown.flip_map))
            figcaption {
                b { (PreEscaped(summary.look(name).swatch())) (name) }
                span.number { "MSE " (PreEscaped(number::html(group.mse.mean))) " " (PreEscaped(html_uncertainty(&group.mse))) }
                span.number { "FLIP " (number::text(shown.flip)) }
                span { (ratio) }
            }
        }
    }
}

/// The colour scales of a budget's maps, shown in place of the reference.
fn colour_bars(index: usize, panel: &Panel, (width, height): (usize, usize)) -> Markup {
    let (from, to) = (panel.scale.bottom(), panel.scale.top);
    let budget = &panel.budget.name;
    let powers = [from, 0.5 * (from + to), to].map(power);
    let fractions = ["0", "0.5", "1"].map(str::to_owned);
    let bar = |kind: &str, words: &str, ticks: [String; 3]| {
        html! {
            div.colour-bar data-panel=(index) data-map=(kind) style={ "aspect-ratio:" (width) "/" (height) } {
                p { (words) ", at " (budget) }
                div.gradient style={ "background:" (ERROR.gradient()) } {}
                div.colour-ticks { @for tick in ticks { span { (PreEscaped(tick)) } } }
            }
        }
    };
    html! {
        (bar("error", "squared error relative to the reference", powers))
        (bar("flip", "FLIP: how different it looks", fractions))
    }
}

fn power(power: f64) -> String {
    match power as i32 {
        0 => "1".to_owned(),
        1 => "10".to_owned(),
        power => format!("10<sup>{}</sup>", power.to_string().replace('-', "\u{2212}")),
    }
}

/// Returns "4.7x lower MSE than mis" in plain text; `None` for the baseline and without a ratio.
fn ratio_words(summary: &Summary, group: &Group) -> Option<String> {
    let ratio = summary.ratio(group, Measure::Mse)?;
    if group.sampler == summary.baseline {
        return None;
    }
    let (ratio, word) = if ratio.ratio >= 1.0 { (ratio, "lower") } else { (ratio.inverse(), "higher") };
    Some(format!("MSE {}\u{d7}{} {word} than {}", times(ratio.ratio), in_brackets(&ratio), summary.baseline))
}

fn in_brackets(ratio: &RatioInterval) -> String {
    match ends(ratio) {
        ends if ends.is_empty() => ends,
        ends => format!(" ({ends})"),
    }
}
