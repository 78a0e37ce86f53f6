//! A rival: maps of visibility over X at points of a scene, as renderers keep them to sample light through windows.
//!
//! Points are spread over what the camera sees, no two with like normals nearer than a radius. Each sends shadow rays to all tiles of the map; a shading
//! point takes the nearest point's tiles within the radius and an angle of normals, and draws one in proportion to its light times mean visibility, then a texel by its
//! light. Neither BRDF nor cosine is in the product: a mixture with BRDF sampling has these, and covers what the floor leaves to chance.

use std::{error::Error, str::FromStr};

use glam::{Vec2, Vec3A};
use headtail_render::{
    columns::Arena,
    integrator::View,
    latlong,
    random::{Purpose, Stream},
    sampler::{Coverage, Draws, Sampler},
    scene::Ray,
    simd::{LANES, Lanes},
    tile::Rows,
};

/// Shadow rays to each tile from each point.
const RAYS: usize = 4;

/// What a cache is set by.
#[derive(Clone, Copy, Debug)]
pub struct Parameters {
    /// Points, about.
    pub points: usize,
    /// Rows of tiles; there are twice as many columns.
    pub rows: usize,
    /// Normals are alike within this angle, in degrees.
    pub degrees: f32,
    /// What a tile counts for that no ray reached, over one that is seen.
    pub floor: f32,
}

impl FromStr for Parameters {
    type Err = Box<dyn Error>;

    /// `POINTS[:ROWS[:DEGREES[:FLOOR]]]`.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let mut parts = text.split(':');
        let mut next = |default: &'static str| parts.next().unwrap_or(default).to_owned();
        let out = Self {
            points: next("2000").parse()?,
            rows: next("16").parse()?,
            degrees: next("25").parse()?,
            floor: next("0.1").parse()?,
        };
        if out.rows == 0 || parts.next().is_some() {
            Err("a cache is POINTS:ROWS:DEGREES:FLOOR".into())
        } else {
            Ok(out)
        }
    }
}

/// The cache.
pub struct MapCache {
    texels: Texels,
    radius: f32,
    /// The cosine of the angle within which normals are alike.
    like: f32,
    points: Vec<(Vec3A, Vec3A)>,
    /// For each point, after that of nothing known, the running sums of the tiles' masses.
    sums: Vec<Vec<f32>>,
}

/// The light of a map by texels of a grid over X.
struct Texels {
    width: usize,
    height: usize,
    /// Rows and columns of tiles.
    shape: (usize, usize),
    /// Masses `[height, width]`, none where its neighbours have light.
    masses: Vec<f32>,
    /// The masses of the tiles.
    tiles: Vec<f32>,
}

impl Texels {
    fn new((width, rows): (usize, usize), luminance: &[f32], shape: (usize, usize)) -> Self {
        let height = rows - 1;
        let mass = |k: usize| {
            let (column, row) = (k % width, k / width);
            // Light is bilinear between texels: all that reach into this one.
            let reach = [width - 1, 0, 1].map(|step| (column + step) % width);
            let light = reach.into_iter().flat_map(|column| [row, row + 1].map(|row| luminance[row * width + column]));
            light.sum::<f32>() * latlong::sin_theta((row as f32 + 0.5) / height as f32)
        };
        let masses = (0..width * height).map(mass).collect();
        let mut out = Self { width, height, shape, masses, tiles: vec![0.0; shape.0 * shape.1] };
        for k in 0..out.masses.len() {
            let tile = out.tile(k % width, k / width);
            out.tiles[tile] += out.masses[k];
        }
        out
    }

    fn tile(&self, column: usize, row: usize) -> usize {
        row * self.shape.0 / self.height * self.shape.1 + column * self.shape.1 / self.width
    }

    /// The texels of a tile.
    fn of_tile(&self, tile: usize) -> impl Iterator<Item = usize> + '_ {
        let bounds =
            |k: usize, tiles: usize, texels: usize| (k * texels).div_ceil(tiles)..((k + 1) * texels).div_ceil(tiles);
        let (rows, across) = self.shape;
        let columns = bounds(tile % across, across, self.width);
        bounds(tile / across, rows, self.height)
            .flat_map(move |row| columns.clone().map(move |column| row * self.width + column))
    }

    /// A point of X in a tile, by light.
    fn draw(&self, tile: usize, u: Vec2) -> Vec2 {
        let (mut target, mut last) = (u.x * self.tiles[tile], 0);
        for texel in self.of_tile(tile) {
            last = texel;
            if target < self.masses[texel] {
                break;
            }
            target -= self.masses[texel];
        }
        let inside = (target / self.masses[last]).clamp(0.0, 0.999_999);
        let (column, row) = ((last % self.width) as f32, (last / self.width) as f32);
        Vec2::new((column + inside) / self.width as f32, (row + u.y) / self.height as f32)
    }

    /// Where a point of X lies: its tile, and the density over X of drawing it in the tile.
    fn density(&self, x: Vec2) -> (usize, f32) {
        let column = ((x.x * self.width as f32) as usize).min(self.width - 1);
        let row = ((x.y * self.height as f32) as usize).min(self.height - 1);
        let (tile, mass) = (self.tile(column, row), self.masses[row * self.width + column]);
        (tile, if mass > 0.0 { mass / self.tiles[tile] * (self.width * self.height) as f32 } else { 0.0 })
    }
}

impl MapCache {
    /// A cache of what a view shows.
    pub fn new(view: &View<'_>, Parameters { points: count, rows, degrees, floor }: Parameters) -> Self {
        let map = view.environment;
        let (columns, like) = (2 * rows, degrees.to_radians().cos());
        let texels = Texels::new((map.width(), map.height()), &map.luminance(), (rows, columns));
        let (mut radius, mut points) = (0.5 * view.scene.bounds().extent().length(), Vec::new());
        while points.len() < count && radius > 1e-4 {
            radius *= 0.85;
            points = spread(view, radius, like);
        }
        let mut random = Stream::new(7, Purpose::Test, 0);
        let mut sums = vec![running(&texels.tiles)];
        for &(p, n) in &points {
            let ray = |tile: usize| {
                let at = Vec2::new((tile % columns) as f32, (tile / columns) as f32) + random.uniform2();
                latlong::direction(at / Vec2::new(columns as f32, rows as f32))
            };
            let directions: Vec<Vec3A> = (0..rows * columns * RAYS).map(|k| k / RAYS).map(ray).collect();
            // What is below the surface is not seen.
            let above = |wi: &Vec3A| n.dot(*wi) > 0.0;
            let rays: Vec<Ray> =
                directions.iter().filter(|wi| above(wi)).map(|&wi| view.scene.leaving(p, n, wi)).collect();
            let mut visible = vec![false; rays.len()];
            view.scene.visible_batch(&rays, &mut visible);
            let mut visible = visible.into_iter();
            let seen: Vec<bool> = directions.iter().map(|wi| above(wi) && visible.next() == Some(true)).collect();
            let mean = |seen: &[bool]| seen.iter().filter(|&&seen| seen).count() as f32 / RAYS as f32;
            let masses: Vec<f32> =
                seen.chunks_exact(RAYS).zip(&texels.tiles).map(|(seen, light)| light * mean(seen).max(floor)).collect();
            sums.push(running(&masses));
        }
        Self { texels, radius, like, points, sums }
    }

    /// Bytes of its points and running sums.
    pub fn bytes(&self) -> usize {
        self.points.len() * size_of::<(Vec3A, Vec3A)>() + self.sums.iter().map(|sums| 4 * sums.len()).sum::<usize>()
    }

    /// The tiles that a point takes: those of nothing known where no other is near.
    fn nearest(&self, p: Vec3A, n: Vec3A) -> usize {
        let (mut found, mut least) = (0, self.radius * self.radius);
        for (k, (other, normal)) in self.points.iter().enumerate() {
            let distance = (*other - p).length_squared();
            if distance < least && normal.dot(n) > self.like {
                (found, least) = (k + 1, distance);
            }
        }
        found
    }
}

/// Points that a camera sees, so far from each other.
fn spread(view: &View<'_>, radius: f32, like: f32) -> Vec<(Vec3A, Vec3A)> {
    let mut points: Vec<(Vec3A, Vec3A)> = Vec::new();
    for pixel in 0..view.width * view.height {
        let (x, y) = ((pixel % view.width) as f32 + 0.5, (pixel / view.width) as f32 + 0.5);
        if let Some(hit) = view.scene.intersect(&view.camera.ray(x, y, view.width, view.height)) {
            let near = |(p, n): &(Vec3A, Vec3A)| (*p - hit.p).length() < radius && n.dot(hit.ng) > like;
            if !points.iter().any(near) {
                points.push((hit.p, hit.ng));
            }
        }
    }
    points
}

fn running(masses: &[f32]) -> Vec<f32> {
    let mut sum = 0.0;
    masses
        .iter()
        .map(|mass| {
            sum += mass;
            sum
        })
        .collect()
}

fn at(columns: &[&[Lanes]; 3], k: usize) -> Vec3A {
    Vec3A::from_array(columns.map(|column| column[k / LANES][k % LANES]))
}

impl Sampler for MapCache {
    fn columns(&self) -> usize {
        1
    }

    fn prepare(&self, rows: &Rows<'_>, state: &mut [Lanes], _arena: &Arena) {
        for (strip, out) in state.iter_mut().enumerate() {
            let (p, n) = (rows.positions(strip), rows.normals(strip));
            for k in 0..LANES.min(rows.len() - strip * LANES) {
                let vector = |lanes: &[Lanes; 3]| Vec3A::new(lanes[0][k], lanes[1][k], lanes[2][k]);
                out[k] = self.nearest(vector(&p), vector(&n)) as f32;
            }
        }
    }

    fn sample(&self, rows: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], mut out: Draws<'_>, _arena: &Arena) {
        for k in 0..rows.len() {
            let (strip, lane) = (k / LANES, k % LANES);
            let sums = &self.sums[state[strip][lane] as usize];
            let target = u[0][strip][lane] * sums[sums.len() - 1];
            let tile = sums.partition_point(|&sum| sum <= target).min(sums.len() - 1);
            let before = if tile == 0 { 0.0 } else { sums[tile - 1] };
            let left = ((target - before) / (sums[tile] - before)).clamp(0.0, 0.999_999);
            let x = self.texels.draw(tile, Vec2::new(left, u[1][strip][lane]));
            let wi = latlong::direction(x);
            for (column, number) in out.wi.iter_mut().zip(wi.to_array()) {
                column[strip][lane] = number;
            }
            out.pdf[strip][lane] = self.pdf_of(sums, x);
        }
    }

    fn pdf(&self, rows: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], _arena: &Arena) {
        for k in 0..rows.len() {
            let sums = &self.sums[state[k / LANES][k % LANES] as usize];
            out[k / LANES][k % LANES] = self.pdf_of(sums, latlong::square(at(&wi, k)));
        }
    }

    fn coverage(&self) -> Coverage {
        Coverage::Everything
    }
}

impl MapCache {
    fn pdf_of(&self, sums: &[f32], x: Vec2) -> f32 {
        let (tile, density) = self.texels.density(x);
        let before = if tile == 0 { 0.0 } else { sums[tile - 1] };
        let pdf = density * (sums[tile] - before) / sums[sums.len() - 1] * latlong::solid_angle_factor(x.y);
        if pdf.is_finite() { pdf } else { 0.0 }
    }
}
