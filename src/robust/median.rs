// SPDX-License-Identifier: MIT OR Apache-2.0

//! The median, and the variance of two-dimensional errors estimated by it.

/// Variance σ² of a coordinate over the median of |r|² of two normal coordinates: |r|²/σ² is χ² distributed
/// with 2 degrees of freedom, with the median 2·ln 2.
const MEDIAN_TO_VARIANCE: f64 = 0.5 / std::f64::consts::LN_2;

/// The median, of an even number the upper one of the middle two; 0 if empty. Reorders the values.
pub fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// Variance of a coordinate by the median of |r|², at least `least`. Over half of the errors must be normal.
/// Reorders the values.
pub fn variance_of(squares: &mut [f64], least: f64) -> f64 {
    (median(squares) * MEDIAN_TO_VARIANCE).max(least)
}

/// Variance of a coordinate by the weighted median of |r|²: pairs (|r|², weight), which it reorders.
pub fn weighted_variance_of(squares: &mut [(f64, f64)]) -> f64 {
    weighted_median(squares) * MEDIAN_TO_VARIANCE
}

/// Buckets by which [`weighted_median`] narrows its values down.
const BUCKETS: usize = 128;

/// Fewer values than this are not narrowed down.
const MIN_BUCKETED: usize = 64;

/// The weighted median of pairs (value, weight); 0 if empty. Reorders the pairs.
pub fn weighted_median(values: &mut [(f64, f64)]) -> f64 {
    let half = 0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>();
    let (mut rest, mut below) =
        if values.len() < MIN_BUCKETED { (values, 0.0) } else { narrowed(values, half) };
    // Bisection: the median is in `rest`, and the values excluded below it have the weight `below`.
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

/// Those of some values that share the bucket of the median, and the weight of all that are less.
///
/// Buckets divide the range of the values' bits, hence are about as wide as their values are large: a few of hundreds
/// of values remain, for which three passes over all of them take less than a selection.
fn narrowed(values: &mut [(f64, f64)], half: f64) -> (&mut [(f64, f64)], f64) {
    let range =
        |[low, high]: [u64; 2], (value, _): &(f64, f64)| [low.min(key(*value)), high.max(key(*value))];
    let [low, high] = values.iter().fold([u64::MAX, 0], range);
    let width = high.saturating_sub(low);
    let shift = (u64::BITS - width.leading_zeros()).saturating_sub(BUCKETS.ilog2());
    let bucket = |value: f64| ((key(value) - low) >> shift) as usize % BUCKETS;
    let mut weights = [0.0; BUCKETS];
    values.iter().for_each(|(value, weight)| weights[bucket(*value)] += weight);
    let (mut own, mut below) = (0, 0.0);
    // If no bucket is past half of the weights, as where these are 0, the median is the greatest value.
    let last = (width >> shift) as usize;
    let is_past = |weight: f64| weight > half;
    while own < last && !is_past(below + weights[own]) {
        below += weights[own];
        own += 1;
    }
    let (mut count, first) = (0, low + ((own as u64) << shift));
    for index in 0..values.len() {
        if key(values[index].0).wrapping_sub(first) >> shift == 0 {
            values.swap(count, index);
            count += 1;
        }
    }
    (&mut values[..count], below)
}

/// An integer that is less where a number is less in the order of [`f64::total_cmp`].
#[inline(always)]
fn key(value: f64) -> u64 {
    let bits = value.to_bits();
    bits ^ (((bits as i64 >> 63) as u64) | 1 << 63)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn worked_by_hand() {
        assert_eq!(median(&mut []), 0.0);
        assert_eq!(median(&mut [3.0]), 3.0);
        assert_eq!(median(&mut [5.0, 1.0, 3.0]), 3.0);
        assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), 3.0);
    }

    #[test]
    fn the_variance_is_that_of_a_normal_distribution() {
        // Quantiles of χ² with 2 degrees of freedom, times a variance of 9, and a third of outliers.
        let normal = (0..1000).map(|i| -18.0 * (1.0 - (f64::from(i) + 0.5) / 1000.0).ln());
        let mut squares: Vec<f64> = normal.clone().collect();
        assert!((variance_of(&mut squares, 0.0) - 9.0).abs() < 0.05);
        assert_eq!(variance_of(&mut squares, 10.0), 10.0);
        squares.extend([1e9; 500]);
        // The median is then the upper quartile of the normal ones, ln 4 over ln 2 times as far.
        assert!((variance_of(&mut squares, 0.0) - 18.0).abs() < 0.1);
        assert_eq!(variance_of(&mut [], 0.5), 0.5);
    }

    #[test]
    fn half_of_the_weight_lies_below() {
        assert_eq!(weighted_median(&mut []), 0.0);
        assert_eq!(weighted_median(&mut [(5.0, 1.0), (1.0, 1.0), (3.0, 1.0)]), 3.0);
        assert_eq!(weighted_median(&mut [(9.0, 5.0), (1.0, 1.0), (2.0, 1.0)]), 9.0);
        assert_eq!(weighted_median(&mut [(4.0, 0.0), (7.0, 0.0)]), 7.0);
    }

    proptest! {
        #[test]
        fn values_in_any_order_have_the_median_of_the_sorted_ones(
            // Quarters add up without rounding; some values come twice, and some are narrowed down before.
            values in prop::collection::vec((0..100u8, 0..8u8), 1..300)
        ) {
            let values: Vec<(f64, f64)> =
                values.into_iter().map(|(value, weight)| (f64::from(value), f64::from(weight) / 4.0)).collect();
            let mut sorted = values.clone();
            sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
            let half = 0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>();
            let mut sum = 0.0;
            let past = sorted.iter().find(|(_, weight)| {
                sum += weight;
                sum > half
            });
            let truth = past.or(sorted.last()).map_or(0.0, |(value, _)| *value);
            prop_assert_eq!(weighted_median(&mut values.clone()), truth);
        }
    }
}
