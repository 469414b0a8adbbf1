//! From two readout times with their errors to a direction and how sure it is.

use super::regression::Gaussian;
use std::f64::consts::TAU;

/// What is expected before anything was seen: cameras held upright, cameras on their side, global
/// shutters.
const EXPECTED: [f64; 3] = [0.7, 0.2, 0.1];
/// The misfit counts as that of Student's t with so many degrees of freedom: errors of the errors.
const FREEDOM: f64 = 6.0;

/// What the camera may do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hypotheses {
    /// Rows, columns, nothing is read one after another: probabilities, of sum 1.
    pub probability: [f64; 3],
    /// The signed readout time, if it is read by rows, and if by columns.
    pub time: [f64; 2],
    /// Standard errors of the times.
    pub error: [f64; 2],
}

/// Weighs the hypotheses; times are in frame periods.
pub(super) fn weigh(found: &Gaussian) -> Option<Hypotheses> {
    let precision = found.covariance.try_inverse()?;
    let misfit = found.mean.dot(&(precision * found.mean));
    // Index 0 of the mean is the readout along x, by columns.
    let alone = |axis: usize| {
        let other = 1 - axis;
        let own = precision[(axis, axis)];
        let time = found.mean[axis] + precision[(axis, other)] / own * found.mean[other];
        (time, (1.0 / own).sqrt(), misfit - time * time * own)
    };
    let likelihood = |misfit: f64| (1.0 + misfit.max(0.0) / FREEDOM).powf(-(FREEDOM + 1.0) / 2.0);
    let [columns, rows] = [alone(0), alone(1)];
    // The readout may take any time within ±1: the share of that which the errors leave.
    let left = |error: f64| (error * TAU.sqrt() / 2.0).min(1.0);
    let weights = [
        EXPECTED[0] * likelihood(rows.2) * left(rows.1),
        EXPECTED[1] * likelihood(columns.2) * left(columns.1),
        EXPECTED[2] * likelihood(misfit),
    ];
    let total: f64 = weights.iter().sum();
    (total > 0.0).then(|| Hypotheses {
        probability: weights.map(|weight| weight / total),
        time: [rows.0, columns.0],
        error: [rows.1, columns.1],
    })
}
