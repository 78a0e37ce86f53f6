//! The dispatches of a step.

use headtail_shaders::gpu::GpuError;

use super::{
    conditions::Conditions,
    dispatch::{Dispatch, Matrix},
    memory::{Memory, Shape},
    piece::Piece,
};
use crate::{Objective, fused::Layout};

/// A step's dispatches, and where in the arena its results are.
pub struct Plan {
    /// Dispatches that are submitted together.
    pub pieces: Vec<Vec<Dispatch>>,
    /// Numbers in the arena, and in the slices of the gradient.
    pub arena: usize,
    pub partials: usize,
    /// Place of the gradient, followed by each condition's loss and whether it is lit.
    pub results: usize,
    pub conditions: usize,
}

impl Plan {
    /// Returns the plan of a step of a head, and the matrix of its conditions, with one column each. `points` pass
    /// through the networks together, fewer where a buffer of `largest` bytes cannot hold them.
    pub fn of_head(
        layout: &Layout,
        shape: Shape,
        objective: Objective,
        points: usize,
        largest: u64,
    ) -> Result<(Self, Matrix), GpuError> {
        let memory = Memory::new(layout, shape, objective, points, (largest / 4) as usize)?;
        let of_conditions = Conditions { memory: &memory };
        let mut pieces = vec![of_conditions.before()];
        for first in (0..shape.conditions).step_by(memory.together) {
            let count = memory.together.min(shape.conditions - first);
            pieces.push(Piece { memory: &memory, first, count }.dispatches());
        }
        pieces.push(of_conditions.after());
        let partials = memory.slices.most * layout.length;
        let (arena, results, conditions) = (memory.length, memory.results, shape.conditions);
        Ok((Self { pieces, arena, partials, results, conditions }, memory.seen))
    }

    /// Returns all dispatches, in order.
    pub fn dispatches(&self) -> impl Iterator<Item = &Dispatch> {
        self.pieces.iter().flatten()
    }
}
