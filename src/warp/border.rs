// SPDX-License-Identifier: MIT OR Apache-2.0

//! Samples outside the picture.

use super::settings::{BorderMode, Fill};

/// The picture outside one plane of the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PlaneBorder {
    Replicate,
    Mirror,
    /// The value of each channel.
    Constant([u16; 4]),
}

impl PlaneBorder {
    /// The border of plane `index`.
    pub fn of(mode: BorderMode, index: usize) -> Self {
        match mode {
            BorderMode::Replicate => Self::Replicate,
            BorderMode::Mirror => Self::Mirror,
            BorderMode::Constant(Fill(planes)) => Self::Constant(planes[index.min(planes.len() - 1)]),
        }
    }
}

/// The index of the sample shown at `index` on an axis of `len` samples, `None` for the fill value.
///
/// [`PlaneBorder::Mirror`] repeats the edge sample: … 1 0 | 0 1 … n−1 | n−1 n−2 …, with period 2n.
pub(super) fn resolve(index: isize, len: usize, border: PlaneBorder) -> Option<usize> {
    let last = len as isize - 1;
    if (0..=last).contains(&index) {
        return Some(index as usize);
    }
    match border {
        PlaneBorder::Replicate => Some(index.clamp(0, last) as usize),
        PlaneBorder::Mirror => {
            let folded = index.rem_euclid(2 * len as isize);
            Some(folded.min(2 * last + 1 - folded) as usize)
        }
        PlaneBorder::Constant(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirror_repeats_the_edge_sample() {
        let shown: Vec<_> = (-4..8).map(|index| resolve(index, 3, PlaneBorder::Mirror).unwrap()).collect();
        assert_eq!(shown, [2, 2, 1, 0, 0, 1, 2, 2, 1, 0, 0, 1]);
    }

    #[test]
    fn replicate_holds_the_edge_and_constant_has_nothing() {
        assert_eq!(resolve(-9, 3, PlaneBorder::Replicate), Some(0));
        assert_eq!(resolve(9, 3, PlaneBorder::Replicate), Some(2));
        assert_eq!(resolve(-1, 3, PlaneBorder::Constant([7; 4])), None);
        assert_eq!(resolve(1, 3, PlaneBorder::Constant([7; 4])), Some(1));
    }

    #[test]
    fn each_plane_has_its_own_fill() {
        let border = |index| PlaneBorder::of(BorderMode::Constant(Fill::planar([16, 128, 129, 255])), index);
        assert_eq!([0, 1, 2].map(border), [16, 128, 129].map(|value| PlaneBorder::Constant([value; 4])));
        assert_eq!(border(usize::MAX), border(3));
    }

    #[test]
    fn one_sample_is_everywhere() {
        for border in [PlaneBorder::Replicate, PlaneBorder::Mirror] {
            assert!((-5..5).all(|index| resolve(index, 1, border) == Some(0)));
        }
    }
}
