//! Contents of blocks: Markdown, tables, formatted numbers.

/// Placeholder for the chart's file in the text of a block.
pub const CHART: &str = "{chart}";

/// Content of a block.
pub struct Filled {
    /// Text between its lines.
    pub markdown: String,
    /// Chart: its file, relative to the root of the repository, and its content.
    pub chart: Option<(String, String)>,
}

impl From<String> for Filled {
    fn from(markdown: String) -> Self {
        Self { markdown, chart: None }
    }
}

/// Formats two or three significant digits.
pub fn digits(value: f64) -> String {
    match value.abs() {
        x if !x.is_finite() => "\u{2013}".into(),
        0.0 => "0".into(),
        x if x >= 100.0 => format!("{value:.0}"),
        x if x >= 10.0 => format!("{value:.1}"),
        x if x >= 0.1 => format!("{value:.2}"),
        x if x >= 0.001 => format!("{value:.4}"),
        _ => format!("{value:.1e}"),
    }
}

/// Returns a Markdown table.
pub fn table(head: &[String], rows: &[Vec<String>]) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let rule = vec!["---".to_owned(); head.len()];
    line(head) + &line(&rule) + &rows.iter().map(|row| line(row)).collect::<String>()
}
