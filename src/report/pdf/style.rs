//! Elements of a drawing, and how classes paint them.

use anyhow::{Context, Result};

use super::super::number::unescape;

/// An element with its attributes.
pub struct Element {
    pub name: String,
    attributes: Vec<(String, String)>,
}

impl Element {
    /// What stands between the angle brackets.
    pub fn parse(tag: &str) -> Self {
        let (name, mut rest) = tag.split_once(' ').unwrap_or((tag, ""));
        let mut attributes = Vec::new();
        while let Some((name, after)) = rest.split_once("=\"") {
            let Some((value, after)) = after.split_once('"') else { break };
            attributes.push((name.trim().to_owned(), unescape(value)));
            rest = after;
        }
        Self { name: name.to_owned(), attributes }
    }

    /// The value of an attribute.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(found, _)| found == name).map(|(_, value)| &**value)
    }

    /// An attribute that is a number.
    ///
    /// # Errors
    /// If it is missing or none.
    pub fn number(&self, name: &str) -> Result<f64> {
        let text = self.get(name).with_context(|| format!("<{}> has no {name}", self.name))?;
        text.parse().with_context(|| format!("<{} {name}=\"{text}\">", self.name))
    }

    fn has(&self, simple: &str) -> bool {
        let mut parts = simple.split('.');
        let name = parts.next().unwrap_or_default();
        let classes: Vec<&str> = self.get("class").unwrap_or_default().split_whitespace().collect();
        (name.is_empty() || name == self.name) && parts.all(|class| classes.contains(&class))
    }
}

/// How an element is painted.
#[derive(Clone, Debug, PartialEq)]
pub struct Paint {
    pub fill: Option<[f64; 3]>,
    pub stroke: Option<[f64; 3]>,
    pub stroke_width: f64,
    pub dashes: String,
    pub is_round: bool,
    pub opacity: f64,
    pub font_size: f64,
    pub is_bold: bool,
}

/// A rule of a style sheet.
struct Rule {
    /// What it is for, from the outside in.
    selector: Vec<String>,
    rank: usize,
    declarations: Vec<(String, String)>,
}

/// A style sheet, rules of higher rank last.
pub struct Sheet {
    rules: Vec<Rule>,
}

impl Sheet {
    /// Rules of classes and names, with blanks for what is inside of what; others are left out.
    pub fn parse(text: &str) -> Self {
        let mut rules = Vec::new();
        for rule in text.split('}') {
            let Some((selectors, declarations)) = rule.split_once('{') else { continue };
            for selector in selectors.split(',') {
                let selector: Vec<String> = selector.split_whitespace().map(str::to_owned).collect();
                // A class ranks above any number of names.
                let rank = |part: &String| 100 * part.matches('.').count() + usize::from(!part.starts_with('.'));
                let rank = selector.iter().map(rank).sum();
                rules.push(Rule { selector, rank, declarations: self::declarations(declarations) });
            }
        }
        rules.sort_by_key(|rule| rule.rank);
        Self { rules }
    }

    /// The paint of an element inside of others, from the outermost on.
    ///
    /// # Errors
    /// If a value is not understood.
    pub fn paint(&self, outer: &[Element], element: &Element) -> Result<Paint> {
        let mut color = [0.0; 3];
        let (mut fill, mut stroke) = ("#000000".to_owned(), "none".to_owned());
        let (mut width, mut dashes, mut join) = ("1".to_owned(), "none".to_owned(), "miter".to_owned());
        let (mut size, mut weight, mut opacity) = ("13px".to_owned(), "400".to_owned(), 1.0);
        let path: Vec<&Element> = outer.iter().chain([element]).collect();
        for end in 1..=path.len() {
            let at = path[end - 1];
            let own = ["fill", "stroke", "stroke-width"]
                .into_iter()
                .filter_map(|name| Some((name.to_owned(), at.get(name)?.to_owned())));
            let of_sheet = self.rules.iter().filter(|rule| matches(&rule.selector, &path[..end]));
            let of_sheet = of_sheet.flat_map(|rule| rule.declarations.iter().cloned());
            let last = at.get("style").map(declarations).unwrap_or_default();
            for (name, value) in own.chain(of_sheet).chain(last) {
                match &*name {
                    "color" => color = colour(&value)?,
                    "fill" => fill = value,
                    "stroke" => stroke = value,
                    "stroke-width" => width = value,
                    "stroke-dasharray" => dashes = value,
                    "stroke-linejoin" => join = value,
                    "font-size" => size = value,
                    "font-weight" => weight = value,
                    // Groups have none.
                    "opacity" => opacity = value.parse().with_context(|| format!("opacity {value}"))?,
                    _ => {}
                }
            }
        }
        let paint = |text: &str| match text {
            "none" => Ok(None),
            "currentColor" => Ok(Some(color)),
            _ => colour(text).map(Some),
        };
        Ok(Paint {
            fill: paint(&fill)?,
            stroke: paint(&stroke)?,
            stroke_width: width.parse().with_context(|| format!("stroke-width {width}"))?,
            dashes: if dashes == "none" { String::new() } else { dashes },
            is_round: join == "round",
            opacity,
            font_size: size.trim_end_matches("px").parse().with_context(|| format!("font-size {size}"))?,
            is_bold: weight.parse::<u32>().is_ok_and(|weight| weight >= 550),
        })
    }
}

fn declarations(text: &str) -> Vec<(String, String)> {
    let pairs = text.split(';').filter_map(|declaration| declaration.split_once(':'));
    pairs.map(|(name, value)| (name.trim().to_owned(), value.trim().to_owned())).collect()
}

/// Whether a selector is for the last element of a path.
fn matches(parts: &[String], path: &[&Element]) -> bool {
    let Some((last, before)) = parts.split_last() else { return false };
    let Some((element, outer)) = path.split_last() else { return false };
    if !element.has(last) {
        return false;
    }
    let mut outer = outer.iter().rev();
    before.iter().rev().all(|part| outer.any(|element| element.has(part)))
}

/// `#rgb` or `#rrggbb`, from 0 to 1.
fn colour(text: &str) -> Result<[f64; 3]> {
    let digits = text.strip_prefix('#').with_context(|| format!("the colour {text} is unknown"))?;
    let wide = digits.len() == 6;
    let channel = |k: usize| -> Result<f64> {
        let part = if wide { digits.get(2 * k..2 * k + 2) } else { digits.get(k..=k) };
        let value = u8::from_str_radix(part.with_context(|| format!("the colour {text} is unknown"))?, 16)?;
        Ok(f64::from(if wide { value } else { 17 * value }) / 255.0)
    };
    Ok([channel(0)?, channel(1)?, channel(2)?])
}
