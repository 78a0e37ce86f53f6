//! Common parts of all pages: head, header, style, script.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::vector;

const STYLE: &str = include_str!("style/page.css");
/// Scripts that sort tables and compare pictures.
const SCRIPTS: [&str; 4] = [
    include_str!("script/radiance.js"),
    include_str!("script/stage.js"),
    include_str!("script/insets.js"),
    include_str!("script/table.js"),
];

/// A self-contained page.
pub struct Page<'a> {
    /// The kind of page: "comparison of samplers".
    pub kicker: &'a str,
    /// For the window's title bar.
    pub title: String,
    /// The heading.
    pub heading: Markup,
    /// Facts below it.
    pub facts: Vec<String>,
    /// The command that produced it; may be empty.
    pub command: &'a str,
    /// The version of headtail that produced it.
    pub version: &'a str,
    /// Style in addition to that of all pages.
    pub style: &'a str,
    /// Script in addition to that of all pages.
    pub script: &'a str,
}

impl Page<'_> {
    /// Returns the HTML page, which loads no external resources.
    pub fn encode(&self, main: &Markup) -> String {
        let policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'";
        let style = [vector::PALETTE, vector::STYLE, STYLE, self.style].concat();
        let script = SCRIPTS.concat() + self.script;
        html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width,initial-scale=1";
                    meta name="color-scheme" content="light dark";
                    meta http-equiv="Content-Security-Policy" content=(policy);
                    meta name="generator" content={ "headtail " (self.version) };
                    link rel="icon" href="data:,";
                    title { (self.title) " \u{b7} headtail" }
                    style { (PreEscaped(style)) }
                }
                body {
                    header {
                        p.kicker { "headtail \u{b7} " (self.kicker) }
                        h1 { (self.heading) }
                        ul.facts { @for fact in &self.facts { li { (fact) } } }
                        @if !self.command.is_empty() {
                            pre.command tabindex="0" aria-label="Command" { code { (self.command) } }
                        }
                    }
                    main { (main) }
                    script { (PreEscaped(script)) }
                }
            }
        }
        .into_string()
            + "\n"
    }
}

/// Returns "1 run", "3 runs".
pub fn count(number: usize, thing: &str) -> String {
    format!("{number} {thing}{}", if number == 1 { "" } else { "s" })
}
