//! Textures of 8-bit texels: sRGB colours, interpolated bilinearly in linear light, linear numbers, and alpha.

use std::sync::LazyLock;

use glam::{Vec2, Vec3A};

use crate::{
    color::srgb_decode,
    error::{Error, Result},
};

/// Linear values of the 256 sRGB codes.
static DECODED: LazyLock<[f32; 256]> = LazyLock::new(|| std::array::from_fn(|code| srgb_decode(code as f32 / 255.0)));

/// Treatment of texture coordinates outside `[0, 1]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// The texture repeats.
    #[default]
    Repeat,
    /// The texture repeats, every second copy mirrored.
    Mirror,
    /// The texel at the edge continues.
    Clamp,
}

impl Wrap {
    /// Maps texel `i` of an infinite row to one of `n > 0` texels.
    fn texel(self, i: i64, n: usize) -> usize {
        let n = n as i64;
        let wrapped = match self {
            Self::Repeat => i.rem_euclid(n),
            Self::Clamp => i.clamp(0, n - 1),
            Self::Mirror => {
                let i = i.rem_euclid(2 * n);
                i.min(2 * n - 1 - i)
            }
        };
        wrapped as usize
    }
}

/// How a value is found between the centres of texels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Filter {
    /// By bilinear interpolation between four texels.
    #[default]
    Bilinear,
    /// It is that of the texel that contains the point.
    Nearest,
}

/// The size of a texture, in texels, its wrap modes for u and v, and its filter.
#[derive(Clone, Debug, PartialEq)]
struct Grid {
    width: usize,
    height: usize,
    wrap: [Wrap; 2],
    filter: Filter,
}

impl Grid {
    /// The grid of `count` texels.
    fn new(width: usize, height: usize, count: usize, wrap: [Wrap; 2]) -> Result<Self> {
        if count == 0 || width.checked_mul(height) != Some(count) {
            return Err(Error::argument("texture", format!("{count} texels cannot be {width} x {height}")));
        }
        Ok(Self { width, height, wrap, filter: Filter::default() })
    }

    /// Interpolates bilinearly between the four texels next to `uv`, or looks up the nearest; `texel` takes
    /// their indices.
    fn interpolate<T>(&self, uv: Vec2, texel: impl Fn(usize) -> T, lerp: impl Fn(T, T, f32) -> T) -> T {
        let at = |x: i64, y: i64| {
            let (x, y) = (self.wrap[0].texel(x, self.width), self.wrap[1].texel(y, self.height));
            texel(y * self.width + x)
        };
        let (x, y) = (uv.x * self.width as f32, uv.y * self.height as f32);
        if self.filter == Filter::Nearest {
            return at(x.floor() as i64, y.floor() as i64);
        }
        let (x, y) = (x - 0.5, y - 0.5);
        let (left, top) = (x.floor(), y.floor());
        let (s, t) = (x - left, y - top);
        // The conversion saturates, and the bounds keep the additions below from overflowing.
        let [left, top] = [left, top].map(|i| (i as i64).clamp(-(1 << 60), 1 << 60));
        let row = |y: i64| lerp(at(left, y), at(left + 1, y), s);
        lerp(row(top), row(top + 1), t)
    }

    /// Size, wrap modes and a filter that is not bilinear, as text.
    fn content(&self) -> String {
        let filter = if self.filter == Filter::Nearest { " nearest" } else { "" };
        format!("{} x {} {:?}{filter}", self.width, self.height, self.wrap)
    }
}

/// A texture of three channels.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    grid: Grid,
    texels: Vec<[u8; 3]>,
}

impl Texture {
    /// Creates a texture of `[height * width]` texels, row-major from the top left; `wrap` is for u and v.
    ///
    /// # Errors
    /// When it has no texels or their number is not `width * height`.
    pub fn new(width: usize, height: usize, texels: Vec<[u8; 3]>, wrap: [Wrap; 2]) -> Result<Self> {
        Ok(Self { grid: Grid::new(width, height, texels.len(), wrap)?, texels })
    }

    /// Returns the texture with a filter.
    #[must_use]
    pub fn with_filter(mut self, filter: Filter) -> Self {
        self.grid.filter = filter;
        self
    }

    /// Returns the linear colour of sRGB texels at texture coordinates `uv` (v downwards, texel centres at
    /// half-integers), by the texture's filter.
    pub fn sample(&self, uv: Vec2) -> Vec3A {
        self.interpolate(uv, |code| DECODED[usize::from(code)])
    }

    /// [`Self::sample`] for texels that are numbers, not colours: 0 to 255 represent 0 to 1.
    pub fn sample_linear(&self, uv: Vec2) -> Vec3A {
        self.interpolate(uv, |code| f32::from(code) / 255.0)
    }

    /// Returns size, wrap modes and filter as text, and the texels.
    pub(super) fn content(&self) -> (String, &[u8]) {
        (self.grid.content(), self.texels.as_flattened())
    }

    /// Returns width and height in texels.
    pub fn size(&self) -> [usize; 2] {
        [self.grid.width, self.grid.height]
    }

    /// Returns the wrap modes for u and v, and the filter.
    pub fn sampling(&self) -> ([Wrap; 2], Filter) {
        (self.grid.wrap, self.grid.filter)
    }

    /// Returns the texels `[height * width]`, row-major from the top left.
    pub fn texels(&self) -> &[[u8; 3]] {
        &self.texels
    }

    fn interpolate(&self, uv: Vec2, decode: impl Fn(u8) -> f32) -> Vec3A {
        self.grid.interpolate(uv, |i| Vec3A::from_array(self.texels[i].map(&decode)), Vec3A::lerp)
    }
}

/// The alpha channel of a texture.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct AlphaTexture {
    grid: Grid,
    texels: Vec<u8>,
    /// BLAKE3 of the content, computed once because many meshes share a texture.
    digest: blake3::Hash,
}

impl AlphaTexture {
    /// Creates a texture of `[height * width]` alphas, 0 to 255 for 0 to 1, row-major from the top left;
    /// `wrap` is for u and v.
    ///
    /// # Errors
    /// As [`Texture::new`].
    pub fn new(width: usize, height: usize, texels: Vec<u8>, wrap: [Wrap; 2], filter: Filter) -> Result<Self> {
        let grid = Grid { filter, ..Grid::new(width, height, texels.len(), wrap)? };
        let digest = blake3::Hasher::new().update(grid.content().as_bytes()).update(&texels).finalize();
        Ok(Self { grid, texels, digest })
    }

    /// Returns the alpha at texture coordinates `uv`, as [`Texture::sample_linear`] does.
    pub fn sample(&self, uv: Vec2) -> f32 {
        // Exact between equal texels, so that an alpha of 1 passes a cutoff of 1.
        self.grid.interpolate(uv, |i| f32::from(self.texels[i]) / 255.0, |a, b, s| a + s * (b - a))
    }

    /// Returns a texture with the alpha in all channels.
    pub fn to_texture(&self) -> Texture {
        Texture { grid: self.grid.clone(), texels: self.texels.iter().map(|&alpha| [alpha; 3]).collect() }
    }

    /// Returns the least and the greatest alpha.
    pub fn range(&self) -> [f32; 2] {
        let codes = self.texels.iter().fold([u8::MAX, 0], |[least, most], &code| [least.min(code), most.max(code)]);
        codes.map(|code| f32::from(code) / 255.0)
    }

    /// Returns the hash of size, wrap modes, filter and texels.
    pub fn digest(&self) -> &[u8] {
        self.digest.as_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn black_and_white(wrap: Wrap) -> Texture {
        Texture::new(2, 1, vec![[0; 3], [255; 3]], [wrap; 2]).unwrap()
    }

    #[test]
    fn interpolation_is_in_linear_light() {
        let texture = black_and_white(Wrap::Clamp);
        assert_eq!(texture.sample(Vec2::new(0.25, 0.5)), Vec3A::ZERO);
        assert_eq!(texture.sample(Vec2::new(0.75, 0.5)), Vec3A::ONE);
        assert_eq!(texture.sample(Vec2::new(0.5, 0.5)), Vec3A::splat(0.5));
    }

    #[test]
    fn numbers_are_not_decoded_as_colors() {
        let texture = Texture::new(1, 1, vec![[0, 51, 255]], [Wrap::Clamp; 2]).unwrap();
        assert_eq!(texture.sample_linear(Vec2::splat(0.5)), Vec3A::new(0.0, 0.2, 1.0));
        assert!(texture.sample(Vec2::splat(0.5)).y < 0.04);
    }

    #[test]
    fn alpha_is_interpolated_and_not_decoded() {
        let texture = AlphaTexture::new(2, 1, vec![51, 255], [Wrap::Clamp; 2], Filter::Bilinear).unwrap();
        assert_eq!([0.1, 0.9].map(|u| texture.sample(Vec2::new(u, 0.5))), [0.2, 1.0]);
        assert!((texture.sample(Vec2::splat(0.5)) - 0.6).abs() < 1e-6);
        assert_eq!(texture.range(), [0.2, 1.0]);
        assert!(AlphaTexture::new(2, 2, vec![0; 3], [Wrap::Clamp; 2], Filter::Bilinear).is_err());
    }

    #[test]
    fn wrap_modes_differ_beyond_the_edge() {
        let at = |wrap, u| black_and_white(wrap).sample(Vec2::new(u, 0.5)).x;
        assert_eq!([at(Wrap::Repeat, 1.25), at(Wrap::Mirror, 1.25), at(Wrap::Clamp, 1.25)], [0.0, 1.0, 1.0]);
        assert_eq!([at(Wrap::Repeat, -0.25), at(Wrap::Mirror, -0.25), at(Wrap::Clamp, -0.25)], [1.0, 0.0, 0.0]);
        assert_eq!([at(Wrap::Repeat, 0.0), at(Wrap::Mirror, 0.0), at(Wrap::Clamp, 0.0)], [0.5, 0.0, 0.0]);
    }

    #[test]
    fn nearest_texel_contains_the_point_under_every_wrap_mode() {
        // Texels 0 to 3 along u, as numbers k / 255.
        let texels = |wrap| Texture::new(4, 1, (0..4).map(|k| [k; 3]).collect(), [wrap; 2]).unwrap();
        let at = |wrap, u| {
            let number = texels(wrap).with_filter(Filter::Nearest).sample_linear(Vec2::new(u, 0.7)).x;
            (number * 255.0).round()
        };
        let row = |wrap| [-0.3, -0.1, 0.0, 0.249, 0.25, 0.999, 1.0, 1.3].map(|u| at(wrap, u));
        assert_eq!(row(Wrap::Repeat), [2.0, 3.0, 0.0, 0.0, 1.0, 3.0, 0.0, 1.0]);
        assert_eq!(row(Wrap::Mirror), [1.0, 0.0, 0.0, 0.0, 1.0, 3.0, 3.0, 2.0]);
        assert_eq!(row(Wrap::Clamp), [0.0, 0.0, 0.0, 0.0, 1.0, 3.0, 3.0, 3.0]);
        let alpha = |u| {
            let texture = AlphaTexture::new(2, 1, vec![51, 255], [Wrap::Clamp; 2], Filter::Nearest).unwrap();
            texture.sample(Vec2::new(u, 0.5))
        };
        assert_eq!([0.49, 0.51].map(alpha), [0.2, 1.0]);
    }

    #[test]
    fn huge_coordinates_do_not_panic() {
        for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
            for u in [1e30, -1e30, f32::MAX, f32::MIN] {
                let _ = black_and_white(wrap).sample(Vec2::splat(u));
                let _ = black_and_white(wrap).with_filter(Filter::Nearest).sample(Vec2::splat(u));
            }
        }
    }
}
