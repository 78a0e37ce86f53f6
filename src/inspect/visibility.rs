//! `headtail inspect --visibility`: draws the learned visibility of a scene.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use clap::Args;
use glam::{Vec2, Vec3, Vec3A};
use headtail_render::{
    color::{luminance, tone_map},
    environment::Environment,
    latlong,
    patches::{Detail, PatchSampler},
    sampler::EnvironmentLight,
    scene::{Camera, Scene},
    tail::TailKind,
    tile::ShadingPoint,
    visibility::{PrecomputedVisibility, SceneVisibility},
};

use crate::{
    arguments::{CameraArguments, open_environment, open_scene},
    given::given,
    report::{
        chart::{Panel, Sides, densities},
        vector::Chart,
    },
};

/// Columns and rows of a picture of the sky.
const SKY: (usize, usize) = (512, 256);
/// Factor and offset for the colours of hidden texels.
const HIDDEN: (f32, Vec3) = (0.08, Vec3::new(0.02, 0.03, 0.10));
/// Upper bound of the displayed radiance, relative to the mean.
const BRIGHTEST: f32 = 6.0;

/// Arguments of `--visibility` and `--portals`.
#[derive(Args)]
#[command(next_help_heading = "For --visibility and --portals")]
pub struct Arguments {
    /// Scene: built-in, or a glTF 2.0 file.
    #[arg(long, value_name = "NAME|FILE", requires = "of_scene", value_parser = given::<String>())]
    scene: Option<String>,
    /// Add the ground plane, if it was present in training.
    #[arg(long, requires = "visibility")]
    ground: bool,
    /// Pixel whose visibility is shown. Default: the centre.
    #[arg(long, value_name = "X,Y", requires = "visibility", value_delimiter = ',', num_args = 1..=2)]
    pixel: Option<Vec<u32>>,
    #[command(flatten)]
    camera: CameraArguments,
}

impl Arguments {
    /// Opens the scene and the camera.
    pub fn open(&self) -> Result<(Scene, Camera)> {
        let scene = open_scene(self.scene.as_deref().context("--scene: name the scene")?, true)?;
        let camera = self.camera.open(&scene)?;
        Ok((scene, camera))
    }
}

/// Draws the cells in false colours and, for one pixel, the map by learned and by traced visibility; also
/// returns a summary in words.
pub fn inspect(arguments: &Arguments, file: &Path, map: &str) -> Result<(Chart, String)> {
    let environment = open_environment(map)?;
    let (mut scene, camera) = arguments.open()?;
    if arguments.ground {
        scene.add_ground();
    }
    let visibility = SceneVisibility::open(file, Some(&scene.geometry_hash()), &environment)?;
    let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
    let patches = PatchSampler::new(light, Detail::Leaves)?;
    let precomputed = PrecomputedVisibility::new(&visibility, &patches.division(), usize::MAX)?;

    let (width, height) = (arguments.camera.width as usize, arguments.camera.height as usize);
    let [x, y] = match arguments.pixel.as_deref() {
        None => [width / 2, height / 2],
        Some(&[x, y]) => [x as usize, y as usize],
        Some(_) => anyhow::bail!("--pixel: write two numbers, as in 320,240"),
    };
    ensure!(x < width && y < height, "--pixel {x},{y}: the picture has {width} x {height} pixels");
    let hit = |x: usize, y: usize| scene.intersect(&camera.ray(x as f32 + 0.5, y as f32 + 0.5, width, height));
    let cells: Vec<[u8; 3]> = (0..width * height)
        .map(|k| {
            let (column, row) = (k % width, k / width);
            let (dx, dy) = (column.abs_diff(x), row.abs_diff(y));
            // Two pixels wide, so that it remains visible when scaled down.
            let is_mark = dx.min(dy) < 2 && (4..14).contains(&dx.max(dy));
            tone_map(if is_mark {
                Vec3A::splat(10.0)
            } else {
                cell_color(&precomputed, hit(column, row).as_ref()).into()
            })
        })
        .collect();
    let at = hit(x, y).with_context(|| format!("--pixel {x},{y}: no surface is seen there"))?;
    let sky = Sky::new(&environment, &scene, &patches, &precomputed, &at);
    let [learned, traced] =
        [&sky.learned, &sky.traced].map(|seen| format!("{:.1} %", 100.0 * sky.visible_fraction(seen)));
    let panels = [
        Panel::plain("cells in false colour; the cross marks the pixel", (&cells, width), Sides::View)?,
        Panel::plain(
            format!("map at the pixel, as learned: {learned} visible"),
            (&sky.picture(&sky.learned), SKY.0),
            Sides::Sphere,
        )?,
        Panel::plain(
            format!("map at the pixel, as traced: {traced} visible"),
            (&sky.picture(&sky.traced), SKY.0),
            Sides::Sphere,
        )?,
    ];
    let cell = sky.cell.map_or_else(
        || "outside of all cells".to_owned(),
        |(cell, level)| format!("in cell {cell}, {level} sizes above the smallest"),
    );
    let rays = visibility.rays() as f64 / 1e6;
    let lines = [
        format!("{} in {}: {} cells from {rays:.1} million shadow rays", scene.name(), map, visibility.cells()),
        format!("Pixel {x},{y}, {cell}; percentages of the light that a diffuse surface would reflect"),
    ];
    let said = format!("{}\n{}: {learned} visible as learned, {traced} as traced", lines[0], lines[1]);
    Ok((densities("visibility", &lines, &panels, panels.len())?, said))
}

/// Returns a colour per cell, darker where the surface turns away.
fn cell_color(precomputed: &PrecomputedVisibility, at: Option<&ShadingPoint>) -> Vec3 {
    let Some(at) = at else { return Vec3::ZERO };
    let shade = 0.25 + 0.75 * at.ns.dot(at.wo).max(0.0);
    let Some((cell, ..)) = precomputed.at(at.p, at.ns) else { return Vec3::splat(0.3 * shade) };
    let hash = cell.wrapping_mul(0x9e37_79b1);
    let channel = |k: u32| 0.15 + 0.85 * f32::from((hash >> (8 * k) & 255) as u8) / 255.0;
    Vec3::new(channel(1), channel(2), channel(3)) * shade
}

/// The map as seen from a surface, texel by texel.
struct Sky {
    radiance: Vec<Vec3>,
    /// Light of each texel that a diffuse surface reflects.
    reflected: Vec<f32>,
    /// Visibility of each texel, learned and traced.
    learned: Vec<f32>,
    traced: Vec<f32>,
    /// The cell, and its number of sizes above the smallest.
    cell: Option<(u32, usize)>,
}

impl Sky {
    fn new(
        environment: &Environment,
        scene: &Scene,
        patches: &PatchSampler,
        precomputed: &PrecomputedVisibility,
        at: &ShadingPoint,
    ) -> Self {
        let (columns, rows) = SKY;
        let directions: Vec<Vec3A> = (0..columns * rows)
            .map(|k| {
                let place = Vec2::new((k % columns) as f32 + 0.5, (k / columns) as f32 + 0.5);
                latlong::direction(place / Vec2::new(columns as f32, rows as f32))
            })
            .collect();
        let radiance: Vec<Vec3> = directions.iter().map(|&wi| environment.radiance(wi).into()).collect();
        let cosines = directions.iter().map(|wi| if wi.dot(at.ng) > 0.0 { wi.dot(at.ns).max(0.0) } else { 0.0 });
        let reflected = cosines
            .zip(&radiance)
            .enumerate()
            .map(|(k, (cosine, &radiance))| {
                let area = ((k / columns) as f32 + 0.5) / rows as f32 * std::f32::consts::PI;
                cosine * luminance(radiance.into()) * area.sin()
            })
            .collect();
        let rays: Vec<_> = directions.iter().map(|&wi| scene.leaving(at.p, at.ng, wi)).collect();
        let mut visible = vec![false; rays.len()];
        scene.visible_batch(&rays, &mut visible);
        let seen = precomputed.at(at.p, at.ns);
        let of_patch = |patch: u16| seen.map_or(1.0, |(_, _, visibility)| visibility[usize::from(patch)]);
        Self {
            radiance,
            reflected,
            learned: patches.patches_of(&directions).into_iter().map(of_patch).collect(),
            traced: visible.into_iter().map(|visible| f32::from(u8::from(visible))).collect(),
            cell: seen.map(|(cell, level, _)| (cell, level)),
        }
    }

    /// Returns the visible fraction of the reflected light.
    fn visible_fraction(&self, seen: &[f32]) -> f32 {
        let sum: f32 = self.reflected.iter().sum();
        let own: f32 = self.reflected.iter().zip(seen).map(|(light, seen)| light * seen).sum();
        own / sum.max(f32::MIN_POSITIVE)
    }

    fn picture(&self, seen: &[f32]) -> Vec<[u8; 3]> {
        let mean = self.radiance.iter().map(|&radiance| luminance(radiance.into())).sum::<f32>();
        let scale = 0.4 * self.radiance.len() as f32 / mean.max(f32::MIN_POSITIVE);
        let texels = self.radiance.iter().zip(seen).zip(&self.reflected).map(|((&radiance, &seen), &reflected)| {
            let shown = (radiance * scale).min(Vec3::splat(BRIGHTEST));
            let hidden = shown * HIDDEN.0 + HIDDEN.1;
            // Below the surface, everything is dark.
            tone_map(if reflected > 0.0 { hidden.lerp(shown, seen) } else { hidden * 0.4 }.into())
        });
        texels.collect()
    }
}
