//! A start for the minimisation that survives outliers.
//!
//! For a rotation the midpoint m of x and x′ makes x′ − x = 2·tan(ωτ/2)·J(m − c), exactly; with
//! tan(a) ≈ a this is linear in the twist: x′ − x = τ(ω·Jm + v), wrong by (ωτ)³/12 of the distance
//! to c. Reweighted least squares from all points towards the tight loss then lets go of a third
//! of the points even where they agree on a motion of their own.

use super::measurement::{Loss, Match, solve_scaled};
use crate::motion::Twist;
use nalgebra::{Matrix3, Vector3};

/// Rounds of reweighting: a coherent third at distance d is let go after about ten.
const ROUNDS: usize = 12;
/// The loss reaches this many standard deviations of the inliers.
const REACH: f64 = 3.0;
/// Variance of a coordinate over the median error: in units of that variance the error is χ² with
/// 2 degrees of freedom, whose median is 2·ln 2.
const MEDIAN_TO_VARIANCE: f64 = 1.0 / (2.0 * std::f64::consts::LN_2);

/// A robust start and the loss that fits the spread found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    pub twist: Twist,
    pub loss: Loss,
}

/// The linear twist of most matches. `noise` is the standard deviation of a coordinate in pixels
/// below which the spread is not believed; `errors` is a buffer.
pub(super) fn robust_start(matches: &[Match], noise: f64, errors: &mut Vec<f64>) -> Option<Start> {
    let mut twist = weighted_twist(matches, |_| 1.0)?;
    let mut loss = robust_loss(matches, twist, noise, errors);
    for _ in 0..ROUNDS {
        let next = weighted_twist(matches, |m| loss.weight(m.error(twist)))?;
        let settled = matches
            .iter()
            .map(|m| (next.velocity - twist.velocity).norm() * m.time.abs())
            .fold(0.0, f64::max)
            < 1e-3 * noise
            && (next.omega - twist.omega).abs() < 1e-9;
        twist = next;
        loss = robust_loss(matches, twist, noise, errors);
        if settled {
            break;
        }
    }
    Some(Start { twist, loss })
}

/// The loss whose reach follows the spread of the better half of the errors.
pub(super) fn robust_loss(matches: &[Match], twist: Twist, noise: f64, errors: &mut Vec<f64>) -> Loss {
    errors.clear();
    errors.extend(matches.iter().map(|m| m.error(twist)));
    let variance = (median(errors) * MEDIAN_TO_VARIANCE).max(noise * noise);
    Loss::GemanMcClure(REACH * REACH * variance)
}

/// The median, 0 of nothing; reorders the values.
pub(super) fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// Least squares for x′ − x = τ(ω·Jm + v).
fn weighted_twist(matches: &[Match], weight: impl Fn(&Match) -> f64) -> Option<Twist> {
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for m in matches {
        let middle = (m.from + m.to) / 2.0;
        let moved = m.to - m.from;
        let w = weight(m);
        let square = w * m.time * m.time;
        normal += Matrix3::new(
            middle.norm_squared(),
            -middle.y,
            middle.x, //
            -middle.y,
            1.0,
            0.0, //
            middle.x,
            0.0,
            1.0,
        ) * square;
        right += Vector3::new(middle.x * moved.y - middle.y * moved.x, moved.x, moved.y) * (w * m.time);
    }
    solve_scaled(normal, right).map(Twist::from_vector)
}
