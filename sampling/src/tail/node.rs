//! Rectangles of a map: the nodes of the tree in which the quad-tree tail halves it.

use crate::morton::morton;

/// A rectangle of cells: a node of the binary tree that halves the map, by columns where it is wider than
/// high, else by rows. [`super::Hierarchical`] halves in the same order, so a node is a rectangle of Y too.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Node {
    /// First column.
    pub column: u32,
    /// First row.
    pub row: u32,
    /// Base-2 logarithm of the width.
    pub width_bits: u32,
    /// Base-2 logarithm of the height.
    pub height_bits: u32,
}

impl Node {
    /// Returns the root over a map of cells, with sides rounded up to powers of two.
    pub fn root(columns: usize, rows: usize) -> Self {
        let bits = |count: usize| count.next_power_of_two().ilog2();
        Self { column: 0, row: 0, width_bits: bits(columns), height_bits: bits(rows) }
    }

    /// Whether it is a single cell.
    pub fn is_cell(self) -> bool {
        self.width_bits + self.height_bits == 0
    }

    /// Whether its children are side by side.
    pub fn halves_columns(self) -> bool {
        self.width_bits > self.height_bits
    }

    /// Returns its two halves; it must not be a cell.
    pub fn children(self) -> [Self; 2] {
        if self.halves_columns() {
            let half = Self { width_bits: self.width_bits - 1, ..self };
            [half, Self { column: self.column + (1 << half.width_bits), ..half }]
        } else {
            let half = Self { height_bits: self.height_bits - 1, ..self };
            [half, Self { row: self.row + (1 << half.height_bits), ..half }]
        }
    }

    /// Returns the place of its first cell in the tree, depth first: the order of nodes of which none holds another.
    pub fn order(self) -> u64 {
        let high = morton((self.column >> 16) as u16, (self.row >> 16) as u16);
        u64::from(high) << 32 | u64::from(morton(self.column as u16, self.row as u16))
    }

    /// Returns the nodes `levels` below, or its cells if there are fewer levels.
    pub fn descendants(self, levels: u32) -> Vec<Self> {
        let levels = levels.min(self.width_bits + self.height_bits);
        let mut nodes = vec![self; 1 << levels];
        for level in 0..levels {
            // From the last one, so that none is overwritten before it is halved.
            for k in (0..1 << level).rev() {
                [nodes[2 * k], nodes[2 * k + 1]] = nodes[k].children();
            }
        }
        nodes
    }
}
