// SPDX-License-Identifier: MIT OR Apache-2.0

//! The paper's own method, on the library's solvers and over a whole run.
//!
//! Source: the paper, Sect. 25.4: initialisation by uniform rotation (25.6), sequential computation
//! (25.7–25.10) from the pair of least E, final choice (25.4.1.3). The product does the same on a
//! sliding window. The inter-frame delay, 0 or the true one, is that of the readout in the input.

use super::timed::untouched;
use super::{Correction, Corrections, Input, Method};
use anyhow::Result;
use nalgebra::Vector2;
use rsrectify::motion::{MotionPath, image_centre};
use rsrectify::solve::Link;
use rsrectify::solve::sequential::link::{Fit, FitBuffers, KnownFrame};

/// Standard deviation of a measured coordinate in pixels.
const TRACKING_NOISE: f64 = 0.1;

/// How much of the paper's method is applied.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Paper {
    /// 25.6 for each pair of frames, nothing else.
    Initialisation,
    /// The recursion 25.7–25.10 from the initial pair to both ends, whatever E it reaches.
    Sequential,
    /// All of it.
    Full,
}

impl Method for Paper {
    fn name(&self) -> String {
        match self {
            Self::Initialisation => "paper-initialisation",
            Self::Sequential => "paper-sequential",
            Self::Full => "paper",
        }
        .into()
    }

    fn solve(&self, input: &Input) -> Result<Corrections> {
        let mut run = Run::new(input);
        let frames = input.stamps.len();
        let fits = match self {
            Self::Initialisation => (0..frames).map(|k| run.initial(k)).collect(),
            Self::Sequential => run.sequential(|reached, initial| reached.or(initial)),
            Self::Full => run.sequential(|reached, initial| {
                let trusted = reached.into_iter().chain(initial);
                trusted.min_by(|a, b| a.energy.total_cmp(&b.energy))
            }),
        };
        Ok(fits.into_iter().map(|fit| fit.map_or_else(untouched, |fit| correction(input, &fit))).collect())
    }
}

/// Carries every pixel to the middle of the readout (25.11).
fn correction(input: &Input, fit: &Fit) -> Box<dyn Correction> {
    let readout = input.readout;
    let centre = image_centre(readout.width(), readout.height());
    let path = MotionPath::uniform(fit.twist, readout.time());
    Box::new(move |pixel: Vector2<f64>| {
        path.carry(pixel - centre, readout.share(pixel.x, pixel.y), 0.5) + centre
    })
}

/// The pairs of a run and the uniform rotation of each that can be trusted.
struct Run {
    links: Vec<Link>,
    uniform: Vec<Option<Fit>>,
    scratch: FitBuffers,
}

impl Run {
    fn new(input: &Input) -> Self {
        let mut scratch = FitBuffers::default();
        let intervals = input.stamps.windows(2).map(|stamps| stamps[1] - stamps[0]);
        let links: Vec<_> = input
            .pairs
            .iter()
            .zip(intervals)
            .map(|(pairs, interval)| Link::new(pairs, &input.readout, interval, TRACKING_NOISE))
            .collect();
        let uniform = links.iter().map(|link| link.uniform(&mut scratch).filter(Fit::is_trusted)).collect();
        Self { links, uniform, scratch }
    }

    /// Frame `k` by the initialisation: the pair that it begins or else the one that it ends.
    fn initial(&self, k: usize) -> Option<Fit> {
        let after = self.uniform.get(k).copied().flatten();
        after.or_else(|| *self.uniform.get(k.checked_sub(1)?)?)
    }

    /// The recursion from the initial pair to both ends. `choose` is given what the recursion reaches
    /// for a frame and what the initialisation says of it; the recursion goes on from its choice.
    fn sequential(&mut self, choose: impl Fn(Option<Fit>, Option<Fit>) -> Option<Fit>) -> Vec<Option<Fit>> {
        let frames = self.links.len() + 1;
        let mut fits = vec![None; frames];
        let Some(pair) = self.initial_pair() else {
            return (0..frames).map(|k| self.initial(k)).collect();
        };
        fits[pair] = self.uniform[pair];
        fits[pair + 1] = self.uniform[pair];
        for k in pair + 2..frames {
            let reached = self.sequential_step(k - 1, KnownFrame::First, fits[k - 1]);
            fits[k] = choose(reached, self.initial(k));
        }
        for k in (0..pair).rev() {
            let reached = self.sequential_step(k, KnownFrame::Second, fits[k + 1]);
            fits[k] = choose(reached, self.initial(k));
        }
        fits
    }

    /// The unknown frame's motion over a pair, where it can be trusted.
    fn sequential_step(&mut self, pair: usize, known: KnownFrame, fit: Option<Fit>) -> Option<Fit> {
        self.links[pair].sequential_step(known, fit?.twist, &mut self.scratch).filter(Fit::is_trusted)
    }

    /// The pair of least E among those in which something moved.
    fn initial_pair(&self) -> Option<usize> {
        let energy = |pair: usize| self.uniform[pair].map(|fit| (pair, fit.energy));
        let moving = (0..self.links.len()).filter(|pair| !self.links[*pair].is_still());
        moving.filter_map(energy).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(pair, _)| pair)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::timed::closed_form::{Run as Closed, assert_undoes_a_constant_translation};
    use crate::methods::timed::closed_form::{SHUTTERS, assert_survives_ignorance, translation};
    use nalgebra::Rotation2;

    const VARIANTS: [Paper; 3] = [Paper::Initialisation, Paper::Sequential, Paper::Full];

    #[test]
    fn a_constant_translation_is_undone() {
        VARIANTS.iter().for_each(|variant| assert_undoes_a_constant_translation(variant));
    }

    #[test]
    fn without_correspondences_frames_stay() {
        VARIANTS.iter().for_each(|variant| assert_survives_ignorance(variant));
    }

    #[test]
    fn a_constant_turn_is_undone() {
        let pivot = Vector2::new(60.0, -30.0);
        let turn = |rate: f64| move |p: Vector2<f64>, t: f64| Rotation2::new(rate * t) * (p - pivot) + pivot;
        for shutter in SHUTTERS {
            let run = Closed::new(shutter, 5, &turn(0.8), &turn(-0.8), 5);
            for variant in VARIANTS {
                let (left, moved) = run.left(&variant, &turn(0.8), &turn(-0.8));
                assert!(moved > 0.5 && left < 0.01, "{variant:?} {shutter:?}: {left} of {moved} px");
            }
        }
    }

    #[test]
    fn the_recursion_follows_what_the_initialisation_cannot() {
        // Constant velocity through frames 0 and 1, then ever faster.
        let path = |t: f64| Vector2::new(150.0, 40.0) * (t + 4.0 * (t - 0.08).max(0.0).powi(2));
        let (flow, inverse) = translation(path);
        let run = Closed::translated(SHUTTERS[2], 8, path, 0);
        let left = |variant: Paper| run.left(&variant, &flow, &inverse).0;
        assert!(left(Paper::Sequential) < 0.6 * left(Paper::Initialisation));
        assert!(left(Paper::Full) < 0.6 * left(Paper::Initialisation));
    }
}
