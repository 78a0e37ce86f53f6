//! Tabulated intermediate densities: the bake of a head, and the direct bake that needs no training.

mod cell_directions;
mod cell_grid;
mod cell_masses;
mod cell_points;
mod direct;
mod normal_grid;
mod share;
mod table;

pub use cell_directions::CellDirections;
pub use cell_grid::CellGrid;
pub use cell_points::CellPoints;
pub use direct::{direct_bake, direct_bake_watched};
pub use normal_grid::NormalGrid;
pub use share::Share;
pub use table::BakedTable;
