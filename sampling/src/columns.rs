//! Columns: numbers of many samples as structure of arrays, in strips of [`LANES`] samples.
//!
//! A column of `n` samples is a slice of `n.div_ceil(LANES)` strips. Lanes beyond the last sample hold
//! arbitrary numbers, which are computed but never read, so that no loop has a remainder.

use std::{
    cell::RefCell,
    ops::{Deref, DerefMut},
};

use crate::simd::{LANES, Lanes};

/// Number of strips of `samples` samples.
pub fn strips(samples: usize) -> usize {
    samples.div_ceil(LANES)
}

/// A pool of reusable buffers: nothing is allocated once it is warm. Each thread has its own.
#[derive(Debug, Default)]
pub struct Arena {
    columns: RefCell<Vec<Vec<Lanes>>>,
    lists: RefCell<Vec<Vec<u16>>>,
}

impl Arena {
    /// Returns `N` columns of `strips` strips with arbitrary content.
    pub fn columns<const N: usize>(&self, strips: usize) -> Columns<'_, N> {
        let mut buffer = self.columns.borrow_mut().pop().unwrap_or_default();
        let needed = N * strips;
        if buffer.len() < needed {
            buffer.resize(needed, [0.0; LANES]);
        }
        Columns { arena: self, buffer, strips }
    }

    /// Returns an empty list of rows.
    pub fn list(&self) -> List<'_> {
        let mut list = self.lists.borrow_mut().pop().unwrap_or_default();
        list.clear();
        List { arena: self, list }
    }
}

/// Columns that return to their arena when dropped.
#[derive(Debug)]
pub struct Columns<'a, const N: usize> {
    arena: &'a Arena,
    buffer: Vec<Lanes>,
    strips: usize,
}

impl<const N: usize> Columns<'_, N> {
    /// The columns.
    #[inline(always)]
    pub fn get(&self) -> [&[Lanes]; N] {
        std::array::from_fn(|k| &self.buffer[k * self.strips..(k + 1) * self.strips])
    }

    /// The columns, mutable.
    #[inline(always)]
    pub fn get_mut(&mut self) -> [&mut [Lanes]; N] {
        let mut rest = &mut self.buffer[..];
        std::array::from_fn(|_| {
            let (column, others) = std::mem::take(&mut rest).split_at_mut(self.strips);
            rest = others;
            column
        })
    }
}

impl<const N: usize> Drop for Columns<'_, N> {
    fn drop(&mut self) {
        self.arena.columns.borrow_mut().push(std::mem::take(&mut self.buffer));
    }
}

/// A list of rows that returns to its arena when dropped.
#[derive(Debug)]
pub struct List<'a> {
    arena: &'a Arena,
    list: Vec<u16>,
}

impl Deref for List<'_> {
    type Target = Vec<u16>;

    fn deref(&self) -> &Vec<u16> {
        &self.list
    }
}

impl DerefMut for List<'_> {
    fn deref_mut(&mut self) -> &mut Vec<u16> {
        &mut self.list
    }
}

impl Drop for List<'_> {
    fn drop(&mut self) {
        self.arena.lists.borrow_mut().push(std::mem::take(&mut self.list));
    }
}

/// Copies the numbers of `rows` from a column, in the order of `rows`.
#[inline(always)]
pub fn gather(column: &[Lanes], rows: &[u16], out: &mut [Lanes]) {
    let (from, to) = (column.as_flattened(), out.as_flattened_mut());
    for (to, &row) in to.iter_mut().zip(rows) {
        *to = from[row as usize];
    }
}

/// Writes numbers back to their `rows`: the inverse of [`gather`].
#[inline(always)]
pub fn scatter(column: &[Lanes], rows: &[u16], out: &mut [Lanes]) {
    let (from, to) = (column.as_flattened(), out.as_flattened_mut());
    for (from, &row) in from.iter().zip(rows) {
        to[row as usize] = *from;
    }
}

/// Defines a function over columns that is compiled for every instruction set (see
/// [`crate::simd::dispatch`]).
///
/// `vectorized! { fn name['a](simd, x: &'a [Lanes], out: &'a mut [Lanes]) { ... } }`; bounds of generic
/// types follow the lifetime: `fn name['a, K: Kernel](simd, ...)`. The first argument names the token of the
/// instruction set.
#[doc(hidden)]
#[macro_export]
macro_rules! vectorized_function {
    ($(#[$meta:meta])* $vis:vis fn $name:ident[$lt:lifetime $(, $generic:ident: $bound:path)*]
        ($simd:ident $(, $argument:ident: $type:ty)* $(,)?) $body:block) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments)]
        $vis fn $name<$lt $(, $generic: $bound)*>($($argument: $type),*) {
            struct Arguments<$lt $(, $generic: $bound)*> {
                $($argument: $type,)*
                kinds: std::marker::PhantomData<(&$lt (), $($generic,)*)>,
            }
            impl<$lt $(, $generic: $bound)*> $crate::simd::Vectorized for Arguments<$lt $(, $generic)*> {
                #[inline(always)]
                fn run<Instructions: $crate::simd::Simd>(self, $simd: Instructions) {
                    let Self { $($argument,)* .. } = self;
                    $body
                }
            }
            $crate::simd::dispatch(Arguments::<$($generic),*> { $($argument,)* kinds: std::marker::PhantomData });
        }
    };
}
pub use crate::vectorized_function as vectorized;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_are_reused() {
        let arena = Arena::default();
        let first = {
            let mut columns = arena.columns::<3>(4);
            columns.get_mut()[2][3][7] = 5.0;
            columns.get()[0].as_ptr()
        };
        let columns = arena.columns::<2>(6);
        assert_eq!(columns.get()[0].as_ptr(), first);
        assert!(columns.get().iter().all(|column| column.len() == 6));
    }

    #[test]
    fn scatter_inverts_gather() {
        let column: Vec<Lanes> = (0..3).map(|s| std::array::from_fn(|l| (s * LANES + l) as f32)).collect();
        let rows = [40, 3, 17, 16];
        let mut picked = [[0.0; LANES]; 1];
        gather(&column, &rows, &mut picked);
        assert_eq!(picked[0][..4], [40.0, 3.0, 17.0, 16.0]);
        let mut back = vec![[-1.0; LANES]; 3];
        scatter(&picked, &rows, &mut back);
        for (k, value) in back.as_flattened().iter().enumerate() {
            assert_eq!(*value, if rows.contains(&(k as u16)) { k as f32 } else { -1.0 });
        }
    }
}
