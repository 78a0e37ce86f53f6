//! Learned visibility as `visibility.wgsl` reads it.

use headtail_render::visibility::FlatVisibility;

/// Words before the table.
const HEADER: u32 = 8;
/// Words of a slot of the table.
const SLOT: usize = 3;

/// Returns the words of learned weights; of `None`, those that say that there are none.
pub fn visibility_words(visibility: Option<&FlatVisibility>) -> Vec<u32> {
    let Some(FlatVisibility { cells, table, weights }) = visibility else { return vec![0; HEADER as usize] };
    let [x, y, z, angle] = cells.map(f32::to_bits);
    let last = (table.len() / SLOT - 1) as u32;
    let mut words = vec![last, x, y, z, angle, HEADER + table.len() as u32, 1, 0];
    words.extend(table);
    words.extend(weights);
    words
}
