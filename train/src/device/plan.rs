//! The memory and the dispatches of a step of a head.

use headtail_model::Mode;
use headtail_shaders::{gpu::GpuError, training::Kernel};

use super::dispatch::{
    Allocator, Columns, Cost, Dispatch, Form, Matrix, Packed, Slices, Splines, TILE, backward, forward, weight_gradient,
};
use crate::{Loss, Objective, fused::Layout};

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
    fn points(self) -> usize {
        self.conditions * self.samples
    }

    /// Returns the length of the batch's numbers on the device: points, four numbers for each of them, and one
    /// for each condition.
    pub fn batch_length(self) -> usize {
        6 * self.points() + self.conditions
    }
}

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
        let together = (points / shape.samples).clamp(1, shape.conditions.min(MOST_GROUPS));
        let step = Step::new(layout, shape, objective, together, (largest / 4) as usize)?;
        let mut pieces = vec![step.before()];
        let mut first = 0;
        while first < shape.conditions {
            let count = step.together.min(shape.conditions - first);
            pieces.push(step.piece(first, count));
            first += count;
        }
        pieces.push(step.after());
        Ok(Self {
            pieces,
            arena: step.length,
            partials: step.slices.most * layout.length,
            seen: step.seen.start,
            results: step.results,
            stride: step.seen.stride,
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

/// A network of points: its layers, and its numbers for a piece of the batch.
struct Network {
    layers: Vec<Packed>,
    /// The other coordinate's features.
    features: Matrix,
    /// Activations; in the backward pass, derivatives by their arguments.
    hidden: Vec<Matrix>,
    logits: Matrix,
    log_slope: usize,
    /// What the first layer makes of each condition, and the sums of the derivatives by it and by the weights
    /// of the features.
    of_condition: Matrix,
    d_condition: Matrix,
}

/// A network of conditions.
struct OfConditions {
    layers: Vec<Packed>,
    hidden: Vec<Matrix>,
    output: Matrix,
    d_output: Matrix,
}

struct Step<'a> {
    layout: &'a Layout,
    shape: Shape,
    objective: Objective,
    /// Conditions of a piece.
    together: usize,
    slices: Slices,
    /// Length of the arena.
    length: usize,
    results: usize,
    /// The condition, followed by the encoder's output: the input of every network.
    seen: Matrix,
    d_seen: Matrix,
    encoder: Option<OfConditions>,
    mixture_weight: Option<OfConditions>,
    /// In autoregressive mode, where the elevation depends on the condition alone.
    elevation_of_condition: Option<OfConditions>,
    elevation: Network,
    azimuth: Network,
    d_log: usize,
    d_value: usize,
}

impl<'a> Step<'a> {
    fn new(
        layout: &'a Layout,
        shape: Shape,
        objective: Objective,
        mut together: usize,
        numbers: usize,
    ) -> Result<Self, GpuError> {
        let most = SLICES.min(numbers / layout.length).max(1);
        let slices = Slices { length: layout.length, most };
        loop {
            let step = Self::of_size(layout, shape, objective, together, slices);
            if step.length <= numbers {
                return Ok(step);
            }
            if together == 1 {
                let what = "a condition's points (strata, brdf_samples)";
                return Err(GpuError::TooLarge { what, needed: 4 * step.length as u64, allowed: 4 * numbers as u64 });
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
                logits: arena.matrix(config.logits(), columns),
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

    fn slope(&self) -> f32 {
        self.layout.config.leaky_slope
    }

    /// The networks of conditions.
    fn before(&self) -> Vec<Dispatch> {
        let mut list: Vec<Dispatch> = self.packed().map(Packed::pack).collect();
        let condition = Matrix { rows: self.layout.config.condition.length(), ..self.seen };
        if let Some(encoder) = &self.encoder {
            self.forward_of_conditions(encoder, condition, Form::Activated, &mut list);
        }
        if let Some(network) = &self.mixture_weight {
            self.forward_of_conditions(network, self.seen, Form::WithBias, &mut list);
        }
        if let Some(network) = &self.elevation_of_condition {
            self.forward_of_conditions(network, self.seen, Form::WithBias, &mut list);
        }
        for Network { layers, of_condition, .. } in [&self.elevation, &self.azimuth] {
            if let Some(first) = layers.first() {
                let (columns, slope) = (self.shape.conditions, self.slope());
                list.push(forward(first, self.seen, *of_condition, columns, Form::WithBias, slope));
            }
        }
        list
    }

    fn packed(&self) -> impl Iterator<Item = &Packed> {
        let of_conditions = [&self.encoder, &self.mixture_weight, &self.elevation_of_condition].into_iter().flatten();
        let of_points = [&self.elevation, &self.azimuth].into_iter().flat_map(|network| &network.layers);
        of_conditions.flat_map(|network| &network.layers).chain(of_points)
    }

    fn forward_of_conditions(&self, network: &OfConditions, input: Matrix, last: Form, list: &mut Vec<Dispatch>) {
        let mut input = input;
        for (index, layer) in network.layers.iter().enumerate() {
            let hidden = network.hidden.get(index).copied();
            let (output, form) = hidden.map_or((network.output, last), |hidden| (hidden, Form::Activated));
            list.push(forward(layer, input, output, self.shape.conditions, form, self.slope()));
            input = output;
        }
    }

    /// Conditions `first .. first + count` forward, their losses, and backward.
    fn piece(&self, first: usize, count: usize) -> Vec<Dispatch> {
        let mut list = Vec::new();
        let piece = Piece { step: self, first, count, columns: count * self.shape.samples };
        piece.forward(&mut list);
        list.push(piece.loss());
        piece.backward(&mut list);
        list
    }

    /// Gradients of what depends on conditions, and the sum of the slices.
    fn after(&self) -> Vec<Dispatch> {
        let mut list = Vec::new();
        for network in [&self.azimuth, &self.elevation] {
            self.feature_gradient(network, &mut list);
        }
        let mut form = Form::Plain;
        if let Some(network) = &self.elevation_of_condition {
            self.backward_of_conditions(network, network.d_output, &mut list);
            self.first_layer_backward(&network.layers[0], network.hidden[0], &mut form, &mut list);
        }
        if let Some(network) = &self.mixture_weight {
            self.backward_of_conditions(network, network.d_output, &mut list);
            self.first_layer_backward(&network.layers[0], network.hidden[0], &mut form, &mut list);
        }
        for Network { layers, d_condition, .. } in [&self.elevation, &self.azimuth] {
            if let Some(first) = layers.first() {
                let derivative = Matrix { rows: first.layer.outputs, ..*d_condition };
                self.first_layer_backward(first, derivative, &mut form, &mut list);
            }
        }
        if let Some(encoder) = &self.encoder {
            let count = encoder.output.rows * encoder.output.stride;
            let through = Columns {
                source: encoder.output.start,
                output: encoder.d_output.start,
                count,
                slope: self.slope(),
                ..Columns::default()
            };
            list.push(through.each(Kernel::ThroughActivation, count));
            self.backward_of_conditions(encoder, encoder.d_output, &mut list);
            let condition = Matrix { rows: self.layout.config.condition.length(), ..self.seen };
            list.push(self.gradient_of_conditions(&encoder.layers[0], encoder.hidden[0], condition));
        }
        let (rows, count) = (self.layout.length, self.slices.most);
        let add = Columns { output: self.results, rows, count, ..Columns::default() };
        list.push(add.each(Kernel::AddSlices, rows));
        list
    }

    /// The weights of a first layer's features.
    fn feature_gradient(&self, network: &Network, list: &mut Vec<Dispatch>) {
        let (Some(first), features) = (network.layers.first(), network.features.rows) else { return };
        let sums = Columns {
            source: network.d_condition.start,
            source_stride: network.d_condition.stride,
            output: first.layer.weight_at(0, first.layer.inputs - features),
            stride: first.layer.inputs,
            rows: first.layer.outputs,
            count: self.shape.conditions,
            ..Columns::default()
        };
        list.push(sums.run(Kernel::FeatureGradient, [first.layer.outputs, features]));
    }

    /// From the output of a network of conditions to its first hidden layer.
    fn backward_of_conditions(&self, network: &OfConditions, d_output: Matrix, list: &mut Vec<Dispatch>) {
        let mut derivative = d_output;
        for (layer, hidden) in network.layers[1..].iter().zip(&network.hidden).rev() {
            list.push(self.gradient_of_conditions(layer, derivative, *hidden));
            let columns = self.shape.conditions;
            list.push(backward(layer, derivative, *hidden, columns, Form::ThroughActivation, self.slope()));
            derivative = *hidden;
        }
    }

    fn first_layer_backward(&self, first: &Packed, derivative: Matrix, form: &mut Form, list: &mut Vec<Dispatch>) {
        list.push(self.gradient_of_conditions(first, derivative, self.seen));
        list.push(backward(first, derivative, self.d_seen, self.shape.conditions, *form, self.slope()));
        *form = Form::Added;
    }

    fn gradient_of_conditions(&self, layer: &Packed, derivative: Matrix, input: Matrix) -> Dispatch {
        weight_gradient(layer.layer, derivative, input, self.shape.conditions, self.slices, false)
    }
}

/// Some conditions of a batch.
struct Piece<'a> {
    step: &'a Step<'a>,
    first: usize,
    count: usize,
    columns: usize,
}

impl Piece<'_> {
    fn coupled(&self) -> bool {
        self.step.layout.config.mode == Mode::Coupled
    }

    fn forward(&self, list: &mut Vec<Dispatch>) {
        let Step { elevation, azimuth, .. } = self.step;
        let features = if self.coupled() { elevation.features } else { azimuth.features };
        let place = Columns {
            output: features.start,
            stride: features.stride,
            feature_count: features.rows,
            count: self.columns,
            point: 2 * self.first * self.step.shape.samples,
            ..Columns::default()
        };
        list.push(place.over(Kernel::Place, self.columns, 1));
        for (network, splines) in [elevation, azimuth].into_iter().zip(self.splines()) {
            self.network(network, list);
            list.push(splines.run(Kernel::SplineForward));
        }
    }

    fn network(&self, network: &Network, list: &mut Vec<Dispatch>) {
        let slope = self.step.slope();
        let features = network.features.rows;
        // Without layers, the logits are the condition's.
        let (output, factors, slope_of_first) = match network.layers.first() {
            Some(first) => (network.hidden[0], first.forward.after_rows(first.layer.inputs - features), slope),
            None => (network.logits, network.logits, 1.0),
        };
        let first_layer = Columns {
            source: network.of_condition.start,
            source_stride: network.of_condition.stride,
            features: network.features.start,
            factors: factors.start,
            factor_stride: factors.stride,
            output: output.start,
            stride: output.stride,
            feature_count: features,
            samples: self.step.shape.samples,
            first: self.first,
            count: self.step.shape.conditions,
            slope: slope_of_first,
            ..Columns::default()
        };
        list.push(first_layer.over(Kernel::FirstLayer, self.columns, output.rows));
        let mut input = output;
        for (index, layer) in network.layers.iter().enumerate().skip(1) {
            let hidden = network.hidden.get(index).copied();
            let (output, form) = hidden.map_or((network.logits, Form::WithBias), |hidden| (hidden, Form::Activated));
            list.push(forward(layer, input, output, self.columns, form, slope));
            input = output;
        }
    }

    /// The splines of the elevation and of the azimuth.
    fn splines(&self) -> [Splines; 2] {
        let step = self.step;
        [(&step.elevation, false), (&step.azimuth, true)].map(|(network, is_circle)| Splines {
            logits: network.logits,
            bins: step.layout.config.bins,
            is_circle,
            point: 2 * self.first * step.shape.samples + usize::from(!is_circle),
            count: self.columns,
            log_slope: network.log_slope,
            value: (!is_circle && self.coupled()).then_some([step.azimuth.features.start, step.d_value]),
            d_log_slope: step.d_log,
        })
    }

    fn loss(&self) -> Dispatch {
        let step = self.step;
        let [logit, d_logit] =
            step.mixture_weight.as_ref().map_or([0; 2], |network| [network.output.start, network.d_output.start]);
        let losses = step.results + step.layout.length;
        let form = match step.objective.loss {
            Loss::ForwardKl => 0,
            Loss::LogChiSquare => 1,
            Loss::ChiSquare => 2,
            Loss::ReverseKl => 3,
        };
        let numbers = [
            step.shape.points(),
            step.shape.samples,
            self.first,
            step.elevation.log_slope,
            step.azimuth.log_slope,
            step.d_log,
            losses,
            losses + step.shape.conditions,
            step.mixture_weight.is_some().into(),
            logit,
            d_logit,
            form,
        ];
        let mut parameters: Vec<u32> = numbers.iter().map(|&number| number as u32).collect();
        parameters.push(step.objective.entropic.to_bits());
        Dispatch { kernel: Kernel::Loss, parameters, groups: [self.count as u32, 1, 1], cost: Cost::default() }
    }

    fn backward(&self, list: &mut Vec<Dispatch>) {
        let Step { elevation, azimuth, .. } = self.step;
        let [of_elevation, of_azimuth] = self.splines();
        list.push(of_azimuth.run(Kernel::SplineBackward));
        self.network_backward(azimuth, list);
        if let (true, Some(first)) = (self.coupled(), azimuth.layers.first()) {
            let derivative = Columns {
                source: azimuth.hidden[0].start,
                source_stride: azimuth.hidden[0].stride,
                factors: first.forward.after_rows(first.layer.inputs - 1).start,
                output: self.step.d_value,
                rows: first.layer.outputs,
                ..Columns::default()
            };
            list.push(derivative.over(Kernel::FeatureDerivative, self.columns, 1));
        }
        list.push(of_elevation.run(Kernel::SplineBackward));
        self.network_backward(elevation, list);
    }

    /// From the derivatives by logits to those by the weights, and the sums of those by what the first layer
    /// makes of a condition.
    fn network_backward(&self, network: &Network, list: &mut Vec<Dispatch>) {
        let step = self.step;
        let mut derivative = network.logits;
        for (layer, hidden) in network.layers.iter().skip(1).zip(&network.hidden).rev() {
            let is_added = self.first > 0;
            list.push(weight_gradient(layer.layer, derivative, *hidden, self.columns, step.slices, is_added));
            list.push(backward(layer, derivative, *hidden, self.columns, Form::ThroughActivation, step.slope()));
            derivative = *hidden;
        }
        let sums = Columns {
            source: derivative.start,
            source_stride: derivative.stride,
            features: network.features.start,
            output: network.d_condition.start,
            stride: network.d_condition.stride,
            rows: derivative.rows,
            feature_count: network.features.rows,
            samples: step.shape.samples,
            first: self.first,
            ..Columns::default()
        };
        list.push(sums.sums(self.count));
    }
}
