// SPDX-License-Identifier: MIT OR Apache-2.0

//! The paper's estimator: one 2D rotation a frame, each from its neighbour.
//!
//! | file | the paper's |
//! |---|---|
//! | [`measurement`] | measurement constraint 25.4 and its sparse Levenberg–Marquardt |
//! | `start` | (robust initial estimate; not in the paper) |
//! | [`link`] | one pair: uniform rotation 25.6, sequential steps 25.7–25.10 |
//! | [`window`] | least E over the window, both directions, final choice 25.4.1.3 |

pub mod link;
pub mod measurement;
mod start;
pub mod window;

#[cfg(test)]
mod tests;
