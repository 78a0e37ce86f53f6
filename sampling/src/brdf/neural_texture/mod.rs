//! Neural materials over a surface: a pyramid of feature textures, and networks from features and
//! directions to reflectance.
//!
//! A simplified NeuMIP (Kuznetsov et al. 2021). At a hit, [`NeuralTexture::features`] looks up eight
//! features, shifts the position by the output of a small network of these and the view (the parallax
//! of structure above or below the reference plane), and looks the features up again there. They are
//! the parameters of the [`Brdf`](super::Brdf): a network of features, `wo` and `wi` gives `ln f_r`. A
//! third network gives the lobes for sampling ([`Mixture`]), with their exact density.
//!
//! Directions are in the surface's tangent frame: x along u, y along v, z along the normal.
//!
//! | file | concept |
//! | --- | --- |
//! | `pyramid.rs` | textures of features, looked up trilinearly |
//! | `network.rs` | small networks in SIMD lanes |
//! | `mixture.rs` | the lobes for sampling |
//! | `columns.rs` | evaluation over columns |
//! | `file.rs` | the file format |

mod columns;
mod file;
mod mixture;
pub(crate) mod network;
mod pyramid;

pub use file::{Description, FORMAT_VERSION};
pub use mixture::{COSINE_FLOOR, FARTHEST, LOBE_FLOOR, Mixture, WIDTHS};
pub use pyramid::Pyramid;

use std::fmt;

use glam::{Vec2, Vec3};

use crate::{
    error::Result,
    frame::Frame,
    linear::{Linear, append_network},
    simd,
};
use network::Network;

/// Numbers per texel.
pub const FEATURES: usize = 8;

/// Standard deviation of a texel's Gaussian footprint, in texels of its level.
pub const TEXEL_WIDTH: f32 = 0.4;

/// The largest shift of a lookup at 45 degrees, in tiles.
pub const FARTHEST_SHIFT: f32 = 0.25;
/// The least cosine by which a shift is divided.
pub const LEAST_SHIFT_COSINE: f32 = 0.15;

/// The largest `ln f_r`, which bounds sample weights where a network extrapolates.
pub const LARGEST_LOG: f32 = 6.0;

/// Sizes of the networks, from input to output.
pub const SHIFT_SIZES: [usize; 4] = [FEATURES + 2, 16, 16, 1];
/// See [`SHIFT_SIZES`].
pub const REFLECTANCE_SIZES: [usize; 5] = [FEATURES + 4, 32, 32, 32, 3];
/// See [`SHIFT_SIZES`].
pub const MIXTURE_SIZES: [usize; 4] = [FEATURES + 2, 16, 16, mixture::OUTPUTS];

/// The position, footprint and view of a surface point on a neural material.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Texture coordinates in tiles.
    pub uv: Vec2,
    /// Standard deviation of the footprint, in tiles.
    pub width: f32,
    /// Direction to the viewer in the tangent frame.
    pub wo: Vec3,
    /// Cosine and sine of the angle from the first axis of [`Frame`](crate::frame::Frame) to the
    /// tangent, and the handedness: 1, or -1 where the texture is mirrored.
    pub tangent: [f32; 3],
}

impl Default for Seen {
    /// The origin of the texture from above, in its finest detail.
    fn default() -> Self {
        Self { uv: Vec2::ZERO, width: 0.0, wo: Vec3::Z, tangent: [1.0, 0.0, 1.0] }
    }
}

impl Seen {
    /// The origin of the texture from the unit direction `wo`, where the unit normal is `n`, and u and v grow
    /// `along` two directions; all in world space. Directions that do not span the surface give an arbitrary
    /// tangent.
    pub fn new(n: Vec3, wo: Vec3, [along_u, along_v]: [Vec3; 2]) -> Self {
        let frame = Frame::from_normal(n);
        let tangent = along_u.reject_from_normalized(n).try_normalize().unwrap_or(frame.s);
        let across = n.cross(tangent);
        let hand = 1.0_f32.copysign(across.dot(along_v));
        Self {
            wo: Vec3::new(wo.dot(tangent), hand * wo.dot(across), n.dot(wo)),
            tangent: [tangent.dot(frame.s), tangent.dot(frame.t), hand],
            ..Self::default()
        }
    }
}

/// Layers of the three networks, first to last, with a leaky ReLU of one slope after all but the last.
#[derive(Clone, Debug)]
pub struct Networks {
    /// From features and `wo.xy` to the shift, see [`SHIFT_SIZES`].
    pub shift: Vec<Linear>,
    /// From features, `wo.xy` and `wi.xy` to `ln f_r` per channel, see [`REFLECTANCE_SIZES`].
    pub reflectance: Vec<Linear>,
    /// From features and `wo.xy` to a [`Mixture`], see [`MIXTURE_SIZES`].
    pub mixture: Vec<Linear>,
    /// Slope of the leaky ReLU, in `[0, 1]`.
    pub leaky_slope: f32,
}

/// A neural material.
#[derive(Clone)]
pub struct NeuralTexture {
    pyramid: Pyramid,
    shift: Network,
    reflectance: Network,
    mixture: Network,
    description: Description,
    hash: blake3::Hash,
}

impl fmt::Debug for NeuralTexture {
    /// Name and hash: equal hashes mean equal materials.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "NeuralTexture({} {})", self.description.name, self.hash.to_hex())
    }
}

impl NeuralTexture {
    /// Makes a material of a pyramid and its networks.
    ///
    /// # Errors
    /// A network has wrong sizes, or the slope is not in `[0, 1]`.
    pub fn new(pyramid: Pyramid, networks: Networks, description: Description) -> Result<Self> {
        let Networks { shift, reflectance, mixture, leaky_slope } = networks;
        let mut material = Self {
            pyramid,
            shift: Network::new("shift", &SHIFT_SIZES, shift, leaky_slope)?,
            reflectance: Network::new("reflectance", &REFLECTANCE_SIZES, reflectance, leaky_slope)?,
            mixture: Network::new("mixture", &MIXTURE_SIZES, mixture, leaky_slope)?,
            description,
            hash: blake3::Hash::from_bytes([0; 32]),
        };
        material.hash = material.content_hash();
        Ok(material)
    }

    /// The metadata of the file.
    pub fn description(&self) -> &Description {
        &self.description
    }

    /// Sets [`Description::psnr`], in dB.
    pub fn set_psnr(&mut self, psnr: f64) {
        self.description.psnr = psnr.is_finite().then_some(psnr);
    }

    /// Sets [`Description::seconds`].
    pub fn set_seconds(&mut self, seconds: f64) {
        self.description.seconds = seconds.is_finite().then_some(seconds);
    }

    /// BLAKE3 hash of everything that reflectance depends on.
    pub fn hash(&self) -> blake3::Hash {
        self.hash
    }

    /// The textures.
    pub fn pyramid(&self) -> &Pyramid {
        &self.pyramid
    }

    /// Standard deviation of a texel's footprint at the finest level, in tiles.
    pub fn finest_width(&self) -> f32 {
        TEXEL_WIDTH / self.pyramid.side() as f32
    }

    /// Looks up the features at a point, with the shift.
    pub fn features(&self, seen: &Seen) -> [f32; FEATURES] {
        let level = (seen.width / self.finest_width()).max(1.0).log2();
        let first = self.pyramid.sample(seen.uv, level);
        let mut input = [0.0; FEATURES + 2];
        input[..FEATURES].copy_from_slice(&first);
        (input[FEATURES], input[FEATURES + 1]) = (seen.wo.x, seen.wo.y);
        let mut raw = [0.0];
        self.shift.of_one(&input, &mut raw);
        let shift = FARTHEST_SHIFT * (2.0 * simd::sigmoid(raw[0]) - 1.0);
        let shift = shift / seen.wo.z.max(LEAST_SHIFT_COSINE);
        self.pyramid.sample(seen.uv + shift * Vec2::new(seen.wo.x, seen.wo.y), level)
    }

    /// Returns the numbers of [`super::FlatBrdf::Neural`].
    fn flat_numbers(&self) -> Vec<f32> {
        let mut numbers = vec![0.0; 4];
        for (place, network) in [&self.shift, &self.mixture, &self.reflectance].into_iter().enumerate() {
            append_network(network.layers(), network.leaky_slope(), &mut numbers);
            numbers[place + 1] = numbers.len() as f32;
        }
        numbers[0] = self.pyramid.side() as f32;
        numbers.extend(self.pyramid.texels().as_flattened());
        numbers
    }

    /// The parameters of the [`Brdf`](super::Brdf) at a point: features, then the tangent.
    pub fn parameters(&self, seen: &Seen) -> [f32; super::parameters::MAX_PARAMETERS] {
        let mut parameters = [0.0; super::parameters::MAX_PARAMETERS];
        parameters[..FEATURES].copy_from_slice(&self.features(seen));
        parameters[FEATURES..FEATURES + 3].copy_from_slice(&seen.tangent);
        parameters
    }
}

#[cfg(test)]
pub(crate) mod tests;
