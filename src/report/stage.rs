//! Two superimposed pictures with a draggable divider, their difference, and an exposure.

use maud::{Markup, html};

/// A picture to choose for a side: the id of an `<img>` element on the page.
pub struct Choice {
    /// The id.
    pub id: String,
    /// Its name.
    pub name: String,
    /// Text below the name on the picture; may be empty.
    pub note: String,
}

/// Choices grouped under headings; an empty heading is not shown.
pub type Choices = [(String, Vec<Choice>)];

/// Returns the section; the last argument has the ids that are shown first.
pub fn section((width, height): (usize, usize), choices: &Choices, [left, right]: [&str; 2]) -> Markup {
    let ratio = width as f64 / height as f64;
    html! {
        section {
            h2 { "Side by side" }
            div.slider #slider {
                div.controls {
                    label { "Left " select #left { (options(choices, left)) } }
                    label { "Right " select #right { (options(choices, right)) } }
                    label { "Show " select #mode {
                        option value="both" { "left | right" }
                        option value="difference" { "|right \u{2212} left|" }
                        option value="relative" { "(right \u{2212} left) / left" }
                    } }
                    label { "Zoom " select #zoom {
                        option value="1" { "fit" }
                        @for zoom in [2, 4, 8, 16] { option value=(zoom) { (zoom) "\u{d7}" } }
                    } }
                    label { "Exposure " input #exposure type="range" min="-8" max="8" step="0.25" value="0"; output #stops { "0" } }
                    label.check { input #pixelated type="checkbox" checked; " Sharp pixels" }
                }
                div.stage #stage tabindex="0" role="group" aria-label="Pictures; arrow keys move the divider or the zoomed part"
                    style={ "aspect-ratio:" (width) "/" (height) ";--ratio:" (ratio) } {
                    canvas #after role="img" {}
                    canvas #before role="img" {}
                    canvas #difference role="img" hidden {}
                    div.divider #divider aria-hidden="true" {}
                    p.tag.tag-left #tag-left aria-live="polite" {}
                    p.tag.tag-right #tag-right aria-live="polite" {}
                }
                input #position type="range" min="0" max="100" step="0.5" value="50" aria-label="Position of the divider";
                p.note {
                    "Drag on the picture, or use the arrow keys. When zoomed in, drag the divider, and the picture to move it. \
                     A difference is of linear values, channel by channel, under the exposure; a relative one is of luminance (plus 0.01 below), \
                     from blue for darker to red for brighter, full at \u{b1}100\u{a0}% over 2"
                    sup { "exposure" }
                    ". The address of the page keeps what is chosen."
                }
            }
            noscript { p.note { "Comparing two pictures needs JavaScript; all pictures are below." } }
        }
    }
}

fn options(choices: &Choices, selected: &str) -> Markup {
    let option = |choice: &Choice| {
        html! { option value=(choice.id) data-note=(choice.note) selected[choice.id == selected] { (choice.name) } }
    };
    html! {
        @for (heading, choices) in choices {
            @if heading.is_empty() { @for choice in choices { (option(choice)) } }
            @else { optgroup label=(heading) { @for choice in choices { (option(choice)) } } }
        }
    }
}
