//! From counted rays to weights.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use crate::parallel::*;

use super::{
    cells::CellKey,
    counts::Counts,
    division::{CLUSTERS, Division, PATCHES},
    weights::Weights,
};
use crate::{columns::vectorized, simd::LANES};

/// What visibility is taken for where nothing is known.
const UNKNOWN: f32 = 0.7;
/// Rays that what is known from larger cells counts as.
const STRENGTH: f32 = 64.0;
/// From this visibility on, a patch counts as seen: the noise of what was learned would only roughen the integrand.
const SEEN: f32 = 0.2;
/// The least weight, relative to the mean of the cell: it bounds how bright a sample is that was thought to be in shadow. A weight is the root of a
/// visibility, the choice of least variance.
const LEAST: f32 = 0.3;

/// Visibility of the patches of a cell, and of their clusters.
#[derive(Clone, Debug)]
pub struct Visibility {
    patches: Vec<f32>,
    clusters: [f32; CLUSTERS],
}

impl Visibility {
    /// That of which nothing is known.
    pub fn unknown() -> Self {
        Self { patches: vec![UNKNOWN; PATCHES], clusters: [UNKNOWN; CLUSTERS] }
    }

    /// The visibility of each patch.
    pub fn patches(&self) -> &[f32] {
        &self.patches
    }

    /// Sets the visibility of the first patches.
    #[cfg(test)]
    pub fn set(&mut self, patches: &[f32]) {
        self.patches[..patches.len()].copy_from_slice(patches);
    }

    /// The visibility that rays speak for, after that of a larger cell.
    fn of(rays: &Rays, above: &Self) -> Self {
        let mut own = above.clone();
        update(rays, above, &mut own);
        own
    }

    /// What each patch of a division is to be weighed with, `[PATCHES]`, and the least of what may be.
    pub fn weigh(&self, division: &Division) -> (Vec<f32>, f32) {
        let (mut weights, mut least) = (vec![0.0; PATCHES], 0.0);
        weigh(&self.patches, division.energies(), &mut weights, &mut least);
        (weights, least)
    }

    /// The weights of the patches of a division.
    pub fn weights(&self, division: &Division) -> Weights {
        let (of_patches, _) = self.weigh(division);
        Weights::new(|patch| of_patches[patch], division.energies())
    }
}

#[inline(always)]
fn root(visibility: f32) -> f32 {
    (visibility / SEEN).min(1.0).sqrt()
}

vectorized! {
    /// [`Visibility::of`], compiled for every instruction set.
    fn update['a](_simd, rays: &'a Rays, above: &'a Visibility, own: &'a mut Visibility) {
        let lists = rays.seen.chunks_exact(LANES).zip(rays.all.chunks_exact(LANES));
        for (cluster, ((seen, all), patches)) in lists.zip(own.patches.chunks_exact_mut(LANES)).enumerate() {
            let before = above.clusters[cluster];
            let mean = (seen.iter().sum::<f32>() + STRENGTH * before) / (all.iter().sum::<f32>() + STRENGTH);
            own.clusters[cluster] = mean;
            for ((patch, seen), all) in patches.iter_mut().zip(seen).zip(all) {
                // What the cluster has learned goes for all of its patches.
                let prior = (*patch + mean - before).clamp(0.0, 1.0);
                *patch = (seen + STRENGTH * prior) / (all + STRENGTH);
            }
        }
    }
}

vectorized! {
    /// [`Visibility::weigh`], compiled for every instruction set.
    fn weigh['a](_simd, visibility: &'a [f32], energies: &'a [f32], weights: &'a mut [f32], least: &'a mut f32) {
        let (mut sum, mut all) = ([0.0; LANES], [0.0; LANES]);
        let lists = visibility.chunks_exact(LANES).zip(energies.chunks_exact(LANES));
        for ((visibility, energies), weights) in lists.zip(weights.chunks_exact_mut(LANES)) {
            for k in 0..LANES {
                weights[k] = root(visibility[k]);
                sum[k] += energies[k] * weights[k];
                all[k] += energies[k];
            }
        }
        // Above 0 even where nothing is seen at all.
        let mean = sum.iter().sum::<f32>() / all.iter().sum::<f32>().max(f32::MIN_POSITIVE);
        let bound = (LEAST * mean).max(f32::MIN_POSITIVE);
        for weight in weights {
            *weight = weight.max(bound);
        }
        *least = bound;
    }
}

/// What `of` makes of the rays of each of the `asked` cells, those of smaller ones that lie in it aside, and of its visibility. The latter is that of the larger one that the cell lies in until it has rays of its own; where
/// `known` has something of the cell, that takes the larger one's place.
pub fn estimate<'a, T: Send>(
    counts: &Counts,
    known: impl Fn(CellKey) -> Option<&'a Visibility> + Sync,
    asked: impl IntoParallelIterator<Item = usize, Iter: IndexedParallelIterator>,
    of: impl Fn(&Rays, Visibility) -> T + Sync,
) -> Vec<T> {
    let by_size = counts.by_size();
    let mut inside = vec![Vec::new(); counts.cells()];
    for cell in 0..counts.cells() {
        if let Some(parent) = counts.parent(cell) {
            inside[parent as usize].push(cell);
        }
    }
    // Cells that others lie in, with the rays of all of these: smaller ones first.
    let mut rays: Vec<Option<Rays>> = vec![None; counts.cells()];
    for cells in &by_size {
        let sums = cells.par_iter().filter(|&&cell| !inside[cell].is_empty()).map(|&cell| {
            let mut sum = Rays::of(counts, cell);
            for &part in &inside[cell] {
                match &rays[part] {
                    Some(rays) => sum.add(rays),
                    None => add_counts(counts.packed(part), &mut sum),
                }
            }
            (cell, sum)
        });
        for (cell, sum) in sums.collect::<Vec<_>>() {
            rays[cell] = Some(sum);
        }
    }
    // Their visibility: larger ones first.
    let unknown = Visibility::unknown();
    let mut found: Vec<Option<Visibility>> = vec![None; counts.cells()];
    let before = |found: &[Option<Visibility>], cell: usize, rays: &Rays| {
        let above = counts.parent(cell).and_then(|parent| found[parent as usize].as_ref());
        Visibility::of(rays, known(counts.key(cell)).or(above).unwrap_or(&unknown))
    };
    for cells in by_size.iter().rev() {
        let own = cells.par_iter().filter_map(|&cell| Some((cell, before(&found, cell, rays[cell].as_ref()?))));
        for (cell, visibility) in own.collect::<Vec<_>>() {
            found[cell] = Some(visibility);
        }
    }
    let of_cell = |cell: usize| {
        let rays = Rays::of(counts, cell);
        of(&rays, found[cell].clone().unwrap_or_else(|| before(&found, cell, &rays)))
    };
    asked.into_par_iter().map(of_cell).collect()
}

/// Rays of each patch, `[PATCHES]`: those that came through, and all.
#[derive(Clone)]
pub struct Rays {
    pub seen: Vec<f32>,
    pub all: Vec<f32>,
}

impl Rays {
    /// Those of a cell, without the cells that lie in it.
    fn of(counts: &Counts, cell: usize) -> Self {
        let mut rays = Self { seen: vec![0.0; PATCHES], all: vec![0.0; PATCHES] };
        add_counts(counts.packed(cell), &mut rays);
        rays
    }

    fn add(&mut self, rays: &Self) {
        for (sum, rays) in [(&mut self.seen, &rays.seen), (&mut self.all, &rays.all)] {
            for (sum, rays) in sum.iter_mut().zip(rays) {
                *sum += rays;
            }
        }
    }
}

vectorized! {
    /// Adds the rays of a cell.
    fn add_counts['a](_simd, counts: &'a [AtomicU64], sum: &'a mut Rays) {
        let lists = sum.seen.chunks_exact_mut(LANES).zip(sum.all.chunks_exact_mut(LANES));
        for (counts, (seen, all)) in counts.chunks_exact(LANES).zip(lists) {
            let mut packed = [0; LANES];
            for (packed, count) in packed.iter_mut().zip(counts) {
                *packed = count.load(Relaxed);
            }
            for k in 0..LANES {
                // As signed numbers, which every processor turns at once.
                seen[k] += (packed[k] >> 32) as i32 as f32;
                all[k] += packed[k] as i32 as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility::cells::Cells;
    use glam::Vec3A;

    #[test]
    fn where_nothing_is_seen_weights_are_above_0() {
        let mut dark = Visibility::unknown();
        dark.set(&[0.0; PATCHES]);
        let (weights, least) = dark.weigh(&Division::new(vec![1.0; PATCHES]));
        assert!(least > 0.0 && weights.iter().all(|&weight| weight >= least), "{least}");
    }

    #[test]
    fn what_many_rays_say_is_believed_and_what_none_say_is_taken_from_around() {
        let cells = Cells::new(Vec3A::ZERO, 0.01);
        let key = |x: f32| cells.key(Vec3A::new(x, 0.0, 10.0), Vec3A::Y);
        let mut counts = Counts::default();
        // In a cell, 4000 rays to patch 3 (one in sixteen comes through) and to patch 20 (none does); in its neighbour, forty to patch 3.
        let rays = (0..8000).map(|k| (key(0.01), if k % 2 == 0 { 3 } else { 20 }, k % 32 == 0));
        counts.add(rays.chain((0..40).map(|_| (key(0.13), 3, false))));
        counts.settle(1000);
        let division = Division::new(vec![1.0; PATCHES]);
        let weights = estimate(&counts, |_| None, 0..counts.cells(), |_, visibility| visibility.weights(&division));
        let at = |x: f32, patch| weights[counts.find(key(x)).unwrap().0 as usize].of_patch(patch);
        // The root of (1/16) / 0.2, in steps of 1/255; 64 rays of the prior, which is as good as the same, change little.
        assert!((at(0.01, 3) - (0.0625_f32 / SEEN).sqrt()).abs() < 0.015, "{}", at(0.01, 3));
        // No less than a share of the mean, which is near to 1.
        assert!((LEAST * 0.9..=LEAST).contains(&at(0.01, 20)), "{}", at(0.01, 20));
        // Forty rays against 64 of the prior, for the cluster as a whole first: 0.0625 * 64 / 104 = 0.0385, and 0.0385 * 64 / 104 = 0.0237.
        assert!((at(0.13, 3) - (0.0237_f32 / SEEN).sqrt()).abs() < 0.015, "{}", at(0.13, 3));
        // Nothing is known of the patches of another cluster but that they are like all.
        assert_eq!(at(0.01, 100), 1.0);
    }
}
