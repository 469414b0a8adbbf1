// SPDX-License-Identifier: MIT OR Apache-2.0

//! A start for the minimisation that survives outliers.
//!
//! For a rotation the midpoint m of x and x′ makes x′ − x = 2·tan(ωτ/2)·J(m − c), exactly; with
//! tan(a) ≈ a this is linear in the twist: x′ − x = τ(ω·Jm + v), wrong by (ωτ)³/12 of the distance
//! to c. Reweighted least squares from all points towards the tight loss then lets go of a third
//! of the points even where they agree on a motion of their own.

use super::measurement::{TimedMatch, solve_scaled};
use crate::motion::Twist;
use crate::robust::loss::{GemanMcClure, Loss};
use crate::robust::median::variance_of;
use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

/// Rounds of reweighting: a coherent third at distance d is let go after about ten.
const ROUNDS: usize = 12;
/// The reweighting ends when the spread changes by less than this share.
const SETTLED: f64 = 1e-3;
/// The loss reaches this many standard deviations of the inliers.
const REACH: f64 = 3.0;

/// A robust start and the reach, in px², of the loss that fits the spread found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    pub twist: Twist,
    pub reach: f64,
}

/// The linear twist of most matches. `noise` is the standard deviation of a coordinate in pixels
/// below which the spread is not believed; `errors` is a buffer.
pub(super) fn robust_start(matches: &[TimedMatch], noise: f64, errors: &mut Vec<f64>) -> Option<Start> {
    let mut twist = weighted_twist(matches, |_| 1.0)?;
    let mut reach = f64::INFINITY;
    for _ in 0..ROUNDS {
        let next = reach_of(errors, matches.iter().map(|m| linear_error(m, twist)), noise);
        let settled = (next - reach).abs() < SETTLED * next;
        reach = next;
        if settled {
            break;
        }
        let loss = GemanMcClure(reach);
        twist = weighted_twist(matches, |m| loss.weight(linear_error(m, twist)))?;
    }
    let reach = reach_of(errors, matches.iter().map(|m| m.error(twist)), noise);
    Some(Start { twist, reach })
}

/// The reach that follows the spread of the better half of the errors.
fn reach_of(buffer: &mut Vec<f64>, errors: impl Iterator<Item = f64>, noise: f64) -> f64 {
    buffer.clear();
    buffer.extend(errors);
    REACH * REACH * variance_of(buffer, noise * noise)
}

/// [`TimedMatch::error`] of the linear model, without its sine and cosine.
fn linear_error(m: &TimedMatch, twist: Twist) -> f64 {
    let middle = (m.from + m.to) / 2.0;
    let velocity = Vector2::new(-middle.y, middle.x) * twist.omega + twist.velocity;
    (m.to - m.from - velocity * m.time).norm_squared() / 2.0
}

/// Least squares for x′ − x = τ(ω·Jm + v).
fn weighted_twist(matches: &[TimedMatch], weight: impl Fn(&TimedMatch) -> f64) -> Option<Twist> {
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for m in matches {
        let middle = (m.from + m.to) / 2.0;
        let moved = m.to - m.from;
        let w = weight(m);
        let by_twist = Matrix2x3::new(-middle.y, 1.0, 0.0, middle.x, 0.0, 1.0);
        normal += by_twist.transpose() * by_twist * (w * m.time * m.time);
        right += by_twist.transpose() * moved * (w * m.time);
    }
    solve_scaled(normal, right).map(Twist::from_vector)
}
