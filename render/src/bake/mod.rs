//! Tabulated intermediate densities: the bake of a head, and the direct bake that needs no training.

mod abreast;
mod cell_masses;
mod direct;
mod normal_grid;
mod prefix;
mod table;

pub use direct::{CellPoints, direct_bake};
pub use normal_grid::{NormalGrid, Stencil};
pub use prefix::search_prefix;
pub use table::{BakedTable, CellGrid, PreparedTable};
