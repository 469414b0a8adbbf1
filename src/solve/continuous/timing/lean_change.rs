// SPDX-License-Identifier: MIT OR Apache-2.0

//! The change of the lean between two frames, and its variance.
//!
//! In the motion quadratic in the point that most displacements of a pair share, shift, roll and zoom take up all but
//! two terms of the first degree: with y along the scan axis of length s, the shear ∂dₓ/∂y + ∂d_y/∂x and the stretch
//! ∂d_y/∂y − ∂dₓ/∂x. Times s they are the change of the lean across and along the axis.
//!
//! The roll during the readout leans the picture by the place times a turn, which is in two of the second degree: with σ = 1 of a
//! scan along rows, −1 along columns, −σ·∂²dₓ/2∂y² and σ·(∂²d_y/∂x∂y − ∂²dₓ/2∂x²), times s; the mean of both is taken.
//!
//! The curvature, the second derivative of a displacement by the place, is in three of the second degree each, of which one
//! combination is left by all else: across the axis ∂²dₓ/∂y² − ∂²dₓ/∂x² + 2·∂²d_y/∂x∂y, in units of ½, along it
//! ∂²d_y/∂y² − 2·∂²dₓ/∂x∂y − ∂²d_y/∂x². Neither perspective, nor the first term of a radial distortion of the lens, nor changes of
//! roll and zoom during the readout leave a trace in it.
//!
//! The variance of the lean is what strips of the picture, side by side along the lines, do not share: misfit and parallax are
//! correlated between neighbours, which the residuals do not show.

use crate::robust::loss::GemanMcClure;
use crate::robust::motion::{Motion, Quadratic, ROUNDS, Round, Sample, Scale, fit, quadratic};
use crate::solve::continuous::data::{FramePair, Match, ScanAxis};
use nalgebra::{SMatrix, Vector2};

/// Strips, and fewest matches in one.
const STRIPS: usize = 4;
const MIN_STRIP: usize = 12;
/// The loss of the fits: weight ¼ at three standard deviations.
const LOSS: GemanMcClure = GemanMcClure(9.0);

/// The change of the lean in a pair. Vectors have the coordinate across the scan axis first, in radii.
#[derive(Clone, Copy, Debug)]
pub struct LeanChange {
    /// l′ − l.
    pub change: Vector2<f64>,
    /// Variance of each coordinate of `change` in squared radii; infinite if unknown.
    pub variance: Vector2<f64>,
    /// Shift of the image centre.
    pub shift: Vector2<f64>,
    /// Stretch along the lines, which the shutter does not change.
    pub stretch: f64,
    /// Change of the roll during the readout, in radians.
    pub roll: f64,
    /// Second derivative, by the place along the axis, of the displacement across it: change of the bend within the frame, with
    /// whatever else bends it, such as perspective.
    pub bend: f64,
    /// What is left of the second derivative of the displacement by the place without all else that bends a frame.
    pub curvature: Vector2<f64>,
}

impl LeanChange {
    /// Along a scan axis; `noise` is the least variance of a coordinate of a match in squared radii.
    pub fn of(pair: &FramePair, axis: ScanAxis, noise: f64) -> Self {
        let [across, along] = if axis.by_rows { [0, 1] } else { [1, 0] };
        let motion = shared_motion(pair, noise);
        let slopes = strip_leans(pair, &motion, axis, noise);
        let variance = scatter(&slopes).unwrap_or(Vector2::repeat(f64::INFINITY));
        let a = |coordinate: usize, term: usize| motion.0[(coordinate, term)];
        let shear = a(across, 1 + along) + a(along, 1 + across);
        let stretch = a(across, 1 + across);
        let [along_twice, across_twice] = if axis.by_rows { [5, 3] } else { [3, 5] };
        let sign = if axis.by_rows { 1.0 } else { -1.0 };
        let turns = [-a(across, along_twice), a(along, 4) - a(across, across_twice)];
        let curvature = Vector2::new(
            a(across, along_twice) - a(across, across_twice) + a(along, 4),
            a(along, along_twice) - a(across, 4) - a(along, across_twice),
        );
        Self {
            change: Vector2::new(shear, a(along, 1 + along) - stretch) * axis.length,
            variance: Vector2::new(variance[across], variance[along]),
            shift: Vector2::new(a(across, 0), a(along, 0)),
            stretch,
            roll: 0.5 * sign * turns.iter().sum::<f64>() * axis.length,
            bend: 2.0 * a(across, along_twice) * axis.length * axis.length,
            curvature: curvature * (2.0 * axis.length * axis.length),
        }
    }
}

/// The motion that most displacements share, about the middles between their ends.
fn shared_motion(pair: &FramePair, noise: f64) -> Quadratic {
    let sample = |m: &Match| Sample::new(quadratic(m.middle()), m.displacement());
    let start = pair.dominant_motion();
    refined(pair.matches.iter().map(sample), start, noise).unwrap_or(start)
}

/// The motion that most samples share.
fn refined<const N: usize>(
    samples: impl Iterator<Item = Sample<f64, N>> + Clone,
    start: Motion<f64, N>,
    noise: f64,
) -> Option<Motion<f64, N>> {
    fit(samples, start, LOSS, [Round::new(Scale::Median { least: noise }); ROUNDS])
}

/// The lean that the displacements of each strip have beside the shared motion.
fn strip_leans(pair: &FramePair, shared: &Quadratic, axis: ScanAxis, noise: f64) -> Vec<Vector2<f64>> {
    let place = |m: &Match| axis.across(m.middle());
    let [low, high] = pair
        .matches
        .iter()
        .map(place)
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], place| [low.min(place), high.max(place)]);
    let mut strips: [Vec<Sample<f64, 2>>; STRIPS] = Default::default();
    for m in &pair.matches {
        let strip = ((place(m) - low) / (high - low) * STRIPS as f64) as usize;
        let terms = [1.0, axis.place(m.middle()) - 0.5];
        let rest = m.displacement() - shared.at(&quadratic(m.middle()));
        strips[strip.min(STRIPS - 1)].push(Sample::new(terms.into(), rest));
    }
    strips.iter().filter_map(|strip| slope(strip, noise)).collect()
}

/// The lean that the displacements of a strip share; `None` if they are too few.
fn slope(strip: &[Sample<f64, 2>], noise: f64) -> Option<Vector2<f64>> {
    let still = Motion(SMatrix::zeros());
    let shared = (strip.len() >= MIN_STRIP).then(|| refined(strip.iter().copied(), still, noise))??;
    Some(shared.0.column(1).into_owned())
}

/// Variance of the mean of some values, by coordinate; `None` for fewer than three.
fn scatter(values: &[Vector2<f64>]) -> Option<Vector2<f64>> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<Vector2<f64>>() / count;
    let squares: Vector2<f64> = values.iter().map(|value| (value - mean).map(|rest| rest * rest)).sum();
    (values.len() >= 3).then(|| squares / (count * (count - 1.0)))
}
