//! The share of the changes of the lean that the shifts between the frames do not explain.
//!
//! Of each coordinate, weighted by the inverse variance,
//!
//! > l′ − l = γ·(v′ − v) + b·s + noise,
//!
//! where b·s stands for parallax: a scene whose depth varies along the scan axis is sheared in proportion to the shift, so s
//! is 1, the shift and the stretch of the lines. With b eliminated, γ is limited to ±1. The median of the variances is added
//! to each, as the three degrees of freedom of a pair's do not determine it.

use super::lean::LeanChange;
use super::velocity::velocities;
use crate::robust::median::median;
use nalgebra::{Matrix4, Vector2, Vector4};
use std::f64::consts::PI;

/// Mean square of the changes over their variance, from which on they are no parallax and no noise: of rendered scenes
/// with much parallax and of still ones up to 15, of shaken ones 80 to 28,000.
const MIN_SIGNAL: f64 = 30.0;
/// Root mean square of the changes of the curvature over those of the lean. With |γ| ≤ 1 a motion below half a cycle a
/// frame has π at most; above, frames are too rare to know its velocity.
const MAX_BEND: f64 = PI;

/// How the changes of the lean agree with the shifts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Explained {
    /// Share of the mean square of the changes that is not explained, 0 to 1.
    pub unexplained: f64,
    /// Mean square of the changes over their variance.
    pub signal: f64,
    /// Root mean square of the changes of curvature over those of the lean.
    pub bend: f64,
    /// Number of changes.
    pub count: usize,
}

impl Explained {
    /// Whether the changes are certain enough, and slow enough, to be compared with the shifts.
    pub fn is_telling(&self) -> bool {
        self.signal > MIN_SIGNAL && self.bend < MAX_BEND
    }

    /// Log likelihood ratio in nats over another explanation of the same changes, of normal errors of unknown
    /// variance.
    pub fn log_likelihood_over(&self, other: &Self) -> f64 {
        // Each pair has two changes.
        self.count as f64 * (other.unexplained / self.unexplained).ln()
    }
}

/// The agreement of successive pairs whose frames have these stamps, one more than pairs; `noise` is the least variance
/// of a change in squared radii. `None` if nothing is known.
pub fn explained(pairs: &[LeanChange], stamps: &[f64], noise: f64) -> Option<Explained> {
    let shifts: Vec<Vector2<f64>> = pairs.iter().map(|pair| pair.shift).collect();
    let velocities = velocities(&shifts, stamps);
    let mut variances: Vec<f64> =
        pairs.iter().flat_map(|pair| [pair.variance.x, pair.variance.y]).filter(|v| v.is_finite()).collect();
    let usual = median(&mut variances).max(noise);
    let mut all = Sums::default();
    for coordinate in 0..2 {
        all += coordinate_sums(pairs, &velocities, coordinate, usual)?;
    }
    let gamma = (all.cross / all.velocity).clamp(-1.0, 1.0);
    let rest = all.change - 2.0 * gamma * all.cross + gamma * gamma * all.velocity;
    let squares = |of: fn(&LeanChange) -> f64| pairs.iter().map(|pair| of(pair).powi(2)).sum::<f64>();
    let found = Explained {
        unexplained: rest / all.change,
        signal: all.change / variances.len() as f64,
        bend: (squares(|pair| pair.bend) / squares(|pair| pair.change.x)).sqrt(),
        count: pairs.len(),
    };
    (found.unexplained.is_finite() && found.bend.is_finite()).then_some(found)
}

/// Sums of squares and products of changes of lean and velocity without what parallax explains, weighted.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    change: f64,
    cross: f64,
    velocity: f64,
}

impl std::ops::AddAssign for Sums {
    fn add_assign(&mut self, other: Self) {
        self.change += other.change;
        self.cross += other.cross;
        self.velocity += other.velocity;
    }
}

fn coordinate_sums(
    pairs: &[LeanChange],
    velocities: &[Vector2<f64>],
    coordinate: usize,
    usual: f64,
) -> Option<Sums> {
    let mut normal = Matrix4::zeros();
    let [mut by_change, mut by_velocity] = [Vector4::zeros(); 2];
    let mut sums = Sums::default();
    for (pair, frames) in pairs.iter().zip(velocities.windows(2)) {
        let weight = 1.0 / (pair.variance[coordinate] + usual);
        let [change, velocity] = [pair.change[coordinate], frames[1][coordinate] - frames[0][coordinate]];
        let terms = Vector4::new(1.0, pair.shift.x, pair.shift.y, pair.stretch);
        normal += terms * terms.transpose() * weight;
        by_change += terms * (change * weight);
        by_velocity += terms * (velocity * weight);
        sums += Sums {
            change: change * change * weight,
            cross: change * velocity * weight,
            velocity: velocity * velocity * weight,
        };
    }
    // A ridge, as of a still picture all terms but the first are 0.
    let ridge = f64::EPSILON * normal.trace();
    let solved = (normal + Matrix4::identity() * ridge).cholesky()?;
    let [of_change, of_velocity] = [solved.solve(&by_change), solved.solve(&by_velocity)];
    Some(Sums {
        change: sums.change - by_change.dot(&of_change),
        cross: sums.cross - by_change.dot(&of_velocity),
        velocity: sums.velocity - by_velocity.dot(&of_velocity),
    })
}
