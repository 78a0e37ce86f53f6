//! Weights by name, as they are written to and read from an exported file.

/// One weight: row-major values with the conventions of PyTorch's `Linear` (`weight` is `[out, in]`, `bias` is `[out]`).
#[derive(Clone, Debug, PartialEq)]
pub struct NamedTensor {
    /// Such as `layer0.linear2.weight` or `encoder.linear0.bias`.
    pub name: String,
    /// `[out, in]` or `[out]`.
    pub shape: Vec<usize>,
    /// `shape` product many values, row-major.
    pub values: Vec<f32>,
}
