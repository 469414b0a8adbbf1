//! Which correspondences are certain enough for solvers that know one noise for all.

use super::correspondence::Correspondence;

/// Those whose deviation is so many times the usual one are left out …
const UNSURE: f64 = 2.0;

/// … if it is larger than this as well, in analysed pixels.
const MOST_DEVIATION: f64 = 0.3;

/// Leaves in `out` those of the correspondences of a pair whose deviation along any axis is at most 0.3 analysed pixels, or
/// twice what is usual in the pair. `scale` are the full-frame pixels to an analysed one.
pub fn certain(found: &[Correspondence], scale: f64, out: &mut Vec<Correspondence>) {
    let mut variances: Vec<f64> = found.iter().map(Correspondence::variance).collect();
    let middle = variances.len() / 2;
    let usual = match variances.get(middle) {
        Some(_) => *variances.select_nth_unstable_by(middle, f64::total_cmp).1,
        None => 0.0,
    };
    let most = MOST_DEVIATION * scale;
    let limit = (most * most).max(UNSURE * UNSURE * usual);
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
    fn what_is_uncertain_is_left_out_unless_most_is() {
        assert_eq!(certain_of(&[], 1.0), 0);
        assert_eq!(certain_of(&[0.1, 0.29, 0.31, 2.0], 1.0), 3, "0.29 is usual");
        assert_eq!(certain_of(&[0.1, 0.1, 0.1, 0.31, 2.0], 1.0), 3);
        assert_eq!(certain_of(&[0.1, 0.1, 0.1, 0.31, 2.0], 2.0), 4, "0.6 full-frame pixels");
        assert_eq!(certain_of(&[1.0, 1.0, 1.9, 2.1], 1.0), 4, "1.9 is usual");
        assert_eq!(certain_of(&[1.0, 1.0, 1.0, 1.9, 2.1], 1.0), 4);
        assert_eq!(certain_of(&[f64::NAN, 0.1, 0.1], 1.0), 2);
    }
}
