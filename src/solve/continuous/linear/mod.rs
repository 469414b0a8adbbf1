// SPDX-License-Identifier: MIT OR Apache-2.0

//! Residuals of the pairs, and their normal equations.

mod banded;
mod bands;
mod equations;
pub mod evaluated;
mod normal;
mod pair_residuals;
mod parallax;
mod residual;
mod shared;
mod system;

pub use banded::Banded;
pub use evaluated::EvaluatedPair;
pub use pair_residuals::INLIER_SQUARE;
pub use residual::Evaluator;
pub use shared::{SHARED, Shared};
pub use system::{SharedEquations, System};
