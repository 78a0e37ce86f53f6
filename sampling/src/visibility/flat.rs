//! Learned visibility as flat lists, for implementations on other devices.

use super::{CLUSTERS, Cells, PATCHES, cells::CellKey, weights::Weights};
use crate::simd::LANES;

/// Words of the weights of a cell, of which each holds four.
const WORDS: usize = (CLUSTERS + PATCHES) / 4;
/// Words of a slot of the table.
const SLOT: usize = 3;

/// The weights of all cells, and where they are found.
///
/// A cell has the key of [`Cells::key`] of its points, or one of their next levels (`CellKey::parent`); the finest one
/// counts.
#[derive(Clone, Debug, PartialEq)]
pub struct FlatVisibility {
    /// The eye in metres, from which cells grow, and the side of a cell over its distance from the eye.
    pub cells: [f32; 4],
    /// `[slots, 3]`: low and high word of a key, and the number of its weights from 1 on, or 0 in a free slot. There are 2^k
    /// slots. A key is in [`Self::slot`], or in the next free one.
    pub table: Vec<u32>,
    /// `[cells, 136]`: weights in units of 1/255, four per word: of the 32 clusters, then of the 16 parts of each.
    pub weights: Vec<u32>,
}

impl FlatVisibility {
    /// Lists cells with their weights; `order` has the number of each cluster of a sampler in the order of the map.
    pub(super) fn new(cells: &Cells, weights: Vec<(CellKey, &Weights)>, order: &[usize]) -> Self {
        let (eye, angle) = cells.parts();
        let slots = (2 * weights.len()).next_power_of_two().max(2);
        let mut flat = Self {
            cells: [eye.x, eye.y, eye.z, angle],
            table: vec![0; SLOT * slots],
            weights: Vec::with_capacity(WORDS * weights.len()),
        };
        for (number, (key, weights)) in (1..).zip(weights) {
            let words = [key.0 as u32, (key.0 >> 32) as u32];
            let mut slot = Self::slot(words, slots);
            while flat.table[SLOT * slot + 2] != 0 {
                slot = (slot + 1) % slots;
            }
            flat.table[SLOT * slot..][..SLOT].copy_from_slice(&[words[0], words[1], number]);
            let clusters = |cluster: usize| order.get(cluster).copied().unwrap_or(cluster);
            let of_clusters = (0..CLUSTERS).map(|cluster| weights.clusters[clusters(cluster)]);
            let of_parts = (0..PATCHES).map(|k| weights.patches[clusters(k / LANES)][k % LANES]);
            let bytes: Vec<u8> = of_clusters.chain(of_parts).collect();
            flat.weights.extend(bytes.as_chunks::<4>().0.iter().map(|bytes| u32::from_le_bytes(*bytes)));
        }
        flat
    }

    /// Returns the first slot of a key, given as low and high word, among `slots`.
    pub fn slot([low, high]: [u32; 2], slots: usize) -> usize {
        let mixed = low.wrapping_mul(0x9e37_79b9) ^ high.wrapping_mul(0x85eb_ca6b);
        let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x2c1b_3c6d);
        (mixed ^ (mixed >> 16)) as usize & (slots - 1)
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3A;

    use super::*;

    #[test]
    fn keys_are_found_with_their_weights_in_the_given_order() {
        let cells = Cells::new(Vec3A::new(1.0, 2.0, 3.0), 0.1);
        let keys: Vec<CellKey> =
            (0..50).map(|k| cells.key(Vec3A::new(k as f32, 0.5 * k as f32, 7.0), Vec3A::Y)).collect();
        let energies = vec![1.0; PATCHES];
        let weights: Vec<Weights> =
            (0..50).map(|k| Weights::new(|patch| ((patch / LANES + k) % 200 + 1) as f32 / 255.0, &energies)).collect();
        let order: Vec<usize> = (0..CLUSTERS).rev().collect();
        let flat = FlatVisibility::new(&cells, keys.iter().copied().zip(&weights).collect(), &order);
        assert_eq!((flat.table.len(), flat.weights.len()), (SLOT * 128, 50 * WORDS));
        for key in &keys {
            let words = [key.0 as u32, (key.0 >> 32) as u32];
            let mut slot = FlatVisibility::slot(words, 128);
            while flat.table[SLOT * slot..][..2] != words {
                assert_ne!(flat.table[SLOT * slot + 2], 0, "a free slot before the key");
                slot = (slot + 1) % 128;
            }
            // Equal keys have the weights of the first.
            let first = keys.iter().position(|own| own == key).unwrap();
            let number = flat.table[SLOT * slot + 2] as usize - 1;
            assert_eq!(number, first);
            let bytes: Vec<u8> =
                flat.weights[number * WORDS..][..WORDS].iter().flat_map(|word| word.to_le_bytes()).collect();
            for cluster in 0..CLUSTERS {
                let expected = ((CLUSTERS - 1 - cluster + first) % 200 + 1) as u8;
                assert_eq!((bytes[cluster], bytes[CLUSTERS + LANES * cluster + 5]), (expected, expected));
            }
        }
    }
}
