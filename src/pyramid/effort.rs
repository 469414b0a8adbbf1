// SPDX-License-Identifier: MIT OR Apache-2.0

//! How finely frames are analysed.

/// Longer side of the analysed luma, at most, in pixels.
const MAX_SIDE: usize = 960;

/// Longer side in pixels below which no frame is reduced: the coarsest levels hold too few patches otherwise.
const MIN_SIDE: usize = 320;

/// How much time the analysis of a frame may take: at how many pixels frames are analysed.
///
/// What either leaves of the distortion, and what it costs: `docs/speed.md`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Effort {
    /// Half the width and height of [`Balanced`](Self::Balanced), but 320 pixels along the longer side where the frame
    /// has them: for slow machines and large frames. The analysis takes half to two thirds of the time.
    Fast,
    /// 960 pixels along the longer side at most.
    #[default]
    Balanced,
}

impl Effort {
    /// Full-frame pixels per analysed pixel, at least 1, for frames whose longer side has `side` pixels.
    pub(super) fn scale(self, side: usize) -> f64 {
        let balanced = side.min(MAX_SIDE) as f64;
        let analysed = match self {
            Self::Fast => (0.5 * balanced).max(balanced.min(MIN_SIDE as f64)),
            Self::Balanced => balanced,
        };
        if analysed > 0.0 { side as f64 / analysed } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_analysed_at() {
        let analysed = |effort: Effort, side: usize| side as f64 / effort.scale(side);
        for (side, fast, balanced) in [
            (3840, 480.0, 960.0),
            (1920, 480.0, 960.0),
            (960, 480.0, 960.0),
            (800, 400.0, 800.0),
            (640, 320.0, 640.0),
            (480, 320.0, 480.0),
            (320, 320.0, 320.0),
            (1, 1.0, 1.0),
            (0, 0.0, 0.0),
        ] {
            assert_eq!((analysed(Effort::Fast, side), analysed(Effort::Balanced, side)), (fast, balanced));
        }
    }
}
