//! Visibility from counted rays, and weights from visibility.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use crate::parallel::*;

use super::{
    cells::CellKey,
    counts::Counts,
    division::{CLUSTERS, Division, PATCHES},
    weights::Weights,
};
use crate::{columns::vectorized, simd::LANES};

/// Prior visibility without rays.
const UNKNOWN: f32 = 0.7;
/// Number of rays that the prior of a larger cell counts as.
const STRENGTH: f32 = 64.0;
/// Smallest visibility with full weight: above it, the noise of estimates would make the integrand rough.
const SEEN: f32 = 0.2;
/// Smallest weight relative to the mean of the cell, which bounds the brightness of samples that were
/// estimated as blocked. Weights are square roots of visibilities, which minimizes variance.
const LEAST: f32 = 0.3;

/// Visibility of the patches and clusters from a cell.
#[derive(Clone, Debug)]
pub struct Visibility {
    patches: Vec<f32>,
    clusters: [f32; CLUSTERS],
}

impl Visibility {
    /// Returns the prior of the largest cells.
    pub fn unknown() -> Self {
        Self { patches: vec![UNKNOWN; PATCHES], clusters: [UNKNOWN; CLUSTERS] }
    }

    /// Returns the visibility of each patch.
    pub fn patches(&self) -> &[f32] {
        &self.patches
    }

    /// Sets the visibility of the first patches.
    #[cfg(test)]
    pub fn set(&mut self, patches: &[f32]) {
        self.patches[..patches.len()].copy_from_slice(patches);
    }

    /// Estimates visibility from rays, with a larger cell as the prior.
    fn of(rays: &Rays, above: &Self) -> Self {
        let mut own = above.clone();
        update(rays, above, &mut own);
        own
    }

    /// Returns the weights of the patches of a division, `[PATCHES]`, and their lower bound.
    pub fn weigh(&self, division: &Division) -> (Vec<f32>, f32) {
        let (mut weights, mut least) = (vec![0.0; PATCHES], 0.0);
        weigh(&self.patches, division.energies(), &mut weights, &mut least);
        (weights, least)
    }

    /// Returns the quantized weights of the patches of a division.
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
    /// Computes [`Visibility::of`], compiled for every instruction set.
    fn update['a](_simd, rays: &'a Rays, above: &'a Visibility, own: &'a mut Visibility) {
        let lists = rays.seen.chunks_exact(LANES).zip(rays.all.chunks_exact(LANES));
        for (cluster, ((seen, all), patches)) in lists.zip(own.patches.chunks_exact_mut(LANES)).enumerate() {
            let before = above.clusters[cluster];
            let mean = (seen.iter().sum::<f32>() + STRENGTH * before) / (all.iter().sum::<f32>() + STRENGTH);
            own.clusters[cluster] = mean;
            for ((patch, seen), all) in patches.iter_mut().zip(seen).zip(all) {
                // The cluster's change is part of the prior of its patches.
                let prior = (*patch + mean - before).clamp(0.0, 1.0);
                *patch = (seen + STRENGTH * prior) / (all + STRENGTH);
            }
        }
    }
}

vectorized! {
    /// Computes [`Visibility::weigh`], compiled for every instruction set.
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
        // Above 0 even where everything is blocked.
        let mean = sum.iter().sum::<f32>() / all.iter().sum::<f32>().max(f32::MIN_POSITIVE);
        let bound = (LEAST * mean).max(f32::MIN_POSITIVE);
        for weight in weights {
            *weight = weight.max(bound);
        }
        *least = bound;
    }
}

/// Calls `of` with the rays and the visibility of each of the `chosen` cells. Rays do not include those of
/// smaller cells within it; the prior is the visibility of the cell that contains it, or its own in
/// `precomputed`.
pub fn estimate<'a, T: Send>(
    counts: &Counts,
    precomputed: impl Fn(CellKey) -> Option<&'a Visibility> + Sync,
    chosen: impl IntoParallelIterator<Item = usize, Iter: IndexedParallelIterator>,
    of: impl Fn(&Rays, Visibility) -> T + Sync,
) -> Vec<T> {
    let by_size = counts.by_size();
    let mut inside = vec![Vec::new(); counts.cells()];
    for cell in 0..counts.cells() {
        if let Some(parent) = counts.parent(cell) {
            inside[parent as usize].push(cell);
        }
    }
    // Rays of cells including those of the cells within them, smaller ones first.
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
    // Visibility of these cells, larger ones first.
    let unknown = Visibility::unknown();
    let mut found: Vec<Option<Visibility>> = vec![None; counts.cells()];
    let before = |found: &[Option<Visibility>], cell: usize, rays: &Rays| {
        let above = counts.parent(cell).and_then(|parent| found[parent as usize].as_ref());
        Visibility::of(rays, precomputed(counts.key(cell)).or(above).unwrap_or(&unknown))
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
    chosen.into_par_iter().map(of_cell).collect()
}

/// Rays of each patch, `[PATCHES]`: unblocked, and all.
#[derive(Clone)]
pub struct Rays {
    pub seen: Vec<f32>,
    pub all: Vec<f32>,
}

impl Rays {
    /// Returns the rays of a cell, without those of cells within it.
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
                // Signed, because every processor converts signed numbers in one instruction.
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
    fn weights_are_positive_where_everything_is_blocked() {
        let mut dark = Visibility::unknown();
        dark.set(&[0.0; PATCHES]);
        let (weights, least) = dark.weigh(&Division::new(vec![1.0; PATCHES]));
        assert!(least > 0.0 && weights.iter().all(|&weight| weight >= least), "{least}");
    }

    #[test]
    fn cells_with_few_rays_follow_their_prior() {
        let cells = Cells::new(Vec3A::ZERO, 0.01);
        let key = |x: f32| cells.key(Vec3A::new(x, 0.0, 10.0), Vec3A::Y);
        let mut counts = Counts::default();
        // In a cell, 4000 rays to patch 3 (1 in 16 is unblocked) and to patch 20 (all are blocked); in its neighbour, 40 to patch 3.
        let rays = (0..8000).map(|k| (key(0.01), if k % 2 == 0 { 3 } else { 20 }, k % 32 == 0));
        counts.add(rays.chain((0..40).map(|_| (key(0.13), 3, false))));
        counts.settle(1000);
        let division = Division::new(vec![1.0; PATCHES]);
        let weights = estimate(&counts, |_| None, 0..counts.cells(), |_, visibility| visibility.weights(&division));
        let at = |x: f32, patch| weights[counts.find(key(x)).unwrap().0 as usize].of_patch(patch);
        // The root of (1/16) / 0.2, in steps of 1/255; the prior's 64 rays are close to it and change little.
        assert!((at(0.01, 3) - (0.0625_f32 / SEEN).sqrt()).abs() < 0.015, "{}", at(0.01, 3));
        // The lower bound relative to the mean, which is near 1.
        assert!((LEAST * 0.9..=LEAST).contains(&at(0.01, 20)), "{}", at(0.01, 20));
        // 40 rays against 64 of the prior, for the whole cluster first: 0.0625 * 64 / 104 = 0.0385, and
        // 0.0385 * 64 / 104 = 0.0237.
        assert!((at(0.13, 3) - (0.0237_f32 / SEEN).sqrt()).abs() < 0.015, "{}", at(0.13, 3));
        // Patches of another cluster have the prior.
        assert_eq!(at(0.01, 100), 1.0);
    }
}
