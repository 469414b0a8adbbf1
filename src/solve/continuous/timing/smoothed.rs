// SPDX-License-Identifier: MIT OR Apache-2.0

//! The leans of frames from their changes.
//!
//! Where frames were moved after their readout, the lean of one does not follow from its motion, but its changes are seen.
//! Each component of the lean is taken as a Gaussian process over the frames,
//!
//! > lᵢ ~ GP(0, s²·m(|i − j|/L)),  yᵢ = lᵢ₊₁ − lᵢ + bᵢ + noise,  bᵢ ~ GP(0, q²·exp(−|i − j|/5)),
//!
//! m the Matérn correlation of order 3/2, yᵢ the changes. A constant lean does not show: it is 0 by the prior. The slow
//! strain b stands for parallax, which integrated would be a drift. s is 1.5 times the root mean square of the changes, which of
//! hand-held footage is right within a factor of two; the length L is the likeliest of a few.

use nalgebra::{DMatrix, DVector};

/// Deviation of a lean over that of its changes.
const SPREAD: f64 = 1.5;
/// Deviation of the slow strain, over that of the changes and over that of the noise, of which the greater counts; the
/// frames over which it changes. On rendered footage the errors of the changes have 0.07 (turning cameras) to 0.2
/// (parallax) of their deviation and a correlation of 0.8 from one to the next.
const STRAIN: f64 = 0.1;
const STRAIN_OF_NOISE: f64 = 2.5;
const STRAIN_FRAMES: f64 = 5.0;
/// Lengths L in frames.
const LENGTHS: [f64; 4] = [1.0, 1.5, 3.0, 6.0];

/// A component of the lean of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Component {
    pub value: f64,
    /// After the changes were seen.
    pub variance: f64,
    /// s², before.
    pub prior: f64,
}

impl Component {
    /// That of a frame that is not between the changes.
    pub fn unknown(changes: &[Change]) -> Self {
        let prior = Moments::of(changes).prior();
        Self { value: 0.0, variance: prior, prior }
    }
}

/// A change from one frame to the next, and its variance; infinite if it is unknown.
#[derive(Clone, Copy, Debug)]
pub struct Change {
    pub value: f64,
    pub variance: f64,
}

/// Mean square of the changes that are known, and of their noise.
struct Moments {
    square: f64,
    noise: f64,
}

impl Moments {
    fn of(changes: &[Change]) -> Self {
        let known = changes.iter().filter(|change| change.variance.is_finite());
        let count = known.clone().count().max(1) as f64;
        let square = known.clone().map(|change| change.value * change.value).sum::<f64>() / count;
        Self { square, noise: known.map(|change| change.variance).sum::<f64>() / count }
    }

    /// s².
    fn prior(&self) -> f64 {
        SPREAD * SPREAD * self.square
    }

    /// q².
    fn strain(&self) -> f64 {
        (STRAIN * STRAIN * self.square).max(STRAIN_OF_NOISE * STRAIN_OF_NOISE * self.noise)
    }
}

/// The component of the lean of the frame before the change numbered `frame`, or after the last one.
pub fn smoothed(changes: &[Change], frame: usize) -> Component {
    let moments = Moments::of(changes);
    let [prior, strain] = [moments.prior(), moments.strain()];
    let known: Vec<(usize, Change)> =
        changes.iter().copied().enumerate().filter(|(_, change)| change.variance.is_finite()).collect();
    let seen = DVector::from_iterator(known.len(), known.iter().map(|(_, change)| change.value));
    let fits = LENGTHS.iter().filter_map(|length| {
        // Covariance of the leans of two frames.
        let covariance = |i: usize, j: usize| prior * correlation(i.abs_diff(j) as f64 / length);
        let with_change =
            |frame: usize, index: usize| covariance(frame, index + 1) - covariance(frame, index);
        let between = |a: usize, b: usize| {
            let [(i, change), (j, _)] = [known[a], known[b]];
            let slow = strain * (-(i.abs_diff(j) as f64) / STRAIN_FRAMES).exp();
            let own = if a == b { change.variance } else { 0.0 };
            with_change(i + 1, j) - with_change(i, j) + slow + own
        };
        let solved = DMatrix::from_fn(known.len(), known.len(), between).cholesky()?;
        let weights = solved.solve(&seen);
        let determinant: f64 = solved.l_dirty().diagonal().iter().map(|root| root.ln()).sum();
        let likelihood = -0.5 * seen.dot(&weights) - determinant;
        let own =
            DVector::from_iterator(known.len(), known.iter().map(|(index, _)| with_change(frame, *index)));
        let value = own.dot(&weights);
        let variance = (prior - own.dot(&solved.solve(&own))).max(0.0);
        Some((likelihood, Component { value, variance, prior }))
    });
    let likeliest = fits.max_by(|a, b| a.0.total_cmp(&b.0));
    likeliest.map_or_else(|| Component::unknown(changes), |(_, found)| found)
}

/// Matérn's correlation of order 3/2.
fn correlation(distance: f64) -> f64 {
    let scaled = 3f64.sqrt() * distance;
    (1.0 + scaled) * (-scaled).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn changes(of: impl Fn(f64) -> f64, count: usize, variance: f64) -> Vec<Change> {
        let at = |k: usize| of(k as f64);
        (0..count).map(|k| Change { value: at(k + 1) - at(k), variance }).collect()
    }

    #[test]
    fn shake_is_found_from_its_changes() {
        let lean = |t: f64| 5.0 * (TAU * 0.21 * t).sin() + 3.0 * (TAU * 0.13 * t + 1.0).sin();
        let changes = changes(lean, 30, 1e-3);
        for frame in [10, 18, 26] {
            let found = smoothed(&changes, frame);
            let error = (found.value - lean(frame as f64)).abs();
            assert!(error < 1.2 && error < 2.0 * found.variance.sqrt(), "{frame}: {found:?}, {error}");
            assert!(found.variance < 0.4 * found.prior, "{found:?}");
        }
    }

    #[test]
    fn a_constant_lean_and_a_slow_strain_do_not_show() {
        let constant = smoothed(&changes(|_| 4.0, 30, 1e-3), 20);
        assert!(constant.value.abs() < 1e-9, "{constant:?}");
        let lean = |t: f64| 5.0 * (TAU * 0.21 * t).sin();
        let strained = smoothed(&changes(|t| lean(t) + 0.3 * t, 30, 1e-3), 20);
        assert!((strained.value - lean(20.0)).abs() < 1.5, "{strained:?}");
    }

    #[test]
    fn without_changes_nothing_is_known() {
        assert_eq!(smoothed(&[], 0), Component::default());
        let unknown = Change { value: 3.0, variance: f64::INFINITY };
        assert_eq!(smoothed(&[unknown; 8], 4).value, 0.0);
    }
}
