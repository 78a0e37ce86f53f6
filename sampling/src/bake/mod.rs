//! Tabulated intermediate densities: the bake of a head, and the direct bake without training.
//!
//! | file | concept |
//! | --- | --- |
//! | `direct.rs` | the direct bake, from the target itself |
//! | `table.rs` | an interpolated table as a density over Y |
//! | `cell_masses.rs` | running sums of four neighbouring tables, side by side |
//! | `normal_grid.rs`, `cell_grid.rs` | the grids of normals and of cells of Y |
//! | `cell_directions.rs` | the directions in each cell, and bounds on weights |
//! | `cell_points.rs` | evenly spaced points of each cell |
//! | `progress.rs` | progress of a bake |

mod cell_directions;
mod cell_grid;
mod cell_masses;
mod cell_points;
mod direct;
mod normal_grid;
mod progress;
mod table;

pub use cell_directions::CellDirections;
pub use cell_grid::CellGrid;
pub use cell_points::CellPoints;
pub use direct::{direct_bake, direct_bake_watched};
pub use normal_grid::NormalGrid;
pub use progress::StageProgress;
pub use table::BakedTable;
