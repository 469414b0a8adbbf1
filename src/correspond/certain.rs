// SPDX-License-Identifier: MIT OR Apache-2.0

//! Selects correspondences of small variance, for solvers that assume the same noise for all.

use super::correspondence::Correspondence;
use crate::robust::median::median;

/// Correspondences are dropped if their standard deviation is more than this many times the median of the
/// pair …
const MAX_DEVIATION_RATIO: f64 = 2.0;

/// … and more than this, in analysed pixels.
const MIN_DEVIATION_LIMIT: f64 = 0.3;

/// Copies to `out` the correspondences of a pair whose standard deviation along every axis is at most 0.3
/// analysed pixels, or twice the median of the pair. `scale` is the width of an analysed pixel in full-frame
/// pixels.
pub fn certain(found: &[Correspondence], scale: f64, out: &mut Vec<Correspondence>) {
    let mut variances: Vec<f64> = found.iter().map(Correspondence::variance).collect();
    let least = MIN_DEVIATION_LIMIT * scale;
    let limit = (least * least).max(MAX_DEVIATION_RATIO * MAX_DEVIATION_RATIO * median(&mut variances));
    out.clear();
    out.extend(found.iter().filter(|found| found.variance() <= limit));
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    fn certain_of(deviations: &[f64], scale: f64) -> usize {
        let of = |deviation: &f64| Correspondence {
            from: Vector2::zeros(),
            to: Vector2::zeros(),
            texture: 1.0,
            residual: 0.0,
            covariance: Matrix2::new(deviation * deviation, 0.0, 0.0, 1e-4),
        };
        let found: Vec<Correspondence> = deviations.iter().map(of).collect();
        let mut out = found.clone();
        certain(&found, scale, &mut out);
        out.len()
    }

    #[test]
    fn uncertain_points_are_dropped_relative_to_the_median() {
        assert_eq!(certain_of(&[], 1.0), 0);
        assert_eq!(certain_of(&[0.1, 0.29, 0.31, 2.0], 1.0), 3, "0.29 is the median");
        assert_eq!(certain_of(&[0.1, 0.1, 0.1, 0.31, 2.0], 1.0), 3);
        assert_eq!(certain_of(&[0.1, 0.1, 0.1, 0.31, 2.0], 2.0), 4, "0.6 full-frame pixels");
        assert_eq!(certain_of(&[1.0, 1.0, 1.9, 2.1], 1.0), 4, "1.9 is the median");
        assert_eq!(certain_of(&[1.0, 1.0, 1.0, 1.9, 2.1], 1.0), 4);
        assert_eq!(certain_of(&[f64::NAN, 0.1, 0.1], 1.0), 2);
    }
}
