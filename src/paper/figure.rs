//! Parts of figures: rows of pictures, and what their colours mean.

use maud::html;

use crate::report::{chart::Scale, colours::DENSITY, picture::data_address};

/// What figures need beyond the style of all pages.
pub const STYLE: &str = include_str!("figure.css");

/// A picture with what stands under it.
pub struct Panel {
    /// A `data:` address.
    pub address: String,
    /// Its name.
    pub name: String,
    /// A figure or two; may be empty.
    pub note: String,
}

impl Panel {
    /// A panel.
    pub fn new(png: &[u8], name: impl Into<String>, note: impl Into<String>) -> Self {
        Self { address: data_address(png), name: name.into(), note: note.into() }
    }
}

/// Panels side by side.
pub fn strip(class: &str, panels: &[Panel]) -> String {
    let strip = html! {
        div.figure.(class) {
            @for panel in panels {
                figure.card {
                    img src=(panel.address) alt=(panel.name);
                    figcaption { b { (panel.name) } @if !panel.note.is_empty() { span.number { (panel.note) } } }
                }
            }
        }
    };
    strip.into_string()
}

/// What the colours of a scale mean.
pub fn legend(scale: Scale, of: &str) -> String {
    legends(&[(scale, of)])
}

/// What the colours of several scales mean, side by side.
pub fn legends(scales: &[(Scale, &str)]) -> String {
    let legends = html! {
        div.legends {
            @for (scale, of) in scales {
                div.legend {
                    p { (of) }
                    div.gradient style={ "background:" (DENSITY.gradient()) } {}
                    div.colour-ticks { @for tick in scale.ticks() { span { (tick) } } }
                }
            }
        }
    };
    legends.into_string()
}

/// The title of a part of a section.
pub fn heading(title: &str) -> String {
    html! { h3 { (title) } }.into_string() + "\n"
}

/// A paragraph; `text` is HTML.
pub fn note(text: &str) -> String {
    format!("<p class=\"note\">{text}</p>\n")
}
