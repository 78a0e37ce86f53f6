//! Samplers over flat lists of shading points, on all threads: the interface for bindings to other languages.
//!
//! All input is checked, since it comes from outside the program. Errors name the list and the row.

use std::sync::Mutex;

use crate::parallel::*;
use glam::Vec3A;

use crate::{
    columns::Arena,
    environment::Environment,
    error::{Error, Result},
    points::{Dimension, PointSet, Points},
    sampler::{self, Draws, Sampler},
    simd::Lanes,
    tile::{Rows, ShadingPoint, Tile},
};

mod prepared;
mod surfaces;

pub use prepared::PreparedPoints;
pub use surfaces::{FittedMaterial, SurfaceList};

/// Points per thread and step.
const TILE: usize = 1024;
/// Largest deviation of a unit vector's squared length from 1.
const UNIT_TOLERANCE: f32 = 1e-3;

/// Shading points; lists have one entry for all points, or one per point.
#[derive(Clone, Copy, Debug)]
pub struct PointList<'a> {
    /// Positions in metres; if empty, the origin, which suffices for samplers that ignore them (see
    /// [`SamplerSpec::needs_positions`](crate::spec::SamplerSpec::needs_positions)).
    pub p: &'a [[f32; 3]],
    /// Unit shading normals in world space.
    pub n: &'a [[f32; 3]],
    /// Unit directions to the viewer. If empty (for samplers that ignore them), the normals are used.
    pub wo: &'a [[f32; 3]],
    /// BRDFs.
    pub surface: SurfaceList<'a>,
}

/// Uniform numbers of draws.
#[derive(Clone, Copy, Debug)]
pub enum Numbers<'a> {
    /// One point of `[0, 1)^2` per draw.
    Given(&'a [[f32; 2]]),
    /// Independent random numbers, a function of the seed and the index in the list.
    Seed(u64),
}

/// Draws, one per shading point; all lists have the same length.
#[derive(Debug)]
pub struct DrawList<'a> {
    /// Unit directions; zero where the pdf is 0.
    pub wi: &'a mut [[f32; 3]],
    /// Solid-angle pdfs; 0 means no sample.
    pub pdf: &'a mut [f32],
    /// The map, and the output list of its radiance from `wi`; zero where the pdf is 0.
    pub radiance: Option<(&'a Environment, &'a mut [[f32; 3]])>,
}

/// Draws one direction per shading point.
///
/// # Errors
/// [`Error::Argument`] if a list has the wrong length, a vector is not of unit length, or a number is
/// out of range.
pub fn sample(sampler: &dyn Sampler, at: &PointList<'_>, numbers: Numbers<'_>, out: DrawList<'_>) -> Result<()> {
    at.check_lengths(out.pdf.len())?;
    each_tile(numbers, out, |work: &mut Workspace, first, out| work.sample(sampler, at, first, numbers, out))
}

/// Calls `work` with the first point of each tile and its part of `out`.
fn each_tile<W: Default>(
    numbers: Numbers<'_>,
    out: DrawList<'_>,
    work: impl Fn(&mut W, usize, DrawList<'_>) -> Result<()> + Sync,
) -> Result<()> {
    let count = out.pdf.len();
    check_length("wi", out.wi.len(), count)?;
    let (map, radiance) = out.radiance.unzip();
    if let Some(radiance) = &radiance {
        check_length("radiance", radiance.len(), count)?;
    }
    if let Numbers::Given(u) = numbers {
        check_length("u", u.len(), count)?;
    }
    // An empty list has no chunks.
    let radiance = radiance.map_or_else(Vec::new, |list| list.chunks_mut(TILE).map(Some).collect());
    let radiance = radiance.into_iter().chain(std::iter::repeat_with(|| None));
    let parts = out.wi.chunks_mut(TILE).zip(out.pdf.chunks_mut(TILE)).zip(radiance).enumerate();
    let first_error = Mutex::new(None);
    parts.collect::<Vec<_>>().into_par_iter().for_each_init(W::default, |own, (index, ((wi, pdf), radiance))| {
        let out = DrawList { wi, pdf, radiance: map.zip(radiance) };
        keep_first(&first_error, index, work(own, index * TILE, out));
    });
    result_of(first_error)
}

/// Evaluates the solid-angle pdfs of unit directions, one per shading point.
///
/// # Errors
/// As [`sample`].
pub fn pdf(sampler: &dyn Sampler, at: &PointList<'_>, wi: &[[f32; 3]], out: &mut [f32]) -> Result<()> {
    at.check_lengths(out.len())?;
    check_length("wi", wi.len(), out.len())?;
    each_tile_of(wi, out, |work: &mut Workspace, first, wi, out| work.pdf(sampler, at, first, wi, out))
}

/// Evaluates `f_r(wo, wi) max(0, n . wi)` per channel, in 1/sr, for unit directions, one per shading point.
///
/// # Errors
/// As [`sample`], and [`Error::Argument`] if surfaces that are not diffuse have no directions to the viewer.
pub fn brdf_cosine(at: &PointList<'_>, wi: &[[f32; 3]], out: &mut [[f32; 3]]) -> Result<()> {
    at.check_lengths(out.len())?;
    check_length("wi", wi.len(), out.len())?;
    if at.wo.is_empty() && !matches!(at.surface, SurfaceList::Diffuse) {
        return Err(Error::argument("wo", "is needed: these surfaces reflect differently to each viewer"));
    }
    each_tile_of(wi, out, |work: &mut Workspace, first, wi, out| work.brdf_cosine(at, first, wi, out))
}

/// Calls `work` with the first point of each tile, and its parts of `wi` and `out`, which have the same length.
fn each_tile_of<W: Default, T: Send>(
    wi: &[[f32; 3]],
    out: &mut [T],
    work: impl Fn(&mut W, usize, &[[f32; 3]], &mut [T]) -> Result<()> + Sync,
) -> Result<()> {
    let first_error = Mutex::new(None);
    let parts = out.par_chunks_mut(TILE).zip(wi.par_chunks(TILE)).enumerate();
    parts.for_each_init(W::default, |own, (index, (out, wi))| {
        keep_first(&first_error, index, work(own, index * TILE, wi, out));
    });
    result_of(first_error)
}

/// Looks up the radiance of a map from unit directions.
///
/// # Errors
/// As [`sample`].
pub fn radiance(map: &Environment, wi: &[[f32; 3]], out: &mut [[f32; 3]]) -> Result<()> {
    check_length("wi", wi.len(), out.len())?;
    for (place, w) in wi.iter().enumerate() {
        check_unit("wi", place, *w)?;
    }
    out.par_iter_mut()
        .zip(wi)
        .with_min_len(TILE)
        .for_each(|(out, w)| *out = map.radiance(Vec3A::from_array(*w)).to_array());
    Ok(())
}

/// Keeps the error of the lowest index, so that the result does not depend on the timing of threads.
fn keep_first(first: &Mutex<Option<(usize, Error)>>, index: usize, result: Result<()>) {
    if let Err(error) = result {
        let mut first = first.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if first.as_ref().is_none_or(|(other, _)| index < *other) {
            *first = Some((index, error));
        }
    }
}

fn result_of(first: Mutex<Option<(usize, Error)>>) -> Result<()> {
    let first = first.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    first.map_or(Ok(()), |(_, error)| Err(error))
}

fn check_length(name: &str, length: usize, count: usize) -> Result<()> {
    if length == count {
        return Ok(());
    }
    Err(Error::argument(name, format!("has {length} rows; {count} are needed")))
}

/// Checks for one entry for all points, or one per point.
fn check_shared_length(name: &str, length: usize, count: usize) -> Result<()> {
    if length == count || length == 1 {
        return Ok(());
    }
    Err(Error::argument(name, format!("has {length} rows; {count}, or 1 for all, are needed")))
}

#[inline(always)]
fn check_unit(name: &str, place: usize, [x, y, z]: [f32; 3]) -> Result<()> {
    let square = x * x + y * y + z * z;
    // In this form the comparison rejects NaN.
    if (square - 1.0).abs() <= UNIT_TOLERANCE {
        return Ok(());
    }
    Err(Error::argument(name, format!("row {place} is ({x}, {y}, {z}), which is not of unit length")))
}

#[inline(always)]
fn check_range(name: &str, place: usize, value: f32, least: f32) -> Result<f32> {
    if (least..=1.0).contains(&value) {
        return Ok(value);
    }
    Err(Error::argument(name, format!("row {place} is {value}, which is not in {least}..=1")))
}

#[inline(always)]
fn entry<T: Copy>(list: &[T], place: usize) -> T {
    list[if list.len() == 1 { 0 } else { place }]
}

impl PointList<'_> {
    fn check_lengths(&self, count: usize) -> Result<()> {
        check_shared_length("n", self.n.len(), count)?;
        for (name, list) in [("p", self.p), ("wo", self.wo)] {
            if !list.is_empty() {
                check_shared_length(name, list.len(), count)?;
            }
        }
        self.surface.check_lengths(count)
    }

    /// Fills a tile with `count` points from `first` on.
    fn fill(&self, tile: &mut Tile, first: usize, count: usize) -> Result<()> {
        tile.clear(&self.surface.brdfs());
        for place in first..first + count {
            tile.push(&self.point(place)?, place as u32);
        }
        Ok(())
    }

    fn point(&self, place: usize) -> Result<ShadingPoint> {
        let n = entry(self.n, place);
        check_unit("n", place, n)?;
        let wo = if self.wo.is_empty() { n } else { entry(self.wo, place) };
        check_unit("wo", place, wo)?;
        let p = if self.p.is_empty() { [0.0; 3] } else { entry(self.p, place) };
        if !p.iter().all(|number| number.is_finite()) {
            return Err(Error::argument(
                "p",
                format!("row {place} is ({}, {}, {}), which is not finite", p[0], p[1], p[2]),
            ));
        }
        let surface = self.surface.surface(place, [n, wo])?;
        let [p, n, wo] = [p, n, wo].map(Vec3A::from_array);
        Ok(ShadingPoint { p, ng: n, ns: n, wo, surface })
    }
}

/// Buffers that a thread reuses.
#[derive(Default)]
struct Workspace {
    tile: Tile,
    arena: Arena,
}

impl Workspace {
    fn sample(
        &mut self,
        sampler: &dyn Sampler,
        at: &PointList<'_>,
        first: usize,
        numbers: Numbers<'_>,
        out: DrawList<'_>,
    ) -> Result<()> {
        at.fill(&mut self.tile, first, out.pdf.len())?;
        let (rows, arena) = (self.tile.rows(), &self.arena);
        sampler::prepared(sampler, &rows, arena, |state| draw(sampler, &rows, state, (first, numbers), out, arena))
    }

    fn pdf(
        &mut self,
        sampler: &dyn Sampler,
        at: &PointList<'_>,
        first: usize,
        wi: &[[f32; 3]],
        out: &mut [f32],
    ) -> Result<()> {
        at.fill(&mut self.tile, first, out.len())?;
        let (rows, arena) = (self.tile.rows(), &self.arena);
        sampler::prepared(sampler, &rows, arena, |state| evaluate(sampler, &rows, state, (first, wi), out, arena))
    }

    fn brdf_cosine(&mut self, at: &PointList<'_>, first: usize, wi: &[[f32; 3]], out: &mut [[f32; 3]]) -> Result<()> {
        at.fill(&mut self.tile, first, out.len())?;
        let (rows, arena) = (self.tile.rows(), &self.arena);
        let mut columns = arena.columns::<6>(rows.strips());
        let [x, y, z, red, green, blue] = columns.get_mut();
        to_columns(first, wi, [x, y, z])?;
        rows.brdf_cosine([x, y, z], [red, green, blue], arena);
        let [red, green, blue] = [red, green, blue].map(|column| column.as_flattened());
        for (k, out) in out.iter_mut().enumerate() {
            *out = [red[k], green[k], blue[k]];
        }
        Ok(())
    }
}

/// Draws for prepared rows, whose first one has the index `first` in the list.
fn draw(
    sampler: &dyn Sampler,
    rows: &Rows<'_>,
    state: &[Lanes],
    (first, numbers): (usize, Numbers<'_>),
    out: DrawList<'_>,
    arena: &Arena,
) -> Result<()> {
    let count = rows.len();
    let mut columns = arena.columns::<9>(rows.strips());
    let [u, v, x, y, z, pdf, red, green, blue] = columns.get_mut();
    match numbers {
        Numbers::Given(list) => {
            for (k, &[a, b]) in list[first..first + count].iter().enumerate() {
                if !((0.0..1.0).contains(&a) && (0.0..1.0).contains(&b)) {
                    let reason = format!("row {} is ({a}, {b}), which is not in [0, 1)", first + k);
                    return Err(Error::argument("u", reason));
                }
                (u.as_flattened_mut()[k], v.as_flattened_mut()[k]) = (a, b);
            }
        }
        Numbers::Seed(seed) => {
            // Keys have 32 bits: longer lists continue with other samples of the same keys.
            let sample = (first >> 32) as u32;
            let points = Points::new(PointSet::Independent, seed).at_sample(sample);
            points.draw(Dimension::Light(0), rows, [&mut *u, &mut *v]);
        }
    }
    let draws = Draws { wi: [&mut *x, &mut *y, &mut *z], pdf: &mut *pdf };
    sampler.sample(rows, state, [u, v], draws, arena);
    out.pdf.copy_from_slice(&pdf.as_flattened()[..count]);
    interleave([&*x, y, z].map(<[Lanes]>::as_flattened), out.pdf, out.wi);
    if let Some((map, list)) = out.radiance {
        // Directions with pdf 0 are arbitrary: look up any valid one; `interleave` zeroes the result.
        for (k, pdf) in out.pdf.iter().enumerate() {
            if *pdf <= 0.0 {
                (x.as_flattened_mut()[k], y.as_flattened_mut()[k], z.as_flattened_mut()[k]) = (0.0, 1.0, 0.0);
            }
        }
        map.radiances([x, y, z], [&mut *red, &mut *green, &mut *blue]);
        interleave([&*red, green, blue].map(<[Lanes]>::as_flattened), out.pdf, list);
    }
    Ok(())
}

/// Evaluates pdfs for prepared rows, whose first one has the index `first` in the list.
fn evaluate(
    sampler: &dyn Sampler,
    rows: &Rows<'_>,
    state: &[Lanes],
    (first, wi): (usize, &[[f32; 3]]),
    out: &mut [f32],
    arena: &Arena,
) -> Result<()> {
    let mut columns = arena.columns::<4>(rows.strips());
    let [x, y, z, pdf] = columns.get_mut();
    to_columns(first, wi, [x, y, z])?;
    sampler.pdf(rows, state, [x, y, z], pdf, arena);
    out.copy_from_slice(&pdf.as_flattened()[..out.len()]);
    Ok(())
}

/// Converts unit directions, the first of which has the index `first` in the list, to columns.
fn to_columns(first: usize, wi: &[[f32; 3]], [x, y, z]: [&mut [Lanes]; 3]) -> Result<()> {
    for (k, w) in wi.iter().enumerate() {
        check_unit("wi", first + k, *w)?;
        (x.as_flattened_mut()[k], y.as_flattened_mut()[k], z.as_flattened_mut()[k]) = (w[0], w[1], w[2]);
    }
    Ok(())
}

/// Converts columns to rows; zeros where there is no sample.
fn interleave([x, y, z]: [&[f32]; 3], pdf: &[f32], out: &mut [[f32; 3]]) {
    for (k, out) in out.iter_mut().enumerate() {
        *out = if pdf[k] > 0.0 { [x[k], y[k], z[k]] } else { [0.0; 3] };
    }
}

#[cfg(test)]
mod tests;
