//! headtail
fn main() {}
