//! The dispatches of a step of a head.

use headtail_shaders::gpu::GpuError;

use super::{
    conditions::Conditions,
    dispatch::Dispatch,
    memory::{Memory, Shape},
    piece::Piece,
};
use crate::{Objective, fused::Layout};

/// A step's dispatches, and where in the arena its inputs and results are.
pub struct Plan {
    /// Dispatches that are submitted together.
    pub pieces: Vec<Vec<Dispatch>>,
    /// Numbers in the arena, and in the slices of the gradient.
    pub arena: usize,
    pub partials: usize,
    /// Place of the conditions, a matrix with one column each.
    pub seen: usize,
    /// Place of the gradient, followed by each condition's loss and whether it is lit.
    pub results: usize,
    /// Distance from one row of conditions to the next.
    pub stride: usize,
}

impl Plan {
    /// `points` pass through the networks together, fewer where a buffer of `largest` bytes cannot hold them.
    pub fn new(
        layout: &Layout,
        shape: Shape,
        objective: Objective,
        points: usize,
        largest: u64,
    ) -> Result<Self, GpuError> {
        let memory = Memory::new(layout, shape, objective, points, (largest / 4) as usize)?;
        let of_conditions = Conditions { memory: &memory };
        let mut pieces = vec![of_conditions.before()];
        for first in (0..shape.conditions).step_by(memory.together) {
            let count = memory.together.min(shape.conditions - first);
            pieces.push(Piece { memory: &memory, first, count }.dispatches());
        }
        pieces.push(of_conditions.after());
        Ok(Self {
            pieces,
            arena: memory.length,
            partials: memory.slices.most * layout.length,
            seen: memory.seen.start,
            results: memory.results,
            stride: memory.seen.stride,
        })
    }

    /// Returns all dispatches, in order.
    pub fn dispatches(&self) -> impl Iterator<Item = &Dispatch> {
        self.pieces.iter().flatten()
    }

    /// Returns conditions of `length` numbers as the matrix at [`Self::seen`].
    pub fn condition_rows(&self, conditions: &[f32], length: usize) -> Vec<f32> {
        let mut rows = vec![0.0; length * self.stride];
        for (column, condition) in conditions.chunks_exact(length).enumerate() {
            for (row, &value) in condition.iter().enumerate() {
                rows[row * self.stride + column] = value;
            }
        }
        rows
    }
}
