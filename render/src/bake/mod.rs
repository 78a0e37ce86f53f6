//! Tabulated intermediate densities: the bake of a head, and the direct bake that needs no training.

mod cell_grid;
mod cell_masses;
mod direct;
mod normal_grid;
mod table;

pub use cell_grid::CellGrid;
pub use direct::{CellPoints, direct_bake};
pub use normal_grid::NormalGrid;
pub use table::BakedTable;
