//! Ratios with intervals from measurements.
//!
//! The error of a sampler at a given time follows from the errors measured at its budgets, by the power law
//! between them (`curve.rs`). Ratios of errors are averaged geometrically over views; their intervals are
//! percentiles of a bootstrap over views and, within each, over runs ([`Ratios`]).
//!
//! | file | concept |
//! | --- | --- |
//! | `ratios.rs` | ratios over views |
//! | `curve.rs` | error at equal time |
//! | `bootstrap.rs` | intervals |

mod bootstrap;
mod curve;
mod ratios;

pub use bootstrap::{Interval, bootstrap};
pub use ratios::{Comparison, Ratios, ViewRuns, views_of};
