//! The header matches the code.

use std::path::Path;

#[test]
fn the_header_matches_the_code() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(folder.join("cbindgen.toml")).unwrap();
    let sources = ["src/lib.rs", "src/status.rs"].map(|file| folder.join(file));
    let builder = sources.iter().fold(cbindgen::Builder::new().with_config(config), cbindgen::Builder::with_src);
    let mut generated = Vec::new();
    builder.generate().unwrap().write(&mut generated);
    let header = folder.join("include/headtail.h");
    if std::env::var_os("HEADTAIL_WRITE_HEADER").is_some() {
        std::fs::write(&header, &generated).unwrap();
    }
    let kept = std::fs::read_to_string(&header).unwrap_or_default();
    assert_eq!(kept, String::from_utf8(generated).unwrap(), "run HEADTAIL_WRITE_HEADER=1 cargo test -p headtail-capi");
}
