//! Finds measured numbers in sentences: they belong in data and in generated blocks.

use std::path::Path;

/// Units that mark a number as measured.
const UNITS: [&str; 11] = ["%", "x", "\u{d7}", "times", "ns", "\u{b5}s", "ms", "nats", "fps", "samples/s", "MB/s"];

/// Returns a finding, with its line, for each measured number outside generated blocks and code.
pub fn measured_numbers(name: &Path, text: &str) -> Vec<String> {
    let is_of_results =
        name.starts_with("docs/results") || name == Path::new("RESULTS.md") || name == Path::new("README.md");
    let (mut is_code, mut is_generated, mut findings) = (false, false, Vec::new());
    for (index, line) in text.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            is_code = !is_code;
        }
        is_generated |= line.contains("<!-- results: ");
        if !is_code && !is_generated {
            for found in in_line(line, is_of_results) {
                let number = index + 1;
                findings.push(format!(
                    "{}:{number}: '{found}' is a measured number outside of a generated block",
                    name.display()
                ));
            }
        }
        is_generated &= !line.contains("<!-- end of results -->");
    }
    findings
}

fn in_line(line: &str, decimals: bool) -> Vec<String> {
    // Excludes code and link targets.
    let mut plain = String::new();
    for (index, part) in line.split('`').enumerate() {
        plain += if index % 2 == 0 { part } else { "code" };
    }
    let words: Vec<&str> = plain.split_whitespace().filter(|word| !word.contains("](")).collect();
    let trimmed = |word: &str| word.trim_matches(|c: char| "()[],.;:*".contains(c)).to_owned();
    let mut found = Vec::new();
    for (index, word) in words.iter().enumerate() {
        let word = trimmed(word);
        let digits = word.trim_end_matches(|c: char| !c.is_ascii_digit());
        let unit = &word[digits.len()..];
        let is_number = !digits.is_empty() && digits.chars().all(|c| c.is_ascii_digit() || c == '.' || c == ',');
        let next = words.get(index + 1).map(|next| trimmed(next)).unwrap_or_default();
        let has_unit = UNITS.contains(&unit) || unit.is_empty() && UNITS.contains(&next.as_str());
        // "256 x 192" is a size.
        let is_size =
            next == "x" && words.get(index + 2).is_some_and(|word| word.starts_with(|c: char| c.is_ascii_digit()));
        if is_number && (has_unit && !is_size || decimals && digits.contains('.') && unit.is_empty()) {
            found.push(if unit.is_empty() && has_unit { format!("{word} {next}") } else { word });
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measured_numbers_are_found_and_settings_are_not() {
        let found = |text: &str| measured_numbers(Path::new("RESULTS.md"), text);
        for text in ["2.3x lower", "the error is 2.3 times lower", "5 % of the time", "(40 ns)", "a KL of 0.04"] {
            assert_eq!(found(text).len(), 1, "{text}");
        }
        for text in ["`ggx:alpha=0.4` has 256 x 192 pixels", "in 12 views", "[page](a-2.3x.md)", "```\n2.3x\n```"] {
            assert_eq!(found(text), Vec::<String>::new(), "{text}");
        }
        let block = "<!-- results: ratios a -->\n2.3x\n<!-- end of results -->\n4 %";
        assert_eq!(found(block).len(), 1);
        assert!(measured_numbers(Path::new("docs/training.md"), "a rate of 0.001").is_empty());
    }
}
