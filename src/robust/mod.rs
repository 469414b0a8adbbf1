//! Robust statistics, for `flow` and `solve` alike.
//!
//! | file | what it has |
//! |---|---|
//! | [`loss`] | what a residual costs, how much it counts, how likely it is; how many equal weights some are worth |
//! | [`median`] | the median, and the variance that follows from it |
//! | [`motion`] | the motion that most displacements share, by iteratively re-weighted least squares |

pub mod loss;
pub mod median;
pub mod motion;
