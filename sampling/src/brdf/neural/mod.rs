//! Measured materials as small networks (Sztrajman et al. 2021), with fitted BRDF sampling.
//!
//! | file | concept |
//! | --- | --- |
//! | `network.rs` | evaluation over columns |
//! | `file.rs`, `open.rs` | files of measured materials; opening some by name |
//! | `check.rs` | finite values, reciprocity and energy |

mod check;
mod file;
mod network;
mod open;

pub use check::{MaterialCheck, VIEWS};
pub use file::{names_file, read_networks, write_networks};
pub use network::{INPUTS, LAYERS, MAX_HIDDEN, Network, OUTPUTS};
pub use open::{open_measured, parse_measured};

use std::fmt;

use glam::Vec3;

use super::{Brdf, FlatBrdf, LobeMixture, Surfaces, parameters::LATENTS};
use crate::{error::Result, linear::append_network, simd::Lanes};

/// A measured BRDF: a network for evaluation, and a mixture of lobes fitted to it for sampling.
pub struct NeuralBrdf {
    name: String,
    network: Network,
    mixture: LobeMixture,
    hash: blake3::Hash,
    check: MaterialCheck,
}

impl NeuralBrdf {
    /// Makes the BRDF of a network, and fits its lobes.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] if the network gives values that no surface has.
    pub fn new(name: &str, network: Network) -> Result<Self> {
        check::refuse_absurd(name, &network)?;
        let mixture = LobeMixture::fit(|at, wi, out| network.evaluate_cosine(at, wi, out));
        let mut hasher = blake3::Hasher::new();
        for number in network.layers().iter().flat_map(|layer| layer.weight().iter().chain(layer.bias())) {
            hasher.update(&number.to_le_bytes());
        }
        let check = MaterialCheck::new(&network, &mixture);
        Ok(Self { name: name.to_owned(), network, mixture, hash: hasher.finalize(), check })
    }

    /// The name in the file.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The lobes that directions are drawn from.
    pub fn mixture(&self) -> &LobeMixture {
        &self.mixture
    }

    /// Luminance of `f_r max(0, n . wi)` for each direction.
    pub fn luminances(&self, n: Vec3, wo: Vec3, wi: &[Vec3]) -> Vec<f32> {
        let pairs: Vec<[Vec3; 2]> = wi.iter().map(|&wi| [wo, wi]).collect();
        self.network.reflected(n, &pairs).into_iter().map(super::luminance).collect()
    }

    /// The measured properties.
    pub fn check(&self) -> &MaterialCheck {
        &self.check
    }
}

impl fmt::Debug for NeuralBrdf {
    /// Equal for equal networks; scenes are compared by it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "NeuralBrdf({}, {})", self.name, self.hash.to_hex())
    }
}

impl Brdf for NeuralBrdf {
    fn parameters(&self) -> usize {
        0
    }

    fn evaluate_cosine(&self, at: &Surfaces<'_>, wi: [&[Lanes]; 3], out: [&mut [Lanes]; 3]) {
        self.network.evaluate_cosine(at, wi, out);
    }

    fn sample(&self, at: &Surfaces<'_>, u: [&[Lanes]; 2], wi: [&mut [Lanes]; 3], pdf: &mut [Lanes]) {
        self.mixture.sample(at, u, wi, pdf);
    }

    fn pdf(&self, at: &Surfaces<'_>, wi: [&[Lanes]; 3], out: &mut [Lanes]) {
        self.mixture.pdf(at, wi, out);
    }

    fn alpha(&self, _at: &Surfaces<'_>, out: &mut [Lanes]) {
        out.fill([self.mixture.alpha(); crate::simd::LANES]);
    }

    fn lobes(&self, at: &Surfaces<'_>, out: [&mut [Lanes]; 4]) {
        self.mixture.lobes(at, out);
    }

    fn latent(&self) -> [f32; LATENTS] {
        self.mixture.latent()
    }

    fn identity(&self) -> Option<blake3::Hash> {
        Some(self.hash)
    }

    fn flat(&self) -> Option<FlatBrdf> {
        let mut numbers = Vec::new();
        self.mixture.append_to(&mut numbers);
        numbers.extend(self.latent());
        append_network(self.network.layers(), 0.0, &mut numbers);
        Some(FlatBrdf::Measured(numbers))
    }

    fn note(&self) -> Option<String> {
        Some(format!("{}: {}", self.name, self.check))
    }
}
