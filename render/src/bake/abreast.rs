//! Sampling a table for many shading points abreast.
//!
//! Each stage is done for all points before the next one: its loads do not wait for each other, and its arithmetic is in SIMD
//! lanes. Every point gets what [`BakedTable::sample_at`] gives, to rounding.

use glam::Vec2;

use super::{
    cell_masses::{CellMasses, FoundRow, Node},
    table::BakedTable,
};
use crate::sampler::ShadingPoint;

/// Points that go through the stages together.
const ABREAST: usize = 16;

/// One number of each point.
type Lanes = [f32; ABREAST];

/// The four nodes around each normal and their weights.
struct Stencils {
    nodes: [[usize; 4]; ABREAST],
    weights: [Lanes; 4],
}

impl BakedTable {
    pub(super) fn sample_abreast(&self, at: &[ShadingPoint], z: &[Vec2], y: &mut [Vec2], q: &mut [f32]) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has the one feature that the function is compiled for, as was just found out.
            unsafe { self.sample_chunks_avx2(at, z, y, q) };
            return;
        }
        self.sample_chunks(at, z, y, q);
    }

    /// [`Self::sample_chunks`] compiled for AVX2: the same operations in the same order, so the same results.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn sample_chunks_avx2(&self, at: &[ShadingPoint], z: &[Vec2], y: &mut [Vec2], q: &mut [f32]) {
        self.sample_chunks(at, z, y, q);
    }

    #[inline(always)]
    fn sample_chunks(&self, at: &[ShadingPoint], z: &[Vec2], y: &mut [Vec2], q: &mut [f32]) {
        let chunks = at.chunks(ABREAST).zip(z.chunks(ABREAST));
        for (((at, z), y), q) in chunks.zip(y.chunks_mut(ABREAST)).zip(q.chunks_mut(ABREAST)) {
            self.sample_chunk(at, z, y, q);
        }
    }

    /// At most [`ABREAST`] points; lanes without a point compute nonsense that nobody reads.
    #[inline(always)]
    fn sample_chunk(&self, at: &[ShadingPoint], z: &[Vec2], y: &mut [Vec2], q: &mut [f32]) {
        let count = at.len();
        let stencils = self.stencils(at);
        let (weights, shares) = self.shares(&stencils);
        let (picked, targets) = pick_nodes(z, &weights, &shares);
        let (rows, columns) = (self.cells.shape().0 as f32, self.cells.shape().1 as f32);
        let mut found = [FoundRow::default(); ABREAST];
        for k in 0..count {
            let node = stencils.nodes[k][picked[k] as usize & 3];
            found[k] = self.quantized.search_row(node, targets[k]);
        }
        let mut masses = [[0.0; ABREAST]; 4];
        for k in 0..count {
            let (column, right) = self.quantized.search_column(found[k], z[k].x);
            let row = found[k];
            y[k] = Vec2::new((column as f32 + right) / columns, (row.index as f32 + row.below) / rows);
            let cell = self.quantized.masses(stencils.nodes[k], row.index, column);
            for (masses, mass) in masses.iter_mut().zip(cell) {
                masses[k] = mass;
            }
        }
        let unit = rows * columns / CellMasses::ROW;
        let mut densities = [0.0; ABREAST];
        for (k, density) in densities.iter_mut().enumerate() {
            let near = weights[0][k] * masses[0][k] + weights[1][k] * masses[1][k];
            let far = weights[2][k] * masses[2][k] + weights[3][k] * masses[3][k];
            *density = (near + far) * unit / shares[3][k];
        }
        q.copy_from_slice(&densities[..count]);
    }

    #[inline(always)]
    fn stencils(&self, at: &[ShadingPoint]) -> Stencils {
        let (mut x, mut y, mut z) = ([0.0; ABREAST], [0.0; ABREAST], [0.0; ABREAST]);
        for (k, at) in at.iter().enumerate() {
            (x[k], y[k], z[k]) = (at.ns.x, at.ns.y, at.ns.z);
        }
        let (mut azimuths, mut polars) = ([0.0; ABREAST], [0.0; ABREAST]);
        for k in 0..ABREAST {
            let position = self.normals.position([x[k], y[k], z[k]]);
            (azimuths[k], polars[k]) = (position.x, position.y);
        }
        let mut corners = [0_u32; ABREAST];
        let mut next = [0_u32; ABREAST];
        let mut weights = [[0.0; ABREAST]; 4];
        for k in 0..ABREAST {
            let cell = self.normals.cell(Vec2::new(azimuths[k], polars[k]));
            (corners[k], next[k]) = (cell.corner, cell.next);
            for (weights, weight) in weights.iter_mut().zip(cell.weights()) {
                weights[k] = weight;
            }
        }
        let mut nodes = [[0; 4]; ABREAST];
        for k in 0..ABREAST {
            nodes[k] = self.normals.nodes_of(corners[k], next[k]);
        }
        Stencils { nodes, weights }
    }

    /// The weights times the scales of the nodes, and their running sums in proportion to the nodes' masses.
    #[inline(always)]
    fn shares(&self, stencils: &Stencils) -> ([Lanes; 4], [Lanes; 4]) {
        let (mut scales, mut rows) = ([[0.0; ABREAST]; 4], [[0.0; ABREAST]; 4]);
        for (k, nodes) in stencils.nodes.iter().enumerate() {
            for (corner, &node) in nodes.iter().enumerate() {
                let node: Node = self.quantized.node(node);
                (scales[corner][k], rows[corner][k]) = (node.scale, node.rows);
            }
        }
        let (mut weights, mut shares) = (stencils.weights, [[0.0; ABREAST]; 4]);
        let mut sum = [0.0; ABREAST];
        for corner in 0..4 {
            for k in 0..ABREAST {
                weights[corner][k] *= scales[corner][k];
                sum[k] += weights[corner][k] * rows[corner][k];
            }
            shares[corner] = sum;
        }
        (weights, shares)
    }
}

/// Which of the four nodes each point draws from, and what is left of its uniform number for the node's rows.
#[inline(always)]
fn pick_nodes(z: &[Vec2], weights: &[Lanes; 4], shares: &[Lanes; 4]) -> ([u32; ABREAST], Lanes) {
    let mut targets = [0.0; ABREAST];
    for (target, z) in targets.iter_mut().zip(z) {
        *target = z.y;
    }
    let mut picked = [0; ABREAST];
    for k in 0..ABREAST {
        let target = targets[k] * shares[3][k];
        let (mut before, mut weight, mut index) = (0.0, weights[0][k], 0);
        for corner in 0..3 {
            let passed = target >= shares[corner][k];
            before = if passed { shares[corner][k] } else { before };
            weight = if passed { weights[corner + 1][k] } else { weight };
            index = if passed { corner as u32 + 1 } else { index };
        }
        // A node of weight 0 has an empty share and is never picked but by rounding, and then its first cell will do.
        targets[k] = (target - before) / weight.max(f32::MIN_POSITIVE);
        picked[k] = index;
    }
    (picked, targets)
}
