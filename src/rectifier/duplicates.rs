//! Duplicates that nothing marks: frames that a change of frame rate repeated.

/// Frames that differ by no more grey levels than this anywhere are one and the same exposure.
const EXACT: f64 = 0.5;
/// So are frames that differ by no more than this share of what successive frames differ by: a
/// duplicate that was encoded again differs by 1 to 10 grey levels where frames that follow each
/// other in hand-held footage differ by about 100.
const SHARE: f64 = 0.125;
/// More duplicates in a row than any change of frame rate makes (15 to 60 a second makes three) are
/// a camera that stands still.
const MOST_IN_A_ROW: usize = 3;

/// Tells duplicates from the differences of successive frames.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Duplicates {
    /// Difference of the last frame that was none, in grey levels.
    usual: f64,
    in_a_row: usize,
}

impl Duplicates {
    /// Whether a frame that differs from the one before it by `difference` grey levels
    /// ([`Sampler::difference`](crate::correspond::Sampler::difference)) repeats it.
    pub fn is_repeated(&mut self, difference: f64) -> bool {
        let alike = difference <= EXACT.max(SHARE * self.usual);
        if alike && self.in_a_row < MOST_IN_A_ROW {
            self.in_a_row += 1;
            return true;
        }
        self.usual = if difference.is_finite() { difference } else { 0.0 };
        if !alike {
            self.in_a_row = 0;
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
