//! `stability.html`: the table with pictures on a self-contained page.

use anyhow::Result;
use maud::{Markup, html};

use super::{
    method::{DEFAULT, METHODS, MIS, Row},
    picture::Pictures,
    regime::Regime,
    table::ratio,
};
use crate::report::{
    chart::{self, Matrix, matrix},
    kind::Look,
    number::text,
    shell::{self, count},
    table::{Cell, Column, Table, Value},
    vector::Chart,
};

const OWN_STYLE: &str = include_str!("page.css");

/// The content of the page.
pub struct Page<'a> {
    /// Regimes with the pictures of one shading point each.
    pub regimes: &'a [(Regime, Pictures)],
    /// The rows of all regimes.
    pub rows: &'a [Row],
    /// Regimes whose file is missing, and the file.
    pub missing: &'a [(String, String)],
    /// The command line.
    pub command: &'a str,
    /// The machine it ran on.
    pub machine: &'a str,
}

impl Page<'_> {
    /// Returns the HTML page.
    pub fn encode(&self) -> Result<String> {
        let sections = self.regimes.iter().map(|(regime, pictures)| self.section(regime, pictures));
        let sections = sections.collect::<Result<Vec<Markup>>>()?;
        let main = html! {
            (self.map())
            (self.summary())
            @for section in sections { (section) }
        };
        let page = shell::Page {
            kicker: "stability",
            title: "Where importance samplers fail".into(),
            heading: html! { "Where importance samplers fail" },
            facts: vec![
                count(self.regimes.len(), "regime"),
                self.machine.to_owned(),
                format!("headtail {}", env!("CARGO_PKG_VERSION")),
            ],
            command: self.command,
            version: env!("CARGO_PKG_VERSION"),
            style: OWN_STYLE,
            script: "",
        };
        Ok(page.encode(&main))
    }

    /// Returns all regimes and methods as a matrix.
    pub fn chart(&self) -> Chart {
        let cell = |regime: &str, method: &str| {
            let row = self.rows.iter().find(|row| row.regime == regime && row.method == method);
            row.map_or(chart::Cell::Empty, |row| match ratio(self.rows, row) {
                Some((ratio, ..)) if row.outcome.is_ok() => chart::Cell::Ratio(ratio),
                _ => chart::Cell::Failed,
            })
        };
        let methods = || METHODS.iter().map(|method| method.0);
        let row = |(regime, _): &(Regime, Pictures)| {
            (regime.name.clone(), methods().map(|method| cell(&regime.name, method)).collect())
        };
        matrix(&Matrix {
            name: "regimes",
            label: "Variance over that of one-sample MIS, regimes by methods".into(),
            columns: methods().map(str::to_owned).collect(),
            rows: self.regimes.iter().map(row).collect(),
        })
    }

    fn map(&self) -> Markup {
        html! {
            section {
                h2 { "Every method in every regime" }
                figure {
                    div.wide-only { (self.chart().html()) }
                    figcaption.note {
                        "Mean relative variance of one sample, without shadows, over that of one-sample MIS: blue is better, red is worse, by powers of ten. Dark: \
                         training stopped, or came to no figure."
                    }
                }
            }
        }
    }

    /// Names the regimes in which a method has higher variance than one-sample MIS.
    fn sentence(&self, method: &str) -> Markup {
        let of_method = || self.rows.iter().filter(|row| row.method == method);
        let worse: Vec<&str> =
            of_method().filter(|row| !is_no_worse(self.rows, row)).map(|row| row.regime.as_str()).collect();
        let all = of_method().count();
        let regimes = if all == 1 { "1 regime".to_owned() } else { format!("{all} regimes") };
        html! {
            li {
                b { (method) }
                @if worse.is_empty() { " has nowhere more variance than one-sample MIS (" (regimes) ")." }
                @else {
                    " has more variance than one-sample MIS, or stopped, in " (worse.len()) " of " (regimes) ": " (worse.join(", ")) "."
                }
            }
        }
    }

    fn summary(&self) -> Markup {
        html! {
            section.reading {
                h2 { "In short" }
                ul {
                    @for (method, _) in METHODS.iter().rev().filter(|method| method.0 != MIS) { (self.sentence(method)) }
                    @for (regime, file) in self.missing {
                        li { b { (regime) } " was not run: give " code { "--maps DIR" } " with " (file) "." }
                    }
                }
                dl.methods { @for (name, what) in METHODS { dt { (name) } dd { (what) } } }
                p.note {
                    "Variance is the mean relative variance of one sample without shadows, by quadrature, over that of one-sample MIS, with a 95 % interval over \
                     shading points; below 1 is better. Weights are f / p over their mean. Pictures show the shading point that reflects most, as lat-long maps on \
                     one logarithmic scale of six powers of ten."
                }
            }
        }
    }

    fn section(&self, regime: &Regime, pictures: &Pictures) -> Result<Markup> {
        let rows = self.rows.iter().filter(|row| row.regime == regime.name);
        let table = Table::new(regime.name.clone(), columns(), rows.map(|row| self.row(row)).collect());
        let pictures = pictures.encode()?;
        Ok(html! {
            section {
                h2 { (regime.name) }
                p.note { (regime.why) "; " (regime.material) " under " (regime.environment.name()) "." }
                (table.html(false))
                div.strip {
                    @for (name, address) in pictures { figure { img src=(address) alt={ "Density of " (name) }; figcaption { (name) } } }
                }
            }
        })
    }

    fn row(&self, row: &Row) -> Vec<Cell> {
        let looks = Look::of_all(METHODS.iter().map(|method| method.0));
        let look = METHODS.iter().zip(looks).find(|(method, _)| method.0 == row.method);
        let swatch = look.map_or(String::new(), |(_, look)| look.swatch());
        let name = Cell { swatch, ..Cell::text(row.method) };
        let name = name.beside(&row.note).marked(row.method == DEFAULT);
        let figures = match &row.outcome {
            Ok(figures) => figures,
            Err(message) => {
                let empty = std::iter::repeat_with(|| Cell::from(Value::Missing)).take(columns().len() - 2);
                return [name, Cell::text(format!("stopped: {message}"))].into_iter().chain(empty).collect();
            }
        };
        let ratio = ratio(self.rows, row).map_or(Value::Missing.into(), |(ratio, low, high)| {
            Cell::number(ratio).beside(format!("{} to {}", text(low.max(0.0)), text(high)))
        });
        let percent = |fraction: f64| Cell::number(100.0 * fraction);
        let (bias, half_width) = figures.bias;
        vec![
            name,
            ratio,
            Cell::number(figures.kl),
            Cell::number(figures.chi_square),
            Value::Number(figures.integral_error, 1).into(),
            Cell::number(figures.largest_weight),
            Cell::number(figures.weight_9999),
            percent(figures.effective),
            percent(figures.uncovered),
            percent(bias).beside(format!("\u{b1} {}", text(100.0 * half_width))),
            Cell::number(figures.nanoseconds),
            Value::Amount(row.skipped as f64).into(),
        ]
    }
}

/// The columns of a regime's table.
fn columns() -> Vec<Column> {
    let numbers = [
        ("Variance", "of MIS"),
        ("KL", "nats"),
        ("Chi\u{b2}", ""),
        ("|1 \u{2212} \u{222b}pdf|", ""),
        ("Weight", "largest"),
        ("Weight", "99.99 %"),
        ("Effective", "%"),
        ("Uncovered", "%"),
        ("Bias", "%"),
        ("Time", "ns"),
        ("Skipped", "steps"),
    ];
    let numbers = numbers.map(|(title, unit)| Column::number(title, unit));
    [vec![Column::text("Method")], numbers.to_vec()].concat()
}

/// Returns whether the variance is at most that of one-sample MIS.
pub fn is_no_worse(rows: &[Row], row: &Row) -> bool {
    // Another order of summation changes the last digits.
    row.method == MIS || ratio(rows, row).is_some_and(|(ratio, ..)| ratio <= 1.001)
}
