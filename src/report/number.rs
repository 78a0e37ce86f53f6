//! Formatting of numbers: a few significant digits, powers of ten in superscript; HTML escaping.

use glam::Vec3A;
use headtail_render::statistics::{MeanInterval, RatioInterval};

/// Escapes text for HTML elements and quoted attributes.
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            // Control characters other than white space are not allowed in HTML.
            c if c.is_control() && !c.is_whitespace() => escaped.push('\u{fffd}'),
            c => escaped.push(c),
        }
    }
    escaped
}

/// Returns the power of ten of a number after rounding to `digits` significant digits.
fn exponent(value: f64, digits: usize) -> i32 {
    let scientific = format!("{:.*e}", digits - 1, value);
    scientific.split_once('e').and_then(|(_, exponent)| exponent.parse().ok()).unwrap_or(0)
}

/// Returns whether a number with this power of ten is printed without an exponent.
fn is_plain(exponent: i32) -> bool {
    (-3..=4).contains(&exponent)
}

fn fixed(value: f64, decimals: i32) -> String {
    format!("{value:.*}", decimals.max(0) as usize).replace('-', "\u{2212}")
}

fn not_finite(value: f64) -> &'static str {
    if value.is_nan() {
        "not a number"
    } else if value > 0.0 {
        "\u{221e}"
    } else {
        "\u{2212}\u{221e}"
    }
}

/// Formats three significant digits as HTML: `0.123`, `4.56 x 10<sup>-7</sup>`.
pub fn html(value: f64) -> String {
    html_digits(value, 3)
}

/// Formats `digits` significant digits as HTML.
pub fn html_digits(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return not_finite(value).to_owned();
    }
    if value == 0.0 {
        return "0".to_owned();
    }
    let exponent = exponent(value, digits);
    let decimals = digits as i32 - 1;
    if is_plain(exponent) {
        fixed(value, decimals - exponent)
    } else {
        fixed(scaled(value, exponent), decimals) + &power(exponent)
    }
}

/// Formats half the width of an interval as a signed percentage of the mean; empty without an interval.
pub fn percent(interval: &MeanInterval) -> String {
    let percent = 100.0 * interval.half_width / interval.mean.abs();
    if !percent.is_finite() {
        return String::new();
    }
    let percent = if percent < 0.01 { "<\u{202f}0.01".to_owned() } else { format!("\u{b1}\u{202f}{}", times(percent)) };
    format!("{percent}\u{202f}%")
}

/// Formats [`percent`] as HTML.
pub fn html_uncertainty(interval: &MeanInterval) -> String {
    match percent(interval) {
        percent if percent.is_empty() => percent,
        percent => format!("<span class=\"ci\">{}</span>", escape(&percent)),
    }
}

/// Formats a number that is often an integer: `64`, `64.3`.
pub fn amount(value: f64) -> String {
    if value.fract() == 0.0 && value.abs() < 1e15 { fixed(value, 0) } else { html(value) }
}

/// Formats three significant digits as plain text: `0.123`, `4.56e-7`.
pub fn text(value: f64) -> String {
    if !value.is_finite() {
        return not_finite(value).to_owned();
    }
    let exponent = exponent(value, 3);
    if value == 0.0 || is_plain(exponent) { fixed(value, 2 - exponent) } else { format!("{value:.2e}") }
}

/// Formats a ratio with two digits for prose: `12`, `3.4`, `0.56`, `3.8e-4`, `1.8e7`.
pub fn times(value: f64) -> String {
    if !value.is_finite() {
        return not_finite(value).to_owned();
    }
    if value > 0.0 && !(0.005..1e5).contains(&value) {
        format!("{value:.1e}")
    } else {
        fixed(value, 1 - exponent(value, 2).max(-2))
    }
}

/// Formats the ends of a ratio's interval: `3.1 to 3.7`; empty if they are unknown or equal.
pub fn ends(ratio: &RatioInterval) -> String {
    match ratio.ends() {
        Some((low, high)) if low < high => format!("{} to {}", times(low), times(high)),
        _ => String::new(),
    }
}

/// Formats seconds with a fitting unit.
pub fn duration(seconds: f64) -> String {
    match seconds {
        s if !s.is_finite() => "unknown".to_owned(),
        s if s >= 3600.0 => format!("{} h {:02} min", (s / 3600.0) as u64, (s / 60.0) as u64 % 60),
        s if s >= 120.0 => format!("{} min {:02} s", (s / 60.0) as u64, s as u64 % 60),
        s if s >= 1.0 => format!("{} s", text(s)),
        s if s >= 1e-3 => format!("{} ms", text(s * 1e3)),
        _ => "under 1 ms".to_owned(),
    }
}

/// Formats a vector.
pub fn vector(v: Vec3A) -> String {
    format!("{:.3} {:.3} {:.3}", v.x, v.y, v.z)
}

fn scaled(value: f64, exponent: i32) -> f64 {
    value / 10_f64.powi(exponent)
}

fn power(exponent: i32) -> String {
    format!("\u{202f}\u{d7}\u{202f}10<sup>{}</sup>", exponent.to_string().replace('-', "\u{2212}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_is_escaped() {
        assert_eq!(escape("<a href=\"x\" b='&'>"), "&lt;a href=&quot;x&quot; b=&#39;&amp;&#39;&gt;");
        assert_eq!(escape("a\u{0}b\u{1b}c\n"), "a\u{fffd}b\u{fffd}c\n");
    }

    #[test]
    fn numbers_have_three_digits() {
        assert_eq!(html(0.0), "0");
        assert_eq!(html(1.0), "1.00");
        assert_eq!(html(0.012_345), "0.0123");
        assert_eq!(html(12_345.6), "12346");
        assert_eq!(html(9.999_9e-4), "0.00100");
        assert_eq!(html(9.999_9e-5), "1.00\u{202f}\u{d7}\u{202f}10<sup>\u{2212}4</sup>");
        assert_eq!(html_digits(1.234_5, 4), "1.234");
        assert_eq!(html(-2.5), "\u{2212}2.50");
        assert_eq!(html(f64::NAN), "not a number");
        assert_eq!(text(4.567e-7), "4.57e-7");
        assert_eq!(text(0.5), "0.500");
        assert_eq!(
            (times(12.345), times(3.44), times(0.123), times(1234.0)),
            ("12".into(), "3.4".into(), "0.12".into(), "1234".into())
        );
        assert_eq!((times(3.84e-4), times(18_884_788.0)), ("3.8e-4".into(), "1.9e7".into()));
    }

    #[test]
    fn uncertainties_are_percentages_of_the_mean() {
        let uncertainty = |mean, half_width| html_uncertainty(&MeanInterval { mean, half_width, count: 3 });
        assert_eq!(uncertainty(2e-5, 1e-6), "<span class=\"ci\">\u{b1}\u{202f}5.0\u{202f}%</span>");
        assert_eq!(uncertainty(1.0, 1e-9), "<span class=\"ci\">&lt;\u{202f}0.01\u{202f}%</span>");
        assert_eq!(uncertainty(1.0, f64::INFINITY), "");
        assert_eq!(uncertainty(0.0, 0.0), "");
    }

    #[test]
    fn integer_amounts_have_no_decimals() {
        assert_eq!(
            (amount(64.0), amount(64.25), amount(f64::NAN)),
            ("64".into(), "64.2".into(), "not a number".into())
        );
    }

    #[test]
    fn durations_have_units() {
        assert_eq!(duration(0.012), "12.0 ms");
        assert_eq!(duration(1e-6), "under 1 ms");
        assert_eq!(duration(35.0), "35.0 s");
        assert_eq!(duration(135.0), "2 min 15 s");
        assert_eq!(duration(7265.0), "2 h 01 min");
    }
}
