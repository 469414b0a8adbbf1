// SPDX-License-Identifier: MIT OR Apache-2.0

//! The fit of a path, γ and κ to the pairs of a window.
//!
//! Gauss–Newton on banded normal equations. Between steps, the variances of the prior and of the residuals
//! are estimated again. Successive windows share pairs, so the estimates of γ and κ of one window enter the
//! beliefs by the share that is new.

mod gauss_newton;
mod multistart;
mod posterior;
mod setup;

pub use gauss_newton::{Summary, fit};
pub use multistart::{COMPARED_PAIRS, DECISIVE_LOG_ODDS, Multistart, STEPS};
pub use posterior::{Covariance, MAX_READOUT_DEVIATION, Posterior};
pub use setup::Setup;
