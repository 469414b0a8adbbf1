// SPDX-License-Identifier: MIT OR Apache-2.0

//! Numbers with a standard deviation, and what several of one number say together.

use rsrectify::readout::Readout;
use serde::Serialize;

/// Standard deviations on either side of the mean between which a normal number lies in 95 of 100 cases.
const SIGMAS: f64 = 1.96;

/// A normal estimate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    pub value: f64,
    /// Standard deviation.
    pub deviation: f64,
}

/// What several estimates say together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Combined {
    pub estimate: Estimate,
    /// Whether they scatter no more than their deviations let expect in 95 of 100 cases.
    pub agree: bool,
}

impl Estimate {
    /// The signed readout time in milliseconds, negative where the bottom row or the right column is read first.
    pub fn of_readout(readout: &Readout, deviation: f64) -> Self {
        let sign = if readout.direction().is_reversed() { -1.0 } else { 1.0 };
        Self { value: sign * readout.time() * 1e3, deviation }
    }

    /// The interval in which the number lies in 95 of 100 cases.
    pub fn interval(&self) -> [f64; 2] {
        [self.value - SIGMAS * self.deviation, self.value + SIGMAS * self.deviation]
    }

    /// Whether the interval leaves the sign open.
    pub fn has_no_sign(&self) -> bool {
        let [low, high] = self.interval();
        low < 0.0 && high > 0.0
    }
}

/// The mean of independent normal estimates, weighted by their inverse variances.
///
/// Where they scatter more than chance allows, its deviation is multiplied by the Birge ratio √(χ²/(n − 1)). `None` without
/// estimates whose deviation is positive and finite.
pub fn combine(estimates: &[Estimate]) -> Option<Combined> {
    let is_valid =
        |one: &&Estimate| one.value.is_finite() && one.deviation.is_finite() && one.deviation > 0.0;
    let estimates: Vec<_> = estimates.iter().filter(is_valid).collect();
    let weight = |one: &Estimate| one.deviation.powi(-2);
    let information: f64 = estimates.iter().map(|one| weight(one)).sum();
    if estimates.is_empty() || !information.is_finite() {
        return None;
    }
    let value = estimates.iter().map(|one| weight(one) * one.value).sum::<f64>() / information;
    let chi_square: f64 = estimates.iter().map(|one| weight(one) * (one.value - value).powi(2)).sum();
    let freedom = (estimates.len() - 1) as f64;
    let agree = freedom == 0.0 || chi_square <= chi_square_limit(freedom);
    let birge = if agree { 1.0 } else { (chi_square / freedom).sqrt() };
    Some(Combined { estimate: Estimate { value, deviation: information.sqrt().recip() * birge }, agree })
}

/// What χ² stays below in 95 of 100 cases, by the approximation of Wilson and Hilferty (1931).
fn chi_square_limit(freedom: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    freedom * (1.0 - spread + 1.6449 * spread.sqrt()).powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn estimate(value: f64, deviation: f64) -> Estimate {
        Estimate { value, deviation }
    }

    #[test]
    fn inverse_variances_are_weights() {
        // (10/1 + 13/(1/4)) / (1 + 4) and 1/√5, χ² = 2.4² + 4·0.6² = 7.2 over 3.84.
        let combined = combine(&[estimate(10.0, 1.0), estimate(13.0, 0.5)]).unwrap();
        assert!((combined.estimate.value - 12.4).abs() < 1e-12 && !combined.agree);
        assert!((combined.estimate.deviation - (7.2_f64 / 5.0).sqrt()).abs() < 1e-12);
        let combined = combine(&[estimate(10.0, 1.0), estimate(11.0, 1.0)]).unwrap();
        assert!(combined.agree && (combined.estimate.deviation - 0.5_f64.sqrt()).abs() < 1e-12);
        assert_eq!(combine(&[estimate(3.0, 0.2)]).unwrap().estimate, estimate(3.0, 0.2));
        assert_eq!(combine(&[estimate(3.0, 0.0), estimate(3.0, f64::INFINITY)]), None);
    }

    #[test]
    fn the_limit_is_that_of_the_tables() {
        // 95 % quantiles of the chi-square distribution.
        for (freedom, limit) in [(1.0, 3.841), (2.0, 5.991), (5.0, 11.070), (20.0, 31.410)] {
            assert!((chi_square_limit(freedom) / limit - 1.0).abs() < 0.03, "{freedom}");
        }
    }

    #[test]
    fn a_sign_is_open_where_zero_is_in_the_interval() {
        assert!(estimate(1.0, 0.6).has_no_sign() && estimate(-1.0, 0.6).has_no_sign());
        assert!(!estimate(1.0, 0.5).has_no_sign() && !estimate(-1.0, 0.5).has_no_sign());
    }
}
