//! A run described by one table: map, conditions, head, training, export, and what is measured afterwards.

pub mod measure;
mod perform;
mod table;

pub use measure::Measures;
pub use perform::{Finished, METRICS, RESULTS, SAMPLER, Surroundings, perform};
pub use table::{Checkpoints, Picture, RunConfig, RunTable, one_line};
