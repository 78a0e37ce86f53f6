//! Environment maps: radiance from every direction at infinity.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | radiance by bilinear lookup, repairs, hash |
//! | `map_file.rs` | maps in files, and their names |
//! | `built_in.rs` | `overcast`, `window`, `studio`, `sunset` |
//! | `density.rs` | the light of a map as a density over X |
//! | `defensive.rs` | the least luminance that samplers assume under extreme lamps |
//! | `bilinear.rs` | sampling linear and bilinear functions |

mod bilinear;
mod built_in;
mod defensive;
mod density;
mod map_file;

pub use bilinear::{Corners, invert_linear, sample_linear};
pub use built_in::{BUILT_IN_NAMES, built_in};
pub(crate) use defensive::solid_angle_means;
pub use density::BilinearDensity;
pub use map_file::MapSpec;

use std::sync::Arc;

use glam::{Vec2, Vec3A, Vec4};

use crate::{
    color::luminance,
    columns::vectorized,
    error::{Error, Result},
    image::{Image, MapLayout, Repair, to_lat_long},
    large::Large,
    latlong, memory,
    remark::Remark,
    simd::{LANES, Lanes},
};

/// An equirectangular map of linear Rec.709 radiance in W/(sr m^2), bilinear between texels.
///
/// Azimuth is periodic with texel centres at `(i + 0.5) / width`; elevation is aligned to the end rows,
/// `j / (height - 1)`, as in Mitsuba 3. A map of one row is read as two equal rows.
///
/// A texel takes 16 bytes, and 36 during construction, of which 12 are the image's: the largest map in
/// a file ([`crate::image::MAX_PIXELS`]) takes 2 GiB, and temporarily 4.5 GiB. [`Self::luminance`]
/// allocates another 4 bytes per texel.
#[derive(Clone, Debug)]
pub struct Environment {
    name: String,
    width: usize,
    height: usize,
    /// Radiance, and the density of the map's light over X.
    texels: Arc<Large<[f32; 4]>>,
    density: BilinearDensity,
    /// The least luminance that samplers assume of texels that are not black.
    least_luminance: f32,
    remarks: Vec<Remark>,
    hash: String,
}

impl Environment {
    /// Makes an environment of an image. Invalid values are repaired: NaN and negative values become 0,
    /// and infinite values or those above 1e15 become the largest valid value of the map.
    /// [`Self::remarks`] lists the repairs.
    ///
    /// # Errors
    /// The image is empty, has 2^31 texels or more, or is black; or the map needs more memory than is
    /// available.
    pub fn from_image(name: &str, image: Image) -> Result<Self> {
        Self::from_image_in(name, image, MapLayout::LatLong)
    }

    /// [`Self::from_image`] of an image in another layout, which is converted to latitude and longitude.
    ///
    /// # Errors
    /// As [`Self::from_image`], or if the size of the image does not match the layout.
    pub fn from_image_in(name: &str, image: Image, layout: MapLayout) -> Result<Self> {
        let repair = Repair::of(image.pixels.iter().flatten().copied(), false);
        Self::repaired(name, image, layout, &repair)
    }

    /// [`Self::from_image_in`] of an image whose values were examined.
    fn repaired(name: &str, mut image: Image, layout: MapLayout, repair: &Repair) -> Result<Self> {
        // Repair before texels are blended with their neighbours.
        image.pixels.iter_mut().flatten().for_each(|value| *value = repair.radiance(*value));
        let remarks = repair.remarks();
        let image = to_lat_long(image, layout)?;
        let Image { width, height, ref pixels } = image;
        memory::require(pixels.len() as u64 * BYTES_PER_TEXEL, || format!("a map of {width} x {height} pixels"))?;
        Self::of_any_size(name, image, remarks)
    }

    /// [`Self::from_image`] without the memory check.
    fn of_any_size(name: &str, image: Image, remarks: Vec<Remark>) -> Result<Self> {
        let Image { width, mut height, mut pixels } = image;
        if pixels.is_empty() || width.checked_mul(height) != Some(pixels.len()) {
            let reason = format!("{} texels cannot be {width} x {height}, at least 1 x 1", pixels.len());
            return Err(Error::argument("environment map", reason));
        }
        // Texel indices have 32 bits; a single row is doubled.
        if width.checked_mul(height.max(2)).is_none_or(|texels| i32::try_from(texels).is_err()) {
            return Err(Error::argument("environment map", "has 2^31 texels or more"));
        }
        if pixels.iter().flatten().all(|&value| value == 0.0) {
            let repairs: Vec<&str> = remarks.iter().map(Remark::text).collect();
            let found = if repairs.is_empty() {
                "is black everywhere".to_owned()
            } else {
                format!("has no usable value ({})", repairs.join("; "))
            };
            return Err(Error::argument("environment map", format!("{found}: there is no light to sample")));
        }
        if height == 1 {
            pixels.extend_from_within(..);
            height = 2;
        }
        let hash = hash(width, height, &pixels);
        let mut luminance: Vec<f32> = pixels.iter().map(|&texel| luminance(Vec3A::from_array(texel))).collect();
        let least_luminance = defensive::least_luminance(width, height, &luminance);
        luminance.iter_mut().for_each(|value| *value = defensive::raised(*value, least_luminance));
        let density = BilinearDensity::new(width, height, &luminance)?;
        let texel = |([red, green, blue], node): (&[f32; 3], f32)| [*red, *green, *blue, node];
        let texels: Vec<[f32; 4]> = pixels.iter().zip(density.nodes()).map(texel).collect();
        let texels = Arc::new(Large::from(texels));
        let density = density.in_texels(&texels);
        Ok(Self { name: name.to_owned(), width, height, texels, density, least_luminance, remarks, hash })
    }

    /// The map's short name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Texels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows; at least 2.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Remarks on unusual files and images: conversions, the chosen layer, repaired values.
    pub fn remarks(&self) -> &[Remark] {
        &self.remarks
    }

    /// Hexadecimal BLAKE3 hash of the size and the texels, by which sampler files identify their map.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// The luminance to which samplers are proportional, `[height * width]`: that of every texel, raised to
    /// 1/64 of the map's mean in maps with extreme lamps (`environment/defensive.rs`), so that light beside a
    /// hidden lamp is sampled.
    pub fn luminance(&self) -> Vec<f32> {
        let of_texel = |&[red, green, blue, _]: &[f32; 4]| self.raised(luminance(Vec3A::new(red, green, blue)));
        self.texels.iter().map(of_texel).collect()
    }

    /// Whether [`Self::luminance`] differs from that of the texels.
    pub fn has_extreme_lamps(&self) -> bool {
        self.least_luminance > 0.0
    }

    /// Returns the luminance to which samplers are proportional where the map has this one.
    pub(crate) fn raised(&self, luminance: f32) -> f32 {
        defensive::raised(luminance, self.least_luminance)
    }

    /// The normalised density of [`Self::luminance`] over X.
    pub fn density(&self) -> &BilinearDensity {
        &self.density
    }

    /// The map as an image.
    pub fn to_image(&self) -> Image {
        Image {
            width: self.width,
            height: self.height,
            pixels: self.texels.iter().map(|&[red, green, blue, _]| [red, green, blue]).collect(),
        }
    }

    /// Looks up the radiance at a point of the square `[0, 1]^2`.
    pub fn radiance_at(&self, x: Vec2) -> Vec3A {
        let stencil = self.stencil(x.x, x.y);
        self.texels_of(&stencil).blend(&stencil)
    }

    /// The indices and weights of the texels around a point of the square.
    #[inline(always)]
    fn stencil(&self, u: f32, v: f32) -> Stencil {
        let column = u * self.width as f32 - 0.5;
        let left = column.floor();
        // Columns -1 and width wrap to width - 1 and 0.
        let i0 = if left < 0.0 { self.width as i32 - 1 } else { (left as i32).min(self.width as i32 - 1) };
        let i1 = if i0 + 1 == self.width as i32 { 0 } else { i0 + 1 };
        let row = v * (self.height - 1) as f32;
        let j = (row as i32).min(self.height as i32 - 2);
        let start = j * self.width as i32;
        Stencil { left: (start + i0) as u32, right: (start + i1) as u32, across: column - left, down: row - j as f32 }
    }

    #[inline(always)]
    fn texels_of(&self, stencil: &Stencil) -> Texels {
        let (left, right) = (stencil.left as usize, stencil.right as usize);
        let texel = |index: usize| Vec4::from_array(self.texels[index]);
        Texels([texel(left), texel(right), texel(left + self.width), texel(right + self.width)])
    }

    /// Looks up the radiance from a unit direction.
    pub fn radiance(&self, wi: Vec3A) -> Vec3A {
        self.radiance_at(latlong::square(wi))
    }

    /// [`Self::radiance`] over columns.
    pub fn radiances(&self, wi: [&[Lanes]; 3], out: [&mut [Lanes]; 3]) {
        radiances(self, wi, out);
    }
}

vectorized! {
    fn radiances['a](_simd, environment: &'a Environment, wi: [&'a [Lanes]; 3], out: [&'a mut [Lanes]; 3]) {
        let [red, green, blue] = out;
        for strip in 0..red.len() {
            let wi = [wi[0][strip], wi[1][strip], wi[2][strip]];
            let mut stencils = [Stencil::default(); LANES];
            for k in 0..LANES {
                let [u, v] = latlong::square_of(wi[0][k], wi[1][k], wi[2][k]);
                stencils[k] = environment.stencil(u, v);
            }
            // All loads come before the arithmetic, so that they overlap.
            let mut texels = [Texels::default(); LANES];
            for k in 0..LANES {
                texels[k] = environment.texels_of(&stencils[k]);
            }
            for k in 0..LANES {
                let radiance = texels[k].blend(&stencils[k]);
                (red[strip][k], green[strip][k], blue[strip][k]) = (radiance.x, radiance.y, radiance.z);
            }
        }
    }
}

/// The upper two of the four texels around a point, and the position between them.
#[derive(Clone, Copy, Debug, Default)]
struct Stencil {
    left: u32,
    right: u32,
    across: f32,
    down: f32,
}

/// Four texels around a point: upper left, upper right, lower left, lower right.
#[derive(Clone, Copy, Debug, Default)]
struct Texels([Vec4; 4]);

impl Texels {
    #[inline(always)]
    fn blend(&self, stencil: &Stencil) -> Vec3A {
        let [a, b, c, d] = self.0;
        let top = a + (b - a) * stencil.across;
        let bottom = c + (d - c) * stencil.across;
        Vec3A::from_vec4((top + (bottom - top) * stencil.down).max(Vec4::ZERO))
    }
}

/// Bytes per texel while a map is opened, besides its image: texels, running sums, and the tables of a
/// hierarchical tail.
const BYTES_PER_TEXEL: u64 = 72;

fn hash(width: usize, height: usize, texels: &[[f32; 3]]) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&(width as u64).to_le_bytes());
    hasher.update(&(height as u64).to_le_bytes());
    // In pieces: a call for each number takes several times as long as the hash.
    let mut bytes = Vec::with_capacity(12 * width);
    for row in texels.chunks(width) {
        bytes.clear();
        bytes.extend(row.as_flattened().iter().flat_map(|channel| channel.to_le_bytes()));
        hasher.update(&bytes);
    }
    hasher.finalize().to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(width: usize, height: usize, pixels: Vec<[f32; 3]>) -> Result<Environment> {
        Environment::from_image("test", Image { width, height, pixels })
    }

    #[test]
    fn invalid_values_are_repaired_and_reported() {
        let map =
            of(2, 2, vec![[f32::NAN, 1.0, -2.0], [f32::INFINITY, 3.0, 0.0], [0.0; 3], [1e30, 0.5, -0.0]]).unwrap();
        assert_eq!(map.texels[0][..3], [0.0, 1.0, 0.0]);
        assert_eq!(map.texels[1][..3], [3.0, 3.0, 0.0]);
        assert_eq!(map.texels[3][..3], [3.0, 0.5, -0.0]);
        assert_eq!(map.remarks().len(), 3);
    }

    #[test]
    fn black_and_empty_maps_are_refused() {
        assert!(of(2, 1, vec![[0.0; 3]; 2]).unwrap_err().to_string().contains("black"));
        assert!(of(1, 1, vec![[f32::NAN; 3]]).unwrap_err().to_string().contains("no usable value"));
        for (width, height) in [(0, 0), (3, 0), (1 << 63, 2), (2, 2)] {
            assert!(of(width, height, vec![]).unwrap_err().to_string().contains("0 texels cannot be"));
        }
    }

    #[test]
    fn a_single_texel_is_a_constant_map() {
        let map = of(1, 1, vec![[1.0, 2.0, 3.0]]).unwrap();
        for x in [Vec2::ZERO, Vec2::ONE, Vec2::new(0.3, 0.9), Vec2::new(1.0, 0.0)] {
            assert_eq!(map.radiance_at(x).to_array(), [1.0, 2.0, 3.0]);
        }
    }

    #[test]
    fn the_lookup_is_continuous_across_the_seam_and_hits_texel_centres() {
        let pixels: Vec<_> = (0..8).map(|k| [k as f32; 3]).collect();
        let map = of(4, 2, pixels).unwrap();
        for i in 0..4 {
            assert_eq!(map.radiance_at(Vec2::new((i as f32 + 0.5) / 4.0, 0.0)).x, i as f32);
            assert_eq!(map.radiance_at(Vec2::new((i as f32 + 0.5) / 4.0, 1.0)).x, (4 + i) as f32);
        }
        assert_eq!(map.radiance_at(Vec2::ZERO), map.radiance_at(Vec2::new(1.0, 0.0)));
        assert_eq!(map.radiance_at(Vec2::ZERO).x, 1.5);
    }
}
