//! Row-major matrices and their products.

use headtail_render::simd::Lanes;

/// A borrowed row-major matrix; rows may be longer than `columns`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Matrix<'a> {
    pub values: &'a [f32],
    pub rows: usize,
    pub columns: usize,
    /// Distance between the starts of consecutive rows.
    pub stride: usize,
}

impl<'a> Matrix<'a> {
    /// Returns a `rows x columns` matrix without gaps.
    #[inline(always)]
    pub fn new(values: &'a [f32], rows: usize, columns: usize) -> Self {
        Self { values, rows, columns, stride: columns }
    }

    /// Returns a range of its columns.
    #[inline(always)]
    pub fn columns(self, first: usize, columns: usize) -> Self {
        assert!(first + columns <= self.columns);
        Self { values: &self.values[first..], columns, ..self }
    }

    fn assert_inside(&self) {
        assert!(
            self.rows == 0 || self.columns == 0 || (self.rows - 1) * self.stride + self.columns <= self.values.len()
        );
    }
}

/// Which factor of a product is transposed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Form {
    /// `a b`.
    Plain,
    /// `a^T b`.
    LeftTransposed,
    /// `a b^T`.
    RightTransposed,
}

/// Computes `out += product` or `out = product`; rows of `out` are `stride` apart.
///
/// # Panics
/// If the sizes do not fit.
pub(super) fn multiply(form: Form, a: Matrix<'_>, b: Matrix<'_>, out: &mut [f32], stride: usize, add: bool) {
    let (rows, inner, a_strides) = match form {
        Form::LeftTransposed => (a.columns, a.rows, (a.stride, 1)),
        _ => (a.rows, a.columns, (1, a.stride)),
    };
    let (columns, b_inner, b_strides) = match form {
        Form::RightTransposed => (b.rows, b.columns, (b.stride, 1)),
        _ => (b.columns, b.rows, (1, b.stride)),
    };
    assert_eq!(inner, b_inner);
    a.assert_inside();
    b.assert_inside();
    assert!(columns <= stride && (rows == 0 || (rows - 1) * stride + columns <= out.len()));
    // SAFETY: the assertions above keep all indices within the three slices for these sizes and strides, and
    // `out` is borrowed mutably, so it overlaps neither factor. Strides are in (column, row) order.
    unsafe {
        gemm::gemm(
            rows,
            columns,
            inner,
            out.as_mut_ptr(),
            1,
            stride as isize,
            add,
            a.values.as_ptr(),
            a_strides.0 as isize,
            a_strides.1 as isize,
            b.values.as_ptr(),
            b_strides.0 as isize,
            b_strides.1 as isize,
            1.0,
            1.0,
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
}

/// Returns the lanes from `first` on.
#[inline(always)]
pub(super) fn lanes_mut(values: &mut [f32], first: usize) -> &mut Lanes {
    values[first..].first_chunk_mut().expect("a whole number of lanes")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_match_their_definition() {
        let a: Vec<f32> = (0..35).map(|k| (k % 7) as f32 - 2.5).collect();
        let b: Vec<f32> = (0..66).map(|k| (k % 5) as f32 - 1.5).collect();
        // a is 5 x 6 with rows 7 apart; b is 6 x 11, or 11 x 6 when transposed.
        let a_matrix = Matrix::new(&a, 5, 7).columns(1, 6);
        let element = |i: usize, k: usize| a[i * 7 + 1 + k];
        let mut out = vec![1.0; 5 * 12];
        multiply(Form::Plain, a_matrix, Matrix::new(&b, 6, 11), &mut out, 12, true);
        let expected = |i: usize, j: usize| (0..6).map(|k| element(i, k) * b[k * 11 + j]).sum::<f32>();
        assert!((0..55).all(|at| (out[at / 11 * 12 + at % 11] - 1.0 - expected(at / 11, at % 11)).abs() < 1e-4));
        assert!((0..5).all(|row| out[row * 12 + 11] == 1.0));

        multiply(Form::RightTransposed, a_matrix, Matrix::new(&b, 11, 6), &mut out, 12, false);
        let expected = |i: usize, j: usize| (0..6).map(|k| element(i, k) * b[j * 6 + k]).sum::<f32>();
        assert!((0..55).all(|at| (out[at / 11 * 12 + at % 11] - expected(at / 11, at % 11)).abs() < 1e-4));

        let mut out = vec![f32::NAN; 6 * 13];
        multiply(Form::LeftTransposed, a_matrix, Matrix::new(&b[..65], 5, 13), &mut out, 13, false);
        let expected = |i: usize, j: usize| (0..5).map(|k| element(k, i) * b[k * 13 + j]).sum::<f32>();
        assert!((0..78).all(|at| (out[at] - expected(at / 13, at % 13)).abs() < 1e-4));
    }

    #[test]
    #[should_panic(expected = "assertion")]
    fn mismatched_sizes_are_rejected() {
        multiply(Form::Plain, Matrix::new(&[0.0; 6], 2, 3), Matrix::new(&[0.0; 6], 2, 3), &mut [0.0; 9], 3, false);
    }
}
