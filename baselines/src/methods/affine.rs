// SPDX-License-Identifier: MIT OR Apache-2.0

//! An affine map between successive frames.
//!
//! Source: W.-H. Cho and K.-S. Hong, *Affine motion based CMOS distortion analysis and CMOS digital
//! image stabilization*, IEEE Trans. Consumer Electronics 53 (2007). Under uniform translation the map
//! between two distorted frames is affine, and the distortion itself follows from it.

use super::robust::{Equation, tukey};
use super::timed::{TimedPair, from_pairs, timed, until_reference};
use super::{Corrections, Input, Method};
use anyhow::Result;
use nalgebra::{Matrix2, Vector2};
use rsrectify::motion::image_centre;
use rsrectify::readout::Readout;

/// Fewer correspondences than this say nothing of six unknowns.
const LEAST_PAIRS: usize = 8;
/// Least time, as a share of the interval between the frames, in which a point goes from one frame to
/// the next; a map that claims less sends it over the whole frame and is not to be divided by.
const LEAST_ELAPSED: f64 = 0.1;

/// The affine map between two distorted frames, every point in uniform motion.
pub struct Affine;

impl Method for Affine {
    fn name(&self) -> String {
        "affine".into()
    }

    fn solve(&self, input: &Input) -> Result<Corrections> {
        let readout = input.readout;
        let found = |k: usize| {
            let interval = input.stamps[k + 1] - input.stamps[k];
            Map::fit(&timed(input, k), &readout).map(|map| (map, interval))
        };
        let found: Vec<_> = (0..input.pairs.len()).map(found).collect();
        Ok(from_pairs(input, &found, |(map, interval)| {
            Box::new(move |pixel| {
                pixel + map.velocity(pixel, &readout, interval) * until_reference(&readout, pixel)
            })
        }))
    }
}

/// x′ − x = linear · x + shift, x in pixels from the image centre.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Map {
    linear: Matrix2<f64>,
    shift: Vector2<f64>,
}

impl Map {
    fn fit(pairs: &[TimedPair], readout: &Readout) -> Option<Self> {
        let scale = readout.width() as f64 / 2.0;
        let equation = |pair: &TimedPair| {
            let at = pair.from / scale;
            Equation::new([(0, 1.0), (1, at.x), (2, at.y)], pair.displacement())
        };
        let equations: Vec<_> = pairs.iter().map(equation).collect();
        let found = (pairs.len() >= LEAST_PAIRS).then(|| tukey(&equations, 3))??;
        Some(Self { linear: Matrix2::from_columns(&found[1..]) / scale, shift: found[0] })
    }

    /// The velocity in px/s of the point at `pixel`: how far it goes to the next frame, over the time
    /// between the two rows that see it. Exact for a uniform translation.
    fn velocity(&self, pixel: Vector2<f64>, readout: &Readout, interval: f64) -> Vector2<f64> {
        let displacement =
            self.linear * (pixel - image_centre(readout.width(), readout.height())) + self.shift;
        let to = pixel + displacement;
        let elapsed = interval + readout.offset(to.x, to.y) - readout.offset(pixel.x, pixel.y);
        displacement / (interval * (elapsed / interval).max(LEAST_ELAPSED))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::timed::closed_form::*;
    use nalgebra::Rotation2;

    #[test]
    fn a_constant_translation_is_undone() {
        assert_undoes_a_constant_translation(&Affine);
    }

    #[test]
    fn without_correspondences_frames_stay() {
        assert_survives_ignorance(&Affine);
    }

    #[test]
    fn a_zoom_and_a_turn_are_undone_to_second_order() {
        let (turn, zoom): (f64, f64) = (0.4, 0.3);
        let flow = move |p: Vector2<f64>, t: f64| Rotation2::new(turn * t) * p * (zoom * t).exp();
        let inverse = move |p: Vector2<f64>, t: f64| flow(p, -t);
        for shutter in SHUTTERS {
            let run = Run::new(shutter, 4, &flow, &inverse, 0);
            let (left, moved) = run.left(&Affine, &flow, &inverse);
            // A chord instead of an arc: about (turn² + zoom²)·period²/2 of 100 px.
            assert!(moved > 0.3 && left < 0.04, "{shutter:?}: {left} of {moved} px");
        }
    }
}
