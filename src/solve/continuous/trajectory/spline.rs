// SPDX-License-Identifier: MIT OR Apache-2.0

//! Uniform cubic B-splines. Time t is in knot spacings; coefficient i has the support [i − 3, i + 1).

/// Coefficients whose support contains an instant.
pub const KNOTS: usize = 4;

/// The coefficients whose support contains t, and their weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Support {
    /// Index of the first coefficient, ⌊t⌋.
    pub first: i64,
    pub weights: [f64; KNOTS],
}

/// Weights of the spline's value.
pub fn values(t: f64) -> Support {
    let (first, s) = interval(t);
    let (s2, s3) = (s * s, s * s * s);
    let weights = [1.0 - 3.0 * (s - s2) - s3, 4.0 - 6.0 * s2 + 3.0 * s3, 1.0 + 3.0 * (s + s2 - s3), s3];
    Support { first, weights: weights.map(|weight| weight / 6.0) }
}

/// Weights of the spline's derivative by t.
pub fn slopes(t: f64) -> Support {
    let (first, s) = interval(t);
    let s2 = s * s;
    let weights = [2.0 * s - 1.0 - s2, 3.0 * s2 - 4.0 * s, 1.0 + 2.0 * s - 3.0 * s2, s2];
    Support { first, weights: weights.map(|weight| weight / 2.0) }
}

fn interval(t: f64) -> (i64, f64) {
    let first = t.floor();
    (first as i64, t - first)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sum(support: Support, coefficient: impl Fn(f64) -> f64) -> f64 {
        (0..4).map(|k| support.weights[k as usize] * coefficient((support.first + k) as f64)).sum()
    }

    #[test]
    fn coefficients_of_a_line_give_the_line() {
        for time in [-2.75, 0.0, 0.3, 7.99] {
            // Coefficient i is centred at i − 1.
            assert!((sum(values(time), |i| 3.0 * (i - 1.0) + 5.0) - (3.0 * time + 5.0)).abs() < 1e-12);
            assert!((sum(slopes(time), |i| 3.0 * (i - 1.0) + 5.0) - 3.0).abs() < 1e-12);
        }
    }

    #[test]
    fn slopes_are_those_of_the_values() {
        let wild = |i: f64| (i * 1.7).sin();
        let time = 4.37;
        let difference = (sum(values(time + 1e-5), wild) - sum(values(time - 1e-5), wild)) / 2e-5;
        assert!((sum(slopes(time), wild) - difference).abs() < 1e-8);
    }
}
