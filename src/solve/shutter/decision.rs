//! From two readout times with their errors to a direction and how sure it is.

use super::regression::Gaussian;
use super::{ReadoutEstimate, Verdict};
use crate::readout::ReadoutDirection;
use std::f64::consts::TAU;

/// What is expected before anything was seen, from first to last: rows downwards, as of cameras held
/// upright, and upwards; columns either way; a global shutter.
const EXPECTED: [f64; 5] = [0.5, 0.15, 0.12, 0.12, 0.1];
/// And that the picture says nothing of the camera: stabilised, re-timed, fast vibration.
const UNEXPECTED: f64 = 0.01;
/// What is unexpected shows as times within so many periods either way.
const RANGE: f64 = 2.0;
/// The misfit counts as that of Student's t with so many degrees of freedom: the errors of the errors.
const FREEDOM: f64 = 6.0;
/// A readout is known if its direction is that probable.
const SURE: f64 = 0.95;
/// And if its standard error is at most so many periods.
const PRECISE: f64 = 0.15;
/// A readout of at most so many periods, with two standard errors, is none.
const SHORT: f64 = 0.08;

/// The directions in the order of [`EXPECTED`], with the axis that is read and its sign.
const DIRECTIONS: [(ReadoutDirection, usize, f64); 4] = [
    (ReadoutDirection::TopToBottom, 1, 1.0),
    (ReadoutDirection::BottomToTop, 1, -1.0),
    (ReadoutDirection::LeftToRight, 0, 1.0),
    (ReadoutDirection::RightToLeft, 0, -1.0),
];

/// One direction: how long the readout takes in it, held to 0 … 1 periods, and how well that fits.
struct Candidate {
    direction: ReadoutDirection,
    time: f64,
    error: f64,
    weight: f64,
}

/// Weighs the directions against each other; `found` is in frame periods of `period` seconds.
pub(super) fn decide(found: &Gaussian, period: f64) -> Option<ReadoutEstimate> {
    let precision = found.covariance.try_inverse()?;
    let misfit = found.mean.dot(&(precision * found.mean));
    let candidates = [0, 1, 2, 3].map(|index| {
        let (direction, axis, sign) = DIRECTIONS[index];
        let other = 1 - axis;
        let own = precision[(axis, axis)];
        // The time along this axis, given that there is none along the other.
        let free = sign * (found.mean[axis] + precision[(axis, other)] / own * found.mean[other]);
        let (time, error) = (free.clamp(0.0, 1.0), 1.0 / own.sqrt());
        let misfit = misfit - free * free * own + (free - time).powi(2) * own;
        // Of all times from 0 to 1 this share fits.
        let share = (error * TAU.sqrt() / if free == time { 1.0 } else { 2.0 }).min(1.0);
        Candidate { direction, time, error, weight: EXPECTED[index] * likelihood(misfit) * share }
    });
    let global = EXPECTED[4] * likelihood(misfit);
    let area = TAU * found.covariance.determinant().max(0.0).sqrt();
    let unexpected = UNEXPECTED * (area / (4.0 * RANGE * RANGE)).min(1.0);
    let total = candidates.iter().map(|candidate| candidate.weight).sum::<f64>() + global + unexpected;
    let best = candidates.iter().max_by(|a, b| a.weight.total_cmp(&b.weight))?;
    let axis = |candidate: &Candidate| candidate.direction.is_by_rows();
    let same = candidates.iter().filter(|candidate| axis(candidate) == axis(best));
    let along = (same.map(|candidate| candidate.weight).sum::<f64>() + global) / total;
    let short = |candidate: &Candidate| candidate.time + 2.0 * candidate.error < SHORT;
    let right = best.weight / total;
    let (verdict, confidence) = if candidates.iter().all(short) {
        (Verdict::Global, along)
    } else if right > SURE && best.error < PRECISE {
        (Verdict::Rolling, right)
    } else {
        (Verdict::Unknown, right)
    };
    Some(ReadoutEstimate {
        verdict,
        direction: best.direction,
        time: best.time * period,
        standard_error: best.error * period,
        confidence,
        times: found.mean * period,
        covariance: found.covariance * (period * period),
    })
}

/// How well a misfit, in squared standard errors, is borne.
fn likelihood(misfit: f64) -> f64 {
    (1.0 + misfit.max(0.0) / FREEDOM).powf(-(FREEDOM + 2.0) / 2.0)
}
