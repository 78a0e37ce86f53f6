//! Samplers as flat arrays with names, for implementations on other devices: what Dr.Jit gathers from and shaders bind.

/// The numbers of an array.
#[derive(Clone, Debug, PartialEq)]
pub enum FlatNumbers {
    /// 32-bit floats.
    Floats(Vec<f32>),
    /// 32-bit unsigned integers.
    Integers(Vec<u32>),
}

/// An array with a name, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct FlatArray {
    /// The name.
    pub name: &'static str,
    /// The size in each dimension.
    pub shape: Vec<usize>,
    /// The numbers.
    pub numbers: FlatNumbers,
}

impl FlatArray {
    /// An array of floats.
    pub fn floats(name: &'static str, shape: Vec<usize>, numbers: Vec<f32>) -> Self {
        Self { name, shape, numbers: FlatNumbers::Floats(numbers) }
    }

    /// An array of integers.
    pub fn integers(name: &'static str, shape: Vec<usize>, numbers: Vec<u32>) -> Self {
        Self { name, shape, numbers: FlatNumbers::Integers(numbers) }
    }
}
