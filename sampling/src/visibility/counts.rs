//! Shadow rays counted by cell and patch.

use std::sync::{
    Mutex, PoisonError,
    atomic::{AtomicU64, Ordering::Relaxed},
};

use super::{
    cell_index::{ByKey, CellIndex},
    cells::{CellKey, LEVELS},
    division::PATCHES,
};

/// Smallest number of rays of a cell, half of the rays that the prior counts as; fewer are not worth the time
/// and memory.
const LEAST_RAYS: usize = 32;

/// A shadow ray that has no cell yet: the key, and the patch with the visibility in the lowest bit.
type Ray = (CellKey, u16);

/// The cells and their counts.
#[derive(Debug, Default)]
pub struct Counts {
    index: CellIndex,
    /// The parent of each cell.
    parents: Vec<Option<u32>>,
    keys: Vec<CellKey>,
    /// For each cell and patch: unblocked rays in the upper half, all in the lower.
    rays: Vec<AtomicU64>,
    /// Rays without a cell.
    fresh: Mutex<Vec<Ray>>,
}

impl Counts {
    /// Returns the finest cell that contains a key, and its level above the key.
    #[inline]
    pub fn find(&self, key: CellKey) -> Option<(u32, usize)> {
        self.index.find(key)
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.parents.len()
    }

    /// Returns the key of a cell.
    pub fn key(&self, cell: usize) -> CellKey {
        self.keys[cell]
    }

    /// Returns the parent of a cell.
    pub fn parent(&self, cell: usize) -> Option<u32> {
        self.parents[cell]
    }

    /// Returns the cells of each size, smaller ones first.
    pub fn by_size(&self) -> Vec<Vec<usize>> {
        let mut cells: Vec<usize> = (0..self.cells()).collect();
        cells.sort_by_key(|&cell| self.keys[cell].size());
        cells.chunk_by(|&a, &b| self.keys[a].size() == self.keys[b].size()).map(<[usize]>::to_vec).collect()
    }

    /// Returns the rays of each patch: unblocked, and all.
    pub fn rays(&self, cell: usize) -> impl Iterator<Item = [u32; 2]> {
        self.packed(cell).iter().map(|rays| {
            let rays = rays.load(Relaxed);
            [(rays >> 32) as u32, rays as u32]
        })
    }

    /// Returns the rays packed into one number per patch: unblocked rays in the upper half, all in the lower.
    pub fn packed(&self, cell: usize) -> &[AtomicU64] {
        &self.rays[cell * PATCHES..][..PATCHES]
    }

    /// Counts rays.
    pub fn add(&self, rays: impl Iterator<Item = (CellKey, u16, bool)>) {
        let (mut fresh, mut last) = (Vec::new(), (None, None));
        for (key, patch, is_visible) in rays {
            if last.0 != Some(key) {
                last = (Some(key), self.find(key));
            }
            match last.1 {
                Some((cell, 0)) => {
                    let ray = 1 | u64::from(is_visible) << 32;
                    self.rays[cell as usize * PATCHES + usize::from(patch)].fetch_add(ray, Relaxed);
                }
                _ => fresh.push((key, patch << 1 | u16::from(is_visible))),
            }
        }
        if !fresh.is_empty() {
            // Sorted per thread, so that rays of a cell become neighbours.
            fresh.sort_unstable();
            self.fresh.lock().unwrap_or_else(PoisonError::into_inner).append(&mut fresh);
        }
    }

    /// Creates cells for rays without one: the finest cells with enough rays, and those that contain them, up
    /// to `most` cells.
    pub fn settle(&mut self, most: usize) {
        let mut rays = std::mem::take(self.fresh.get_mut().unwrap_or_else(PoisonError::into_inner));
        for level in 0..LEVELS {
            let groups = || rays.chunk_by(|a, b| a.0 == b.0);
            let mut missing: ByKey<usize> = ByKey::default();
            for group in groups().filter(|group| self.index.get(group[0].0).is_none()) {
                *missing.entry(group[0].0).or_default() += group.len();
            }
            let makes_cell = |&(_, count): &(CellKey, usize)| count >= LEAST_RAYS || level + 1 == LEVELS;
            let mut new: Vec<(usize, CellKey)> =
                missing.into_iter().filter(makes_cell).map(|(key, count)| (count, key)).collect();
            // Cells with most rays first, in case memory is short.
            new.sort_unstable_by_key(|&(count, key)| (std::cmp::Reverse(count), key));
            // Includes the cells that contain them, most of which are shared.
            let room = most.saturating_sub(self.cells()).min(new.len() + new.len() / 2);
            self.rays.reserve(room * PATCHES);
            for (_, key) in new {
                if self.cells() + LEVELS <= most {
                    self.insert(key, level);
                }
            }
            let mut left = Vec::new();
            for group in groups() {
                match self.index.get(group[0].0) {
                    Some(place) => {
                        for (_, ray) in group {
                            let rays = &mut self.rays[place as usize * PATCHES + usize::from(ray >> 1)];
                            *rays.get_mut() += 1 | u64::from(ray & 1) << 32;
                        }
                    }
                    None => left.extend(group.iter().map(|&(key, ray)| (key.parent(), ray))),
                }
            }
            rays = left;
        }
    }

    /// Adds a new cell with its rays (unblocked, and all, for each patch), after the cells that contain it.
    pub fn restore(&mut self, key: CellKey, rays: impl Iterator<Item = [u32; 2]>) {
        let parent = self.index.get(key.parent());
        self.push(key, parent);
        let cell = self.cells() - 1;
        for (own, [seen, all]) in self.rays[cell * PATCHES..].iter_mut().zip(rays) {
            *own.get_mut() = u64::from(seen) << 32 | u64::from(all);
        }
    }

    /// Adds a cell and the cells that contain it; returns its number.
    fn insert(&mut self, key: CellKey, level: usize) -> u32 {
        if let Some(cell) = self.index.get(key) {
            return cell;
        }
        let parent = (level + 1 < LEVELS).then(|| self.insert(key.parent(), level + 1));
        self.push(key, parent)
    }

    fn push(&mut self, key: CellKey, parent: Option<u32>) -> u32 {
        let cell = self.cells() as u32;
        self.index.insert(key, cell);
        self.parents.push(parent);
        self.keys.push(key);
        self.rays.extend(std::iter::repeat_with(AtomicU64::default).take(PATCHES));
        cell
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility::cells::Cells;
    use glam::Vec3A;

    fn rays(count: usize) -> Vec<(CellKey, u16, bool)> {
        let cells = Cells::new(Vec3A::ZERO, 0.01);
        let at = |k: usize| Vec3A::new((k * 37 % 101) as f32 * 0.1, 0.0, 9.0 + (k * 53 % 97) as f32 * 0.05);
        (0..count).map(|k| (cells.key(at(k), Vec3A::Y), (k * 7 % PATCHES) as u16, k % 3 == 0)).collect()
    }

    fn all(counts: &Counts) -> Vec<(CellKey, Option<CellKey>, Vec<[u32; 2]>)> {
        let parent = |cell| counts.parent(cell).map(|parent| counts.keys[parent as usize]);
        (0..counts.cells()).map(|cell| (counts.keys[cell], parent(cell), counts.rays(cell).collect())).collect()
    }

    #[test]
    fn counts_are_complete_and_independent_of_ray_order() {
        let rays = rays(20_000);
        let settled = |rays: &mut dyn Iterator<Item = &(CellKey, u16, bool)>| {
            let mut counts = Counts::default();
            counts.add(rays.copied());
            counts.settle(100_000);
            counts
        };
        let (mut forward, mut backward) = (settled(&mut rays.iter()), settled(&mut rays.iter().rev()));
        assert_eq!(all(&forward), all(&backward));
        // The same rays again, now that there are cells.
        forward.add(rays.iter().copied());
        backward.add(rays.iter().rev().copied());
        forward.settle(100_000);
        backward.settle(100_000);
        assert_eq!(all(&forward), all(&backward));
        let sum = all(&forward).iter().flat_map(|(_, _, rays)| rays).fold([0, 0], |s, r| [s[0] + r[0], s[1] + r[1]]);
        assert_eq!(sum, [2 * rays.iter().filter(|ray| ray.2).count() as u32, 40_000]);
    }

    #[test]
    fn cells_with_most_rays_stay_within_the_memory() {
        let mut counts = Counts::default();
        counts.add(rays(50_000).into_iter());
        let often = Cells::new(Vec3A::ZERO, 0.01).key(Vec3A::new(-3.0, 0.0, 9.0), Vec3A::Y);
        counts.add((0..5000).map(|_| (often, 5, true)));
        counts.settle(100);
        assert!((LEVELS..=100).contains(&counts.cells()));
        assert_eq!(counts.find(often).map(|(_, level)| level), Some(0));
        let mut none = Counts::default();
        none.add(rays(100).into_iter());
        none.settle(0);
        assert_eq!((none.cells(), none.find(often)), (0, None));
    }
}
