//! Output of divan benchmarks as tables: median times and throughput.

use anyhow::{Context, Result};

use crate::markdown::table;

/// Returns a table of the benchmarks that divan printed.
///
/// # Errors
/// If there is no column of medians.
pub fn shown(text: &str) -> Result<String> {
    let mut lines = text.lines();
    let is_head = |line: &&str| line.contains("median") && line.contains("fastest");
    let head: Vec<char> = lines.find(is_head).context("there is no head with 'median'")?.chars().collect();
    let place = |name: &str| head.windows(name.len()).position(|part| part.iter().copied().eq(name.chars()));
    let [first, median, mean] = ["fastest", "median", "mean"].map(|name| place(name).context("a column is missing"));
    let (first, median, mean) = (first?, median?, mean?);
    let (mut groups, mut rows): (Vec<String>, Vec<Vec<String>>) = (Vec::new(), Vec::new());
    for line in lines {
        let line: Vec<char> = line.chars().collect();
        let part =
            |from: usize, to: usize| line.get(from..to.min(line.len())).unwrap_or_default().iter().collect::<String>();
        let value = part(median, mean).trim_matches([' ', '│']).to_owned();
        let tree = part(0, first);
        let name = tree.trim_start_matches([' ', '│', '├', '╰', '─']);
        // Each level is indented by three characters.
        let depth = (tree.chars().count() - name.chars().count()) / 3;
        match (name.trim(), rows.last_mut()) {
            ("", Some(row)) if !value.is_empty() && row.len() == 2 => row.push(value),
            ("", _) => {}
            (name, _) => {
                groups.truncate(depth.saturating_sub(1));
                groups.push(name.to_owned());
                if !value.is_empty() {
                    rows.push(vec![groups.join(", "), value]);
                }
            }
        }
    }
    rows.iter_mut().for_each(|row| row.resize(3, String::new()));
    Ok(table(&["benchmark", "median", "throughput"].map(String::from), &rows))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tree_becomes_rows_of_medians() {
        let text = "\
sampling            fastest       │ slowest       │ median        │ mean          │ samples │ iters
├─ brdf                           │               │               │               │         │
│  ├─ Coherent      36.13 µs      │ 100 µs        │ 36.75 µs      │ 38.5 µs       │ 100     │ 100
│  │                113.3 Mitem/s │ 40.94 Mitem/s │ 111.4 Mitem/s │ 106.3 Mitem/s │         │
│  ╰─ Scattered     36.42 µs      │ 72.65 µs      │ 36.73 µs      │ 37.16 µs      │ 100     │ 100
│                   112.4 Mitem/s │ 56.37 Mitem/s │ 111.2 Mitem/s │ 110.2 Mitem/s │         │
╰─ rest             1 s           │ 3 s           │ 2 s           │ 2 s           │ 3       │ 3";
        let expected = "| brdf, Coherent | 36.75 µs | 111.4 Mitem/s |\n| brdf, Scattered | 36.73 µs | 111.2 Mitem/s |\n| rest | 2 s |  |";
        let shown = shown(text).unwrap();
        assert!(shown.contains(expected), "{shown}");
        assert!(super::shown("no table").is_err());
    }
}
