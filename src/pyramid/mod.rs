// SPDX-License-Identifier: MIT OR Apache-2.0

//! The image pyramid of the luma, built once per frame and shared by all comparisons.
//!
//! | step | file | what it does |
//! |---|---|---|
//! | build | `reducer` | a luma view → the pyramid of a frame |
//! | size | `effort` | at how many pixels a frame is analysed |
//! | reduce | `luma` | any luma view → grey of that size, by area average |
//! | compare | `difference` | difference of two frames, to detect duplicates |
//! | halve | `level` | half the resolution, with a border of replicated pixels |
//!
//! Level 0 has the resolution of the *analysed* luma; level l is 2^l times coarser. Pixel centres are
//! integers on all levels, so that x on level 0 is (x + ½)/2^l − ½ on level l.
//!
//! Gradients are not stored: a kernel that has the rows of a patch in registers computes them with two
//! subtractions per pixel, faster than loading them.

mod difference;
mod effort;
mod level;
mod luma;
mod reducer;

pub(crate) use difference::block_difference;
pub use effort::Effort;
pub(crate) use level::Level;
pub(crate) use luma::grey_row;
pub use reducer::{Pyramid, Reducer};
