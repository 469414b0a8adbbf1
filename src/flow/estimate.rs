// SPDX-License-Identifier: MIT OR Apache-2.0

//! What is estimated for a patch and for a cell.

use super::patch::SIDE;

/// The estimate for a patch or a cell: displacement x and y in pixels of the level; then means over its
/// pixels: squared difference; structure tensor xx, xy, yy; squared difference from the mean grey; and last
/// 1, or 0 without an estimate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Mean(pub(super) [f32; SIDE]);

impl Mean {
    #[inline(always)]
    pub(super) fn shift(&self) -> [f32; 2] {
        [self.0[0], self.0[1]]
    }

    #[inline(always)]
    pub(super) fn residual(&self) -> f32 {
        self.0[2]
    }

    #[inline(always)]
    pub(super) fn tensor(&self) -> [f32; 3] {
        [self.0[3], self.0[4], self.0[5]]
    }

    #[inline(always)]
    pub(super) fn energy(&self) -> f32 {
        self.0[6]
    }
}

/// The result for one patch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PatchFlow {
    pub(super) mean: Mean,
    /// Mean squared differences of the quarters: top left, bottom left, top right, bottom right.
    pub(super) quarters: [f32; 4],
    /// What each quarter counts in the mean of the patches that cover its cell.
    pub(super) weights: [f32; 4],
}

impl PatchFlow {
    /// The same, with the structure tensor multiplied by `share`.
    pub(super) fn with_scaled_tensor(mut self, share: f32) -> Self {
        self.mean.0[3..6].iter_mut().for_each(|value| *value *= share);
        self
    }
}
