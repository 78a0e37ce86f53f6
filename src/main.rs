//! headtail
#[cfg_attr(not(test), expect(dead_code, reason = "the command line does not call it yet"))]
mod report;

fn main() {}
