// SPDX-License-Identifier: MIT OR Apache-2.0

//! The leans and bends of frames from their changes.
//!
//! Where frames were moved after their readout, the lean of one does not follow from its motion, but its changes are seen, and
//! a stabiliser leaves slow motions in the picture. So each component of the lean is taken as
//!
//! > lᵢ = γ·vᵢ + rᵢ, rᵢ ~ GP(0, s²·m(|i − j|/L)), γ ~ N(0, ½²),
//! >
//! > yᵢ = lᵢ₊₁ − lᵢ + bᵢ + noise, bᵢ ~ GP(0, q²·exp(−|i − j|/5)),
//!
//! v the velocity of the picture as it was placed, yᵢ the changes. A stabiliser moves a frame by no more than it crops, so r is
//! the velocity of a stationary process, whose sum over many frames is nearly 0: with Matérn's correlation of order 5/2,
//! m(d) = (1 + x − x²)·exp(−x), x = √5·d. The slow strain b stands for parallax, which integrated would be a drift. The length L is
//! the likeliest of a few, s² that with which the changes have their mean square: 2s²·(1 − m(1/L)).
//!
//! The bend Qᵢ = γ·dl/dt, the second derivative of a displacement by its place, is taken as such a process, too, with the curvatures of
//! pairs as its changes, as γ and its sign are not known. At γ = 0.42 and 0.4 cycles a frame it is as large as the lean.

use crate::solve::continuous::prior::READOUT_DEVIATION;
use nalgebra::{DMatrix, DVector};

/// Lengths L in frames. With a longer one, 6 or 8, half as much again of a walker's lean is left.
const LENGTHS: [f64; 5] = [1.0, 1.4, 2.0, 2.8, 4.0];
/// Deviation of the slow strain, over that of the changes and over that of their noise, of which the greater counts; the
/// frames over which it changes. On rendered footage the errors of the changes have 0.07 (turning cameras) to 0.2 (parallax)
/// of the deviation of the changes, with parallax 4 to 8 times that of the noise, and a correlation of 0.8 from one to the next.
const STRAIN: f64 = 0.07;
const STRAIN_OF_NOISE: f64 = 8.0;
const STRAIN_FRAMES: f64 = 5.0;

/// Deviation of the errors of the bend's changes over that of the lean's slow strain: of rendered walks and shakes 2.8 to 3.3.
const BEND_ERROR: f64 = 3.0;

/// A component of the leans or bends of successive frames, as it is seen.
#[derive(Clone, Debug)]
pub struct Series {
    /// From one frame to the next; the variance of one that is unknown is infinite.
    changes: Vec<Component>,
    /// Velocity of the picture at each frame, one more than changes.
    velocities: Vec<f64>,
    /// Variance of the slow strain.
    strain: f64,
}

/// A component of a lean, of a bend or of the change of one, and its variance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Component {
    pub value: f64,
    pub variance: f64,
}

impl Series {
    /// A component of the lean.
    pub fn of_lean(changes: Vec<Component>, velocities: Vec<f64>) -> Self {
        let series = Self { changes, velocities, strain: 0.0 };
        let [square, noise] = mean_squares(&series.known());
        let strain = (STRAIN * STRAIN * square).max(STRAIN_OF_NOISE * STRAIN_OF_NOISE * noise);
        Self { strain, ..series }
    }

    /// A component of the bend, from its changes and that component of the lean.
    pub fn of_bend(changes: Vec<f64>, lean: &Self) -> Self {
        let variance = BEND_ERROR * BEND_ERROR * lean.strain;
        let change =
            |(value, lean): (f64, &Component)| Component { value, variance: variance.max(lean.variance) };
        Self {
            changes: changes.into_iter().zip(&lean.changes).map(change).collect(),
            velocities: vec![0.0; lean.velocities.len()],
            strain: 0.0,
        }
    }

    /// The changes that are known, by the frame before them.
    fn known(&self) -> Vec<(usize, Component)> {
        self.changes.iter().copied().enumerate().filter(|(_, change)| change.variance.is_finite()).collect()
    }

    /// Of a frame that is not between the changes.
    pub fn unknown(&self) -> Component {
        let [square, _] = mean_squares(&self.known());
        Component { value: 0.0, variance: square * LENGTHS.map(spread).into_iter().fold(0.0, f64::max) }
    }

    /// The component of a frame as estimated from the changes, at each correlation length that they do not contradict.
    fn conditioned(&self, frame: usize) -> [Option<Conditioned>; LENGTHS.len()] {
        let known = self.known();
        let [square, _] = mean_squares(&known);
        let seen = DVector::from_iterator(known.len(), known.iter().map(|(_, change)| change.value));
        let turning = DVector::from_iterator(
            known.len(),
            known.iter().map(|(index, _)| self.velocities[index + 1] - self.velocities[*index]),
        );
        LENGTHS.map(|length| {
            let scale = square * spread(length);
            // Covariances of leans, and of changes, that are so many frames apart.
            let leans: Vec<f64> = (0..self.changes.len() + 2)
                .map(|distance| scale * correlation(distance as f64 / length))
                .collect();
            let changes: Vec<f64> = (0..self.changes.len())
                .map(|distance| {
                    let slow = self.strain * (-(distance as f64) / STRAIN_FRAMES).exp();
                    2.0 * leans[distance] - leans[distance + 1] - leans[distance.abs_diff(1)] + slow
                })
                .collect();
            let between = |a: usize, b: usize| {
                let own = if a == b { known[a].1.variance } else { 0.0 };
                changes[known[a].0.abs_diff(known[b].0)] + own
            };
            let own = DVector::from_iterator(
                known.len(),
                known
                    .iter()
                    .map(|(index, _)| leans[frame.abs_diff(index + 1)] - leans[frame.abs_diff(*index)]),
            );
            let solved = DMatrix::from_fn(known.len(), known.len(), between).cholesky()?;
            let [by_seen, by_turning] = [solved.solve(&seen), solved.solve(&turning)];
            let determinant: f64 = solved.l_dirty().diagonal().iter().map(|root| root.ln()).sum();
            Some(Conditioned {
                log_likelihood: -0.5 * seen.dot(&by_seen) - determinant,
                cross: turning.dot(&by_seen),
                information: turning.dot(&by_turning),
                value: own.dot(&by_seen),
                by_gamma: self.velocities[frame] - own.dot(&by_turning),
                variance: (scale - own.dot(&solved.solve(&own))).max(0.0),
            })
        })
    }
}

/// Mean square of known changes, and of their noise.
fn mean_squares(known: &[(usize, Component)]) -> [f64; 2] {
    let mean = |of: fn(&Component) -> f64| {
        known.iter().map(|(_, change)| of(change)).sum::<f64>() / known.len().max(1) as f64
    };
    [mean(|change| change.value * change.value), mean(|change| change.variance)]
}

/// A component of the lean of a frame, given the changes and γ: `value` + γ·`by_gamma`, with `variance`. Of γ
/// the changes say `information`·γ = `cross`.
#[derive(Clone, Copy)]
struct Conditioned {
    log_likelihood: f64,
    cross: f64,
    information: f64,
    value: f64,
    by_gamma: f64,
    variance: f64,
}

/// The components of the lean of the frame before the change numbered `frame`, or after the last one; all have the same γ and the same
/// length.
pub fn smoothed<const N: usize>(series: &[Series; N], frame: usize) -> [Component; N] {
    let conditioned = series.each_ref().map(|component| component.conditioned(frame));
    let fits = (0..LENGTHS.len()).filter_map(|length| {
        let all: Vec<Conditioned> = conditioned.iter().map(|of| of[length]).collect::<Option<_>>()?;
        let sum = |of: fn(&Conditioned) -> f64| all.iter().map(of).sum::<f64>();
        let information = READOUT_DEVIATION.powi(-2) + sum(|one| one.information);
        let gamma = sum(|one| one.cross) / information;
        let likelihood =
            sum(|one| one.log_likelihood) + 0.5 * (gamma * gamma * information - information.ln());
        let component = |one: &Conditioned| Component {
            value: one.value + gamma * one.by_gamma,
            variance: one.variance + one.by_gamma * one.by_gamma / information,
        };
        Some((likelihood, std::array::from_fn(|index| component(&all[index]))))
    });
    let likeliest = fits.max_by(|a, b| a.0.total_cmp(&b.0));
    likeliest.map_or_else(|| series.each_ref().map(Series::unknown), |(_, found)| found)
}

/// Variance of a lean over that of its changes.
fn spread(length: f64) -> f64 {
    0.5 / (1.0 - correlation(1.0 / length))
}

/// Correlation of the velocity of a process with Matérn's correlation of order 5/2.
fn correlation(distance: f64) -> f64 {
    let scaled = 5f64.sqrt() * distance;
    (1.0 + scaled - scaled * scaled) * (-scaled).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const VARIANCE: f64 = 1e-3;

    /// Of this lean, 30 changes of a picture with this velocity.
    fn series(lean: impl Fn(f64) -> f64, velocity: impl Fn(f64) -> f64) -> Series {
        let change =
            |k: usize| Component { value: lean((k + 1) as f64) - lean(k as f64), variance: VARIANCE };
        Series::of_lean((0..30).map(change).collect(), (0..=30).map(|k| velocity(k as f64)).collect())
    }

    fn found(series: Series, frame: usize) -> Component {
        let [found] = smoothed(&[series], frame);
        found
    }

    #[test]
    fn shake_is_found_from_its_changes() {
        let lean = |t: f64| 5.0 * (TAU * 0.21 * t).sin() + 3.0 * (TAU * 0.13 * t + 1.0).sin();
        for frame in [10, 18, 26] {
            let found = found(series(lean, |_| 0.0), frame);
            let error = (found.value - lean(frame as f64)).abs();
            assert!(error < 1.2 && error < 2.0 * found.variance.sqrt(), "{frame}: {found:?}, {error}");
            // The mean square of the lean is 17.
            assert!(found.variance < 10.0, "{found:?}");
        }
    }

    #[test]
    fn a_constant_lean_and_a_slow_strain_do_not_show() {
        let constant = found(series(|_| 4.0, |_| 0.0), 20);
        assert!(constant.value.abs() < 1e-9, "{constant:?}");
        let lean = |t: f64| 5.0 * (TAU * 0.21 * t).sin();
        let strained = found(series(|t| lean(t) + 0.3 * t, |_| 0.0), 20);
        assert!((strained.value - lean(20.0)).abs() < 1.5, "{strained:?}");
    }

    /// A stabiliser takes out the shake and leaves a slow motion: its lean is then told by the velocity that is left.
    #[test]
    fn what_of_the_motion_is_left_tells_the_slow_part_of_the_lean() {
        let slow = |t: f64| 12.0 * (TAU * 0.025 * t + 0.5).sin();
        let lean = |t: f64| 0.6 * (slow(t) + 5.0 * (TAU * 0.21 * t).sin());
        let [mut with, mut without, mut whole] = [0.0; 3];
        for frame in 2..29 {
            let lean_of_frame = lean(frame as f64);
            let error = |series: Series| (found(series, frame).value - lean_of_frame).powi(2);
            with += error(series(lean, slow));
            without += error(series(lean, |_| 0.0));
            whole += lean_of_frame.powi(2);
        }
        assert!(with < 0.25 * without && with < 0.1 * whole, "{with}, {without} of {whole}");
    }

    #[test]
    fn without_changes_nothing_is_known() {
        let none = Series::of_lean(Vec::new(), vec![0.0]);
        assert_eq!(found(none, 0), Component::default());
        let unknown = Component { value: 3.0, variance: f64::INFINITY };
        let unknown = Series::of_lean(vec![unknown; 8], vec![1.0; 9]);
        assert_eq!(found(unknown, 4).value, 0.0);
    }
}
