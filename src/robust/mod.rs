// SPDX-License-Identifier: MIT OR Apache-2.0

//! Robust statistics, for `flow` and `solve` alike.
//!
//! | file | content |
//! |---|---|
//! | [`loss`] | cost, weight and log likelihood of a residual; effective number of weights |
//! | [`median`] | the median, and the variance that follows from it |
//! | [`motion`] | the motion that most displacements share, by iteratively re-weighted least squares |

pub mod loss;
pub mod median;
pub mod motion;
