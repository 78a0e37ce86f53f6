//! A run described by one table: map, conditions, head, training, export and measurements.
//!
//! | file | concept |
//! | --- | --- |
//! | `table.rs`, `view.rs` | the table of a run, and its views |
//! | `contents.rs` | the files that it names, as hashes |
//! | `perform.rs`, `measure.rs` | from settings to files; what is measured |

mod contents;
pub mod measure;
mod perform;
mod table;
mod view;

pub use contents::Contents;
pub use measure::Measures;
pub use perform::{Finished, METRICS, RESULTS, RunContext, SAMPLER, perform};
pub use table::{Checkpoints, RunConfig, RunTable, one_line};
pub use view::Picture;
