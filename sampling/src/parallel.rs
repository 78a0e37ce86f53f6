//! Parallel loops with the feature `rayon`; without it, loops on the calling thread with the same results.

#[cfg(feature = "rayon")]
pub use rayon::prelude::*;
#[cfg(not(feature = "rayon"))]
pub use sequential::*;

/// The methods of rayon that this crate calls, on iterators of the standard library.
#[cfg(not(feature = "rayon"))]
mod sequential {
    pub trait IntoParallelIterator {
        type Iter: Iterator<Item = Self::Item>;
        type Item;
        fn into_par_iter(self) -> Self::Iter;
    }

    impl<I: IntoIterator> IntoParallelIterator for I {
        type Iter = I::IntoIter;
        type Item = I::Item;
        fn into_par_iter(self) -> I::IntoIter {
            self.into_iter()
        }
    }

    pub trait IndexedParallelIterator: ParallelIterator {}

    impl<I: Iterator> IndexedParallelIterator for I {}

    pub trait ParallelIterator: Iterator + Sized {
        fn flat_map_iter<J: IntoIterator>(self, of: impl FnMut(Self::Item) -> J) -> impl Iterator<Item = J::Item> {
            self.flat_map(of)
        }

        fn with_min_len(self, _length: usize) -> Self {
            self
        }

        fn for_each_init<T>(self, init: impl Fn() -> T, work: impl Fn(&mut T, Self::Item)) {
            let mut scratch = init();
            self.for_each(|item| work(&mut scratch, item));
        }
    }

    impl<I: Iterator> ParallelIterator for I {}

    pub trait ParallelSlice<T> {
        fn par_iter(&self) -> std::slice::Iter<'_, T>;
        fn par_chunks(&self, size: usize) -> std::slice::Chunks<'_, T>;
    }

    impl<T> ParallelSlice<T> for [T] {
        fn par_iter(&self) -> std::slice::Iter<'_, T> {
            self.iter()
        }

        fn par_chunks(&self, size: usize) -> std::slice::Chunks<'_, T> {
            self.chunks(size)
        }
    }

    pub trait ParallelSliceMut<T> {
        fn par_iter_mut(&mut self) -> std::slice::IterMut<'_, T>;
        fn par_chunks_mut(&mut self, size: usize) -> std::slice::ChunksMut<'_, T>;
        fn par_chunks_exact_mut(&mut self, size: usize) -> std::slice::ChunksExactMut<'_, T>;
        fn par_sort_by_key<K: Ord>(&mut self, key: impl Fn(&T) -> K);
    }

    impl<T> ParallelSliceMut<T> for [T] {
        fn par_iter_mut(&mut self) -> std::slice::IterMut<'_, T> {
            self.iter_mut()
        }

        fn par_chunks_mut(&mut self, size: usize) -> std::slice::ChunksMut<'_, T> {
            self.chunks_mut(size)
        }

        fn par_chunks_exact_mut(&mut self, size: usize) -> std::slice::ChunksExactMut<'_, T> {
            self.chunks_exact_mut(size)
        }

        fn par_sort_by_key<K: Ord>(&mut self, key: impl Fn(&T) -> K) {
            self.sort_by_key(key);
        }
    }
}
