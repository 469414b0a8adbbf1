//! Uniform cubic B-splines. Coefficient i has a say between the times i − 3 and i + 1, in units
//! of the knot spacing.

/// Weights of the four coefficients that have a say at some instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Support {
    /// Index of the first of them.
    pub first: i64,
    pub weights: [f64; 4],
}

/// Weights for the spline's value.
pub fn values(time: f64) -> Support {
    let (first, s) = interval(time);
    let (s2, s3) = (s * s, s * s * s);
    let weights = [1.0 - 3.0 * (s - s2) - s3, 4.0 - 6.0 * s2 + 3.0 * s3, 1.0 + 3.0 * (s + s2 - s3), s3];
    Support { first, weights: weights.map(|weight| weight / 6.0) }
}

/// Weights for the spline's slope, per knot spacing.
pub fn slopes(time: f64) -> Support {
    let (first, s) = interval(time);
    let s2 = s * s;
    let weights = [2.0 * s - 1.0 - s2, 3.0 * s2 - 4.0 * s, 1.0 + 2.0 * s - 3.0 * s2, s2];
    Support { first, weights: weights.map(|weight| weight / 2.0) }
}

fn interval(time: f64) -> (i64, f64) {
    let first = time.floor();
    (first as i64, time - first)
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
