//! The sky as samplers take weights of it: patches, and for tables a grid over Y.

use super::layout::{GridLayout, PATCHES};

/// What weights are given for: the patches of a map's sky, and for samplers that draw from a grid over Y its cells, too.
///
/// Rays are counted by patches alone, whatever draws: what is learned for one sampler serves all.
#[derive(Clone, Debug)]
pub struct Division {
    energies: Vec<f32>,
    grid: Option<PatchGrid>,
}

impl Division {
    /// Patches with their shares of light, in their order; those that do not exist have 0.
    ///
    /// # Panics
    /// If there are not [`PATCHES`] of them.
    pub fn new(energies: Vec<f32>) -> Self {
        assert_eq!(energies.len(), PATCHES, "a share of light for each patch");
        Self { energies, grid: None }
    }

    /// The same with a grid over Y.
    #[must_use]
    pub fn with_grid(self, grid: PatchGrid) -> Self {
        Self { grid: Some(grid), ..self }
    }

    /// The shares of light of the patches.
    pub fn energies(&self) -> &[f32] {
        &self.energies
    }

    /// The grid over Y.
    pub fn grid(&self) -> Option<&PatchGrid> {
        self.grid.as_ref()
    }

    /// Bytes of the weights of the grid at one place.
    pub fn grid_bytes(&self) -> usize {
        self.grid.as_ref().map_or(0, |grid| grid.layout.bytes())
    }
}

/// A grid over Y whose cells know what patches of sky they are of.
#[derive(Clone, Debug)]
pub struct PatchGrid {
    layout: GridLayout,
    /// The patches of each cell `[rows, columns]`, with their shares in it.
    parts: Vec<Vec<(u16, f32)>>,
}

impl PatchGrid {
    /// A grid of which points say what patches it is of: `points` are those of each cell `[rows, columns]`, evenly spread over it.
    ///
    /// # Panics
    /// If a cell has no points, or a patch is none.
    pub fn new(layout: GridLayout, points: impl ExactSizeIterator<Item = Vec<u16>>) -> Self {
        assert_eq!(points.len(), layout.rows * layout.columns, "points of each cell");
        let parts = points.map(|mut patches| {
            assert!(!patches.is_empty() && patches.iter().all(|&patch| usize::from(patch) < PATCHES));
            let one = 1.0 / patches.len() as f32;
            patches.sort_unstable();
            patches.chunk_by(|a, b| a == b).map(|same| (same[0], one * same.len() as f32)).collect()
        });
        Self { layout, parts: parts.collect() }
    }

    /// How the weights of the cells are laid out.
    pub fn layout(&self) -> GridLayout {
        self.layout
    }

    /// The patches of each cell `[rows, columns]`, with their shares in it.
    pub(super) fn parts(&self) -> impl Iterator<Item = &[(u16, f32)]> {
        self.parts.iter().map(Vec::as_slice)
    }
}
