//! What was learned of a scene beforehand, for renderings that begin with it.

use std::path::Path;

use glam::Vec3A;

use super::{
    cells::{CellKey, Cells},
    counts::Counts,
    division::{Division, PATCHES},
    estimate::{self, Visibility},
    places::Places,
    weights::Weights,
    worth::Worth,
};
use crate::{
    environment::Environment,
    error::{Error, Result},
};

/// The shadow rays of a scene under a map, counted by cell and patch. It holds for every material and from every viewpoint, but for this scene and this
/// map alone. Its file is described at [`Self::read`].
#[derive(Debug)]
pub struct SceneVisibility {
    /// The hash of the scene's geometry: [`SceneContext::geometry_hash`](crate::spec::SceneContext::geometry_hash).
    pub scene_hash: String,
    /// The map's name, for messages.
    pub environment: String,
    /// [`Environment::hash`](crate::environment::Environment::hash).
    pub environment_hash: String,
    /// Wall-clock seconds that learning took, where they are known.
    pub seconds: Option<f64>,
    pub(super) cells: Cells,
    pub(super) counts: Counts,
}

impl SceneVisibility {
    /// How many cells, of all sizes.
    pub fn cells(&self) -> usize {
        self.counts.cells()
    }

    /// How many shadow rays it was learned from.
    pub fn rays(&self) -> u64 {
        (0..self.cells()).flat_map(|cell| self.counts.rays(cell)).map(|[_, all]| u64::from(all)).sum()
    }

    /// Reads a file ([`Self::read`]) that must have been learned under this map in the scene with this geometry hash.
    ///
    /// # Errors
    /// The file cannot be read, or was learned in another scene or under another map.
    pub fn open(path: &Path, scene_hash: &str, environment: &Environment) -> Result<Self> {
        let visibility = Self::read(path)?;
        let wrong = |what: &str| Err(Error::invalid(path, "visibility", format!("was learned {what}")));
        if visibility.environment_hash != environment.hash() {
            return wrong(&format!("under another map, {}", visibility.environment));
        }
        if visibility.scene_hash != scene_hash { wrong("in another scene") } else { Ok(visibility) }
    }
}

/// A [`SceneVisibility`] as renderings use it.
#[derive(Debug)]
pub struct Known {
    cells: Cells,
    places: Places,
    found: Vec<(Visibility, Weights)>,
    worth: Worth,
}

impl Known {
    /// Bytes of a cell: its visibility, its weights, and its place in the list of cells.
    const CELL_BYTES: usize = PATCHES * 4 + size_of::<(Visibility, Weights)>() + 24;

    /// The visibility for a division of the sky, in at most `bytes` bytes.
    ///
    /// # Errors
    /// It takes more.
    pub fn new(visibility: &SceneVisibility, division: &Division, bytes: usize) -> Result<Self> {
        let cells = visibility.cells();
        let cell_bytes = Self::CELL_BYTES;
        if cells > bytes / cell_bytes {
            let megabytes = |bytes: usize| bytes.div_ceil(1 << 20);
            let (needed, allowed) = (megabytes(cells * cell_bytes), megabytes(bytes));
            return Err(Error::argument("visibility", format!("takes {needed} MB, and {allowed} MB are allowed")));
        }
        let counts = &visibility.counts;
        let found = estimate::estimate(
            counts,
            |_| None,
            0..cells,
            |rays, visibility| {
                let (worth, weights) = (Worth::of(rays, &visibility, division), visibility.weights(division));
                (worth, (visibility, weights))
            },
        );
        let (worths, found): (Vec<_>, Vec<_>) = found.into_iter().unzip();
        Ok(Self {
            cells: visibility.cells,
            places: (0..cells).map(|cell| (counts.key(cell), cell as u32)).collect(),
            found,
            worth: worths.into_iter().fold(Worth::default(), Worth::with),
        })
    }

    /// The division of space.
    pub fn cells(&self) -> Cells {
        self.cells
    }

    /// Bytes that it takes.
    pub fn bytes(&self) -> usize {
        self.found.len() * Self::CELL_BYTES
    }

    /// What drawing with it would gain.
    pub(super) fn worth(&self) -> Worth {
        self.worth
    }

    /// How many cells.
    pub fn count(&self) -> usize {
        self.found.len()
    }

    /// The finest cell that a point with a normal lies in: its number, how many sizes it is above the smallest, and the visibility of each patch from
    /// there; `None` where nothing is known.
    pub fn at(&self, p: Vec3A, n: Vec3A) -> Option<(u32, usize, &[f32])> {
        let (cell, level) = self.find(self.cells.key(p, n))?;
        Some((cell, level, self.found[cell as usize].0.patches()))
    }

    /// The finest cell that a key lies in, and how many levels above it.
    #[inline]
    pub(super) fn find(&self, key: CellKey) -> Option<(u32, usize)> {
        self.places.find(key)
    }

    /// The visibility in exactly this cell.
    pub(super) fn visibility(&self, key: CellKey) -> Option<&Visibility> {
        self.places.get(key).map(|cell| &self.found[cell as usize].0)
    }

    /// The weights of a cell by its number.
    #[inline(always)]
    pub(super) fn weights(&self, cell: u32) -> Option<&Weights> {
        self.found.get(cell as usize).map(|found| &found.1)
    }
}
