//! Printed pages: no figure is split between two sheets.

use std::{collections::HashMap, fs, path::Path, process::Command};

use super::folder;

/// Adds marks at the edges of all figures.
const MARK: &str = include_str!("mark.js");

/// Prints a page and returns the number of its figures. Panics if one is split.
pub fn whole_figures(browser: &str, page: &Path) -> usize {
    let html = fs::read_to_string(page).unwrap();
    let (copy, pdf) = (page.with_extension("print.html"), page.with_extension("print.pdf"));
    fs::write(&copy, html.replace("</body>", &format!("<script>{MARK}</script></body>"))).unwrap();
    let profile = folder();
    let mut command = Command::new(browser);
    command
        .args("--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --no-pdf-header-footer".split(' '));
    command.args("--disable-background-networking --disable-component-update --disable-sync".split(' '));
    command.args(["--virtual-time-budget=5000".to_owned(), format!("--user-data-dir={}", profile.path().display())]);
    let output = command.arg(format!("--print-to-pdf={}", pdf.display())).arg(&copy).output().unwrap();
    let bytes = fs::read(&pdf).unwrap_or_else(|_| panic!("{}: {output:?}", page.display()));
    let sheets = sheets_of_marks(&String::from_utf8_lossy(&bytes));
    for (mark, sheet) in &sheets {
        if let Some(number) = mark.strip_suffix("-top") {
            let other = sheets.get(&format!("{number}-bottom"));
            assert_eq!(Some(sheet), other, "{}: figure {number} is cut in two", page.display());
        }
    }
    sheets.len() / 2
}

/// Returns the sheet of each mark in a PDF. Chromium compresses only the contents of sheets.
fn sheets_of_marks(pdf: &str) -> HashMap<String, usize> {
    let objects: HashMap<&str, &str> = pdf
        .split("endobj")
        .filter_map(|object| {
            let (head, body) = object.split_once(" 0 obj")?;
            Some((head.rsplit(char::is_whitespace).next()?, body))
        })
        .collect();
    let sheets: Vec<&str> = objects.values().copied().filter(|body| body.contains("/Type /Page\n")).collect();
    assert!(!sheets.is_empty(), "no sheet is found in the PDF");
    let mut found = HashMap::new();
    for (number, sheet) in sheets.iter().enumerate() {
        let Some((_, links)) = sheet.split_once("/Annots [") else { continue };
        let (links, _) = links.split_once(']').unwrap();
        for link in links.split(" 0 R").map(str::trim).filter(|link| !link.is_empty()) {
            let Some((_, address)) = objects[link].split_once("https://mark.invalid/") else { continue };
            found.insert(address.split(')').next().unwrap().to_owned(), number);
        }
    }
    found
}
