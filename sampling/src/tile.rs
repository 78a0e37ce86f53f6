//! Shading points of a tile as columns, and selections of their rows.

use glam::Vec3A;

use crate::{
    brdf::{Brdf, BrdfTable, LATENTS, MAX_PARAMETERS, OF_MATERIAL, Surface, Surfaces},
    columns::{Arena, gather, scatter, strips, vectorized},
    simd::{LANES, Lanes},
};

/// Maximum number of points of a tile: rows are 16-bit numbers.
pub const MAX_POINTS: usize = 1 << 15;

/// A point to shade; all vectors have unit length, are in world space, and point away from the surface.
#[derive(Clone, Copy, Debug)]
pub struct ShadingPoint {
    /// Position in metres; in a scene, offset from the surface by the position's rounding error.
    pub p: Vec3A,
    /// Geometric normal, on the side of `wo`.
    pub ng: Vec3A,
    /// Shading normal, on the side of `wo`.
    pub ns: Vec3A,
    /// Direction to the viewer.
    pub wo: Vec3A,
    /// The surface's BRDF, with textures looked up.
    pub surface: Surface,
}

impl ShadingPoint {
    /// Whether two points reflect alike: all but the positions are equal.
    pub fn is_same(&self, other: &Self) -> bool {
        (self.ng, self.ns, self.wo, self.surface) == (other.ng, other.ns, other.wo, other.surface)
    }
}

/// Shading points as structure of arrays. Each has a key (its pixel) that selects its random numbers.
#[derive(Clone, Debug, Default)]
pub struct Tile {
    len: usize,
    vectors: [[Vec<Lanes>; 3]; 4],
    parameters: [Vec<Lanes>; MAX_PARAMETERS],
    brdf: Vec<u32>,
    keys: Vec<u32>,
    /// Largest number of parameters among the points' BRDFs.
    used: usize,
    /// Whether all points have the same BRDF.
    is_uniform: bool,
    brdfs: BrdfTable,
}

/// Position.
const P: usize = 0;
/// Geometric normal.
const NG: usize = 1;
/// Shading normal.
const NS: usize = 2;
/// Direction to the viewer.
const WO: usize = 3;

impl Tile {
    /// Makes a tile of points with the analytic BRDFs; keys are the points' indices.
    ///
    /// # Panics
    /// If there are more than [`MAX_POINTS`], or a BRDF is not an analytic one.
    pub fn of(points: &[ShadingPoint]) -> Self {
        Self::of_table(points, &BrdfTable::default())
    }

    /// [`Self::of`] with the BRDFs of a table.
    ///
    /// # Panics
    /// If there are more than [`MAX_POINTS`], or the table does not have a BRDF.
    pub fn of_table(points: &[ShadingPoint], brdfs: &BrdfTable) -> Self {
        let mut tile = Self::default();
        tile.clear(brdfs);
        for (key, point) in points.iter().enumerate() {
            tile.push(point, key as u32);
        }
        tile
    }

    /// Removes all points, and sets the table of BRDFs for later ones.
    pub fn clear(&mut self, brdfs: &BrdfTable) {
        self.len = 0;
        self.used = 0;
        self.brdf.clear();
        self.keys.clear();
        self.brdfs.clone_from(brdfs);
    }

    /// Adds a point with its key.
    ///
    /// # Panics
    /// If there are [`MAX_POINTS`] already, or the table does not have the point's BRDF.
    pub fn push(&mut self, point: &ShadingPoint, key: u32) {
        assert!(self.len < MAX_POINTS, "a tile is full");
        let (strip, lane) = (self.len / LANES, self.len % LANES);
        if lane == 0 {
            for column in self.vectors.as_flattened_mut().iter_mut().chain(&mut self.parameters) {
                if column.len() <= strip {
                    column.push([0.0; LANES]);
                }
            }
        }
        let vectors = [point.p, point.ng, point.ns, point.wo];
        for (columns, vector) in self.vectors.iter_mut().zip(vectors) {
            for (column, number) in columns.iter_mut().zip(vector.to_array()) {
                column[strip][lane] = number;
            }
        }
        // Parameters that the BRDF does not have are not read.
        let parameters = self.brdfs.get(point.surface.brdf).parameters();
        for (column, number) in self.parameters.iter_mut().zip(point.surface.parameters).take(parameters) {
            column[strip][lane] = number;
        }
        self.used = self.used.max(parameters);
        self.is_uniform = self.brdf.first().is_none_or(|&first| self.is_uniform && first == point.surface.brdf);
        self.brdf.push(point.surface.brdf);
        self.keys.push(key);
        self.len += 1;
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The point of a row.
    pub fn point(&self, row: usize) -> ShadingPoint {
        let (strip, lane) = (row / LANES, row % LANES);
        let vector = |which: usize| Vec3A::from_array(self.vectors[which].each_ref().map(|column| column[strip][lane]));
        let (brdf, mut parameters) = (self.brdf[row], [0.0; MAX_PARAMETERS]);
        let used = self.brdfs.get(brdf).parameters();
        for (parameter, column) in parameters.iter_mut().zip(&self.parameters).take(used) {
            *parameter = column[strip][lane];
        }
        let surface = Surface { brdf, parameters };
        ShadingPoint { p: vector(P), ng: vector(NG), ns: vector(NS), wo: vector(WO), surface }
    }

    /// Position (metres) and geometric normal of a point.
    #[inline(always)]
    pub fn position_and_normal(&self, row: usize) -> (Vec3A, Vec3A) {
        let (strip, lane) = (row / LANES, row % LANES);
        let vector = |which: usize| Vec3A::from_array(self.vectors[which].each_ref().map(|column| column[strip][lane]));
        (vector(P), vector(NG))
    }

    /// The keys of the points.
    pub fn keys(&self) -> &[u32] {
        &self.keys
    }

    /// All rows in order.
    pub fn rows(&self) -> Rows<'_> {
        Rows { tile: self, list: None }
    }
}

/// A selection of a tile's points in some order, without copies. Columns that belong to it (random
/// numbers, pdfs, a sampler's state) have one place per row of the selection, in its order.
#[derive(Clone, Copy, Debug)]
pub struct Rows<'a> {
    tile: &'a Tile,
    list: Option<&'a [u16]>,
}

impl<'a> Rows<'a> {
    /// Number of rows.
    pub fn len(&self) -> usize {
        self.list.map_or(self.tile.len, <[u16]>::len)
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of strips of a column that belongs to these rows.
    pub fn strips(&self) -> usize {
        strips(self.len())
    }

    /// The row of the tile at a place.
    #[inline(always)]
    pub fn row(&self, place: usize) -> usize {
        self.list.map_or(place, |list| list[place] as usize)
    }

    /// The point at a place.
    pub fn point(&self, place: usize) -> ShadingPoint {
        self.tile.point(self.row(place))
    }

    /// The BRDFs that points refer to.
    pub fn brdfs(&self) -> &'a BrdfTable {
        &self.tile.brdfs
    }

    /// The key of the point at a place.
    #[inline(always)]
    pub fn key(&self, place: usize) -> u32 {
        self.tile.keys[self.row(place)]
    }

    /// Selects the rows at `places`; `rows` is overwritten with their rows in the tile.
    pub fn select<'b>(&self, places: &[u16], rows: &'b mut Vec<u16>) -> Rows<'b>
    where
        'a: 'b,
    {
        rows.clear();
        rows.extend(places.iter().map(|&place| self.row(place as usize) as u16));
        Rows { tile: self.tile, list: Some(rows) }
    }

    /// One strip of positions in metres.
    #[inline(always)]
    pub fn positions(&self, strip: usize) -> [Lanes; 3] {
        self.strip(&self.tile.vectors[P], strip)
    }

    /// One strip of shading normals.
    #[inline(always)]
    pub fn normals(&self, strip: usize) -> [Lanes; 3] {
        self.strip(&self.tile.vectors[NS], strip)
    }

    /// One strip of geometric normals.
    #[inline(always)]
    pub fn geometric_normals(&self, strip: usize) -> [Lanes; 3] {
        self.strip(&self.tile.vectors[NG], strip)
    }

    /// One strip of directions to the viewer.
    #[inline(always)]
    pub fn views(&self, strip: usize) -> [Lanes; 3] {
        self.strip(&self.tile.vectors[WO], strip)
    }

    #[inline(always)]
    fn strip(&self, columns: &[Vec<Lanes>; 3], strip: usize) -> [Lanes; 3] {
        let Some(list) = self.list else {
            return [columns[0][strip], columns[1][strip], columns[2][strip]];
        };
        let mut out = [[0.0; LANES]; 3];
        let rows = &list[(strip * LANES).min(list.len())..];
        let [x, y, z] = [columns[0].as_flattened(), columns[1].as_flattened(), columns[2].as_flattened()];
        for (lane, &row) in rows.iter().enumerate().take(LANES) {
            (out[0][lane], out[1][lane], out[2][lane]) = (x[row as usize], y[row as usize], z[row as usize]);
        }
        out
    }

    /// Evaluates `f_r max(0, n . wi)` per channel in 1/sr, for one direction per row; zero where `wi`
    /// is below the geometric surface.
    pub fn brdf_cosine(&self, wi: [&[Lanes]; 3], mut out: [&mut [Lanes]; 3], arena: &Arena) {
        self.by_brdf(arena, |group| {
            let [x, y, z] = &mut out;
            match group.places {
                None => group.brdf.evaluate_cosine(&group.surfaces, wi, [x, y, z]),
                Some(places) => {
                    let [mut own, mut values] = [arena.columns::<3>(group.strips), arena.columns::<3>(group.strips)];
                    gather_all(wi, places, own.get_mut());
                    group.brdf.evaluate_cosine(&group.surfaces, own.get(), values.get_mut());
                    scatter_all(values.get(), places, [x, y, z]);
                }
            }
        });
        above_ground(self, wi, out);
    }

    /// Draws directions by BRDF sampling; pdf 0 means no sample.
    pub fn sample_brdf(&self, u: [&[Lanes]; 2], wi: [&mut [Lanes]; 3], pdf: &mut [Lanes], arena: &Arena) {
        let [x, y, z] = wi;
        self.by_brdf(arena, |group| match group.places {
            None => group.brdf.sample(&group.surfaces, u, [x, y, z], pdf),
            Some(places) => {
                let (mut own, mut drawn) = (arena.columns::<2>(group.strips), arena.columns::<4>(group.strips));
                gather_all(u, places, own.get_mut());
                let [a, b, c, d] = drawn.get_mut();
                group.brdf.sample(&group.surfaces, own.get(), [a, b, c], d);
                scatter_all(drawn.get(), places, [x, y, z, pdf]);
            }
        });
    }

    /// Evaluates the solid-angle pdfs of [`Self::sample_brdf`].
    pub fn brdf_pdf(&self, wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        self.by_brdf(arena, |group| match group.places {
            None => group.brdf.pdf(&group.surfaces, wi, out),
            Some(places) => {
                let [mut own, mut pdfs] = [arena.columns::<3>(group.strips), arena.columns::<3>(group.strips)];
                gather_all(wi, places, own.get_mut());
                group.brdf.pdf(&group.surfaces, own.get(), pdfs.get_mut()[0]);
                scatter_all([pdfs.get()[0]], places, [out]);
            }
        });
    }

    /// Trowbridge-Reitz widths of the narrowest lobes; 1 for diffuse surfaces.
    pub fn alpha(&self, out: &mut [Lanes], arena: &Arena) {
        self.by_brdf(arena, |group| match group.places {
            None => group.brdf.alpha(&group.surfaces, out),
            Some(places) => {
                let mut own = arena.columns::<1>(group.strips);
                group.brdf.alpha(&group.surfaces, own.get_mut()[0]);
                scatter_all(own.get(), places, [out]);
            }
        });
    }

    /// Columns of [`Brdf::latent`].
    pub fn latents(&self, mut out: [&mut [Lanes]; LATENTS], arena: &Arena) {
        self.by_brdf(arena, |group| {
            for (out, number) in out.iter_mut().zip(group.brdf.latent()) {
                match group.places {
                    None => out.fill([number; LANES]),
                    Some(places) => {
                        let out = out.as_flattened_mut();
                        places.iter().for_each(|&place| out[usize::from(place)] = number);
                    }
                }
            }
        });
    }

    /// Features, first tangent and handedness of neural materials at the points; zeros for other BRDFs.
    pub fn textures(&self, mut out: [&mut [Lanes]; OF_MATERIAL], arena: &Arena) {
        self.by_brdf(arena, |group| {
            let mut own = arena.columns::<OF_MATERIAL>(group.strips);
            group.brdf.texture(&group.surfaces, own.get_mut());
            for (from, to) in own.get().into_iter().zip(&mut out) {
                match group.places {
                    None => to.copy_from_slice(from),
                    Some(places) => scatter(from, places, to),
                }
            }
        });
    }

    /// Columns of [`crate::brdf::Lobes`]: diffuse, specular, f0 and alpha.
    pub fn lobes(&self, mut out: [&mut [Lanes]; 4], arena: &Arena) {
        self.by_brdf(arena, |group| {
            let [diffuse, specular, f0, alpha] = &mut out;
            match group.places {
                None => group.brdf.lobes(&group.surfaces, [diffuse, specular, f0, alpha]),
                Some(places) => {
                    let mut own = arena.columns::<4>(group.strips);
                    group.brdf.lobes(&group.surfaces, own.get_mut());
                    scatter_all(own.get(), places, [diffuse, specular, f0, alpha]);
                }
            }
        });
    }

    /// Calls `work` for each BRDF that occurs, with its points.
    pub(crate) fn by_brdf(&self, arena: &Arena, mut work: impl FnMut(Group<'_>)) {
        if self.is_empty() {
            return;
        }
        let (tile, first) = (self.tile, self.tile.brdf[self.row(0)]);
        if tile.is_uniform || (1..self.len()).all(|place| tile.brdf[self.row(place)] == first) {
            return self.with_surfaces(arena, |surfaces| {
                work(Group { brdf: tile.brdfs.get(first), places: None, strips: self.strips(), surfaces });
            });
        }
        let (mut places, mut rows) = (arena.list(), arena.list());
        for index in 0..tile.brdfs.len() as u32 {
            places.clear();
            places.extend((0..self.len() as u16).filter(|&place| tile.brdf[self.row(place as usize)] == index));
            if !places.is_empty() {
                let part = self.select(&places, &mut rows);
                part.with_surfaces(arena, |surfaces| {
                    let brdf = tile.brdfs.get(index);
                    work(Group { brdf, places: Some(&places), strips: part.strips(), surfaces });
                });
            }
        }
    }

    /// Calls `work` with the columns that BRDFs read: the tile's own, or gathered ones.
    fn with_surfaces(&self, arena: &Arena, work: impl FnOnce(Surfaces<'_>)) {
        let tile = self.tile;
        let own = |which: usize| tile.vectors[which].each_ref().map(|column| &column[..strips(tile.len)]);
        let parameters = tile.parameters.each_ref().map(|column| &column[..strips(tile.len)]);
        let Some(list) = self.list else {
            return work(Surfaces { n: own(NS), wo: own(WO), parameters });
        };
        let mut gathered = arena.columns::<{ 6 + MAX_PARAMETERS }>(self.strips());
        let columns = own(NS).into_iter().chain(own(WO)).chain(parameters);
        for (from, to) in columns.zip(gathered.get_mut()).take(6 + tile.used) {
            gather(from, list, to);
        }
        let [nx, ny, nz, ox, oy, oz, parameters @ ..] = gathered.get();
        work(Surfaces { n: [nx, ny, nz], wo: [ox, oy, oz], parameters });
    }
}

vectorized! {
    /// Zeroes values for directions below the geometric surface.
    fn above_ground['a](_simd, rows: &'a Rows<'a>, wi: [&'a [Lanes]; 3], values: [&'a mut [Lanes]; 3]) {
        let [red, green, blue] = values;
        for strip in 0..rows.strips() {
            let ng = rows.geometric_normals(strip);
            let mut cosine = [0.0; LANES];
            for lane in 0..LANES {
                let [x, y, z] = [wi[0][strip][lane], wi[1][strip][lane], wi[2][strip][lane]];
                cosine[lane] = ng[0][lane] * x + ng[1][lane] * y + ng[2][lane] * z;
            }
            for lane in 0..LANES {
                red[strip][lane] = if cosine[lane] > 0.0 { red[strip][lane] } else { 0.0 };
            }
            for lane in 0..LANES {
                green[strip][lane] = if cosine[lane] > 0.0 { green[strip][lane] } else { 0.0 };
            }
            for lane in 0..LANES {
                blue[strip][lane] = if cosine[lane] > 0.0 { blue[strip][lane] } else { 0.0 };
            }
        }
    }
}

/// The points of one BRDF.
pub(crate) struct Group<'a> {
    pub brdf: &'a dyn Brdf,
    /// Places among the rows; `None` for all.
    pub places: Option<&'a [u16]>,
    pub strips: usize,
    pub surfaces: Surfaces<'a>,
}

pub(crate) fn gather_all<const N: usize>(from: [&[Lanes]; N], places: &[u16], to: [&mut [Lanes]; N]) {
    for (from, to) in from.into_iter().zip(to) {
        gather(from, places, to);
    }
}

pub(crate) fn scatter_all<const N: usize>(from: [&[Lanes]; N], places: &[u16], to: [&mut [Lanes]; N]) {
    for (from, to) in from.into_iter().zip(to) {
        scatter(from, places, to);
    }
}
