//! `stability.html`: the table with pictures, on one page that needs nothing but itself.

use std::fmt::Write;

use anyhow::Result;

use super::{
    method::{DEFAULT, METHODS, MIS, Row},
    picture::Pictures,
    regime::Regime,
    table::ratio,
};
use crate::report::number::escape;

const STYLE: &str = include_str!("../report/page.css");
const OWN_STYLE: &str = include_str!("page.css");

/// What the page shows.
pub struct Page<'a> {
    /// Regimes with the pictures of one shading point each.
    pub regimes: &'a [(Regime, Pictures)],
    /// The rows of all regimes.
    pub rows: &'a [Row],
    /// Regimes whose file is not there, and the file.
    pub missing: &'a [(String, String)],
    /// The command line.
    pub command: &'a str,
    /// What it ran on.
    pub machine: &'a str,
}

impl Page<'_> {
    /// The whole page.
    pub fn encode(&self) -> Result<String> {
        let mut page = format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'\">\n\
             <title>headtail stability</title>\n<style>\n{STYLE}{OWN_STYLE}</style>\n</head>\n<body>\n<header>\n\
             <p class=\"kicker\">headtail \u{b7} stability</p>\n<h1>Where importance samplers fail</h1>\n\
             <ul class=\"facts\"><li>{} regimes</li><li>{}</li><li>headtail {}</li></ul>\n\
             <pre class=\"command\" tabindex=\"0\" aria-label=\"Command\"><code>{}</code></pre>\n</header>\n<main>\n",
            self.regimes.len(),
            escape(self.machine),
            env!("CARGO_PKG_VERSION"),
            escape(self.command),
        );
        page += &self.summary();
        for (regime, pictures) in self.regimes {
            page += &self.section(regime, pictures)?;
        }
        Ok(page + "</main>\n</body>\n</html>\n")
    }

    fn summary(&self) -> String {
        let worse = |method: &str| -> Vec<String> {
            let of_method = self.rows.iter().filter(|row| row.method == method);
            of_method.filter(|row| !is_no_worse(self.rows, row)).map(|row| escape(&row.regime)).collect()
        };
        let sentence = |method: &str| {
            let names = worse(method);
            let all = self.rows.iter().filter(|row| row.method == method).count();
            match names.len() {
                0 => format!("<b>{method}</b> has nowhere more variance than one-sample MIS ({all} regimes)."),
                count => format!(
                    "<b>{method}</b> has more variance than one-sample MIS, or stopped, in {count} of {all}: {}.",
                    names.join(", ")
                ),
            }
        };
        let mut items: Vec<String> =
            METHODS.iter().map(|method| method.0).filter(|method| *method != MIS).map(sentence).collect();
        items.reverse();
        for (regime, file) in self.missing {
            items.push(format!(
                "<b>{}</b> was not run: give <code>--maps DIR</code> with {}.",
                escape(regime),
                escape(file)
            ));
        }
        let methods: Vec<String> =
            METHODS.iter().map(|(name, what)| format!("<dt>{name}</dt><dd>{what}</dd>")).collect();
        format!(
            "<section class=\"reading\">\n<h2>In short</h2>\n<ul>\n<li>{}</li>\n</ul>\n<dl class=\"methods\">{}</dl>\n\
             <p class=\"note\">Variance is the mean relative variance of one sample without shadows, by quadrature, over that of one-sample MIS, \
             with a 95 % interval over shading points; below 1 is better. Weights are f / p over their mean. Pictures show the shading point that \
             reflects most, as lat-long maps on one logarithmic scale of six powers of ten.</p>\n</section>\n",
            items.join("</li>\n<li>"),
            methods.concat(),
        )
    }

    fn section(&self, regime: &Regime, pictures: &Pictures) -> Result<String> {
        let mut section = format!(
            "<section>\n<h2>{}</h2>\n<p class=\"note\">{}; {} under {}.</p>\n<div class=\"table\"><table>\n<thead><tr><th>method</th>\
             <th>variance / MIS</th><th>KL</th><th>chi\u{b2}</th><th>|1 \u{2212} \u{222b}pdf|</th><th>largest weight</th><th>99.99 %</th>\
             <th>effective</th><th>uncovered</th><th>bias</th><th>ns</th><th>skipped</th></tr></thead>\n<tbody>\n",
            escape(&regime.name),
            escape(regime.why),
            escape(&regime.material.to_string()),
            escape(regime.environment.name()),
        );
        for row in self.rows.iter().filter(|row| row.regime == regime.name) {
            section += &self.row(row);
        }
        section += "</tbody>\n</table></div>\n<div class=\"strip\">\n";
        for (name, address) in pictures.encode()? {
            let _ =
                writeln!(section, "<figure><img src=\"{address}\" alt=\"\"><figcaption>{name}</figcaption></figure>");
        }
        Ok(section + "</div>\n</section>\n")
    }

    fn row(&self, row: &Row) -> String {
        let class = if is_no_worse(self.rows, row) { "" } else { " class=\"worse\"" };
        let method = if row.method == DEFAULT { format!("<b>{DEFAULT}</b>") } else { row.method.to_owned() };
        let note = if row.note.is_empty() { String::new() } else { format!("<small>{}</small>", escape(&row.note)) };
        let figures = match &row.outcome {
            Ok(figures) => figures,
            Err(message) => {
                return format!(
                    "<tr{class}><th>{method}</th><td colspan=\"11\">stopped: {}</td></tr>\n",
                    escape(message)
                );
            }
        };
        let ratio = ratio(self.rows, row).map_or("\u{2013}".into(), |(ratio, low, high)| {
            format!("{} <small>{} to {}</small>", short(ratio), short(low.max(0.0)), short(high))
        });
        let percent = |x: f64| format!("{:.2} %", 100.0 * x);
        let (bias, half_width) = figures.bias;
        format!(
            "<tr{class}><th>{method}{note}</th><td>{ratio}</td><td>{}</td><td>{}</td><td>{:.0e}</td><td>{}</td><td>{}</td><td>{}</td>\
             <td>{}</td><td>{:.2} \u{b1} {:.2} %</td><td>{:.0}</td><td>{}</td></tr>\n",
            short(figures.kl),
            short(figures.chi_square),
            figures.integral_error,
            short(figures.largest_weight),
            short(figures.weight_9999),
            percent(figures.effective),
            percent(figures.uncovered),
            100.0 * bias,
            100.0 * half_width,
            figures.nanoseconds,
            row.skipped,
        )
    }
}

/// Whether the variance is at most that of one-sample MIS.
pub fn is_no_worse(rows: &[Row], row: &Row) -> bool {
    // The same sampler in another order of sums differs in its last digits.
    row.method == MIS || ratio(rows, row).is_some_and(|(ratio, ..)| ratio <= 1.001)
}

/// Three digits.
fn short(value: f64) -> String {
    match value.abs() {
        size if !size.is_finite() => "\u{221e}".into(),
        0.0 => "0".into(),
        size if !(1e-3..1e5).contains(&size) => format!("{value:.1e}"),
        size if size < 10.0 => format!("{value:.3}"),
        size if size < 1000.0 => format!("{value:.1}"),
        _ => format!("{value:.0}"),
    }
}
