//! Parts of figures: rows of pictures, what their colours mean, tables.

use maud::html;

use crate::report::{
    chart::Scale,
    colours::DENSITY,
    picture::data_address,
    table::{Cell, Column, Table},
};

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
    let legend = html! {
        div.legend {
            p { (of) }
            div.gradient style={ "background:" (DENSITY.gradient()) } {}
            div.colour-ticks { @for tick in scale.ticks() { span { (tick) } } }
        }
    };
    legend.into_string()
}

/// A table, its first column words, all others numbers in words.
pub fn table(name: &str, head: &[&str], rows: &[Vec<String>]) -> String {
    let columns = head.iter().enumerate().map(|(k, title)| match k {
        0 => Column::text(*title),
        _ => Column::number(*title, ""),
    });
    let rows = rows.iter().map(|row| row.iter().map(Cell::text).collect()).collect();
    Table::new(name, columns.collect(), rows).html(false).into_string()
}
