//! The median, and the variance of two-dimensional errors from it.

/// Ratio of the variance of a normal coordinate to the median of |r|² of two such coordinates: in units of
/// the variance
/// |r|² is χ² with 2 degrees of freedom, whose median is 2·ln 2.
pub(super) const MEDIAN_TO_VARIANCE: f64 = 0.5 / std::f64::consts::LN_2;

/// The median (the upper one of an even number of values), 0 for no values; reorders them.
pub(super) fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// The weighted median of `(value, weight)`; 0 for no values. Reorders them.
pub(super) fn weighted_median(values: &mut [(f64, f64)]) -> f64 {
    let half = 0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>();
    let (mut rest, mut below) = (values, 0.0);
    // Bisection: the median lies in `rest`; the values dropped below it have the total weight `below`.
    loop {
        let Some(middle) = rest.len().checked_sub(1).map(|last| last / 2) else { return 0.0 };
        let (lower, (value, own), _) = rest.select_nth_unstable_by(middle, |a, b| a.0.total_cmp(&b.0));
        let value = *value;
        let weight = lower.iter().map(|(_, weight)| weight).sum::<f64>() + *own;
        let is_past = below + weight > half;
        if rest.len() == 1 || is_past && middle == 0 {
            return value;
        }
        rest = if is_past {
            &mut rest[..=middle]
        } else {
            below += weight;
            &mut rest[middle + 1..]
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worked_by_hand() {
        assert_eq!(median(&mut []), 0.0);
        assert_eq!(median(&mut [3.0]), 3.0);
        assert_eq!(median(&mut [5.0, 1.0, 3.0]), 3.0);
        assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), 3.0);
    }

    #[test]
    fn half_of_the_weight_lies_below() {
        assert_eq!(weighted_median(&mut []), 0.0);
        assert_eq!(weighted_median(&mut [(5.0, 1.0), (1.0, 1.0), (3.0, 1.0)]), 3.0);
        assert_eq!(weighted_median(&mut [(9.0, 5.0), (1.0, 1.0), (2.0, 1.0)]), 9.0);
        assert_eq!(weighted_median(&mut [(4.0, 0.0), (7.0, 0.0)]), 7.0);
    }

    #[test]
    fn values_in_any_order_have_the_median_of_the_sorted_ones() {
        let mut random = super::super::random::Random(4);
        for count in 1..60 {
            // Quarters add up without rounding; some values come twice.
            let mut weight = || (8.0 * random.uniform()).floor() / 4.0;
            let values: Vec<(f64, f64)> = (0..count).map(|_| ((5.0 * weight()).floor(), weight())).collect();
            let mut sorted = values.clone();
            sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
            let half = 0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>();
            let mut sum = 0.0;
            let past = sorted.iter().find(|(_, weight)| {
                sum += weight;
                sum > half
            });
            let truth = past.or(sorted.last()).map_or(0.0, |(value, _)| *value);
            assert_eq!(weighted_median(&mut values.clone()), truth, "{values:?}");
        }
    }
}
