// SPDX-License-Identifier: MIT OR Apache-2.0

//! Detection of unmarked duplicates: frames repeated by a frame-rate conversion.

/// Frames whose difference is at most this, in grey levels, are exact duplicates.
const MAX_EXACT_DIFFERENCE: f64 = 0.5;
/// Frames whose difference is at most this share of that between successive distinct frames are re-encoded
/// duplicates: these differ by 1 to 10 grey levels, successive frames of hand-held footage by about 100.
const MAX_DIFFERENCE_SHARE: f64 = 0.125;
/// Longest run of duplicates: a conversion from 15 to 60 frames a second has three; a longer run is a still
/// camera.
const MAX_RUN: usize = 3;

/// Detects duplicates by the differences of successive frames.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Duplicates {
    /// Difference of the last frame that was not a duplicate, in grey levels.
    last_distinct: f64,
    run: usize,
}

impl Duplicates {
    /// Whether a frame that differs from its predecessor by `difference` grey levels
    /// ([`Sampler::difference`](crate::correspond::Sampler::difference)) is a duplicate of it.
    pub fn is_repeated(&mut self, difference: f64) -> bool {
        let is_duplicate = difference <= MAX_EXACT_DIFFERENCE.max(MAX_DIFFERENCE_SHARE * self.last_distinct);
        if is_duplicate && self.run < MAX_RUN {
            self.run += 1;
            return true;
        }
        self.last_distinct = if difference.is_finite() { difference } else { 0.0 };
        if !is_duplicate {
            self.run = 0;
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn repeated(differences: &[f64]) -> Vec<bool> {
        let mut duplicates = Duplicates::default();
        differences.iter().map(|&difference| duplicates.is_repeated(difference)).collect()
    }

    #[test]
    fn exact_and_re_encoded_duplicates_are_found() {
        assert_eq!(repeated(&[90.0, 0.0, 120.0, 8.0, 85.0, 0.1]), [false, true, false, true, false, true]);
        assert_eq!(repeated(&[90.0, 3.0, 5.0, 2.0, 100.0, 4.0]), [false, true, true, true, false, true]);
    }

    #[test]
    fn a_small_motion_in_a_still_scene_is_none() {
        assert_eq!(repeated(&[6.0, 3.0, 5.0, 2.0, 4.0]), [false; 5]);
    }

    #[test]
    fn a_still_camera_is_no_row_of_duplicates() {
        assert_eq!(repeated(&[90.0, 0.2, 0.2, 0.2, 0.2, 0.2]), [false, true, true, true, false, false]);
        assert_eq!(repeated(&[90.0, 4.0, 4.0, 4.0, 4.0, 4.0])[4..], [false, false]);
        assert_eq!(repeated(&[f64::INFINITY, 1.0]), [false, false]);
    }
}
