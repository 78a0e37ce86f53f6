//! Named weights, as written to and read from an exported file.

/// A weight: row-major values with the conventions of PyTorch's `Linear` (`weight` is `[out, in]`, `bias`
/// `[out]`).
#[derive(Clone, Debug, PartialEq)]
pub struct NamedTensor {
    /// The name, for example `layer0.linear2.weight` or `encoder.linear0.bias`.
    pub name: String,
    /// `[out, in]` or `[out]`.
    pub shape: Vec<usize>,
    /// The values, row-major; their number is the product of `shape`.
    pub values: Vec<f32>,
}
