//! Samplers as named flat arrays, for implementations on other devices (Dr.Jit gathers, shader bindings).

/// The numbers of an array.
#[derive(Clone, Debug, PartialEq)]
pub enum FlatNumbers {
    /// 32-bit floats.
    Floats(Vec<f32>),
    /// 32-bit unsigned integers.
    Integers(Vec<u32>),
}

/// A named row-major array.
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
    /// Makes an array of floats.
    pub fn floats(name: &'static str, shape: Vec<usize>, numbers: Vec<f32>) -> Self {
        Self { name, shape, numbers: FlatNumbers::Floats(numbers) }
    }

    /// Makes an array of integers.
    pub fn integers(name: &'static str, shape: Vec<usize>, numbers: Vec<u32>) -> Self {
        Self { name, shape, numbers: FlatNumbers::Integers(numbers) }
    }
}
