// SPDX-License-Identifier: MIT OR Apache-2.0

//! The exact truth of a sequence: where each pixel belongs, and where it is seen next.

mod capture;
mod dense;

pub use capture::{Capture, ExactMatch, Sample};
pub use dense::DisplacementMap;
