//! Output of commands: text unchanged, JSON tables as Markdown.

use anyhow::{Context, Result, bail};
use headtail_eval::Output;
use serde_json::{Map, Value};

use crate::{
    block::Block,
    forest,
    markdown::{Filled, digits, table},
};

/// Returns what a block shows of an output: the text, a table of benchmarks, a table by name (`table=`), or a
/// pivot (`rows=`, `columns=`, `value=`) or chart of a list.
///
/// # Errors
/// If there is no such table.
pub fn fill(output: &Output, block: &Block) -> Result<Filled> {
    Ok(match (&*block.kind, &output.output) {
        ("text", Value::String(text)) => format!("```text\n{}\n```", text.trim_end()).into(),
        ("bench", Value::String(text)) => crate::bench::shown(text)?.into(),
        ("table", value) => {
            let wanted = block.need("table")?;
            let mut found = Vec::new();
            tables_of(value, wanted, &mut found);
            if found.is_empty() {
                bail!("there is no table '{wanted}'");
            }
            found.iter().map(|(name, rows)| format!("{name}:\n\n{}\n", shown(rows))).collect::<String>().into()
        }
        ("pivot", Value::Array(rows)) => pivot(rows, block)?.into(),
        ("forest", Value::Array(rows)) => forest::of_list(rows, block)?,
        (kind, _) => bail!("'{kind}' cannot show the output of this command"),
    })
}

/// Collects tables whose names begin with `wanted`, in the order of the output.
fn tables_of<'a>(value: &'a Value, wanted: &str, found: &mut Vec<(&'a str, Vec<&'a Map<String, Value>>)>) {
    match value {
        Value::Object(object) => {
            if let (Some(Value::String(name)), Some(Value::Array(rows))) = (object.get("name"), object.get("rows"))
                && name.starts_with(wanted)
            {
                found.push((name, rows.iter().filter_map(Value::as_object).collect()));
            }
            object.values().for_each(|value| tables_of(value, wanted, found));
        }
        Value::Array(values) => values.iter().for_each(|value| tables_of(value, wanted, found)),
        _ => {}
    }
}

/// Formats rows with text columns first.
fn shown(rows: &[&Map<String, Value>]) -> String {
    let mut columns: Vec<&String> = rows.first().map(|row| row.keys().collect()).unwrap_or_default();
    columns.sort_by_key(|column| !rows[0][*column].is_string());
    let line = |row: &&Map<String, Value>| columns.iter().map(|column| cell(row.get(*column))).collect();
    let head: Vec<String> = columns.iter().map(|column| (*column).clone()).collect();
    table(&head, &rows.iter().map(line).collect::<Vec<_>>())
}

fn cell(value: Option<&Value>) -> String {
    match value {
        Some(Value::Number(number)) => digits(number.as_f64().unwrap_or(f64::NAN)),
        Some(Value::String(text)) => text.parse().map_or_else(|_| with_dashes(text), digits),
        Some(Value::Bool(is)) => is.to_string(),
        _ => "\u{2013}".into(),
    }
}

/// Joins the ends of an interval in brackets by a dash.
fn with_dashes(text: &str) -> String {
    match text.split_once('[') {
        Some((value, ends)) if ends.ends_with(']') => format!("{value}[{}", ends.replace(", ", "\u{2013}")),
        _ => text.to_owned(),
    }
}

/// Pivots one value of a list of objects by two of its keys, in order of first appearance; `only` is what names of
/// columns begin with.
fn pivot(list: &[Value], block: &Block) -> Result<String> {
    let [row_key, column_key, value_key] = [block.need("rows")?, block.need("columns")?, block.need("value")?];
    let text = |object: &Value, key: &str| -> Result<String> {
        Ok(object
            .get(key)
            .with_context(|| format!("there is no column '{key}'"))?
            .as_str()
            .unwrap_or_default()
            .to_owned())
    };
    let (mut rows, mut columns, mut cells) = (Vec::new(), Vec::new(), Vec::new());
    let wanted = block.get("only").unwrap_or_default();
    for object in list {
        let (row, column) = (text(object, row_key)?, text(object, column_key)?);
        if !column.starts_with(wanted) {
            continue;
        }
        for (name, known) in [(&row, &mut rows), (&column, &mut columns)] {
            if !known.contains(name) {
                known.push(name.clone());
            }
        }
        cells.push((row, column, cell(object.get(value_key))));
    }
    let line = |row: &String| {
        let value = |column: &String| {
            let found = cells.iter().find(|(own, with, _)| own == row && with == column);
            found.map_or_else(|| "\u{2013}".to_owned(), |(.., value)| value.clone())
        };
        std::iter::once(row.clone()).chain(columns.iter().map(value)).collect()
    };
    let corner = format!("{value_key} by {row_key}").replace('_', " ");
    let head: Vec<String> = std::iter::once(corner).chain(columns.iter().cloned()).collect();
    Ok(table(&head, &rows.iter().map(line).collect::<Vec<_>>()))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn output(output: Value) -> Output {
        Output { environment: "e1".into(), command: "x".into(), seconds: 1.0, output }
    }

    #[test]
    fn nested_tables_are_found() {
        let rows = json!([{"sampler": "mis", "MSE": 0.25}]);
        let paper = output(json!([{"parts": [{"tables": [{"name": "numbers-a", "rows": rows}]}]}]));
        let block = |head: &str| Block::parse(head).unwrap();
        let table = fill(&paper, &block("table paper command=paper table=numbers")).unwrap().markdown;
        assert!(table.contains("| sampler | MSE |\n| --- | --- |\n| mis | 0.25 |"), "{table}");
        assert!(fill(&paper, &block("table paper command=paper table=words")).is_err());
    }

    #[test]
    fn lists_become_tables_by_two_keys() {
        let list = json!([{"r": "sun", "m": "mis", "v": "1"}, {"r": "sun", "m": "head", "v": 2.5}, {"r": "fog", "m": "head", "v": 3.0}]);
        let block = Block::parse("pivot s command=s rows=r columns=m value=v").unwrap();
        let table = fill(&output(list), &block).unwrap().markdown;
        assert!(table.contains("| sun | 1.00 | 2.50 |\n| fog | \u{2013} | 3.00 |"), "{table}");
    }

    #[test]
    fn lists_become_charts_of_ratios_to_a_baseline() {
        let dot = |sampler: &str, scene: &str, ratio: f64| json!({"sampler": sampler, "scene": scene, "lit": "day", "ratio": ratio, "ratio_low": 0.9 * ratio, "ratio_high": 1.1 * ratio});
        let list = json!([dot("mis", "tree", 1.0), dot("head", "tree", 2.0), dot("head", "room", 8.0), {"sampler": "head", "scene": "hall"}]);
        let head =
            "forest s command=s rows=sampler columns=scene value=ratio baseline=mis full=lit:night file=docs/s.svg";
        let filled = fill(&output(list), &Block::parse(head).unwrap()).unwrap();
        let (file, svg) = filled.chart.unwrap();
        assert_eq!(file, "docs/s.svg");
        assert!(
            svg.contains(">4.00 (2)</text>") && !svg.contains(">mis</text>") && !svg.contains(">hall</text>"),
            "{svg}"
        );
        // Two dots, both hollow, and two of the legend.
        assert_eq!((svg.matches("<circle").count(), svg.matches("fill=\"white\" stroke").count()), (4, 2));
        let misspelt = head.replace("value=ratio", "value=ration");
        assert!(fill(&output(json!([dot("head", "tree", 2.0)])), &Block::parse(&misspelt).unwrap()).is_err());
    }
}
