//! Arrays of numpy.

use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::error::refused;

/// Returns the rows of `N` numbers of a contiguous array.
pub fn rows<'a, const N: usize>(array: &'a PyReadonlyArray2<'_, f32>) -> PyResult<&'a [[f32; N]]> {
    if array.shape()[1] != N {
        return Err(refused(format!("an array has {} columns; {N} are needed", array.shape()[1])));
    }
    Ok(array.as_slice()?.as_chunks().0)
}
