//! The sampler of patches, with or without a head and weights.

use std::sync::Arc;

use glam::{Vec2, Vec3A};

use super::{
    draw::{self, COLUMNS, LOBES, MIXTURE_WEIGHT},
    hierarchy::{Detail, PARTS, Patches},
};
use crate::{
    columns::Arena,
    error::{Error, Result},
    head::{Head, logit_of_mixture_weight},
    latlong,
    sampler::{Coverage, Draws, EnvironmentLight, IntermediateDensity, Sampler},
    simd::Lanes,
    tail::{Hierarchical, Tail, TailWarp},
    tile::Rows,
    visibility::{Division, PATCHES, Unoccluded, Weighting},
};

/// Samples directions by the patches of a light. It covers the whole integrand, but glossy lobes can be
/// narrower than patches: combine it with BRDF sampling, in which its mixture weight depends on the lobe.
/// Masses are multiplied by the weights of `W`.
#[derive(Clone, Debug)]
pub struct PatchSampler<W = Unoccluded> {
    pub(super) light: EnvironmentLight,
    pub(super) patches: Arc<Patches>,
    pub(super) head: Option<Arc<Head>>,
    pub(super) weighting: W,
}

impl PatchSampler {
    /// The sampler of a light.
    ///
    /// # Errors
    /// The tail is not a quad-tree, which makes rectangles of the map rectangles of Y.
    pub fn new(light: EnvironmentLight, detail: Detail) -> Result<Self> {
        let patches = Arc::new(Patches::alone(quad_tree(&light)?, detail));
        Ok(Self { light, patches, head: None, weighting: Unoccluded })
    }

    /// The sampler of a light with a head before the patches, which samples their residual. A mixture weight
    /// that the head has learned is a factor of the odds of patches.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_head(light: EnvironmentLight, detail: Detail, head: Head) -> Result<Self> {
        let patches = Arc::new(Patches::new(quad_tree(&light)?, detail));
        Ok(Self { light, patches, head: Some(Arc::new(head)), weighting: Unoccluded })
    }

    /// The same sampler with the masses of patches multiplied by weights.
    pub fn weighted<W: Weighting>(&self, weighting: W) -> PatchSampler<W> {
        PatchSampler { light: self.light.clone(), patches: self.patches.clone(), head: self.head.clone(), weighting }
    }

    /// Returns the number of each cluster in the order of the map, which that of [`Self::division`] is.
    pub(crate) fn cluster_numbers(&self) -> &[usize] {
        &self.patches.numbers
    }

    /// The patches that weights refer to, in the order of the map, with their fractions of the light; 0 for
    /// missing patches.
    pub fn division(&self) -> Division {
        let mut energies = vec![0.0; PATCHES];
        for (block, number) in self.patches.leaves.blocks.iter().zip(&self.patches.numbers) {
            energies[number * PARTS..][..PARTS].copy_from_slice(&block[0]);
        }
        Division::new(energies)
    }

    /// Returns the patch of [`Self::division`] of each direction.
    pub fn patches_of(&self, wi: &[Vec3A]) -> Vec<u16> {
        wi.iter().map(|&wi| self.patch_at(latlong::square(wi))).collect()
    }

    /// Returns the patch of [`Self::division`] of a point of X.
    pub fn patch_at(&self, x: Vec2) -> u16 {
        let (column, row, _) = self.light.tail().light().cell(x);
        let leaf = self.patches.lookup.patch(column as u32, row as u32) as usize / PARTS;
        (self.patches.numbers[leaf / PARTS] * PARTS + leaf % PARTS) as u16
    }
}

/// Returns the tail if it is a quad-tree, in which a rectangle of the map is a rectangle of Y.
pub(super) fn quad_tree(light: &EnvironmentLight) -> Result<&Hierarchical> {
    match &**light.tail() {
        Tail::Hierarchical(tail) => Ok(tail),
        _ => Err(Error::argument("patches", "need the hierarchical tail")),
    }
}

impl<W: Weighting> Sampler for PatchSampler<W> {
    fn columns(&self) -> usize {
        COLUMNS + self.head.as_ref().map_or(0, |head| head.columns())
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        let (state, of_head) = state.split_at_mut(COLUMNS * at.strips());
        if let Some(head) = &self.head {
            head.prepare(at, of_head, arena);
        }
        self.patches.prepare(&self.weighting, at, state, arena);
    }

    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena) {
        let (state, of_head) = state.split_at(COLUMNS * at.strips());
        let (patches, weighting) = (&*self.patches, &self.weighting);
        let mut y = arena.columns::<2>(at.strips());
        if let Some(head) = &self.head {
            let mut through = arena.columns::<3>(at.strips());
            let [z_u, z_v, q] = through.get_mut();
            head.sample(at, of_head, u, [&mut *z_u, &mut *z_v], q, arena);
            draw::sample(patches, weighting, at, state, [z_u, z_v], y.get_mut(), out.pdf);
            multiply(out.pdf, q);
        } else {
            draw::sample(patches, weighting, at, state, u, y.get_mut(), out.pdf);
        }
        self.light.directions(y.get(), out, arena);
    }

    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        let (state, of_head) = state.split_at(COLUMNS * at.strips());
        let (patches, weighting, grid) = (&*self.patches, &self.weighting, self.light.tail().light());
        let mut columns = arena.columns::<7>(at.strips());
        let [x_u, x_v, y_u, y_v, z_u, z_v, q] = columns.get_mut();
        latlong::squares(wi, [&mut *x_u, &mut *x_v]);
        if let Some(head) = &self.head {
            self.light.tail().inverse_columns([x_u, x_v], [&mut *y_u, &mut *y_v], out);
            draw::invert(patches, weighting, grid, at, state, [x_u, x_v], [y_u, y_v], [&mut *z_u, &mut *z_v], q);
            latlong::to_solid_angle(x_v, out);
            multiply(out, q);
            head.density(at, of_head, [z_u, z_v], q, arena);
        } else {
            draw::density(patches, weighting, grid, at, state, [x_u, x_v], q);
            self.light.pdf_at([x_u, x_v], out);
        }
        multiply(out, q);
    }

    fn mixture_weight(&self, at: &Rows<'_>, state: &[Lanes], out: &mut [Lanes], arena: &Arena) {
        let Some(head) = &self.head else {
            for (state, out) in state.chunks_exact(COLUMNS).zip(out) {
                *out = state[MIXTURE_WEIGHT];
            }
            return;
        };
        let mut lobes = arena.columns::<LOBES>(at.strips());
        at.lobes(lobes.get_mut(), arena);
        draw::mixture_weights_by_width(lobes.get(), out);
        if head.has_mixture_weight() {
            for mixture_weight in out.as_flattened_mut() {
                *mixture_weight = logit_of_mixture_weight(*mixture_weight);
            }
            head.mixture_weight_after(at, out, arena);
        }
    }

    /// With a head, the mixture weight comes from the head instead.
    fn mixes_by_state(&self) -> bool {
        self.head.is_none()
    }

    fn coverage(&self) -> Coverage {
        self.light.coverage()
    }
}

impl Patches {
    /// Computes the state of shading points, [`COLUMNS`] lanes for each strip.
    pub(super) fn prepare<W: Weighting>(&self, weighting: &W, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        let mut columns = arena.columns::<{ LOBES + 1 }>(at.strips());
        let [a, b, c, d, weights] = columns.get_mut();
        at.lobes([a, b, c, d], arena);
        weighting.indices(at, weights);
        for (strip, state) in state.chunks_exact_mut(COLUMNS).enumerate() {
            for (to, from) in state.iter_mut().zip(columns.get()) {
                *to = from[strip];
            }
        }
        draw::prepare(self, weighting, at, state);
    }
}

/// Multiplies densities by others.
pub(super) fn multiply(by: &mut [Lanes], others: &[Lanes]) {
    for (density, other) in by.as_flattened_mut().iter_mut().zip(others.as_flattened()) {
        *density *= other;
    }
}
