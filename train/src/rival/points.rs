//! Views of a material, and directions in proportion to its reflectance.

use std::{f32::consts::TAU, sync::Arc};

use glam::{Vec2, Vec3, Vec3A};
use headtail_render::{
    brdf::{
        Brdf, BrdfTable, MAX_PARAMETERS, NeuralTexture, Surface,
        neural::{NeuralBrdf, open_measured},
        neural_texture::{FEATURES, Seen, TEXEL_WIDTH},
    },
    columns::{Arena, strips},
    random::{Purpose, Stream},
    rival::{Rival, RivalSampler},
    sampler::{Draws, Sampler},
    scene::MaterialSpec,
    simd::{LANES, Lanes},
    tile::{ShadingPoint, Tile},
};
use serde::Serialize;

use super::view::View;
use crate::{Error, Result};

/// Smallest cosine of views.
const LEAST_COSINE: f32 = 0.02;

/// A material that samplers are trained for.
pub struct RivalMaterial {
    /// Its name in files.
    pub name: String,
    /// Its hash, by which samplers identify it.
    pub identity: blake3::Hash,
    table: BrdfTable,
    index: u32,
    /// Its texture, if it has one.
    texture: Option<Arc<NeuralTexture>>,
}

impl RivalMaterial {
    /// Opens the materials of `nbrdf:FILE#NAME,...` or `neural:FILE`.
    ///
    /// # Errors
    /// The file cannot be read, or it is another kind of material.
    pub fn open(text: &str) -> Result<Vec<Self>> {
        let wrong = |reason: &str| Error::ConfigFile { name: format!("material '{text}'"), reason: reason.to_owned() };
        match text.parse::<MaterialSpec>()? {
            MaterialSpec::Measured { file, names } => {
                let measured = open_measured(&file, &names)?;
                Ok(measured.into_iter().map(Self::measured).collect())
            }
            MaterialSpec::Neural(spec) => Ok(vec![Self::textured(Arc::new(NeuralTexture::read(&spec.file)?))]),
            _ => Err(wrong("has no network: name nbrdf:FILE#NAME or neural:FILE")),
        }
    }

    /// Wraps a measured material.
    pub fn measured(brdf: Arc<NeuralBrdf>) -> Self {
        let (name, identity) = (brdf.name().to_owned(), brdf.identity().expect("measured materials have one"));
        let (table, index) = BrdfTable::default().with(brdf);
        Self { name, identity, table, index, texture: None }
    }

    /// Wraps a neural material over a surface.
    pub fn textured(texture: Arc<NeuralTexture>) -> Self {
        let (name, identity) = (texture.description().name.clone(), texture.hash());
        let (table, index) = BrdfTable::default().with(texture.clone());
        Self { name, identity, table, index, texture: Some(texture) }
    }

    /// Draws a view from above: with a texture at a random position and footprint, without one in the xz
    /// plane.
    fn view(&self, random: &mut Stream) -> ([f32; MAX_PARAMETERS], View) {
        let u = random.uniform2();
        // 50 % uniform over the hemisphere, 50 % over the projected disk.
        let squared = 1.0 - u.x;
        let z = if random.uniform() < 0.5 { squared } else { squared.sqrt() }.max(LEAST_COSINE);
        let turn = if self.texture.is_some() { Vec2::from_angle(TAU * u.y) } else { Vec2::X };
        let wo = ((1.0 - z * z).sqrt() * turn).extend(z);
        let (uv, of_level) = (random.uniform2(), random.uniform());
        let Some(texture) = &self.texture else {
            return ([0.0; MAX_PARAMETERS], View { features: [0.0; FEATURES], wo: wo.to_array() });
        };
        let side = texture.pyramid().side();
        let level = side.ilog2() as f32 * of_level * of_level;
        // The first axis of the frame of +z is +x: local directions equal world directions.
        let width = TEXEL_WIDTH / side as f32 * level.exp2();
        let parameters = texture.parameters(&Seen { uv, width, wo, tangent: [1.0, 0.0, 1.0] });
        let mut features = [0.0; FEATURES];
        features.copy_from_slice(&parameters[..FEATURES]);
        (parameters, View { features, wo: wo.to_array() })
    }

    /// Returns a tile with `copies` points per view.
    fn tile(&self, views: &[([f32; MAX_PARAMETERS], View)], copies: usize) -> Tile {
        let point = |(parameters, view): &([f32; MAX_PARAMETERS], View)| ShadingPoint {
            p: Vec3A::ZERO,
            ng: Vec3A::Z,
            ns: Vec3A::Z,
            wo: Vec3A::from_array(view.wo),
            surface: Surface { brdf: self.index, parameters: *parameters },
        };
        let points: Vec<_> = views.iter().flat_map(|view| std::iter::repeat_n(point(view), copies)).collect();
        Tile::of_table(&points, &self.table)
    }
}

/// Directions with pdfs and reflected luminance; a pdf of 0 is not a sample.
type Drawn = Vec<(Vec3, f32, f32)>;

/// Draws a direction for each point of a tile.
fn draw(tile: &Tile, random: &mut Stream, by: &dyn Sampler) -> Drawn {
    let arena = Arena::default();
    let mut columns = arena.columns::<9>(strips(tile.len()));
    let [u, v, x, y, z, pdf, red, green, blue] = columns.get_mut();
    for k in 0..strips(tile.len()) * LANES {
        (u[k / LANES][k % LANES], v[k / LANES][k % LANES]) = random.uniform2().into();
    }
    let rows = tile.rows();
    let numbers: [&[Lanes]; 2] = [u, v];
    by.sample(&rows, &[], numbers, Draws { wi: [&mut *x, &mut *y, &mut *z], pdf: &mut *pdf }, &arena);
    rows.brdf_cosine([x, y, z], [&mut *red, &mut *green, &mut *blue], &arena);
    let at = |column: &[Lanes], k: usize| column[k / LANES][k % LANES];
    let one = |k: usize| {
        let wi = Vec3::new(at(x, k), at(y, k), at(z, k));
        let f = Vec3A::new(at(red, k), at(green, k), at(blue, k));
        let pdf = at(pdf, k);
        (wi, pdf, if pdf > 0.0 { headtail_render::color::luminance(f) } else { 0.0 })
    };
    (0..tile.len()).map(one).collect()
}

/// Views with directions, and weights, which sum to 1 for each view.
#[derive(Clone, Debug)]
pub(super) struct Points {
    pub views: Vec<View>,
    /// The same number for each view.
    pub wi: Vec<[f32; 3]>,
    pub weights: Vec<f32>,
}

impl Points {
    /// Draws the points of a step; equal seeds and steps give equal points.
    pub fn draw(material: &RivalMaterial, views: usize, directions: usize, seed: u64, step: u64) -> Self {
        let mut random = Stream::new(seed, Purpose::Batch, step);
        let views: Vec<_> = (0..views).map(|_| material.view(&mut random)).collect();
        let tile = material.tile(&views, directions);
        let drawn = draw(&tile, &mut random, &headtail_render::sampler::BrdfSampler);
        let (mut wi, mut weights) = (Vec::with_capacity(drawn.len()), Vec::with_capacity(drawn.len()));
        for of_view in drawn.chunks_exact(directions) {
            let weight = |&(_, pdf, value): &(Vec3, f32, f32)| if pdf > 0.0 { value / pdf } else { 0.0 };
            let sum = of_view.iter().map(weight).sum::<f32>();
            for drawn in of_view {
                let is_one = drawn.1 > 0.0 && drawn.0.z > 1e-3;
                weights.push(if is_one && sum > 0.0 { weight(drawn) / sum } else { 0.0 });
                wi.push(if is_one { drawn.0.to_array() } else { [0.0, 0.0, 1.0] });
            }
        }
        Self { views: views.into_iter().map(|(_, view)| view).collect(), wi, weights }
    }

    /// Returns the number of views.
    pub fn views(&self) -> usize {
        self.views.len()
    }

    /// Returns the number of directions per view.
    pub fn directions(&self) -> usize {
        self.wi.len() / self.views.len()
    }

    /// Splits into parts of at most `size` views.
    pub fn split(&self, size: usize) -> Vec<Self> {
        let each = self.directions();
        let part = |start: usize| {
            let range = start..(start + size).min(self.views.len());
            let of_wi = range.start * each..range.end * each;
            Self {
                views: self.views[range].to_vec(),
                wi: self.wi[of_wi.clone()].to_vec(),
                weights: self.weights[of_wi].to_vec(),
            }
        };
        (0..self.views.len()).step_by(size).map(part).collect()
    }
}

/// Quality of a sampler, over views that are not used for training.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct RivalQuality {
    /// The median over views of the relative variance of an estimate under a white sky.
    pub relative_variance: f64,
    /// The median for the material's own sampling.
    pub own_relative_variance: f64,
    /// The fraction of draws that are samples.
    pub kept: f64,
}

impl RivalQuality {
    /// Measures a sampler for a material, over `views` views of `directions` directions.
    pub fn measure(material: &RivalMaterial, rival: &Rival, views: usize, directions: usize, seed: u64) -> Self {
        let mut random = Stream::new(seed, Purpose::Validation, 0);
        let all: Vec<_> = (0..views).map(|_| material.view(&mut random)).collect();
        let sampler = RivalSampler::new(vec![(material.identity, rival.clone())]);
        let (mut own, mut others, mut kept) = (Vec::new(), Vec::new(), 0);
        for view in &all {
            let tile = material.tile(std::slice::from_ref(view), directions);
            let by_own = draw(&tile, &mut random, &headtail_render::sampler::BrdfSampler);
            let by_rival = draw(&tile, &mut random, &sampler);
            kept += by_rival.iter().filter(|(_, pdf, _)| *pdf > 0.0).count();
            own.push(relative_variance(&by_own));
            others.push(relative_variance(&by_rival));
        }
        let median = |list: &mut Vec<f64>| {
            list.sort_by(f64::total_cmp);
            list[list.len() / 2]
        };
        let kept = kept as f64 / (views * directions) as f64;
        let [relative_variance, own_relative_variance] = [median(&mut others), median(&mut own)];
        Self { relative_variance, own_relative_variance, kept }
    }
}

/// Returns the relative variance of estimates of the radiance reflected under a white sky.
fn relative_variance(drawn: &Drawn) -> f64 {
    let value = |&(_, pdf, value): &(Vec3, f32, f32)| if pdf > 0.0 { f64::from(value / pdf) } else { 0.0 };
    let mean = drawn.iter().map(value).sum::<f64>() / drawn.len() as f64;
    let squares = drawn.iter().map(|one| value(one).powi(2)).sum::<f64>() / drawn.len() as f64;
    squares / (mean * mean).max(f64::MIN_POSITIVE) - 1.0
}

#[cfg(test)]
impl Points {
    /// Returns a sampler's pdfs towards all directions. The views' parameters are features and an untwisted
    /// tangent.
    pub fn densities(&self, material: &RivalMaterial, rival: &Rival) -> Vec<f32> {
        let with_parameters = |view: &View| {
            let mut parameters = [0.0; MAX_PARAMETERS];
            parameters[..FEATURES].copy_from_slice(&view.features);
            parameters[FEATURES..FEATURES + 3].copy_from_slice(&[1.0, 0.0, 1.0]);
            (parameters, *view)
        };
        let views: Vec<_> = self.views.iter().map(with_parameters).collect();
        let tile = material.tile(&views, self.directions());
        let sampler = RivalSampler::new(vec![(material.identity, rival.clone())]);
        let arena = Arena::default();
        let mut columns = arena.columns::<4>(strips(tile.len()));
        let [x, y, z, pdf] = columns.get_mut();
        for (k, wi) in self.wi.iter().enumerate() {
            let (strip, lane) = (k / LANES, k % LANES);
            (x[strip][lane], y[strip][lane], z[strip][lane]) = (wi[0], wi[1], wi[2]);
        }
        sampler.pdf(&tile.rows(), &[], [x, y, z], pdf, &arena);
        pdf.as_flattened()[..tile.len()].to_vec()
    }
}
