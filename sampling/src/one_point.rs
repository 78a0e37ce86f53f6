//! One shading point and many directions, as a tile of copies of the point.

use glam::{Vec2, Vec3A, Vec4};

use crate::{
    brdf::BrdfTable,
    columns::{Arena, strips},
    simd::{LANES, Lanes},
    tile::{ShadingPoint, Tile},
};

/// Copies of a point in a tile, for lists of any length.
pub const COPIES: usize = 256;

/// A shading point, ready for many directions or random numbers: for embedders, tests and quadratures.
/// It uses the same functions as rendering of many points.
#[derive(Debug)]
pub struct OnePoint {
    tile: Tile,
    /// Buffers of all calls.
    pub arena: Arena,
}

impl OnePoint {
    /// Makes a tile of `copies` copies of a point with an analytic BRDF; lists are processed in parts of this length.
    ///
    /// # Panics
    /// As [`Self::of_table`].
    pub fn new(at: &ShadingPoint, copies: usize) -> Self {
        Self::of_table(at, copies, &BrdfTable::default())
    }

    /// Makes a tile of `copies` copies of a point with a BRDF of a table.
    ///
    /// # Panics
    /// If there are no copies or more than [`MAX_POINTS`](crate::tile::MAX_POINTS), or the table does not have the BRDF.
    pub fn of_table(at: &ShadingPoint, copies: usize, brdfs: &BrdfTable) -> Self {
        assert!(copies > 0, "a point needs a copy");
        Self { tile: Tile::of_table(&vec![*at; copies], brdfs), arena: Arena::default() }
    }

    /// The approximate width in radians of the BRDF's narrowest lobe; pi for a diffuse surface.
    pub fn lobe_width(&self) -> f32 {
        let rows = self.tile.rows();
        let mut alpha = vec![[0.0; LANES]; rows.strips()];
        rows.alpha(&mut alpha, &self.arena);
        if self.tile.point(0).surface.brdf == BrdfTable::LAMBERT { std::f32::consts::PI } else { alpha[0][0] }
    }

    /// The copies.
    pub fn tile(&self) -> &Tile {
        &self.tile
    }

    /// Evaluates `f_r max(0, n . wi)` per channel, in 1/sr, for each direction.
    pub fn brdf_cosines(&self, wi: &[Vec3A]) -> Vec<Vec3A> {
        self.map(wi, |columns, out: [&mut [Lanes]; 3]| self.tile.rows().brdf_cosine(columns, out, &self.arena))
            .map(Vec3A::from_array)
            .collect()
    }

    /// Evaluates the solid-angle pdfs of BRDF sampling.
    pub fn brdf_pdfs(&self, wi: &[Vec3A]) -> Vec<f32> {
        self.map(wi, |columns, [out]| self.tile.rows().brdf_pdf(columns, out, &self.arena)).map(|[pdf]| pdf).collect()
    }

    /// Draws directions by BRDF sampling, with their pdfs; `None` means no sample.
    pub fn sample_brdf(&self, u: &[Vec2]) -> Vec<Option<(Vec3A, f32)>> {
        self.map(u, |columns, [x, y, z, pdf]| self.tile.rows().sample_brdf(columns, [x, y, z], pdf, &self.arena))
            .map(|[x, y, z, pdf]| (pdf > 0.0).then_some((Vec3A::new(x, y, z), pdf)))
            .collect()
    }

    /// Maps a list of vectors with a function over columns of the tile's length.
    pub fn map<const N: usize, const M: usize, V: Components<N>>(
        &self,
        list: &[V],
        work: impl Fn([&[Lanes]; N], [&mut [Lanes]; M]),
    ) -> impl Iterator<Item = [f32; M]> {
        let length = strips(self.tile.len());
        let mut all = Vec::with_capacity(list.len());
        for part in list.chunks(self.tile.len()) {
            let (mut from, mut to) = (self.arena.columns::<N>(length), self.arena.columns::<M>(length));
            // Lanes without an element repeat the first one.
            for k in 0..length * LANES {
                let numbers = part.get(k).unwrap_or(&part[0]).components();
                for (column, number) in from.get_mut().into_iter().zip(numbers) {
                    column.as_flattened_mut()[k] = number;
                }
            }
            work(from.get(), to.get_mut());
            let columns = to.get().map(<[Lanes]>::as_flattened);
            all.extend((0..part.len()).map(|k| columns.map(|column| column[k])));
        }
        all.into_iter()
    }
}

impl ShadingPoint {
    /// The point, ready for many directions.
    pub fn one(&self) -> OnePoint {
        OnePoint::new(self, COPIES)
    }

    /// The point with a BRDF of a table, ready for many directions.
    pub fn one_of(&self, brdfs: &BrdfTable) -> OnePoint {
        OnePoint::of_table(self, COPIES, brdfs)
    }

    /// [`OnePoint::lobe_width`] of an analytic BRDF.
    pub fn lobe_width(&self) -> f32 {
        OnePoint::new(self, 1).lobe_width()
    }

    /// Evaluates `f_r max(0, n . wi)` per channel, in 1/sr; zero where `wi` is below the geometric
    /// surface. For many directions, use [`OnePoint::brdf_cosines`].
    pub fn brdf_cosine(&self, wi: Vec3A) -> Vec3A {
        OnePoint::new(self, 1).brdf_cosines(&[wi])[0]
    }
}

/// A vector as an array of components.
pub trait Components<const N: usize> {
    /// The components.
    fn components(&self) -> [f32; N];
}

impl Components<2> for Vec2 {
    fn components(&self) -> [f32; 2] {
        self.to_array()
    }
}

impl Components<3> for Vec3A {
    fn components(&self) -> [f32; 3] {
        self.to_array()
    }
}

impl Components<4> for Vec4 {
    fn components(&self) -> [f32; 4] {
        self.to_array()
    }
}
