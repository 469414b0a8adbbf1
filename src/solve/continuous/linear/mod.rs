//! Residuals of the pairs, and their normal equations.

pub mod banded;
pub mod bands;
pub mod equations;
pub mod evaluated;
pub mod normal;
pub mod pair_residuals;
pub mod parallax;
pub mod residual;
pub mod shared;
pub mod system;
