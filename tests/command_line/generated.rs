//! Tables of the documentation that are generated: commands from the help, settings of training from the types and
//! presets. HEADTAIL_WRITE_TABLES=1 writes them.

use std::{fs, path::Path};

use toml::{Table, Value};

use super::{documentation::commands_of_the_help, folder, headtail, text};

const PRESETS: [&str; 5] = ["fast-cosine", "fast-ggx", "over-patches", "paper-cosine", "paper-ggx"];
/// Tables of settings, with the type and the file of each.
const TYPES: [(&str, &str, &str); 5] = [
    ("", "FitConfig", "train/src/config.rs"),
    ("head.", "HeadConfig", "model/src/head/config.rs"),
    ("head.encoder.", "EncoderConfig", "model/src/head/config.rs"),
    ("flow.", "FlowSettings", "train/src/flow/settings.rs"),
    ("flow.shape.", "FlowConfig", "model/src/flow/config.rs"),
];

/// Compares the block `<!-- NAME: ... -->` of a page to a table, or writes it.
fn check(page: &str, name: &str, table: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(page);
    let old = fs::read_to_string(&path).unwrap();
    let (before, rest) = old.split_once(&format!("<!-- {name}: ")).expect("a block");
    let (how, rest) = rest.split_once("-->\n\n").unwrap();
    let end = format!("\n<!-- end of {name} -->");
    let (_, after) = rest.split_once(&end).unwrap();
    let new = format!("{before}<!-- {name}: {how}-->\n\n{table}{end}{after}");
    if std::env::var_os("HEADTAIL_WRITE_TABLES").is_some() {
        fs::write(&path, new).unwrap();
    } else {
        assert!(old == new, "{page}: the table is old; run {how}");
    }
}

#[test]
fn commands_of_the_help_are_those_of_the_page() {
    let rows = commands_of_the_help();
    let lines: String = rows.iter().map(|(name, about)| format!("| `{name}` | {about} |\n")).collect();
    check("docs/commands.md", "commands", &format!("| command | what it does |\n| --- | --- |\n{lines}"));
}

/// Returns the fields of a type with the first sentences of their documentation.
fn fields(of: &str, file: &str) -> Vec<(String, String)> {
    let source = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap();
    let (_, body) = source.split_once(&format!("pub struct {of} {{\n")).expect("the type");
    let (mut found, mut about) = (Vec::new(), String::new());
    for line in body.lines().map(str::trim).take_while(|line| *line != "}") {
        if let Some(words) = line.strip_prefix("///") {
            about += words;
        } else if let Some((name, _)) = line.strip_prefix("pub ").and_then(|line| line.split_once(':')) {
            let sentence = about.trim().split(". ").next().unwrap_or_default().trim_end_matches('.');
            found.push((name.to_owned(), sentence.replace('|', "\\|")));
            about.clear();
        }
    }
    found
}

/// Returns a setting as it is written in a file; `none` where a table is replaced by a word.
fn value(settings: &Table, key: &str) -> String {
    let mut parts = key.split('.');
    let first = parts.next().and_then(|part| settings.get(part));
    match parts.fold(first, |own, part| own?.get(part)) {
        Some(Value::Float(number)) if *number != 0.0 && !(1e-3..1e4).contains(number) => format!("{number:e}"),
        Some(Value::String(word)) => word.clone(),
        Some(own) => own.to_string(),
        None => "none".to_owned(),
    }
}

#[test]
fn settings_of_training_are_those_of_the_types() {
    let presets = PRESETS.map(|preset| {
        let out = headtail(folder().path(), &format!("fit --preset {preset} --print-config"));
        text(&out.stdout).parse::<Table>().expect("settings")
    });
    let mut table =
        format!("| setting | meaning | {} |\n| --- | --- |{}\n", PRESETS.join(" | "), " --- |".repeat(PRESETS.len()));
    for (prefix, of, file) in TYPES {
        for (name, about) in fields(of, file) {
            // Tables of their own.
            if TYPES.iter().any(|(other, ..)| *other == format!("{prefix}{name}.")) {
                continue;
            }
            let key = format!("{prefix}{name}");
            let values = presets.each_ref().map(|settings| value(settings, &key));
            table += &format!("| `{key}` | {about} | {} |\n", values.join(" | "));
        }
    }
    check("docs/training.md", "settings", &table);
}
