//! Precomputed visibility of a scene, as in files of `bake --visibility`.

use std::path::Path;

use glam::Vec3A;

use super::{
    cell_index::CellIndex,
    cells::{CellKey, Cells},
    counts::Counts,
    division::{Division, PATCHES},
    estimate::{self, Visibility},
    flat::FlatVisibility,
    predicted_gain::PredictedGain,
    weights::{Weighting, Weights},
};
use crate::{
    environment::Environment,
    error::{Error, Result},
    simd::Lanes,
    tile::Rows,
};

/// Shadow rays of a scene under a map, counted by cell and patch: valid for all materials and viewpoints of this scene and map.
/// [`Self::read`] describes its file.
#[derive(Debug)]
pub struct SceneVisibility {
    /// Hash of the scene's geometry:
    /// [`SceneContext::geometry_hash`](crate::spec::SceneContext::geometry_hash).
    pub scene_hash: String,
    /// The map's name, for messages.
    pub environment: String,
    /// [`Environment::hash`](crate::environment::Environment::hash).
    pub environment_hash: String,
    /// Wall-clock seconds of learning, if recorded.
    pub seconds: Option<f64>,
    pub(super) cells: Cells,
    pub(super) counts: Counts,
}

impl SceneVisibility {
    /// Returns the number of cells of all sizes.
    pub fn cells(&self) -> usize {
        self.counts.cells()
    }

    /// Returns the number of shadow rays.
    pub fn rays(&self) -> u64 {
        (0..self.cells()).flat_map(|cell| self.counts.rays(cell)).map(|[_, all]| u64::from(all)).sum()
    }

    /// Reads a file ([`Self::read`]) and checks that it was learned under this map, and in the scene with a geometry
    /// hash if one is given.
    ///
    /// # Errors
    /// The file cannot be read, or was learned in another scene or under another map.
    pub fn open(path: &Path, scene_hash: Option<&str>, environment: &Environment) -> Result<Self> {
        let visibility = Self::read(path)?;
        let wrong = |what: &str| Err(Error::invalid(path, "visibility", format!("was learned {what}")));
        if visibility.environment_hash != environment.hash() {
            return wrong(&format!("under another map, {}", visibility.environment));
        }
        let is_other = scene_hash.is_some_and(|hash| visibility.scene_hash != hash);
        if is_other { wrong("in another scene") } else { Ok(visibility) }
    }
}

/// A [`SceneVisibility`] with its weights, ready for rendering.
#[derive(Debug)]
pub struct PrecomputedVisibility {
    cells: Cells,
    index: CellIndex,
    estimates: Vec<(Visibility, Weights)>,
    /// The weights outside all cells.
    unknown: Weights,
    gain: PredictedGain,
}

impl PrecomputedVisibility {
    /// Bytes of a cell: visibility, weights, and its entry in the index.
    const CELL_BYTES: usize = PATCHES * 4 + size_of::<(Visibility, Weights)>() + 24;

    /// Computes the visibility of the patches of a division.
    ///
    /// # Errors
    /// The result takes more than `bytes` bytes.
    pub fn new(visibility: &SceneVisibility, division: &Division, bytes: usize) -> Result<Self> {
        let cells = visibility.cells();
        let cell_bytes = Self::CELL_BYTES;
        if cells > bytes / cell_bytes {
            let megabytes = |bytes: usize| bytes.div_ceil(1 << 20);
            let (needed, allowed) = (megabytes(cells * cell_bytes), megabytes(bytes));
            return Err(Error::argument("visibility", format!("takes {needed} MB, and {allowed} MB are allowed")));
        }
        let counts = &visibility.counts;
        let estimates = estimate::estimate(
            counts,
            |_| None,
            0..cells,
            |rays, visibility| {
                let (gain, weights) = (PredictedGain::of(rays, &visibility, division), visibility.weights(division));
                (gain, (visibility, weights))
            },
        );
        let (gains, estimates): (Vec<_>, Vec<_>) = estimates.into_iter().unzip();
        Ok(Self {
            cells: visibility.cells,
            index: (0..cells).map(|cell| (counts.key(cell), cell as u32)).collect(),
            estimates,
            unknown: Weights::unknown(),
            gain: gains.into_iter().fold(PredictedGain::default(), PredictedGain::with),
        })
    }

    /// Returns the division of space.
    pub fn cells(&self) -> Cells {
        self.cells
    }

    /// Returns its size in bytes.
    pub fn bytes(&self) -> usize {
        self.estimates.len() * Self::CELL_BYTES
    }

    /// Returns the predicted gain of its weights.
    pub(super) fn gain(&self) -> PredictedGain {
        self.gain
    }

    /// Returns the number of cells.
    pub fn count(&self) -> usize {
        self.estimates.len()
    }

    /// Returns the finest cell of a point with a normal: its number, its level above the smallest cells, and
    /// the visibility of each patch; `None` outside all cells.
    pub fn at(&self, p: Vec3A, n: Vec3A) -> Option<(u32, usize, &[f32])> {
        let (cell, level) = self.find(self.cells.key(p, n))?;
        Some((cell, level, self.estimates[cell as usize].0.patches()))
    }

    /// Returns the finest cell that contains a key, and its level above the key.
    #[inline]
    pub(super) fn find(&self, key: CellKey) -> Option<(u32, usize)> {
        self.index.find(key)
    }

    /// Returns the cells with their weights, in the order of their numbers.
    pub(super) fn weighted_cells(&self) -> Vec<(CellKey, &Weights)> {
        let mut cells: Vec<_> = self.index.iter().collect();
        cells.sort_unstable_by_key(|&(_, cell)| cell);
        cells.into_iter().map(|(key, cell)| (key, &self.estimates[cell as usize].1)).collect()
    }

    /// Returns its weights as lists for other devices; `order` is that of [`FlatVisibility::new`].
    pub(crate) fn flat(&self, order: &[usize]) -> FlatVisibility {
        FlatVisibility::new(&self.cells, self.weighted_cells(), order)
    }

    /// Returns the visibility of the cell with exactly this key.
    pub(super) fn visibility(&self, key: CellKey) -> Option<&Visibility> {
        self.index.get(key).map(|cell| &self.estimates[cell as usize].0)
    }

    /// Returns the weights of a cell by its number.
    #[inline(always)]
    pub(super) fn weights(&self, cell: u32) -> Option<&Weights> {
        self.estimates.get(cell as usize).map(|(_, weights)| weights)
    }
}

impl Weighting for PrecomputedVisibility {
    const UNIT: f32 = Weights::UNIT;

    fn indices(&self, at: &Rows<'_>, out: &mut [Lanes]) {
        for (key, out) in self.cells.keys_of(at).into_iter().zip(out.as_flattened_mut()) {
            // The number after the cell's; 0 outside all cells.
            *out = f32::from_bits(self.find(key).map_or(0, |(cell, _)| cell + 1));
        }
    }

    #[inline(always)]
    fn at(&self, index: f32) -> Option<&Weights> {
        Some(index.to_bits().checked_sub(1).and_then(|cell| self.weights(cell)).unwrap_or(&self.unknown))
    }
}
