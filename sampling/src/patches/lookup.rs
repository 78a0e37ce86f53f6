//! Finds the patch of a cell of the map.

use crate::tail::Node;

/// Logarithm of the largest number of nodes of the level at which a search begins.
const TOP_BITS: u32 = 13;
/// Marks the number of a patch; other numbers are nodes.
const IS_PATCH: u16 = 1 << 15;

/// A tree from cells to patches.
#[derive(Clone, Debug)]
pub struct Lookup {
    /// The node, or patch, of each rectangle of the top level.
    top: Vec<u16>,
    /// Rectangles in a row of the top level.
    width: u32,
    /// The logarithms of their sides.
    bits: [u32; 2],
    nodes: Vec<Halves>,
}

/// A node: the bit of the column or row that tells its halves apart, and the halves.
#[derive(Clone, Copy, Debug)]
struct Halves {
    is_column: bool,
    bit: u8,
    halves: [u16; 2],
}

impl Lookup {
    /// The lookup of patches with their numbers (below 32768). Cells outside all patches are dark and get the
    /// number 0.
    pub fn new(root: Node, mut patches: Vec<(Node, u16)>) -> Self {
        patches.sort_unstable_by_key(|(patch, _)| patch.order());
        let mut shape = root;
        while root.width_bits + root.height_bits - shape.width_bits - shape.height_bits < TOP_BITS && !shape.is_cell() {
            shape = shape.children()[0];
        }
        let width = 1 << (root.width_bits - shape.width_bits);
        let height = 1 << (root.height_bits - shape.height_bits);
        let mut lookup = Self {
            top: vec![IS_PATCH; width * height],
            width: width as u32,
            bits: [shape.width_bits, shape.height_bits],
            nodes: Vec::new(),
        };
        lookup.fill(root, &patches, shape);
        lookup
    }

    /// Fills the top level below a node at or above it, in which `patches` are.
    fn fill(&mut self, node: Node, patches: &[(Node, u16)], shape: Node) {
        let at_top = (node.width_bits, node.height_bits) == (shape.width_bits, shape.height_bits);
        if at_top || patches.is_empty() || patches[0].0 == node {
            let entry = self.entry(node, patches);
            for row in node.row >> shape.height_bits..(node.row + (1 << node.height_bits)) >> shape.height_bits {
                for column in
                    node.column >> shape.width_bits..(node.column + (1 << node.width_bits)) >> shape.width_bits
                {
                    self.top[(row * self.width + column) as usize] = entry;
                }
            }
        } else {
            for (half, patches) in halves(node, patches) {
                self.fill(half, patches, shape);
            }
        }
    }

    /// Returns the number of a node in which `patches` are, after adding all nodes below it; or that of the patch.
    fn entry(&mut self, node: Node, patches: &[(Node, u16)]) -> u16 {
        match patches {
            [] => IS_PATCH,
            [(patch, number), ..] if *patch == node => IS_PATCH | number,
            _ => {
                let own = self.nodes.len();
                let is_column = node.halves_columns();
                let bit = if is_column { node.width_bits } else { node.height_bits } as u8 - 1;
                self.nodes.push(Halves { is_column, bit, halves: [IS_PATCH; 2] });
                self.nodes[own].halves = halves(node, patches).map(|(half, patches)| self.entry(half, patches));
                own as u16
            }
        }
    }

    /// The patch of a cell.
    #[inline(always)]
    pub fn patch(&self, column: u32, row: u32) -> u32 {
        let mut at = self.top[((row >> self.bits[1]) * self.width + (column >> self.bits[0])) as usize];
        while at & IS_PATCH == 0 {
            let Halves { is_column, bit, halves } = self.nodes[at as usize];
            at = halves[((if is_column { column } else { row } >> bit) & 1) as usize];
        }
        u32::from(at & !IS_PATCH)
    }
}

/// Returns the halves of a node with the patches in each.
fn halves(node: Node, patches: &[(Node, u16)]) -> [(Node, &[(Node, u16)]); 2] {
    let [first, second] = node.children();
    let (of_first, of_second) = patches.split_at(patches.partition_point(|(patch, _)| patch.order() < second.order()));
    [(first, of_first), (second, of_second)]
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;

    #[test]
    fn every_cell_finds_the_patch_that_holds_it() {
        // Below, at and above the top level; a part without patches.
        for (columns, rows) in [(1, 1), (8, 4), (3, 17), (512, 255)] {
            let root = Node::root(columns, rows);
            let (mut patches, mut stack) = (HashMap::new(), vec![root]);
            while let Some(node) = stack.pop() {
                let is_dark = node.column >= 4 && node.row >= 2;
                if node.is_cell() || (node.column * 3 + node.row * 5 + node.width_bits) % 29 == 3 {
                    if !is_dark && patches.len() < 20_000 {
                        patches.insert(node, patches.len() as u16 + 1);
                    }
                } else {
                    stack.extend(node.children());
                }
            }
            let lookup = Lookup::new(root, patches.clone().into_iter().collect());
            for row in 0..rows as u32 {
                for column in 0..columns as u32 {
                    let mut node = root;
                    while !node.is_cell() && !patches.contains_key(&node) {
                        let [first, second] = node.children();
                        node = if column >= second.column && row >= second.row { second } else { first };
                    }
                    let expected = patches.get(&node).copied().unwrap_or(0);
                    assert_eq!(lookup.patch(column, row), u32::from(expected), "{columns} x {rows}: {column}, {row}");
                }
            }
        }
    }
}
