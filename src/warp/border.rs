//! Samples outside the picture.

use super::settings::BorderMode;

/// The index of the sample shown at `index` on an axis of `len` samples, `None` for the fill value.
///
/// [`BorderMode::Mirror`] repeats the edge sample: … 1 0 | 0 1 … n−1 | n−1 n−2 …, with period 2n.
pub(super) fn resolve(index: isize, len: usize, mode: BorderMode) -> Option<usize> {
    let last = len as isize - 1;
    if (0..=last).contains(&index) {
        return Some(index as usize);
    }
    match mode {
        BorderMode::Replicate => Some(index.clamp(0, last) as usize),
        BorderMode::Mirror => {
            let folded = index.rem_euclid(2 * len as isize);
            Some(folded.min(2 * last + 1 - folded) as usize)
        }
        BorderMode::Constant => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirror_repeats_the_edge_sample() {
        let shown: Vec<_> = (-4..8).map(|index| resolve(index, 3, BorderMode::Mirror).unwrap()).collect();
        assert_eq!(shown, [2, 2, 1, 0, 0, 1, 2, 2, 1, 0, 0, 1]);
    }

    #[test]
    fn replicate_holds_the_edge_and_constant_has_nothing() {
        assert_eq!(resolve(-9, 3, BorderMode::Replicate), Some(0));
        assert_eq!(resolve(9, 3, BorderMode::Replicate), Some(2));
        assert_eq!(resolve(-1, 3, BorderMode::Constant), None);
        assert_eq!(resolve(1, 3, BorderMode::Constant), Some(1));
    }

    #[test]
    fn one_sample_is_everywhere() {
        for mode in [BorderMode::Replicate, BorderMode::Mirror] {
            assert!((-5..5).all(|index| resolve(index, 1, mode) == Some(0)));
        }
    }
}
