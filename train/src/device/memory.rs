//! The memory of a step of a head: where its matrices are in the arena.

use headtail_model::Mode;
use headtail_shaders::gpu::GpuError;

use super::dispatch::{Allocator, Matrix, Packed, Slices, TILE};
use crate::{Objective, fused::Layout};

/// The largest number of workgroups along one axis, which are those of conditions.
const MOST_GROUPS: usize = 65_535;

/// The largest number of slices of the gradient.
const SLICES: usize = 256;

/// Sizes of a batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    pub conditions: usize,
    /// Points per condition.
    pub samples: usize,
}

impl Shape {
    pub fn points(self) -> usize {
        self.conditions * self.samples
    }

    /// Returns the length of the batch's numbers on the device: points, four numbers for each of them, and one
    /// for each condition.
    pub fn batch_length(self) -> usize {
        6 * self.points() + self.conditions
    }
}

/// A network of points: its layers, and its numbers for a piece of the batch.
pub struct Network {
    pub layers: Vec<Packed>,
    /// The other coordinate's features.
    pub features: Matrix,
    /// Activations; in the backward pass, derivatives by their arguments.
    pub hidden: Vec<Matrix>,
    pub logits: Matrix,
    pub log_slope: usize,
    /// What the first layer makes of each condition, and the sums of the derivatives by it and by the weights
    /// of the features.
    pub of_condition: Matrix,
    pub d_condition: Matrix,
}

/// A network of conditions.
pub struct OfConditions {
    pub layers: Vec<Packed>,
    pub hidden: Vec<Matrix>,
    pub output: Matrix,
    pub d_output: Matrix,
}

/// Where the numbers of a step are in the arena.
pub struct Memory<'a> {
    pub layout: &'a Layout,
    pub shape: Shape,
    pub objective: Objective,
    /// Conditions of a piece.
    pub together: usize,
    pub slices: Slices,
    /// Length of the arena.
    pub length: usize,
    pub results: usize,
    /// The condition, followed by the encoder's output: the input of every network.
    pub seen: Matrix,
    pub d_seen: Matrix,
    pub encoder: Option<OfConditions>,
    pub mixture_weight: Option<OfConditions>,
    /// In autoregressive mode, where the elevation depends on the condition alone.
    pub elevation_of_condition: Option<OfConditions>,
    pub elevation: Network,
    pub azimuth: Network,
    pub d_log: usize,
    pub d_value: usize,
}

impl<'a> Memory<'a> {
    /// Places the conditions of about `points` points together, fewer where they do not fit into `numbers` numbers.
    pub fn new(
        layout: &'a Layout,
        shape: Shape,
        objective: Objective,
        points: usize,
        numbers: usize,
    ) -> Result<Self, GpuError> {
        let mut together = (points / shape.samples).clamp(1, shape.conditions.min(MOST_GROUPS));
        let most = SLICES.min(numbers / layout.length).max(1);
        let slices = Slices { length: layout.length, most };
        loop {
            let memory = Self::of_size(layout, shape, objective, together, slices);
            if memory.length <= numbers {
                return Ok(memory);
            }
            if together == 1 {
                let what = "a condition's points (strata, brdf_samples)";
                return Err(GpuError::TooLarge { what, needed: 4 * memory.length as u64, allowed: 4 * numbers as u64 });
            }
            together = together.div_ceil(2);
        }
    }

    fn of_size(layout: &'a Layout, shape: Shape, objective: Objective, together: usize, slices: Slices) -> Self {
        let (config, mut arena) = (&layout.config, Allocator::default());
        let results = arena.length;
        arena.length += (layout.length + 2 * shape.conditions).next_multiple_of(TILE);
        let stride = shape.conditions.next_multiple_of(TILE);
        let rows = config.network_condition();
        let (seen, d_seen) = (arena.matrix(rows, stride), arena.matrix(rows, stride));
        let of_conditions = |layers: &[_], arena: &mut Allocator| {
            let layers: Vec<Packed> = layers.iter().map(|layer| Packed::new(*layer, arena)).collect();
            let (last, others) = layers.split_last()?;
            let hidden = others.iter().map(|packed| arena.matrix(packed.layer.outputs, stride)).collect();
            let [output, d_output] = [(); 2].map(|()| arena.matrix(last.layer.outputs, stride));
            Some(OfConditions { layers, hidden, output, d_output })
        };
        let mut encoder = of_conditions(&layout.encoder, &mut arena);
        if let Some(encoder) = &mut encoder {
            encoder.output = seen.after_rows(layout.encoder[0].inputs);
            encoder.d_output = d_seen.after_rows(layout.encoder[0].inputs);
        }
        let mixture_weight = of_conditions(&layout.mixture_weight, &mut arena);
        let coupled = config.mode == Mode::Coupled;
        let elevation_of_condition = if coupled { None } else { of_conditions(&layout.elevation, &mut arena) };
        let columns = (together * shape.samples).next_multiple_of(TILE);
        let mut network = |layers: &[_], features: usize| {
            let layers: Vec<Packed> = layers.iter().map(|layer| Packed::new(*layer, &mut arena)).collect();
            let hidden: Vec<Matrix> = layers
                .split_last()
                .map_or(&[][..], |(_, others)| others)
                .iter()
                .map(|packed| arena.matrix(packed.layer.outputs, columns))
                .collect();
            let first = layers.first().map_or(config.logits(), |packed| packed.layer.outputs);
            Network {
                features: arena.matrix(features, columns),
                hidden,
                logits: arena.logits(config.logits(), columns),
                log_slope: arena.matrix(1, columns).start,
                of_condition: arena.matrix(first, stride),
                d_condition: arena.matrix((1 + features) * first, stride),
                layers,
            }
        };
        let mut elevation = network(if coupled { &layout.elevation } else { &[] }, if coupled { 2 } else { 0 });
        let azimuth = network(&layout.azimuth, 1);
        if let Some(of_condition) = &elevation_of_condition {
            elevation.of_condition = of_condition.output;
            elevation.d_condition = of_condition.d_output;
        }
        let [d_log, d_value] = [(); 2].map(|()| arena.matrix(1, columns).start);
        let length = arena.length;
        Self {
            layout,
            shape,
            objective,
            together,
            slices,
            length,
            results,
            seen,
            d_seen,
            encoder,
            mixture_weight,
            elevation_of_condition,
            elevation,
            azimuth,
            d_log,
            d_value,
        }
    }

    pub fn slope(&self) -> f32 {
        self.layout.config.leaky_slope
    }
}
