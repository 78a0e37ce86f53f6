//! Shaders of training: matrix products, splines and losses with their derivatives, over matrices of one
//! column per point.
//!
//! All have the same bindings: weights, the batch, an arena that holds the matrices, slices of the gradient,
//! and a uniform structure `Params`.

use crate::RATIONAL_QUADRATIC;

/// Random numbers, and the target at points; see [`crate::Shader::of_targets`].
pub(crate) const TARGETS: [&str; 2] =
    [include_str!("../wgsl/train/random.wgsl"), include_str!("../wgsl/train/targets.wgsl")];
/// The surfaces of conditions.
pub(crate) const ANALYTIC_SURFACE: &str = include_str!("../wgsl/train/analytic_surface.wgsl");
pub(crate) const FITTED_SURFACE: &str = include_str!("../wgsl/train/fitted_surface.wgsl");
/// The square of a head: over a tail, which may match the light, or over patches over one that does.
pub(crate) const IN_TAIL: &str = include_str!("../wgsl/train/in_tail.wgsl");
pub(crate) const EXACT_TAIL: &str = include_str!("../wgsl/train/exact_tail.wgsl");
pub(crate) const INEXACT_TAIL: &str = include_str!("../wgsl/train/inexact_tail.wgsl");
pub(crate) const IN_PATCHES: &str = include_str!("../wgsl/train/in_patches.wgsl");
/// Parts of matrix products that a thread sums up.
const REGISTER_TILE: &str = include_str!("../wgsl/train/register_tile.wgsl");
/// How points are drawn.
pub(crate) const STRATA: &str = include_str!("../wgsl/train/strata.wgsl");
pub(crate) const TABULATED: &str = include_str!("../wgsl/train/tabulated.wgsl");

/// The constants of the shader that draws targets: numbers of points, of points per condition, of strata per
/// side and of BRDF samples; place and stride of the conditions in the arena; whether surfaces are microfacets, whether
/// their width is part of the condition, and whether they are of a neural material; whether points are of X.
pub const TARGET_SIZES: [&str; 10] = [
    "POINTS",
    "SAMPLES",
    "STRATA",
    "BRDF_SAMPLES",
    "CONDITIONS",
    "CONDITION_STRIDE",
    "IS_GLOSSY",
    "HAS_ALPHA",
    "IS_NEURAL",
    "IS_IN_X",
];

/// The constants of the optimiser's shader: numbers of weights and of conditions; place in the arena of the
/// gradient, which is followed by each condition's loss and whether it is lit; the largest number of steps; whether
/// there is a moving average.
pub const OPTIMIZER_SIZES: [&str; 5] = ["WEIGHTS", "CONDITIONS", "GRADIENT", "MOST_STEPS", "HAS_AVERAGE"];

/// Its factors: those of AdamW, and the norm to which gradients are clipped.
pub const OPTIMIZER_FACTORS: [&str; 4] = ["BETA_1", "BETA_2", "EPSILON", "CLIP_NORM"];

/// Returns the shader of the optimiser, with the entry points `judge` and `move_weights`, for numbers in the order of
/// [`OPTIMIZER_SIZES`] and [`OPTIMIZER_FACTORS`].
pub fn optimizer(sizes: [usize; 5], factors: [f32; 4]) -> String {
    let sizes = OPTIMIZER_SIZES.iter().zip(sizes).map(|(name, value)| format!("const {name}: u32 = {value}u;\n"));
    let factors = OPTIMIZER_FACTORS.iter().zip(factors).map(|(name, value)| {
        let finite = value.clamp(f32::MIN_POSITIVE, f32::MAX);
        format!("const {name}: f32 = {finite:?};\n")
    });
    sizes.chain(factors).chain([include_str!("../wgsl/train/optimizer.wgsl").into()]).collect()
}

/// A shader, named as its entry point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kernel {
    /// A layer, forward or backward. `rows` is the number of its threads along the outputs, 8 outputs each.
    Affine {
        /// 1 to 16.
        rows: u32,
        /// What becomes of the product, 0 to 7: see `affine.wgsl`.
        form: u32,
    },
    /// The gradient of a layer's weights, with `rows` as for `Affine`.
    WeightGradient {
        /// 1 to 16.
        rows: u32,
    },
    /// Splines, in the density direction.
    SplineForward,
    /// Their derivatives.
    SplineBackward,
    /// Losses and their derivatives.
    Loss,
    /// A layer's weights in the order of both passes.
    Pack,
    /// The features of points.
    Place,
    /// A first layer, of features and of what it makes of a condition.
    FirstLayer,
    /// Derivatives by a feature.
    FeatureDerivative,
    /// Derivatives through an activation.
    ThroughActivation,
    /// The sum of the slices of the gradient.
    AddSlices,
    /// Sums over the columns of a condition.
    ConditionSums,
    /// The gradient of a feature's weights.
    FeatureGradient,
    /// The coordinates of points before all coupling layers of a flow.
    PlacePoints,
    /// The features that a coupling layer sees.
    PlaceFeatures,
    /// Derivatives by features become those by the coordinate.
    FeaturesBackward,
    /// The likelihood of a flow.
    Likelihood,
}

impl Kernel {
    /// Returns the name of the entry point.
    pub const fn entry(self) -> &'static str {
        match self {
            Self::Affine { .. } => "affine",
            Self::WeightGradient { .. } => "weight_gradient",
            Self::SplineForward => "spline_forward",
            Self::SplineBackward => "spline_backward",
            Self::Loss => "loss",
            Self::Pack => "pack",
            Self::Place => "place",
            Self::FirstLayer => "first_layer",
            Self::FeatureDerivative => "feature_derivative",
            Self::ThroughActivation => "through_activation",
            Self::AddSlices => "add_slices",
            Self::ConditionSums => "condition_sums",
            Self::FeatureGradient => "feature_gradient",
            Self::PlacePoints => "place_points",
            Self::PlaceFeatures => "place_features",
            Self::FeaturesBackward => "features_backward",
            Self::Likelihood => "likelihood",
        }
    }

    /// Returns the WGSL source.
    pub fn source(self) -> String {
        match self {
            Self::Affine { rows, form } => {
                let source = include_str!("../wgsl/train/affine.wgsl");
                format!("const ROWS: u32 = {rows}u;\nconst FORM: u32 = {form}u;\n{REGISTER_TILE}\n{source}")
            }
            Self::WeightGradient { rows } => {
                let source = include_str!("../wgsl/train/weight_gradient.wgsl");
                format!("const ROWS: u32 = {rows}u;\n{REGISTER_TILE}\n{source}")
            }
            Self::SplineForward | Self::SplineBackward => {
                [RATIONAL_QUADRATIC, include_str!("../wgsl/train/spline_gradient.wgsl")].join("\n")
            }
            Self::Loss => include_str!("../wgsl/train/loss.wgsl").into(),
            Self::PlacePoints | Self::PlaceFeatures | Self::FeaturesBackward | Self::Likelihood => {
                include_str!("../wgsl/train/coupling.wgsl").into()
            }
            _ => include_str!("../wgsl/train/columns.wgsl").into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use headtail_sampling::{
        FlatArray,
        environment::Environment,
        flat_patches,
        patches::Detail,
        tail::{Tail, TailKind},
    };
    use naga::valid::{Capabilities, ValidationFlags, Validator};

    use super::*;
    use crate::Shader;

    fn assert_valid(name: &str, entry: &str, source: &str) {
        let module = naga::front::wgsl::parse_str(source);
        let module = module.unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(source)));
        assert!(module.entry_points.iter().any(|found| found.name == entry), "{name}");
        let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
        let found = validator.validate(&module);
        found.unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(source)));
    }

    #[test]
    fn shaders_of_targets_are_valid() {
        let map = Environment::open("studio").unwrap();
        let of = |kind| Tail::of_environment(kind, &map).unwrap();
        let (tree, rows) = (of(TailKind::Hierarchical), of(TailKind::RowColumn));
        let light = FlatArray::floats("light.cells", vec![512, 1024], vec![1.0; 8]);
        let patches = flat_patches(&tree, Detail::Twigs).unwrap();
        let flow = vec![
            FlatArray::floats("tail.cells", vec![16, 8], vec![0.0; 128]),
            FlatArray::floats("tail.boxes", vec![21, 4], vec![0.0; 84]),
        ];
        let nodes = FlatArray::floats("light.nodes", vec![3, 4], vec![1.0; 12]);
        let material = FlatArray::floats("material.numbers", vec![8], vec![1.0; 8]);
        for (name, arrays, entries) in [
            ("tree", tree.flat(), &["place_strata"][..]),
            ("rows", rows.flat(), &["place_strata"]),
            ("patches", patches.clone(), &["place_strata"]),
            ("table", [rows.flat(), vec![light.clone()]].concat(), &["tabulate", "sum_rows", "place_tabulated"]),
            ("flow", [flow, vec![nodes]].concat(), &["place_strata"]),
            ("fitted", [patches, vec![material.clone()]].concat(), &["place_strata"]),
            ("fitted table", [rows.flat(), vec![light, material]].concat(), &["tabulate", "place_tabulated"]),
        ] {
            let shader = Shader::of_targets(&arrays, [4; TARGET_SIZES.len()], 0.25).unwrap();
            for entry in entries {
                assert_valid(name, entry, &shader.source);
            }
        }
    }

    #[test]
    fn the_shader_of_the_optimiser_is_valid() {
        for entry in ["judge", "move_weights"] {
            assert_valid("optimizer", entry, &optimizer([4; 5], [0.0, 0.9, 1e-8, f32::INFINITY]));
        }
    }

    #[test]
    fn shaders_are_valid_and_need_no_optional_capability() {
        let forms = (0..8).map(|form| Kernel::Affine { rows: 13, form });
        let layers = [1, 13, 16]
            .into_iter()
            .flat_map(|rows| [Kernel::Affine { rows, form: 0 }, Kernel::WeightGradient { rows }])
            .chain(forms);
        let others = [
            Kernel::SplineForward,
            Kernel::SplineBackward,
            Kernel::Loss,
            Kernel::Pack,
            Kernel::Place,
            Kernel::FirstLayer,
            Kernel::FeatureDerivative,
            Kernel::ThroughActivation,
            Kernel::AddSlices,
            Kernel::ConditionSums,
            Kernel::FeatureGradient,
            Kernel::PlacePoints,
            Kernel::PlaceFeatures,
            Kernel::FeaturesBackward,
            Kernel::Likelihood,
        ];
        for kernel in layers.chain(others) {
            assert_valid(&format!("{kernel:?}"), kernel.entry(), &kernel.source());
        }
    }
}
