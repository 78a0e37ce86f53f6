//! Computes the hash of the sources that measurements depend on.

#[path = "src/sources.rs"]
mod sources;

fn main() {
    let repository = std::path::Path::new("..");
    for source in sources::SOURCES {
        if repository.join(source).exists() {
            println!("cargo:rerun-if-changed=../{source}");
        }
    }
    println!("cargo:rerun-if-changed=src/sources.rs");
    println!("cargo:rustc-env=HEADTAIL_SOURCES={}", sources::hash(repository));
}
