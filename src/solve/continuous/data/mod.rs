// SPDX-License-Identifier: MIT OR Apache-2.0

//! Measurements: the correspondences of the pairs of frames in a window.

mod dominant;
mod matches;
mod overlay;
mod pair;
mod window;

pub use matches::{Match, ScanAxis};
pub use overlay::StaticOverlay;
#[cfg(test)]
pub use pair::Track;
pub use pair::{FramePair, INDEPENDENT_MATCHES};
pub use window::{PairWindow, breadth};
