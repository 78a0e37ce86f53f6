//! Computes the hashes of the sources that measurements depend on.

#[path = "src/sources.rs"]
mod sources;

fn main() {
    let repository = std::path::Path::new("..");
    for source in sources::DEVICE_SOURCES {
        if repository.join(source).exists() {
            println!("cargo:rerun-if-changed=../{source}");
        }
    }
    println!("cargo:rerun-if-changed=src/sources.rs");
    println!("cargo:rustc-env=HEADTAIL_SOURCES={}", sources::hash(repository, sources::SOURCES));
    println!("cargo:rustc-env=HEADTAIL_DEVICE_SOURCES={}", sources::hash(repository, sources::DEVICE_SOURCES));
}
