//! Large read-only tables that are read at random places.
//!
//! A lookup in a table of some megabytes misses the processor's table of page addresses as often as its caches. Where the system has larger
//! pages (Linux), such tables ask for them.

use std::ops::Deref;

use bytemuck::Pod;

/// Tables smaller than this many bytes gain nothing: one of the usual larger pages.
const LEAST: usize = 2 << 20;

/// A list that never changes, in large pages where they help.
#[derive(Debug)]
pub enum Large<T> {
    /// In ordinary memory.
    Ordinary(Vec<T>),
    /// In memory of its own, which was asked for in large pages.
    #[cfg(target_os = "linux")]
    Mapped(memmap2::MmapMut),
}

impl<T: Pod> From<Vec<T>> for Large<T> {
    fn from(list: Vec<T>) -> Self {
        #[cfg(target_os = "linux")]
        if size_of_val(&list[..]) >= LEAST
            && let Ok(mut map) = memmap2::MmapMut::map_anon(size_of_val(&list[..]))
        {
            // Advice: a system without such pages keeps the others.
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
    fn lists_of_every_size_are_kept_as_they_are() {
        for length in [0, 1, 1000, LEAST / 4 - 1, LEAST / 4, LEAST / 2 + 3] {
            let list: Vec<f32> = (0..length).map(|k| k as f32).collect();
            let large = Large::from(list.clone());
            assert!(large[..] == list[..] && large.clone()[..] == list[..], "{length}");
        }
    }
}
