//! Layouts of directions in a picture, and conversion to latitude-longitude.

use std::{f64::consts::PI, fmt, str::FromStr};

use glam::{DVec2, DVec3, Vec3A};

use super::{Image, MAX_PIXELS};
use crate::{
    error::{Error, Result},
    latlong, memory,
};

/// The layout of directions in a picture of the sphere.
///
/// The centre of a latitude-longitude map is forward (+Z), the side to its right is right (-X), and up is +Y.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MapLayout {
    /// Latitude and longitude, twice as wide as high, up at the top; see [`crate::latlong`].
    #[default]
    LatLong,
    /// An equal-area square (Clarberg 2008), as in pbrt-v4: up in the middle, down at the corners.
    EqualArea,
    /// Six faces of a cube in a column or a row, in OpenEXR's order: +X, -X, +Y, -Y, +Z, -Z, each as
    /// seen from inside with forward +Z.
    Cube,
    /// An unfolded cube: 3 x 4 faces with up, forward, down and backward (upside down) in a column, and
    /// left and right beside forward; or 4 x 3 faces with left, forward, right and backward in a row,
    /// and up and down beside forward.
    Cross,
    /// A light probe (Debevec 1998): a disc with forward in the middle, whose radius is the angle to forward.
    Angular,
}

/// Names of layouts.
const NAMES: [(&str, MapLayout); 5] = [
    ("latlong", MapLayout::LatLong),
    ("equal-area", MapLayout::EqualArea),
    ("cube", MapLayout::Cube),
    ("cross", MapLayout::Cross),
    ("angular", MapLayout::Angular),
];

impl MapLayout {
    /// All names, as parsed from text.
    pub fn names() -> impl Iterator<Item = &'static str> {
        NAMES.into_iter().map(|(name, _)| name)
    }
}

impl fmt::Display for MapLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = NAMES.into_iter().find(|(_, layout)| layout == self).map_or("", |(name, _)| name);
        f.write_str(name)
    }
}

impl FromStr for MapLayout {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let found = NAMES.into_iter().find(|(name, _)| *name == text).map(|(_, layout)| layout);
        found.ok_or_else(|| format!("write one of {}", MapLayout::names().collect::<Vec<_>>().join(", ")))
    }
}

/// Right, up and forward.
const RIGHT: DVec3 = DVec3::NEG_X;
const UP: DVec3 = DVec3::Y;
const FORWARD: DVec3 = DVec3::Z;

/// A face of a cube: its position among the faces of the picture, and its orientation.
struct Face {
    column: usize,
    row: usize,
    forward: DVec3,
    right: DVec3,
}

const fn face(column: usize, row: usize, forward: DVec3, right: DVec3) -> Face {
    Face { column, row, forward, right }
}

const LEFT: DVec3 = DVec3::X;
const DOWN: DVec3 = DVec3::NEG_Y;
const BACKWARD: DVec3 = DVec3::NEG_Z;

/// Faces in a column; for a row, columns and rows are exchanged.
const CUBE: [Face; 6] = [
    face(0, 0, LEFT, FORWARD),
    face(0, 1, RIGHT, BACKWARD),
    face(0, 2, UP, LEFT),
    face(0, 3, DOWN, LEFT),
    face(0, 4, FORWARD, RIGHT),
    face(0, 5, BACKWARD, LEFT),
];
const TALL_CROSS: [Face; 6] = [
    face(1, 0, UP, RIGHT),
    face(1, 1, FORWARD, RIGHT),
    face(1, 2, DOWN, RIGHT),
    face(1, 3, BACKWARD, RIGHT),
    face(0, 1, LEFT, FORWARD),
    face(2, 1, RIGHT, BACKWARD),
];
const WIDE_CROSS: [Face; 6] = [
    face(1, 0, UP, RIGHT),
    face(1, 1, FORWARD, RIGHT),
    face(1, 2, DOWN, RIGHT),
    face(0, 1, LEFT, FORWARD),
    face(2, 1, RIGHT, BACKWARD),
    face(3, 1, BACKWARD, LEFT),
];

/// Converts a picture from another layout to latitude-longitude, with at least the same local resolution.
///
/// Each texel is divided into parts whose light is splatted bilinearly, weighted by solid angle, so
/// that the light of small sources such as a sun is preserved.
///
/// # Errors
/// [`Error::Argument`] if the size does not match the layout, or the new picture is too large.
pub(crate) fn to_lat_long(image: Image, layout: MapLayout) -> Result<Image> {
    let wrong = |wanted: &str| {
        let reason = format!("{} x {} pixels are not {wanted}, as the layout {layout} has", image.width, image.height);
        Err(Error::argument("layout", reason))
    };
    let is_square = image.width == image.height;
    match layout {
        MapLayout::LatLong => Ok(image),
        MapLayout::EqualArea if !is_square => wrong("a square"),
        MapLayout::Angular if !is_square => wrong("a square"),
        MapLayout::EqualArea => resample(&image, 2 * image.width, |splats| equal_area(&image, splats)),
        MapLayout::Angular => resample(&image, 2 * image.width, |splats| angular(&image, splats)),
        MapLayout::Cube | MapLayout::Cross => {
            let (columns, rows) = match (layout, image.width > image.height) {
                (MapLayout::Cube, false) => (1, 6),
                (MapLayout::Cube, true) => (6, 1),
                (_, false) => (3, 4),
                (_, true) => (4, 3),
            };
            let side = image.width / columns;
            if side == 0 || (side * columns, side * rows) != (image.width, image.height) {
                return wrong(&format!("{columns} x {rows} squares"));
            }
            let faces = match (layout, columns) {
                (MapLayout::Cube, _) => CUBE,
                (_, 3) => TALL_CROSS,
                _ => WIDE_CROSS,
            };
            let is_row = (columns, rows) == (6, 1);
            resample(&image, 4 * side, |splats| {
                for Face { column, row, forward, right } in &faces {
                    let place = if is_row { (*row, *column) } else { (*column, *row) };
                    cube_face(&image, side, place, *forward, *right, splats);
                }
            })
        }
    }
}

/// Weighted sums at every texel of a latitude-longitude picture.
struct Splats {
    width: usize,
    height: usize,
    /// `[height * width]` sums of weight x value, and of weights.
    sums: Vec<[f32; 4]>,
}

/// Makes a picture of `width` x `width / 2` pixels from the splats of `fill`.
fn resample(image: &Image, width: usize, fill: impl FnOnce(&mut Splats)) -> Result<Image> {
    // A single row would be doubled.
    let height = (width / 2).max(2);
    if width * height > MAX_PIXELS {
        let reason = format!("{} x {} pixels take more than {MAX_PIXELS} as a map", image.width, image.height);
        return Err(Error::argument("layout", reason));
    }
    memory::require(28 * (width * height) as u64, || format!("a map of {width} x {height} pixels"))?;
    let mut splats = Splats { width, height, sums: vec![[0.0; 4]; width * height] };
    fill(&mut splats);
    Ok(splats.finish())
}

impl Splats {
    /// Adds the light of a solid angle in a direction.
    fn add(&mut self, w: DVec3, solid_angle: f64, value: [f32; 3]) {
        let x = latlong::square(w.as_vec3a().normalize_or(Vec3A::Y));
        let (column, row) = (x.x * self.width as f32 - 0.5, x.y * (self.height - 1) as f32);
        let (left, top) = (column.floor(), row.floor().min((self.height - 2) as f32));
        let (across, down) = (column - left, row - top);
        let (left, top) = ((left as isize).rem_euclid(self.width as isize) as usize, top as usize);
        let right = if left + 1 == self.width { 0 } else { left + 1 };
        for (column, row, fraction) in [
            (left, top, (1.0 - across) * (1.0 - down)),
            (right, top, across * (1.0 - down)),
            (left, top + 1, (1.0 - across) * down),
            (right, top + 1, across * down),
        ] {
            let sum = &mut self.sums[row * self.width + column];
            let weight = fraction * solid_angle as f32;
            for (sum, value) in sum.iter_mut().zip(value) {
                *sum += weight * value;
            }
            sum[3] += weight;
        }
    }

    /// Computes the averages. Texels near the poles without any splat copy the nearest in their row, or
    /// else the next row.
    fn finish(self) -> Image {
        let Self { width, height, sums } = self;
        let mut image = Image::black(width, height);
        let mut is_empty_row = vec![false; height];
        for (y, (row, pixels)) in sums.chunks_exact(width).zip(image.pixels.chunks_exact_mut(width)).enumerate() {
            let filled: Vec<usize> = (0..width).filter(|&x| row[x][3] > 0.0).collect();
            is_empty_row[y] = filled.is_empty();
            let mut next = 0;
            for (x, pixel) in pixels.iter_mut().enumerate().filter(|_| !filled.is_empty()) {
                while next < filled.len() && filled[next] < x {
                    next += 1;
                }
                let after = if next < filled.len() { filled[next] } else { filled[0] + width };
                let before = if next == 0 {
                    filled[filled.len() - 1] as isize - width as isize
                } else {
                    filled[next - 1] as isize
                };
                let nearest = if after - x <= (x as isize - before) as usize {
                    after
                } else {
                    before.rem_euclid(width as isize) as usize
                };
                let [r, g, b, weight] = row[nearest % width];
                *pixel = [r / weight, g / weight, b / weight];
            }
        }
        // From the equator to both poles.
        let copy = |image: &mut Image, from: usize, to: usize| {
            image.pixels.copy_within(from * width..(from + 1) * width, to * width);
        };
        for y in (0..height / 2).rev().filter(|&y| is_empty_row[y]) {
            copy(&mut image, y + 1, y);
        }
        for y in (height / 2..height).filter(|&y| is_empty_row[y]) {
            copy(&mut image, y - 1, y);
        }
        image
    }
}

/// Parts of a texel along each side; their distance is at most half a texel of the new map.
const PARTS: usize = 4;

/// Centres of the parts of texel `k` of `count`, from 0 to 1 over the picture.
fn parts(k: usize, count: usize) -> [f64; PARTS] {
    std::array::from_fn(|i| (k as f64 + (i as f64 + 0.5) / PARTS as f64) / count as f64)
}

fn equal_area(image: &Image, splats: &mut Splats) {
    let solid_angle = 4.0 * PI / (PARTS * PARTS * image.pixels.len()) as f64;
    each_part(image, |place, value| splats.add(equal_area_direction(place), solid_angle, value));
}

/// Calls `add` for each part of each texel, with its position in `[0, 1]^2`.
fn each_part(image: &Image, mut add: impl FnMut(DVec2, [f32; 3])) {
    for y in 0..image.height {
        for x in 0..image.width {
            let value = image.pixels[y * image.width + x];
            for t in parts(y, image.height) {
                for s in parts(x, image.width) {
                    add(DVec2::new(s, t), value);
                }
            }
        }
    }
}

/// The direction of a point of the equal-area square: maps concentric squares to circles, octant by
/// octant (Clarberg 2008, section 2).
fn equal_area_direction(place: DVec2) -> DVec3 {
    let p = 2.0 * place - DVec2::ONE;
    let (a, b) = (p.x.abs(), p.y.abs());
    // Distance from the edge between the hemispheres: positive inside the diamond, which is the upper one.
    let inside = 1.0 - (a + b);
    let r = 1.0 - inside.abs();
    let phi = if r == 0.0 { 0.0 } else { ((b - a) / r + 1.0) * PI / 4.0 };
    let height = (1.0 - r * r).copysign(inside);
    let radius = r * (2.0 - r * r).max(0.0).sqrt();
    let (sin, cos) = phi.sin_cos();
    // Azimuth zero is backward, as in lat-long maps, and increases to the left.
    let [zero, quarter] = [cos.copysign(p.x) * radius, sin.copysign(p.y) * radius];
    BACKWARD * zero + LEFT * quarter + UP * height
}

fn angular(image: &Image, splats: &mut Splats) {
    let area = 4.0 / (PARTS * PARTS * image.pixels.len()) as f64;
    each_part(image, |place, value| {
        let p = 2.0 * place - DVec2::ONE;
        let r = p.length();
        if r > 1.0 {
            return;
        }
        let (sin, cos) = (PI * r).sin_cos();
        // sin(pi r) / r, which tends to pi in the middle.
        let ratio = if r > 1e-9 { sin / r } else { PI };
        let w = FORWARD * cos + (RIGHT * p.x - UP * p.y) * ratio;
        splats.add(w, area * PI * ratio, value);
    });
}

fn cube_face(image: &Image, side: usize, place: (usize, usize), forward: DVec3, right: DVec3, splats: &mut Splats) {
    let (left, top) = (place.0 * side, place.1 * side);
    // As seen from inside the cube.
    let up = right.cross(forward);
    let area = 4.0 / (PARTS * PARTS * side * side) as f64;
    for y in 0..side {
        for x in 0..side {
            let value = image.pixels[(top + y) * image.width + left + x];
            for t in parts(y, side) {
                for s in parts(x, side) {
                    let w = forward + right * (2.0 * s - 1.0) - up * (2.0 * t - 1.0);
                    splats.add(w, area / w.length().powi(3), value);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth picture of the sphere without symmetry.
    fn light(w: DVec3) -> [f32; 3] {
        let lobe = |to: DVec3, width: f64| ((w.dot(to.normalize()) - 1.0) / width).exp();
        let sky = 0.3 + 0.2 * w.y;
        let values = [
            sky + 3.0 * lobe(DVec3::new(0.3, 0.5, 0.8), 0.05),
            sky + 2.0 * lobe(DVec3::new(-0.9, 0.1, -0.2), 0.1),
            sky + lobe(DVec3::new(0.5, -0.7, -0.4), 0.2),
        ];
        values.map(|value| value as f32)
    }

    /// The mean of bilinear lookups over all directions.
    fn mean(image: &Image) -> [f64; 3] {
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for y in 0..image.height {
            // The integral of the hat function of a row; the first and last rows are at the poles.
            let step = PI / (image.height - 1) as f64;
            let theta = step * y as f64;
            let weight = if y == 0 || y == image.height - 1 { 0.125 * step } else { theta.sin() };
            for pixel in &image.pixels[y * image.width..(y + 1) * image.width] {
                total += weight;
                (0..3).for_each(|c| sum[c] += weight * f64::from(pixel[c]));
            }
        }
        sum.map(|sum| sum / total)
    }

    /// [`light`] in a layout, at the `direction` of the centre of each texel.
    fn pictured(width: usize, height: usize, direction: impl Fn(DVec2) -> Option<DVec3>) -> Image {
        let mut image = Image::black(width, height);
        for y in 0..height {
            for x in 0..width {
                let place = DVec2::new((x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / height as f64);
                image.pixels[y * width + x] = direction(place).map_or([0.0; 3], |w| light(w.normalize()));
            }
        }
        image
    }

    fn cubes(columns: usize, rows: usize, faces: &[Face; 6]) -> Image {
        pictured(48 * columns, 48 * rows, |place| {
            let (x, y) = (place.x * columns as f64, place.y * rows as f64);
            let at = |face: &&Face| (face.column, face.row) == (x as usize, y as usize);
            let Face { forward, right, .. } = faces.iter().find(at)?;
            let (s, t) = (2.0 * x.fract() - 1.0, 2.0 * y.fract() - 1.0);
            Some(*forward + *right * s - right.cross(*forward) * t)
        })
    }

    fn every_layout() -> Vec<(MapLayout, Image)> {
        let row = std::array::from_fn(|k| {
            let Face { row, forward, right, .. } = CUBE[k];
            face(row, 0, forward, right)
        });
        let disc = |place: DVec2| {
            let p = 2.0 * place - DVec2::ONE;
            let r = p.length();
            let sin = (PI * r).sin() / r;
            (r <= 1.0).then(|| FORWARD * (PI * r).cos() + (RIGHT * p.x - UP * p.y) * sin)
        };
        vec![
            (MapLayout::EqualArea, pictured(96, 96, |place| Some(equal_area_direction(place)))),
            (MapLayout::Cube, cubes(1, 6, &CUBE)),
            (MapLayout::Cube, cubes(6, 1, &row)),
            (MapLayout::Cross, cubes(3, 4, &TALL_CROSS)),
            (MapLayout::Cross, cubes(4, 3, &WIDE_CROSS)),
            (MapLayout::Angular, pictured(192, 192, disc)),
        ]
    }

    #[test]
    fn all_layouts_convert_to_the_same_map() {
        let of_sphere = |width: usize, height: usize| {
            let mut image = Image::black(width, height);
            for y in 0..height {
                for x in 0..width {
                    let place = [(x as f32 + 0.5) / width as f32, y as f32 / (height - 1) as f32];
                    image.pixels[y * width + x] = light(latlong::direction(place.into()).as_dvec3());
                }
            }
            image
        };
        let truth = mean(&of_sphere(512, 257));
        for (layout, image) in every_layout() {
            let size = (image.width, image.height);
            let map = to_lat_long(image, layout).unwrap();
            assert_eq!(map.width, 2 * map.height, "{layout}");
            let own = mean(&map);
            for c in 0..3 {
                assert!((own[c] / truth[c] - 1.0).abs() < 1e-3, "{layout} {size:?}: {own:?} and {truth:?}");
            }
            // Texels differ from the light of their direction by at most a blur of the smallest lobe
            // over 1.5 texels.
            let expected = of_sphere(map.width, map.height);
            for (k, (a, b)) in map.pixels.iter().zip(&expected.pixels).enumerate() {
                let near = (0..3).all(|c| (a[c] - b[c]).abs() < 0.25);
                assert!(near, "{layout} {size:?}, column {} row {}: {a:?} and {b:?}", k % map.width, k / map.width);
            }
        }
    }

    #[test]
    fn light_of_a_single_texel_is_preserved() {
        for (layout, mut image) in every_layout() {
            image.pixels.fill([0.0; 3]);
            // On a face, inside the disc, and away from the poles.
            let (x, y) = match layout {
                MapLayout::Cross if image.width > image.height => (image.width * 2 / 5, image.height / 2),
                MapLayout::Cross => (image.width / 2, image.height * 2 / 5),
                _ => (image.width * 2 / 5, image.height * 2 / 5),
            };
            let (width, height) = (image.width, image.height);
            image.pixels[y * width + x] = [1000.0; 3];
            let map = to_lat_long(image, layout).unwrap();
            // The solid angle of the texel, from the parts.
            let mut splats = Splats { width: 4, height: 2, sums: vec![[0.0; 4]; 8] };
            let mut white = Image::black(width, height);
            white.pixels[y * width + x] = [1.0; 3];
            match layout {
                MapLayout::EqualArea => equal_area(&white, &mut splats),
                MapLayout::Angular => angular(&white, &mut splats),
                _ => {
                    let side = width.max(height) / if layout == MapLayout::Cube { 6 } else { 4 };
                    cube_face(&white, side, (x / side, y / side), FORWARD, RIGHT, &mut splats);
                }
            }
            let solid_angle: f64 = splats.sums.iter().map(|sum| f64::from(sum[0])).sum();
            let light = mean(&map)[0] * 4.0 * PI;
            // Sums of weights are the solid angles of texels, up to the density of parts.
            assert!(
                (light / (1000.0 * solid_angle) - 1.0).abs() < 0.03,
                "{layout}: {light} of {}",
                1000.0 * solid_angle
            );
        }
    }

    #[test]
    fn sizes_that_do_not_match_a_layout_are_rejected() {
        for (layout, width, height) in [
            (MapLayout::EqualArea, 8, 4),
            (MapLayout::Angular, 8, 9),
            (MapLayout::Cube, 8, 47),
            (MapLayout::Cube, 2, 6),
            (MapLayout::Cross, 6, 9),
            (MapLayout::Cross, 0, 0),
        ] {
            let image = Image::black(width, height);
            assert!(to_lat_long(image, layout).unwrap_err().to_string().contains(&layout.to_string()));
        }
    }

    #[test]
    fn names_round_trip() {
        for name in MapLayout::names() {
            assert_eq!(name.parse::<MapLayout>().unwrap().to_string(), name);
        }
        assert!("mercator".parse::<MapLayout>().unwrap_err().contains("equal-area"));
    }
}
