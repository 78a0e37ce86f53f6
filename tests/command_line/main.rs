//! The command line: every command on small built-in data, errors, interruption, reproducibility.
//!
//! `demo` takes too long for a test; the script that runs every check runs it.

mod browser;
mod comparison;
mod composite;
mod documentation;
mod every_command;
mod export;
mod generated;
#[cfg(target_os = "linux")]
mod inputs;
mod interruption;
mod live;
mod lost_work;
mod names;
mod options;
mod pictures;
mod placement;
mod print;
mod refusals;
mod samplers;
mod sweep;
mod sweep_nodes;
mod sweep_page;
mod visibility;

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use headtail_render::image::{Image, read_radiance};
use tempfile::TempDir;

/// A file of one portal.
const PORTALS: &str =
    r#"{"portals": [{"center": [2, 1, 0], "normal": [-1, 0, 0], "up": [0, 1, 0], "width": 1, "height": 2}]}"#;

/// Runs the program in `folder`, so that paths in arguments and messages are short, with `--force`.
fn headtail(folder: &Path, arguments: &str) -> Output {
    command(folder, arguments).arg("--force").output().expect("the program starts")
}

fn command(folder: &Path, arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_headtail"));
    command.current_dir(folder).args(arguments.split_whitespace());
    command
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("the program writes UTF-8")
}

/// Runs a command that must succeed; returns its standard output.
fn succeed(folder: &Path, arguments: &str) -> String {
    let output = headtail(folder, arguments);
    assert!(output.status.success(), "{arguments}: {}\n{}", output.status, text(&output.stderr));
    text(&output.stdout)
}

/// Runs a command that must fail with one line; returns the line.
fn fail(folder: &Path, arguments: &str) -> String {
    let output = headtail(folder, arguments);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{arguments}: {message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{arguments}: {message}");
    let sentence = message.strip_prefix("error: ").unwrap_or_else(|| panic!("{arguments}: {message}"));
    let reason = sentence.rsplit(": ").next().unwrap_or_default().trim();
    assert_eq!(sentence.matches(reason).count(), 1, "the reason is given twice: {sentence}");
    sentence.trim_end().to_owned()
}

/// Runs a command that the argument parser must reject; returns its message.
fn refuse(folder: &Path, arguments: &str) -> String {
    let output = headtail(folder, arguments);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments}: {message}");
    assert!(message.starts_with("error: ") && !message.contains("panicked"), "{arguments}: {message}");
    message
}

/// Returns the output of `info --json` for a file.
fn info(folder: &Path, file: &str) -> serde_json::Value {
    serde_json::from_str(&succeed(folder, &format!("info {file} --json"))).expect("JSON")
}

/// Returns the tensors of a safetensors file without its header.
fn after_header(bytes: &[u8]) -> Vec<u8> {
    let length = u64::from_le_bytes(bytes[..8].try_into().expect("eight bytes"));
    bytes[8 + length as usize..].to_vec()
}

fn folder() -> TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// Returns the sorted names in a folder, including leftover temporary files.
fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("the folder is there");
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    // The record of the commands.
    names.retain(|name| name != ".headtail");
    names.sort();
    names
}

fn picture(path: &Path) -> Image {
    read_radiance(path).unwrap()
}

/// Mean over pixels and channels.
fn mean(image: &Image) -> f64 {
    image.pixels.iter().flatten().map(|&value| f64::from(value)).sum::<f64>() / (3 * image.pixels.len()) as f64
}

/// A Radiance file of flat (not run-length coded) pixels of one colour: `mantissa / 256 * 2^(exponent -
/// 128)`.
fn radiance_file(width: usize, height: usize, mantissa: u8, exponent: u8) -> Vec<u8> {
    let mut bytes = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n").into_bytes();
    bytes.extend([mantissa, mantissa, mantissa, exponent].repeat(width * height));
    bytes
}

fn is_png(path: &Path) -> bool {
    fs::read(path).unwrap().starts_with(b"\x89PNG\r\n\x1a\n")
}

/// Returns whether a file is a self-contained SVG drawing.
fn is_svg(path: &Path) -> bool {
    let svg = fs::read_to_string(path).unwrap();
    // The XML namespace is the only address.
    let addresses = svg.matches("http:").count() + svg.matches("https:").count();
    svg.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\"") && svg.ends_with("</svg>\n") && addresses == 1
}

const SMALL: &str = "--width 24 --height 18";

#[test]
fn the_help_of_every_command_ends_with_examples() {
    let here = folder();
    for name in [
        "demo",
        "fit",
        "fit-material",
        "fit-rival",
        "check-material",
        "backends",
        "bake",
        "render",
        "compare",
        "chart",
        "conformance",
        "inspect",
        "material",
        "stability",
        "composite",
        "view",
        "live",
        "scenes",
    ] {
        let help = succeed(here.path(), &format!("{name} --help"));
        let (_, examples) = help.split_once("Examples:").unwrap_or_else(|| panic!("{name}: no examples"));
        assert!(examples.contains(&format!("headtail {name}")), "{help}");
        assert!(succeed(here.path(), "--help").contains(&format!("\n  {name} ")));
    }
    let version = format!("headtail {}", env!("CARGO_PKG_VERSION"));
    assert_eq!(succeed(here.path(), "-V").trim(), version);
    let long = succeed(here.path(), "--version");
    assert!(
        long.starts_with(&version) && long.contains("features: ndarray") && long.contains("instruction set: "),
        "{long}"
    );
}
