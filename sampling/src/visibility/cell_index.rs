//! The numbers of cells by their keys.

use std::{
    collections::HashMap,
    hash::{BuildHasherDefault, Hasher},
};

use super::cells::{CellKey, LEVELS};

/// A hash for keys that a product distributes well enough.
#[derive(Clone, Copy, Debug, Default)]
pub struct KeyHasher(u64);

impl Hasher for KeyHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_u64(u64::from(byte));
        }
    }

    fn write_u64(&mut self, key: u64) {
        let product = (self.0 ^ key ^ (key >> 29)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = product ^ (product >> 32);
    }
}

/// A map from keys of cells.
pub type ByKey<T> = HashMap<CellKey, T, BuildHasherDefault<KeyHasher>>;

/// The numbers of cells by their keys.
#[derive(Debug, Default)]
pub struct CellIndex(ByKey<u32>);

impl CellIndex {
    /// Returns the cell with exactly this key.
    #[inline]
    pub fn get(&self, key: CellKey) -> Option<u32> {
        self.0.get(&key).copied()
    }

    /// Returns the finest cell that contains a key, and its level above the key.
    #[inline]
    pub fn find(&self, mut key: CellKey) -> Option<(u32, usize)> {
        if self.0.is_empty() {
            return None;
        }
        for level in 0..LEVELS {
            if let Some(cell) = self.get(key) {
                return Some((cell, level));
            }
            key = key.parent();
        }
        None
    }

    /// Returns all keys with their numbers, in any order.
    pub fn iter(&self) -> impl Iterator<Item = (CellKey, u32)> {
        self.0.iter().map(|(&key, &cell)| (key, cell))
    }

    /// Sets the number of a key.
    pub fn insert(&mut self, key: CellKey, cell: u32) {
        self.0.insert(key, cell);
    }
}

impl FromIterator<(CellKey, u32)> for CellIndex {
    fn from_iter<T: IntoIterator<Item = (CellKey, u32)>>(cells: T) -> Self {
        Self(cells.into_iter().collect())
    }
}
