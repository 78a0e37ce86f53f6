//! The light that shading points reflect of a map, to a few per cent of it where lobes are wide: coarse maps seen through lobes, made beforehand.
//!
//! After the split sum of Karis 2013, "Real Shading in Unreal Engine 4": a Trowbridge-Reitz lobe is taken to be round about the mirrored
//! direction, as it is seen from above.

use std::f32::consts::{FRAC_1_PI, LOG2_E};

use glam::Vec3A;

use crate::{
    color::luminance,
    columns::Arena,
    latlong,
    simd::{self, LANES, Lanes},
    tile::Rows,
};

/// Columns and rows of the map that is seen through lobes, and of what is seen.
const SOURCE: (usize, usize) = (64, 32);
const SEEN: (usize, usize) = (32, 16);
/// Widths of Trowbridge-Reitz lobes: 1, 1/2, 1/4, ...
const WIDTHS: usize = 5;

/// A map through a cosine lobe and through [`WIDTHS`] Trowbridge-Reitz lobes.
#[derive(Clone, Debug)]
pub struct Prefiltered {
    /// Means of luminance under each lobe, `[1 + WIDTHS, SEEN.1, SEEN.0]`: first the cosine's, about the normal.
    means: Vec<f32>,
}

impl Prefiltered {
    /// The luminance of a map of `height` rows of `width` texels, from pole to pole.
    pub fn new(width: usize, height: usize, texels: &[f32]) -> Self {
        let source = source(width, height, texels);
        let mut means = Vec::with_capacity((1 + WIDTHS) * SEEN.0 * SEEN.1);
        for lobe in 0..=WIDTHS {
            for cell in 0..SEEN.0 * SEEN.1 {
                let axis = centre(cell, SEEN);
                let (mut sum, mut weights) = (0.0_f64, 0.0_f64);
                for &(w, solid_angle, mean) in &source {
                    let weight = f64::from(solid_angle * weight(lobe, axis.dot(w)));
                    sum += weight * f64::from(mean);
                    weights += weight;
                }
                means.push((sum / weights) as f32);
            }
        }
        Self { means }
    }

    /// Columns and rows of what a lobe sees.
    pub const SEEN: (usize, usize) = SEEN;

    /// Means under the cosine lobe about the directions of cells, `[rows, columns]`.
    pub fn under_cosine(&self) -> &[f32] {
        &self.means[..SEEN.0 * SEEN.1]
    }

    /// The mean under a lobe about the direction of a place of the unit square, bilinear between the middles of cells.
    #[inline(always)]
    fn mean(&self, lobe: usize, u: f32, v: f32) -> f32 {
        let (x, y) =
            (u * SEEN.0 as f32 + (SEEN.0 as f32 - 0.5), (v * SEEN.1 as f32 - 0.5).clamp(0.0, SEEN.1 as f32 - 1.0));
        let (left, top) = (x as usize, (y as usize).min(SEEN.1 - 2));
        let (s, t) = (x - left as f32, y - top as f32);
        let texel = |column: usize, row: usize| self.means[(lobe * SEEN.1 + row) * SEEN.0 + column % SEEN.0];
        let along = |row: usize| texel(left, row) + s * (texel(left + 1, row) - texel(left, row));
        along(top) + t * (along(top + 1) - along(top))
    }

    /// The luminance that shading points reflect of it.
    pub fn reflected(&self, at: &Rows<'_>, out: &mut [Lanes], arena: &Arena) {
        let mut columns = arena.columns::<13>(at.strips());
        let [diffuse, specular, f0, alpha, x, y, z, red, green, blue, scale, u, v] = columns.get_mut();
        at.lobes([&mut *diffuse, &mut *specular, &mut *f0, &mut *alpha], arena);
        mirrored(at, [x, y, z]);
        at.brdf_cosine([x, y, z], [red, green, blue], arena);
        for strip in 0..at.strips() {
            let (n, wo) = (at.normals(strip), at.views(strip));
            for lane in 0..LANES {
                let cos_o = n[0][lane] * wo[0][lane] + n[1][lane] * wo[1][lane] + n[2][lane] * wo[2][lane];
                let cos_o = cos_o.clamp(1e-6, 1.0);
                // Schlick's approximation.
                specular[strip][lane] *= f0[strip][lane] + (1.0 - f0[strip][lane]) * (1.0 - cos_o).powi(5);
                // Lobes have no scale; the mirrored direction gives it.
                let lobes = diffuse[strip][lane] * cos_o * FRAC_1_PI
                    + specular[strip][lane] * towards_mirror(cos_o, alpha[strip][lane]);
                let value = luminance(Vec3A::new(red[strip][lane], green[strip][lane], blue[strip][lane]));
                let ratio = value / lobes;
                scale[strip][lane] = if (ratio > 0.0) & (ratio < f32::INFINITY) { ratio } else { 1.0 };
            }
        }
        latlong::squares([x, y, z], [u, v]);
        for (strip, out) in out.iter_mut().enumerate() {
            for lane in 0..LANES {
                let octaves = -simd::ln(alpha[strip][lane].max(1e-6)) * LOG2_E;
                let lobe = 1 + ((octaves + 0.5) as usize).min(WIDTHS - 1);
                out[lane] = specular[strip][lane] * self.mean(lobe, u[strip][lane], v[strip][lane]);
            }
            let normals = at.normals(strip);
            (x[strip], y[strip], z[strip]) = (normals[0], normals[1], normals[2]);
        }
        latlong::squares([x, y, z], [u, v]);
        for (strip, out) in out.iter_mut().enumerate() {
            for lane in 0..LANES {
                let diffuse = diffuse[strip][lane] * self.mean(0, u[strip][lane], v[strip][lane]);
                let light = scale[strip][lane] * (diffuse + out[lane]);
                out[lane] = if light.is_finite() { light } else { 0.0 };
            }
        }
    }
}

/// The directions to the viewer, mirrored about the shading normals.
fn mirrored(at: &Rows<'_>, [x, y, z]: [&mut [Lanes]; 3]) {
    for strip in 0..at.strips() {
        let (n, wo) = (at.normals(strip), at.views(strip));
        for lane in 0..LANES {
            let twice = 2.0 * (n[0][lane] * wo[0][lane] + n[1][lane] * wo[1][lane] + n[2][lane] * wo[2][lane]);
            x[strip][lane] = twice * n[0][lane] - wo[0][lane];
            y[strip][lane] = twice * n[1][lane] - wo[1][lane];
            z[strip][lane] = twice * n[2][lane] - wo[2][lane];
        }
    }
}

/// A Trowbridge-Reitz lobe times the cosine towards the mirrored direction, without Fresnel reflection: `D G2 / (4 cos_o)` with Smith's
/// height-correlated masking.
#[inline(always)]
fn towards_mirror(cos_o: f32, alpha: f32) -> f32 {
    let squared = (alpha * alpha).max(1e-12);
    let tangent_squared = 1.0 / (cos_o * cos_o) - 1.0;
    FRAC_1_PI / (4.0 * cos_o * squared * (1.0 + squared * tangent_squared).sqrt())
}

/// The direction of the middle of a cell.
fn centre(cell: usize, (columns, rows): (usize, usize)) -> Vec3A {
    let place = glam::Vec2::new((cell % columns) as f32 + 0.5, (cell / columns) as f32 + 0.5);
    latlong::direction(place / glam::Vec2::new(columns as f32, rows as f32))
}

/// What a lobe weighs directions with, at a cosine to its axis: the clamped cosine, or a Trowbridge-Reitz distribution of half vectors.
fn weight(lobe: usize, cos: f32) -> f32 {
    let Some(octave) = lobe.checked_sub(1) else { return cos.max(0.0) };
    let squared = 0.25_f32.powi(octave as i32);
    // The half vector is at half of the angle.
    let cos_half_squared = 0.5 * (1.0 + cos);
    cos.max(0.0) * squared / (cos_half_squared * (squared - 1.0) + 1.0).powi(2)
}

/// Directions, solid angles and means of luminance of the cells of the map that is seen.
fn source(width: usize, height: usize, texels: &[f32]) -> Vec<(Vec3A, f32, f32)> {
    let mut sums = vec![(0.0_f64, 0.0_f64); SOURCE.0 * SOURCE.1];
    for (k, &value) in texels.iter().enumerate() {
        let v = (k / width) as f32 / (height - 1) as f32;
        let row = ((v * SOURCE.1 as f32) as usize).min(SOURCE.1 - 1);
        let weight = f64::from(latlong::sin_theta(v));
        let cell = &mut sums[row * SOURCE.0 + (k % width) * SOURCE.0 / width];
        *cell = (cell.0 + weight * f64::from(value), cell.1 + weight);
    }
    let mean: f64 = sums.iter().map(|sum| sum.0).sum::<f64>() / sums.iter().map(|sum| sum.1).sum::<f64>();
    let of_cell = |(cell, &(sum, weight)): (usize, &(f64, f64))| {
        let v = ((cell / SOURCE.0) as f32 + 0.5) / SOURCE.1 as f32;
        // Maps smaller than the grid leave cells without a texel.
        (centre(cell, SOURCE), latlong::sin_theta(v), if weight > 0.0 { sum / weight } else { mean } as f32)
    };
    sums.iter().enumerate().map(of_cell).collect()
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::{
        brdf::{Ggx, Lambert, Surface},
        random::{Purpose, Stream},
        tile::{ShadingPoint, Tile},
    };

    fn reflected(map: &Prefiltered, points: &[ShadingPoint]) -> Vec<f32> {
        let (tile, arena) = (Tile::of(points), Arena::default());
        let mut out = vec![[0.0; LANES]; tile.rows().strips()];
        map.reflected(&tile.rows(), &mut out, &arena);
        out.as_flattened()[..points.len()].to_vec()
    }

    fn at(n: Vec3A, wo: Vec3A, surface: Surface) -> ShadingPoint {
        ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface }
    }

    #[test]
    fn what_is_reflected_of_smooth_light_is_near_the_integral() {
        const SIDE: usize = 64;
        // Brighter towards one side, and everywhere lit.
        let radiance = |w: Vec3A| (1.0 + w.x + 0.5 * w.y).powi(2) + 0.2;
        let direction = |k: usize| {
            let (u, v) = ((k % (2 * SIDE)) as f32 / (2 * SIDE) as f32, (k / (2 * SIDE)) as f32 / (SIDE - 1) as f32);
            latlong::direction(glam::Vec2::new(u, v))
        };
        let texels: Vec<f32> = (0..2 * SIDE * SIDE).map(|k| radiance(direction(k))).collect();
        let map = Prefiltered::new(2 * SIDE, SIDE, &texels);
        let surfaces: [Surface; 3] = [
            Lambert { albedo: Vec3::splat(0.5) }.into(),
            Ggx::new(0.4, Vec3::splat(0.5)).into(),
            Ggx::new(0.2, Vec3::ONE).into(),
        ];
        let cells = |k: usize| (centre(k, (128, 64)), latlong::sin_theta((k / 128) as f32 / 64.0 + 0.5 / 64.0));
        let directions: Vec<(Vec3A, f32)> = (0..128 * 64).map(cells).collect();
        let mut random = Stream::new(0, Purpose::Test, 0);
        for surface in surfaces {
            let points: Vec<ShadingPoint> = (0..50)
                .map(|_| random.direction())
                .map(|n| at(n, (n + 0.3 * n.any_orthonormal_vector()).normalize(), surface))
                .collect();
            for (point, estimate) in points.iter().zip(reflected(&map, &points)) {
                let tile = Tile::of(&vec![*point; directions.len()]);
                let (rows, arena) = (tile.rows(), Arena::default());
                let mut columns = arena.columns::<6>(rows.strips());
                let [x, y, z, red, green, blue] = columns.get_mut();
                for (place, (w, _)) in directions.iter().enumerate() {
                    (x.as_flattened_mut()[place], y.as_flattened_mut()[place], z.as_flattened_mut()[place]) =
                        (*w).into();
                }
                rows.brdf_cosine([x, y, z], [red, green, blue], &arena);
                let light = directions.iter().zip(green.as_flattened()).map(|(&(w, sin), f)| radiance(w) * sin * f);
                let truth = light.sum::<f32>() * 2.0 * std::f32::consts::PI.powi(2) / directions.len() as f32;
                // A cell is 11 degrees wide, in which this light changes by up to a fifth; the width of a lobe is off by up to the
                // root of 2, which in the darkest place lets in as much light again from around.
                assert!((0.6..1.7).contains(&(estimate / truth)), "{surface:?}: {estimate} instead of {truth}");
            }
        }
    }

    #[test]
    fn small_maps_and_odd_surfaces_give_numbers() {
        let map = Prefiltered::new(2, 2, &[1.0, 2.0, 3.0, 4.0]);
        let below = at(Vec3A::Y, -Vec3A::Y, Ggx::new(0.0, Vec3::ZERO).into());
        let grazing = at(Vec3A::Y, Vec3A::X, Ggx::new(1.0, Vec3::ONE).into());
        assert!(reflected(&map, &[below, grazing]).into_iter().all(|light| (0.0..=4.0).contains(&light)));
    }
}
