// SPDX-License-Identifier: MIT OR Apache-2.0

//! Parallel iteration: on rayon's threads with the feature `rayon`, sequential without it.
//!
//! Without the feature, this module provides the used names of rayon for the iterators of the standard
//! library.

#[cfg(feature = "rayon")]
pub(crate) use rayon::{join, prelude::*, scope};
#[cfg(not(feature = "rayon"))]
pub(crate) use sequential::*;

#[cfg(not(feature = "rayon"))]
mod sequential {
    use std::slice::{Chunks, ChunksMut, IterMut};

    pub fn join<A, B>(first: impl FnOnce() -> A, second: impl FnOnce() -> B) -> (A, B) {
        (first(), second())
    }

    pub fn scope<R>(work: impl FnOnce(&()) -> R) -> R {
        work(&())
    }

    pub trait ParallelSlice<T> {
        fn par_iter_mut(&mut self) -> IterMut<'_, T>;
        fn par_chunks(&self, size: usize) -> Chunks<'_, T>;
        fn par_chunks_mut(&mut self, size: usize) -> ChunksMut<'_, T>;
    }

    impl<T> ParallelSlice<T> for [T] {
        fn par_iter_mut(&mut self) -> IterMut<'_, T> {
            self.iter_mut()
        }

        fn par_chunks(&self, size: usize) -> Chunks<'_, T> {
            self.chunks(size)
        }

        fn par_chunks_mut(&mut self, size: usize) -> ChunksMut<'_, T> {
            self.chunks_mut(size)
        }
    }

    pub trait IntoParallelIterator: IntoIterator + Sized {
        fn into_par_iter(self) -> Self::IntoIter {
            self.into_iter()
        }
    }

    impl<I: IntoIterator> IntoParallelIterator for I {}

    pub trait ParallelIterator: Iterator + Sized {
        fn with_min_len(self, _: usize) -> Self {
            self
        }

        fn for_each_init<S>(self, init: impl FnOnce() -> S, work: impl Fn(&mut S, Self::Item)) {
            let mut state = init();
            self.for_each(|item| work(&mut state, item));
        }
    }

    impl<I: Iterator> ParallelIterator for I {}
}
