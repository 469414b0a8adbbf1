// SPDX-License-Identifier: MIT OR Apache-2.0

//! Monotone projection and inversion.
//!
//! The forward map along a line folds at occlusions and has gaps at disocclusions. To have an inverse, it
//! is projected to a monotone sequence of bounded slope.

/// Limits the differences between successive `values` to `least`..`most`; does nothing if they are within
/// these limits. `spare` is a buffer.
#[inline(always)]
pub(super) fn limit_slopes(values: &mut [f64], least: f64, most: f64, spare: &mut Vec<f64>) {
    // Without an early end, so that it is in vectors: most sequences are within.
    let within = |all: bool, (from, to): (&f64, &f64)| all & (least..=most).contains(&(to - from));
    if values.iter().zip(values.iter().skip(1)).fold(true, within) {
        return;
    }
    raise_slopes(values, least, spare);
    values.iter_mut().for_each(|value| *value = -*value);
    raise_slopes(values, -most, spare);
    values.iter_mut().for_each(|value| *value = -*value);
}

/// The mean of the smallest sequence above `values` and the largest one below whose steps are all at
/// least `least`: symmetric at a fold.
fn raise_slopes(values: &mut [f64], least: f64, spare: &mut Vec<f64>) {
    let mut above = f64::NEG_INFINITY;
    spare.clear();
    spare.extend(values.iter().map(|&value| {
        above = value.max(above + least);
        above
    }));
    let mut below = f64::INFINITY;
    for (value, above) in values.iter_mut().zip(spare.iter()).rev() {
        below = value.min(below - least);
        *value = (below + above) / 2.0;
    }
}

/// The inverse of an increasing sequence, evaluated at non-decreasing values.
///
/// Between two values it is the Hermite cubic whose slopes are the inverse of the central differences.
/// They are at most twice the slope of the chord, so that it is monotone for any sequence (the condition
/// of Fritsch and Carlson is three times). Its error is that of the differences, h²/6 · f‴ in the slope
/// and a tenth of h times that in the position.
pub(super) struct Inverse<'a> {
    values: &'a [f64],
    /// Slope outside the sequence: change of the value per step.
    spacing: f64,
    /// The step that contains the last value.
    step: usize,
}

impl<'a> Inverse<'a> {
    /// The inverse of at least two increasing values, extrapolated with the slope `spacing`.
    pub fn new(values: &'a [f64], spacing: f64) -> Self {
        Self { values, spacing, step: 0 }
    }

    /// The position of `value` in steps from the first one; `value` must not be less than in the last call.
    #[inline(always)]
    pub fn at(&mut self, value: f64) -> f64 {
        let values = self.values;
        let (first, last) = (values[0], values[values.len() - 1]);
        if value < first {
            return (value - first) / self.spacing;
        }
        if value >= last {
            return (values.len() - 1) as f64 + (value - last) / self.spacing;
        }
        while values[self.step + 1] <= value {
            self.step += 1;
        }
        let (from, to) = (values[self.step], values[self.step + 1]);
        let rise = to - from;
        let before = if self.step == 0 { rise } else { from - values[self.step - 1] };
        let after = values.get(self.step + 2).map_or(rise, |next| next - to);
        let t = (value - from) / rise;
        let u = 1.0 - t;
        let (start, end) = (2.0 * rise / (before + rise), 2.0 * rise / (rise + after));
        self.step as f64 + t * t * (3.0 - 2.0 * t) + t * u * (start * u - end * t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limited(values: &[f64], least: f64, most: f64) -> Vec<f64> {
        let mut values = values.to_vec();
        limit_slopes(&mut values, least, most, &mut Vec::new());
        values
    }

    #[test]
    fn sequences_within_limits_stay() {
        let values = [0.0, 1.0, 1.5, 3.5];
        assert_eq!(limited(&values, 0.5, 2.0), values);
    }

    #[test]
    fn a_fold_is_shared_between_its_sides() {
        // Above: 0 1 2 3 3 3 4; below: 0 1 1 1 2 3 4.
        assert_eq!(
            limited(&[0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 2.0, 3.0, 4.0], 0.0, 9.0),
            [0.0, 1.0, 1.5, 2.0, 2.0, 2.0, 2.5, 3.0, 4.0]
        );
        // The same on a slope of 1: 0 2 4 4 6 becomes …
        assert_eq!(limited(&[0.0, 2.0, 4.0, 4.0, 6.0], 1.0, 9.0), [0.0, 2.0, 3.5, 4.5, 6.0]);
    }

    #[test]
    fn a_jump_is_spread() {
        assert_eq!(limited(&[0.0, 0.0, 4.0, 4.0], -2.0, 2.0), [0.0, 1.0, 3.0, 4.0]);
        for (least, most) in [(0.1, 3.0), (-0.7, 0.7), (0.5, 0.6)] {
            let wild: Vec<f64> = (0..200u64).map(|k| (k * k * 7919 % 101) as f64 / 10.0).collect();
            for pair in limited(&wild, least, most).windows(2) {
                let step = pair[1] - pair[0];
                assert!((least - 1e-9..=most + 1e-9).contains(&step), "{step}");
            }
        }
    }

    #[test]
    fn the_inverse_undoes() {
        // f(x) = x + 3·sin(x/10) on every fourth x.
        let f = |x: f64| x + 3.0 * (x / 10.0).sin();
        let values: Vec<f64> = (0..60).map(|k| f(4.0 * k as f64)).collect();
        let mut inverse = Inverse::new(&values, 4.0);
        for x in (40..2000).map(|k| k as f64 / 10.0) {
            let error = 4.0 * inverse.at(f(x)) - x;
            // 0.1 · 4 · 4²/6 · f‴ with |f‴| ≤ 0.003, over f′² ≥ 0.49.
            assert!(error.abs() < 6.6e-3, "{x}: {error}");
        }
    }

    #[test]
    fn the_inverse_grows_and_goes_on_outside() {
        let values = [0.0, 1e-9, 5.0, 5.1, 5.1000001, 40.0];
        let mut inverse = Inverse::new(&values, 2.0);
        assert_eq!(inverse.at(-3.0), -1.5);
        let mut before = 0.0;
        for k in 0..=400 {
            let at = inverse.at(f64::from(k) / 10.0);
            assert!(at >= before && at <= 5.0, "{k}: {at} after {before}");
            before = at;
        }
        assert_eq!(inverse.at(44.0), 7.0);
    }
}
