//! The fit of a path, γ and κ to the pairs of a window.
//!
//! Gauss–Newton on banded normal equations. Between the steps the variances of the prior and of the residuals are estimated anew.
//! Several windows contain the same pair, so that what a window alone constrains γ and κ to goes into the beliefs only by the
//! share that is new.

mod gauss_newton;
mod multistart;
mod posterior;
mod setup;

pub use gauss_newton::{Summary, fit};
pub use multistart::{DECISIVE_LOG_BAYES_FACTOR, MAX_READOUT_DEVIATION, Multistart, STEPS};
pub use posterior::{Covariance, Posterior};
pub use setup::Setup;
