//! Large read-only tables with random access.
//!
//! Lookups in a table of several megabytes miss the TLB as often as the caches. On Linux, such tables request
//! huge pages.

use std::ops::Deref;

use bytemuck::Pod;

/// Size in bytes from which huge pages are requested: the usual size of one.
const LEAST: usize = 2 << 20;

/// An immutable list, in huge pages where they help.
#[derive(Debug)]
pub enum Large<T> {
    /// In ordinary memory.
    Ordinary(Vec<T>),
    /// In a mapping of its own, for which huge pages were requested.
    #[cfg(target_os = "linux")]
    Mapped(memmap2::MmapMut),
}

impl<T: Pod> From<Vec<T>> for Large<T> {
    fn from(list: Vec<T>) -> Self {
        #[cfg(target_os = "linux")]
        if size_of_val(&list[..]) >= LEAST
            && let Ok(mut map) = memmap2::MmapMut::map_anon(size_of_val(&list[..]))
        {
            // Only advice: a system without huge pages uses ordinary ones.
            let _ = map.advise(memmap2::Advice::HugePage);
            map.copy_from_slice(bytemuck::cast_slice(&list));
            return Self::Mapped(map);
        }
        Self::Ordinary(list)
    }
}

impl<T: Pod> Deref for Large<T> {
    type Target = [T];

    #[inline(always)]
    fn deref(&self) -> &[T] {
        match self {
            Self::Ordinary(list) => list,
            #[cfg(target_os = "linux")]
            Self::Mapped(map) => bytemuck::cast_slice(map),
        }
    }
}

impl<T: Pod> Clone for Large<T> {
    fn clone(&self) -> Self {
        self.to_vec().into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn content_is_kept_for_all_sizes() {
        for length in [0, 1, 1000, LEAST / 4 - 1, LEAST / 4, LEAST / 2 + 3] {
            let list: Vec<f32> = (0..length).map(|k| k as f32).collect();
            let large = Large::from(list.clone());
            assert!(large[..] == list[..] && large.clone()[..] == list[..], "{length}");
        }
    }
}
