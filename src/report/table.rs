//! Tables for pages, LaTeX (booktabs) and CSV.

use std::{fmt::Write, path::Path};

use anyhow::Result;
use headtail_render::file;
use maud::{Markup, PreEscaped, html};

use super::number;
use super::vector::saved;

/// The value of a cell.
#[derive(Clone, Debug)]
pub enum Value {
    /// Text.
    Text(String),
    /// A number with its count of significant digits.
    Number(f64, usize),
    /// A number that is often an integer.
    Amount(f64),
    /// A ratio.
    Times(f64),
    /// Seconds with a fitting unit.
    Duration(f64),
    /// Nothing.
    Missing,
}

/// A cell of a table.
#[derive(Clone, Debug)]
pub struct Cell {
    /// The value.
    pub value: Value,
    /// Its uncertainty in words; may be empty.
    pub beside: String,
    /// Whether it is highlighted.
    pub marked: bool,
    /// The name's marker, as SVG.
    pub swatch: String,
    /// The sort key if it is not the value.
    pub order: Option<f64>,
}

impl From<Value> for Cell {
    fn from(value: Value) -> Self {
        Self { value, beside: String::new(), marked: false, swatch: String::new(), order: None }
    }
}

impl Cell {
    /// A cell of text.
    pub fn text(words: impl Into<String>) -> Self {
        Value::Text(words.into()).into()
    }

    /// A number with three significant digits.
    pub fn number(value: f64) -> Self {
        Value::Number(value, 3).into()
    }

    /// Adds the uncertainty.
    pub fn beside(self, beside: impl Into<String>) -> Self {
        Self { beside: beside.into(), ..self }
    }

    /// Sets the highlight.
    pub fn marked(self, marked: bool) -> Self {
        Self { marked, ..self }
    }

    /// Returns the number, NaN if there is none.
    pub fn amount(&self) -> f64 {
        match self.value {
            Value::Number(value, _) | Value::Amount(value) | Value::Times(value) | Value::Duration(value) => value,
            Value::Text(_) | Value::Missing => f64::NAN,
        }
    }

    fn html(&self) -> String {
        match &self.value {
            Value::Text(words) => number::escape(words),
            Value::Number(value, digits) => number::html_digits(*value, *digits),
            Value::Amount(value) => number::amount(*value),
            Value::Times(value) => format!("{}\u{d7}", number::times(*value)),
            Value::Duration(seconds) => number::duration(*seconds),
            Value::Missing => "\u{2013}".to_owned(),
        }
    }

    fn latex(&self) -> String {
        let shown = match &self.value {
            Value::Text(words) => latex_text(words),
            Value::Number(value, digits) => latex_number(*value, *digits),
            Value::Missing => "--".to_owned(),
            Value::Amount(_) | Value::Times(_) | Value::Duration(_) => latex_text(&self.html_free()),
        };
        let shown = if self.marked { format!("\\textbf{{{shown}}}") } else { shown };
        if self.beside.is_empty() { shown } else { format!("{shown} {{\\scriptsize {}}}", latex_text(&self.beside)) }
    }

    /// Formats the value, with markup only for powers of ten.
    fn html_free(&self) -> String {
        match self.value {
            Value::Amount(value) if value.fract() != 0.0 => number::text(value),
            _ => self.html(),
        }
    }

    fn csv(&self) -> String {
        match &self.value {
            Value::Text(words) => words.clone(),
            Value::Missing => String::new(),
            _ => self.amount().to_string(),
        }
    }

    fn key(&self) -> String {
        match (&self.value, self.order) {
            (_, Some(order)) => order.to_string(),
            (Value::Text(words), None) => words.clone(),
            _ => self.amount().to_string(),
        }
    }
}

/// A column's title and unit.
#[derive(Clone, Debug)]
pub struct Column {
    title: String,
    unit: String,
    is_number: bool,
}

impl Column {
    /// A column of text.
    pub fn text(title: impl Into<String>) -> Self {
        Self { title: title.into(), unit: String::new(), is_number: false }
    }

    /// A column of numbers.
    pub fn number(title: impl Into<String>, unit: impl Into<String>) -> Self {
        Self { title: title.into(), unit: unit.into(), is_number: true }
    }

    fn words(&self) -> String {
        if self.unit.is_empty() { self.title.clone() } else { format!("{} ({})", self.title, self.unit) }
    }
}

/// A table whose first column names the rows.
pub struct Table {
    /// Stem of its file names.
    pub name: String,
    /// The columns.
    pub columns: Vec<Column>,
    /// Groups of rows, separated by rules.
    pub groups: Vec<Vec<Vec<Cell>>>,
}

impl Table {
    /// A table with one group.
    pub fn new(name: impl Into<String>, columns: Vec<Column>, rows: Vec<Vec<Cell>>) -> Self {
        Self { name: name.into(), columns, groups: vec![rows] }
    }

    /// Writes the table into a folder as LaTeX and CSV.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        file::replace(&folder.join(&self.name).with_extension("tex"), self.latex().as_bytes())?;
        Ok(file::replace(&folder.join(&self.name).with_extension("csv"), &self.csv()?)?)
    }

    /// Returns HTML with links that save the table; clicks on headings sort it if `sortable`.
    pub fn html(&self, sortable: bool) -> Markup {
        let class = |column: &Column| column.is_number.then_some("number");
        html! {
            div.scroll tabindex="0" role="region" aria-label="Table" {
                table.sortable[sortable].plain[!sortable] {
                    thead { tr {
                        @for column in &self.columns {
                            th scope="col" class=[class(column)] aria-sort=[sortable.then_some("none")] {
                                @if sortable { button type="button" { (column.title) small { (column.unit) } } }
                                @else { (column.title) " " small { (column.unit) } }
                            }
                        }
                    } }
                    @for rows in &self.groups {
                        tbody { @for row in rows { tr { @for (k, cell) in row.iter().enumerate() { (self.cell(k, cell)) } } } }
                    }
                }
            }
            p.save {
                "Save " (saved(&self.name, "tex", "application/x-tex", self.latex().as_bytes())) " "
                @if let Ok(csv) = self.csv() { (saved(&self.name, "csv", "text/csv", &csv)) }
            }
        }
    }

    fn cell(&self, column: usize, cell: &Cell) -> Markup {
        let content = html! {
            (PreEscaped(&cell.swatch)) (PreEscaped(cell.html()))
            @if !cell.beside.is_empty() { span.ci { (cell.beside) } }
        };
        let best = cell.marked.then_some("best");
        html! {
            @if column == 0 { th scope="row" class=[best] data-value=(cell.key()) { (content) } }
            @else if self.columns[column].is_number {
                td.number.best[cell.marked] data-value=(cell.key()) { (content) }
            }
            @else { td class=[best] data-value=(cell.key()) { (content) } }
        }
    }

    /// Returns a `tabular` for the package booktabs.
    pub fn latex(&self) -> String {
        let columns: String = self.columns.iter().map(|column| if column.is_number { 'r' } else { 'l' }).collect();
        let line = |cells: Vec<String>| format!("{} \\\\\n", cells.join(" & "));
        let head = line(self.columns.iter().map(|column| latex_text(&column.words())).collect());
        let mut latex = format!("% \\usepackage{{booktabs}}\n\\begin{{tabular}}{{{columns}}}\n\\toprule\n{head}");
        for rows in &self.groups {
            latex += "\\midrule\n";
            latex.extend(rows.iter().map(|row| line(row.iter().map(Cell::latex).collect())));
        }
        latex + "\\bottomrule\n\\end{tabular}\n"
    }

    /// Encodes numbers in full precision; uncertainties get a column of their own.
    ///
    /// # Errors
    /// Never in memory; see [`csv::Writer`].
    pub fn csv(&self) -> Result<Vec<u8>> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        let rows = || self.groups.iter().flatten();
        let has_beside = |k: usize| rows().any(|row| row.get(k).is_some_and(|cell| !cell.beside.is_empty()));
        let beside: Vec<bool> = (0..self.columns.len()).map(has_beside).collect();
        let names = self.columns.iter().zip(&beside).flat_map(|(column, &beside)| {
            let words = column.words();
            let second = beside.then(|| format!("{words}, 95 % interval"));
            [Some(words), second]
        });
        writer.write_record(names.flatten())?;
        for row in rows() {
            let cells = row.iter().zip(&beside);
            writer.write_record(
                cells.flat_map(|(cell, &beside)| [Some(cell.csv()), beside.then(|| cell.beside.clone())]).flatten(),
            )?;
        }
        Ok(writer.into_inner()?)
    }
}

/// Formats a number as LaTeX, with a power of ten if needed.
fn latex_number(value: f64, digits: usize) -> String {
    let html = number::html_digits(value, digits);
    let math = html.replace('\u{202f}', "").replace("\u{d7}10<sup>", "\\times10^{").replace("</sup>", "}");
    if value.is_finite() { format!("${}$", math.replace('\u{2212}', "-")) } else { latex_text(&html) }
}

/// Escapes text for LaTeX.
fn latex_text(words: &str) -> String {
    let mut latex = String::with_capacity(words.len());
    for letter in words.chars() {
        match letter {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => {
                let _ = write!(latex, "\\{letter}");
            }
            '\\' => latex += "\\textbackslash{}",
            '~' => latex += "\\textasciitilde{}",
            '^' => latex += "\\textasciicircum{}",
            '<' => latex += "$<$",
            '>' => latex += "$>$",
            '\u{d7}' => latex += "$\\times$",
            '\u{b1}' => latex += "$\\pm$",
            '\u{2212}' => latex += "$-$",
            '\u{2191}' => latex += "$\\uparrow$",
            '\u{221e}' => latex += "$\\infty$",
            '\u{2013}' => latex += "--",
            '\u{2026}' => latex += "\\ldots{}",
            '\u{b2}' => latex += "$^2$",
            '\u{202f}' | '\u{a0}' => latex.push('~'),
            letter if letter.is_control() => latex.push(' '),
            letter => latex.push(letter),
        }
    }
    latex
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let row = |name: &str, value: f64| {
            vec![Cell::text(name), Cell::number(value).beside("\u{b1} 5 %").marked(value < 1.0), Value::Missing.into()]
        };
        Table::new(
            "t",
            vec![Column::text("Sampler"), Column::number("MSE", "100 %"), Column::number("Rays", "")],
            vec![row("a_b<i>", 4.56e-7), row("mis", 12.0)],
        )
    }

    #[test]
    fn latex_is_escaped_and_has_the_rules_of_booktabs() {
        let latex = table().latex();
        assert_eq!(
            latex.lines().skip(1).collect::<Vec<_>>(),
            [
                "\\begin{tabular}{lrr}",
                "\\toprule",
                "Sampler & MSE (100 \\%) & Rays \\\\",
                "\\midrule",
                "a\\_b$<$i$>$ & \\textbf{$4.56\\times10^{-7}$} {\\scriptsize $\\pm$ 5 \\%} & -- \\\\",
                "mis & $12.0$ {\\scriptsize $\\pm$ 5 \\%} & -- \\\\",
                "\\bottomrule",
                "\\end{tabular}",
            ]
        );
    }

    #[test]
    fn csv_has_full_precision_and_intervals() {
        let csv = String::from_utf8(table().csv().unwrap()).unwrap();
        let lines: Vec<&str> = csv.lines().collect();
        assert_eq!(lines[0], "Sampler,MSE (100 %),\"MSE (100 %), 95 % interval\",Rays");
        assert_eq!(lines[1], "a_b<i>,0.000000456,\u{b1} 5 %,");
    }

    #[test]
    fn html_escapes_names_and_highlights_marked_cells() {
        let html = table().html(true).into_string();
        assert!(html.contains("a_b&lt;i&gt;") && !html.contains("<i>"));
        assert_eq!(html.matches("class=\"number best\"").count(), 1);
        assert!(html.contains("download=\"t.tex\"") && html.contains("download=\"t.csv\""));
    }
}
