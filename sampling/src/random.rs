//! Random streams keyed by (seed, purpose, index): the same key gives the same numbers on any number of
//! threads.

use chacha20::ChaCha8Rng;
use glam::Vec2;
use rand_core::{Rng, SeedableRng};

/// The purpose of a stream; streams of different purposes never overlap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Purpose {
    /// Camera rays and light samples of one pixel.
    Pixel = 1,
    /// Initial network weights.
    Weights = 2,
    /// A training batch.
    Batch = 3,
    /// The fixed validation set.
    Validation = 4,
    /// Tabulation of a density.
    Bake = 5,
    /// Tests and benchmarks.
    Test = 6,
    /// Training points of a flow tail.
    Tail = 7,
    /// Light paths through fabric.
    Texture = 8,
    /// Rays that portals are found with.
    Portals = 9,
}

/// The stream of (seed, purpose, index).
#[derive(Debug)]
pub struct Stream(ChaCha8Rng);

impl Stream {
    /// Opens the stream of a key.
    pub fn new(seed: u64, purpose: Purpose, index: u64) -> Self {
        let mut key = [0_u8; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        key[8..12].copy_from_slice(&(purpose as u32).to_le_bytes());
        let mut generator = ChaCha8Rng::from_seed(key);
        generator.set_stream(index);
        Self(generator)
    }

    /// Returns how many 32-bit words the numbers drawn so far took: one per uniform number.
    pub fn position(&self) -> u64 {
        self.0.get_word_pos() as u64
    }

    /// Moves to a [`position`](Self::position), forwards or backwards.
    pub fn seek(&mut self, position: u64) {
        self.0.set_word_pos(position.into());
    }

    /// Draws a uniform number in `[0, 1)` with 24 bits.
    pub fn uniform(&mut self) -> f32 {
        (self.0.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0)
    }

    /// Draws a uniform point of `[0, 1)^2`.
    pub fn uniform2(&mut self) -> Vec2 {
        Vec2::new(self.uniform(), self.uniform())
    }

    /// Draws a uniform unit direction.
    pub fn direction(&mut self) -> glam::Vec3A {
        let z = 1.0 - 2.0 * self.uniform();
        let r = (1.0 - z * z).max(0.0).sqrt();
        let (sin, cos) = (std::f32::consts::TAU * self.uniform()).sin_cos();
        glam::Vec3A::new(r * cos, r * sin, z).normalize()
    }
}
