// SPDX-License-Identifier: MIT OR Apache-2.0

//! One translation a frame: the global motion between successive frames as a constant velocity.
//!
//! Sources: S. P. Nicklin, R. D. Fisher and R. H. Middleton, *Rolling shutter image compensation*,
//! RoboCup 2006, LNCS 4434 (2007); W.-H. Cho and K.-S. Hong, *Affine motion based CMOS distortion
//! analysis and CMOS digital image stabilization*, IEEE Trans. Consumer Electronics 53 (2007), its
//! translational part; J.-B. Chun, H. Jung and C.-M. Kyung, *Suppressing rolling-shutter distortion of
//! CMOS image sensors by motion vector detection*, IEEE Trans. Consumer Electronics 54 (2008). They
//! differ in how the global motion is measured, not in what is made of it.

use super::robust::{Equation, tukey};
use super::timed::{TimedPair, from_pairs, timed, until_reference};
use super::{Corrections, Input, Method};
use anyhow::Result;
use nalgebra::Vector2;

/// One translation a frame.
pub struct Translation;

impl Method for Translation {
    fn name(&self) -> String {
        "translation".into()
    }

    fn solve(&self, input: &Input) -> Result<Corrections> {
        let found: Vec<_> = (0..input.pairs.len()).map(|k| velocity(&timed(input, k))).collect();
        let readout = input.readout;
        Ok(from_pairs(input, &found, |velocity| {
            Box::new(move |pixel| pixel + velocity * until_reference(&readout, pixel))
        }))
    }
}

/// The velocity in px/s that most correspondences of a pair of frames share: x′ − x = v·(t′ − t).
pub fn velocity(pairs: &[TimedPair]) -> Option<Vector2<f64>> {
    let equations: Vec<_> =
        pairs.iter().map(|pair| Equation::new([(0, pair.elapsed())], pair.displacement())).collect();
    tukey(&equations, 1).map(|found| found[0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::timed::closed_form::*;

    #[test]
    fn a_constant_translation_is_undone() {
        assert_undoes_a_constant_translation(&Translation);
    }

    #[test]
    fn without_correspondences_frames_stay() {
        assert_survives_ignorance(&Translation);
    }
}
