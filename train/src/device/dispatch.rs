//! Matrices in the arena, and the dispatches of the shaders of training, whose parameters are those of their
//! structures `Params`.

use headtail_shaders::training::Kernel;

use crate::fused::Layer;

/// One run of a shader.
#[derive(Clone, Debug, PartialEq)]
pub struct Dispatch {
    pub kernel: Kernel,
    pub parameters: Vec<u32>,
    pub groups: [u32; 3],
    pub cost: Cost,
}

/// The least cost of a dispatch; 0 for small ones.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// Floating-point operations of matrix products.
    pub operations: f64,
    /// Bytes that are read and written.
    pub bytes: f64,
}

impl Cost {
    /// A product of matrices of `rows` x `inner` and `inner` x `columns` numbers.
    fn of_product(rows: usize, inner: usize, columns: usize) -> Self {
        let [rows, inner, columns] = [rows, inner, columns].map(|size| size as f64);
        Self { operations: 2.0 * rows * inner * columns, bytes: 4.0 * (rows + inner) * columns }
    }

    /// Reading or writing rows of numbers.
    pub fn of_rows(rows: usize, columns: usize) -> Self {
        Self { operations: 0.0, bytes: 4.0 * rows as f64 * columns as f64 }
    }
}

/// Columns of a workgroup of `affine`: matrices have a multiple of them.
pub const TILE: usize = 128;

/// A matrix `[rows, columns]` in the arena; rows are `stride` numbers apart.
#[derive(Clone, Copy, Debug)]
pub struct Matrix {
    pub start: usize,
    pub rows: usize,
    pub stride: usize,
}

impl Matrix {
    /// Returns the matrix without its first rows.
    pub fn after_rows(self, row: usize) -> Self {
        Self { start: self.start + row * self.stride, rows: self.rows - row, ..self }
    }
}

/// Hands out the arena.
#[derive(Default)]
pub struct Allocator {
    pub length: usize,
}

impl Allocator {
    pub fn matrix(&mut self, rows: usize, stride: usize) -> Matrix {
        let start = self.length;
        self.length += rows * stride;
        Matrix { start, rows, stride }
    }

    /// Places the logits of splines, and after them what the forward pass keeps for the backward pass: see
    /// `spline_gradient.wgsl`.
    pub fn logits(&mut self, rows: usize, stride: usize) -> Matrix {
        const KEPT: usize = 8;
        Matrix { rows, ..self.matrix(rows + KEPT, stride) }
    }
}

/// A layer whose weights are in the arena in the order of each pass: `[inputs, outputs]` and
/// `[outputs, inputs]`, with rows padded to whole workgroups.
#[derive(Clone, Copy, Debug)]
pub struct Packed {
    pub layer: Layer,
    pub forward: Matrix,
    pub backward: Matrix,
}

/// Returns the number of workgroups along `rows` rows of a product, and the number of their threads along
/// them, each of which computes 8 rows.
fn tiling(rows: usize) -> (usize, usize) {
    let groups = rows.div_ceil(8 * 16);
    (groups, rows.div_ceil(groups).div_ceil(8))
}

impl Packed {
    pub fn new(layer: Layer, arena: &mut Allocator) -> Self {
        let padded = |rows| {
            let (groups, threads) = tiling(rows);
            8 * groups * threads
        };
        let forward = arena.matrix(layer.inputs, padded(layer.outputs));
        let backward = arena.matrix(layer.outputs, padded(layer.inputs));
        Self { layer, forward, backward }
    }

    /// Packs the weights.
    pub fn pack(&self) -> Dispatch {
        let Self { layer, forward, backward } = self;
        let columns = Columns {
            source: layer.start,
            factors: backward.start,
            factor_stride: backward.stride,
            output: forward.start,
            stride: forward.stride,
            rows: layer.outputs,
            feature_count: layer.inputs,
            ..Columns::default()
        };
        columns.each(Kernel::Pack, layer.outputs * layer.inputs)
    }
}

/// Number of workgroups of 64 threads.
pub fn threads(count: usize) -> usize {
    count.div_ceil(64)
}

/// Workgroups of 64 threads for `count` numbers, in rows: there are more than one row may have.
pub fn spread(count: usize) -> [u32; 2] {
    let (groups, most) = (threads(count), 1 << 15);
    [groups.min(most), groups.div_ceil(most)].map(|groups| groups as u32)
}

pub fn words<const N: usize>(numbers: [usize; N]) -> Vec<u32> {
    numbers.map(|number| u32::try_from(number).expect("the arena is below 2^32 numbers")).into()
}

/// What becomes of a product, as in `affine.wgsl`.
#[derive(Clone, Copy)]
pub enum Form {
    WithBias,
    Activated,
    /// As `Activated`; the argument of the activation is written to the matrix.
    Kept(Matrix),
    /// As `Kept`, with the matrix's numbers added to the argument.
    Residual(Matrix),
    ThroughActivation,
    /// As `ThroughActivation`, with the matrix's numbers added.
    ThroughActivationAdded(Matrix),
    Plain,
    Added,
}

impl Form {
    /// Returns the shader's number, and the place of the other matrix.
    fn numbers(self) -> (u32, usize) {
        match self {
            Self::WithBias => (0, 0),
            Self::Activated => (1, 0),
            Self::Kept(other) => (2, other.start / 4),
            Self::Residual(other) => (3, other.start / 4),
            Self::ThroughActivation => (4, 0),
            Self::ThroughActivationAdded(other) => (5, other.start / 4),
            Self::Plain => (6, 0),
            Self::Added => (7, 0),
        }
    }
}

/// Propagates `input` through a layer to `output`, over `columns` columns. Only the first `input.rows` inputs
/// are seen.
pub fn forward(layer: &Packed, input: Matrix, output: Matrix, columns: usize, form: Form, slope: f32) -> Dispatch {
    affine(layer.forward, layer.layer.outputs, (input, output), columns, (form, layer.layer.bias_at(), slope))
}

/// Propagates derivatives by a layer's output to those by its first `output.rows` inputs.
pub fn backward(layer: &Packed, input: Matrix, output: Matrix, columns: usize, form: Form, slope: f32) -> Dispatch {
    affine(layer.backward, layer.layer.inputs, (input, output), columns, (form, 0, slope))
}

fn affine(
    factor: Matrix,
    rows: usize,
    (input, output): (Matrix, Matrix),
    columns: usize,
    (form, bias, slope): (Form, usize, f32),
) -> Dispatch {
    let (groups, along) = tiling(rows);
    let (form, other) = form.numbers();
    let mut parameters = words([
        factor.start / 4,
        factor.stride / 4,
        input.start / 4,
        output.start / 4,
        input.stride / 4,
        output.rows.min(rows),
        input.rows.min(factor.rows),
        bias,
        other,
    ]);
    parameters.push(slope.to_bits());
    let groups = [columns.div_ceil(TILE) as u32, groups as u32, 1];
    let cost = Cost::of_product(output.rows.min(rows), input.rows.min(factor.rows), columns);
    Dispatch { kernel: Kernel::Affine { rows: along as u32, form }, parameters, groups, cost }
}

/// Where slices of the gradient are.
#[derive(Clone, Copy)]
pub struct Slices {
    /// Numbers of one slice: the weights.
    pub length: usize,
    /// The largest number of slices.
    pub most: usize,
}

impl Slices {
    /// Least number of columns of a slice: shorter ones cost more memory traffic than they gain parallelism.
    pub const LEAST: usize = 256;

    /// Adds the slices up, to the place `output`.
    pub fn add(self, output: usize) -> Dispatch {
        let columns = Columns { output, rows: self.length, count: self.most, ..Columns::default() };
        columns.each(Kernel::AddSlices, self.length)
    }

    /// Returns the number of columns of a slice.
    fn columns(self, columns: usize) -> usize {
        columns.div_ceil(self.most).next_multiple_of(16).max(Self::LEAST)
    }
}

/// Computes the gradient of a layer's weights, for its first `input.rows` inputs, and of its biases.
pub fn weight_gradient(
    layer: Layer,
    derivative: Matrix,
    input: Matrix,
    columns: usize,
    slices: Slices,
    is_added: bool,
) -> Dispatch {
    let (groups, along) = tiling(layer.outputs);
    let (columns, slice) = (columns.next_multiple_of(TILE), slices.columns(columns));
    let inputs = input.rows.min(layer.inputs);
    let parameters = words([
        derivative.start / 4,
        input.start / 4,
        derivative.stride / 4,
        layer.outputs,
        inputs,
        columns / 4,
        slice / 4,
        layer.start,
        layer.inputs,
        layer.bias_at(),
        slices.length,
        is_added.into(),
    ]);
    let groups = [inputs.div_ceil(64) as u32, groups as u32, columns.div_ceil(slice) as u32];
    let cost = Cost::of_product(layer.outputs, inputs, columns);
    Dispatch { kernel: Kernel::WeightGradient { rows: along as u32 }, parameters, groups, cost }
}

/// The parameters of `columns.wgsl`.
#[derive(Clone, Copy, Default)]
pub struct Columns {
    pub source: usize,
    pub source_stride: usize,
    pub features: usize,
    pub factors: usize,
    pub factor_stride: usize,
    pub output: usize,
    pub stride: usize,
    pub rows: usize,
    pub feature_count: usize,
    pub samples: usize,
    pub first: usize,
    pub count: usize,
    pub point: usize,
    pub slope: f32,
}

impl Columns {
    /// Runs a kernel with some workgroups.
    pub fn run(self, kernel: Kernel, [x, y]: [usize; 2]) -> Dispatch {
        let mut parameters = words([
            self.source,
            self.source_stride,
            self.features,
            self.factors,
            self.factor_stride,
            self.output,
            self.stride,
            self.rows,
            self.feature_count,
            self.samples,
            self.first,
            self.count,
            self.point,
        ]);
        parameters.push(self.slope.to_bits());
        Dispatch { kernel, parameters, groups: [x as u32, y as u32, 1], cost: Cost::default() }
    }

    /// Runs a kernel with one thread per column, and one row of workgroups per row.
    pub fn over(self, kernel: Kernel, columns: usize, rows: usize) -> Dispatch {
        let dispatch = self.run(kernel, [threads(columns.next_multiple_of(TILE)), rows]);
        Dispatch { cost: Cost::of_rows(rows.max(self.rows), columns), ..dispatch }
    }

    /// Runs `ConditionSums` over `rows` rows of some conditions.
    pub fn sums(self, conditions: usize) -> Dispatch {
        let dispatch = self.run(Kernel::ConditionSums, [conditions, self.rows]);
        Dispatch { cost: Cost::of_rows(self.rows, conditions * self.samples), ..dispatch }
    }

    /// Runs a kernel with one thread for each of `count` numbers.
    pub fn each(self, kernel: Kernel, count: usize) -> Dispatch {
        self.run(kernel, spread(count).map(|groups| groups as usize))
    }
}

/// Splines of a piece of the batch.
#[derive(Clone, Copy)]
pub struct Splines {
    pub logits: Matrix,
    pub bins: usize,
    pub is_circle: bool,
    /// Place of the first point's coordinate in the batch; of a chain, in the arena.
    pub point: usize,
    /// Whether the spline is one of a chain: points are a row, and derivatives by them take the place of those by values.
    pub is_of_chain: bool,
    pub count: usize,
    pub log_slope: usize,
    /// Places of the values and of the derivatives by them, if something follows from them.
    pub value: Option<[usize; 2]>,
    pub d_log_slope: usize,
}

impl Splines {
    /// Runs `SplineForward` or `SplineBackward`.
    pub fn run(&self, kernel: Kernel) -> Dispatch {
        let [value, d_value] = self.value.unwrap_or_default();
        let parameters = words([
            self.logits.start,
            self.logits.stride,
            self.bins,
            self.is_circle.into(),
            self.point,
            self.count,
            self.log_slope,
            self.value.is_some().into(),
            value,
            self.d_log_slope,
            d_value,
            self.is_of_chain.into(),
        ]);
        let passes = if kernel == Kernel::SplineBackward { 2 } else { 1 };
        let groups = [threads(self.count.next_multiple_of(TILE)) as u32, 1, 1];
        Dispatch { kernel, parameters, groups, cost: Cost::of_rows(passes * self.logits.rows, self.count) }
    }
}
