//! Whether another implementation of the samplers is right: a kit of cases with correct results, and a checker that
//! names common faults.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | the cases, their map and their points |
//! | `kit.rs` | the files of a kit |
//! | `check.rs` | the comparison of answers |
//! | `faults.rs` | faults by which answers are explained |

mod check;
mod faults;
mod kit;

use std::sync::Arc;

use glam::{Vec2, Vec3A};
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    batch::{self, DrawList, Numbers, PointList, SurfaceList},
    environment::Environment,
    export::{ExportedSampler, Intermediate},
    image::Image,
    latlong,
    patches::{Detail, PatchSampler},
    random::{Purpose, Stream},
    sampler::{BrdfSampler, EmitterSampler, EnvironmentLight, OneSampleMis, Sampler},
    simd::cos_sin_turns,
    tail::{Tail, TailKind},
};

use crate::Result;

pub use check::{Verdict, check};
pub use kit::{kit_files, write_answers, write_kit};

/// Texels of the map.
const WIDTH: usize = 64;
const HEIGHT: usize = 32;
/// Shading points of a case, and rows of each.
const POINTS: usize = 4;
const ROWS: usize = 512;
/// Width of glossy lobes.
const ALPHA: f32 = 0.3;

/// A sampler and the surfaces that it is checked on.
pub struct Case {
    /// The name, and that of its files.
    pub name: &'static str,
    /// What the sampler is.
    pub what: &'static str,
    /// The width of the surfaces' lobes, whose reflectance at normal incidence is 1; `None` on diffuse surfaces.
    pub alpha: Option<f32>,
    sampler: Arc<dyn Sampler>,
}

/// A row of a case: a draw from a uniform point, and the pdf of a given direction.
#[derive(Clone, Copy, Debug, Default)]
pub struct Row {
    /// Shading normal.
    pub n: Vec3A,
    /// Direction to the viewer.
    pub wo: Vec3A,
    /// Uniform point of the draw.
    pub u: Vec2,
    /// Given direction.
    pub given: Vec3A,
    /// The correct results.
    pub answer: Answer,
}

/// The results of a row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Answer {
    /// The drawn direction; zero where the pdf is 0.
    pub wi: Vec3A,
    /// Its solid-angle pdf; 0 means no sample.
    pub pdf: f32,
    /// The solid-angle pdf of the given direction.
    pub pdf_of_given: f32,
}

/// Returns the map: smooth light without symmetries, with lamps at the seam and beside a pole.
///
/// # Errors
/// If memory is short.
pub fn map() -> Result<Arc<Environment>> {
    let radiance = |index: usize| {
        let (column, row) = (index % WIDTH, index / WIDTH);
        let (turn, down) = ((column as f32 + 0.5) / WIDTH as f32, row as f32 / (HEIGHT - 1) as f32);
        // The same bits on every system.
        let ((_, sine), (cosine, _)) = (cos_sin_turns(turn - 0.1), cos_sin_turns(3.0 * turn));
        let sky = 0.3 + (1.0 - down) * (1.0 + 0.8 * sine + 0.3 * cosine);
        let lamp = match (column, row) {
            (0 | 63, 12) => 60.0,
            (20, 1) => 80.0,
            (41, 25) => 30.0,
            _ => 0.0,
        };
        [sky + lamp, 0.9 * sky + lamp, 1.1 * sky + 0.8 * lamp]
    };
    let pixels = (0..WIDTH * HEIGHT).map(radiance).collect();
    Ok(Arc::new(Environment::from_image("conformance", Image { width: WIDTH, height: HEIGHT, pixels })?))
}

/// Returns the table of the case `table`.
///
/// # Errors
/// If memory is short.
pub fn table(map: &Arc<Environment>) -> Result<ExportedSampler> {
    let warp = Tail::of_environment(TailKind::Hierarchical, map)?;
    let table = direct_bake(&warp, NormalGrid::new(8, 16)?, CellGrid::new(16, 16)?)?;
    Ok(ExportedSampler::new(Intermediate::DirectBake(table), TailKind::Hierarchical, map, None)?)
}

/// Returns all cases.
///
/// # Errors
/// If memory is short.
pub fn cases(map: &Arc<Environment>) -> Result<Vec<Case>> {
    let light = EnvironmentLight::new(map.clone(), TailKind::Hierarchical)?;
    let patches = || PatchSampler::new(light.clone(), Detail::Leaves);
    let emitter = EmitterSampler::new(light.clone());
    let case = |name, what, alpha, sampler| Case { name, what, alpha, sampler };
    Ok(vec![
        case("emitter", "emitter sampling: the map alone, by the quad-tree", None, Arc::new(emitter.clone())),
        case("patches", "patches on diffuse surfaces", None, Arc::new(patches()?)),
        case(
            "patches-glossy",
            "patches alone on glossy surfaces, without BRDF sampling",
            Some(ALPHA),
            Arc::new(patches()?),
        ),
        case("table", "the table of table.safetensors", None, table(map)?.open(map)?.into_inner()),
        case(
            "mis-glossy",
            "emitter sampling (u.x < 0.5) and BRDF sampling in one-sample MIS",
            Some(ALPHA),
            Arc::new(OneSampleMis::new(emitter, BrdfSampler)),
        ),
    ])
}

impl Case {
    /// Returns the rows with their correct answers.
    ///
    /// # Errors
    /// If the sampler cannot be evaluated.
    pub fn rows(&self) -> Result<Vec<Row>> {
        let mut random = Stream::new(11, Purpose::Test, 0);
        let mut rows = Vec::new();
        for point in 0..POINTS {
            // The first surface faces up, and one faces down.
            let n = match point {
                0 => Vec3A::Y,
                1 => Vec3A::new(0.2, -0.9, 0.3).normalize(),
                _ => random.direction(),
            };
            let wo = (n + 0.8 * n.any_orthonormal_vector()).normalize();
            for row in 0..ROWS {
                // Some given directions are beside a pole.
                let given = match row % 16 {
                    0 => (Vec3A::Y + 0.05 * random.direction()).normalize(),
                    1 => (0.05 * random.direction() - Vec3A::Y).normalize(),
                    _ => random.direction(),
                };
                rows.push(Row { n, wo, u: random.uniform2(), given, answer: Answer::default() });
            }
        }
        let answers = self.answers(&rows)?;
        for (row, answer) in rows.iter_mut().zip(answers) {
            row.answer = answer;
        }
        Ok(rows)
    }

    /// Returns the correct answers for rows.
    fn answers(&self, rows: &[Row]) -> Result<Vec<Answer>> {
        let (n, wo) = (vectors(rows, |row| row.n), vectors(rows, |row| row.wo));
        let u: Vec<[f32; 2]> = rows.iter().map(|row| row.u.to_array()).collect();
        let (mut wi, mut pdf) = (vec![[0.0; 3]; rows.len()], vec![0.0; rows.len()]);
        let out = DrawList { wi: &mut wi, pdf: &mut pdf, radiance: None };
        let at = PointList { p: &[], n: &n, wo: &wo, surface: self.surface() };
        batch::sample(&*self.sampler, &at, Numbers::Given(&u), out)?;
        let of_given = self.pdfs(rows)?;
        let answer = |((wi, pdf), pdf_of_given)| Answer { wi: Vec3A::from_array(wi), pdf, pdf_of_given };
        Ok(wi.into_iter().zip(pdf).zip(of_given).map(answer).collect())
    }

    /// Returns the correct pdfs of given directions.
    fn pdfs(&self, rows: &[Row]) -> Result<Vec<f32>> {
        let (n, wo, wi) = (vectors(rows, |row| row.n), vectors(rows, |row| row.wo), vectors(rows, |row| row.given));
        let mut out = vec![0.0; rows.len()];
        batch::pdf(&*self.sampler, &PointList { p: &[], n: &n, wo: &wo, surface: self.surface() }, &wi, &mut out)?;
        Ok(out)
    }

    fn surface(&self) -> SurfaceList<'_> {
        match &self.alpha {
            Some(alpha) => SurfaceList::Glossy { alpha: std::slice::from_ref(alpha), f0: &[1.0] },
            None => SurfaceList::Diffuse,
        }
    }
}

/// Returns a vector of each row.
fn vectors(rows: &[Row], of: impl Fn(&Row) -> Vec3A) -> Vec<[f32; 3]> {
    rows.iter().map(|row| of(row).to_array()).collect()
}

/// Returns the sine of the polar angle of a direction.
fn sine(wi: Vec3A) -> f32 {
    latlong::sin_theta(latlong::square(wi).y)
}

#[cfg(test)]
mod tests;
