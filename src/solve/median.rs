//! The median, and what it says of the spread of two-dimensional errors.

/// Variance of a coordinate over the median of an error that is, in units of that variance, χ² with 2 degrees
/// of freedom, as |r|² of two normal coordinates is: its median is 2·ln 2.
pub(super) const MEDIAN_TO_VARIANCE: f64 = 0.5 / std::f64::consts::LN_2;

/// The median (of an even number the upper middle one), 0 of nothing; reorders the values.
pub(super) fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// The value below which half of the weight of `(value, weight)` lies; 0 for none.
pub(super) fn weighted_median(values: &mut [(f64, f64)]) -> f64 {
    let half = 0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>();
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let mut sum = 0.0;
    let middle = values.iter().find(|(_, weight)| {
        sum += weight;
        sum > half
    });
    middle.or(values.last()).map_or(0.0, |(value, _)| *value)
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
}
