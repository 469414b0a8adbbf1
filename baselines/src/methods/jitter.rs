// SPDX-License-Identifier: MIT OR Apache-2.0

//! High-frequency jitter, by a translational and by an affine model.
//!
//! Source: S. Baker, E. Bennett, S. B. Kang and R. Szeliski, *Removing rolling shutter wobble*, CVPR
//! 2010: what a point moves from one frame to the next is the integral of the camera's velocity between
//! the two exposures, so that a velocity of many knots a frame can be solved for, as in
//! super-resolution, under a robust error and a penalty on its changes.
//!
//! The paper minimises absolute errors by linear programming; here it is reweighted least squares with
//! Tukey's loss, over the whole run at once; its velocity is piecewise constant, here it is piecewise
//! linear; and its penalty is on absolute changes, here on squared ones. One setting of knots and
//! smoothness serves all sequences, the best for none of them.

use super::robust::{Cost, Equation, tukey};
use super::timed::{TimedPair, timed, until_reference, untouched};
use super::{Correction, Corrections, Input, Method};
use anyhow::Result;
use nalgebra::Vector2;
use rsrectify::motion::image_centre;
use std::sync::Arc;

/// Knots of the velocity in a frame period: more than four to a cycle of 2.5 cycles a frame.
const KNOTS: usize = 12;
/// What a velocity that changes by v pixels a step from one knot to the next costs: this share of the
/// correspondences to a knot, times v²/2, where a correspondence off by r costs r.
///
/// Less of it takes turns and parallax for shake at multiples of the frame rate, more of it holds back
/// vibration. Chosen between the two on seeds 11 and 12, none of which is judged, with true
/// correspondences and 0.15 px of noise: of rot2_B40, btt_g085_sway and vibration are left 91, 74 and 45 %
/// at 0.3, 55, 55 and 55 % at 1, and 41, 41 and 74 % at 3 (translation alone).
const SMOOTHNESS: f64 = 1.0;
/// The same for a change of the affine part from one frame to the next, at the edge of the frame.
const AFFINE_SMOOTHNESS: f64 = 0.02;

/// High-frequency jitter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Jitter {
    /// The picture is shifted.
    Translation,
    /// And has a slow affine motion, constant from one frame's start to the next.
    Affine,
}

impl Method for Jitter {
    fn name(&self) -> String {
        match self {
            Self::Translation => "jitter-translation",
            Self::Affine => "jitter-affine",
        }
        .into()
    }

    fn solve(&self, input: &Input) -> Result<Corrections> {
        let basis = Basis::new(*self, input);
        let Some(motion) = Motion::fit(basis, input) else {
            return Ok(input.stamps.iter().map(|_| untouched()).collect());
        };
        let motion = Arc::new(motion);
        let readout = input.readout;
        let centre = image_centre(readout.width(), readout.height());
        let correction = |stamp: &f64| {
            let (motion, reference) = (motion.clone(), stamp + 0.5 * readout.time());
            Box::new(move |pixel: Vector2<f64>| {
                let seen = reference - until_reference(&readout, pixel);
                motion.carry(pixel - centre, seen, reference) + centre
            }) as Box<dyn Correction>
        };
        Ok(input.stamps.iter().map(correction).collect())
    }
}

/// What a motion is made of, and where each coefficient stands among the unknowns: in order of time, so
/// that what a correspondence touches lies together.
#[derive(Clone, Debug)]
struct Basis {
    /// Time of the first knot and between knots, in seconds.
    first: f64,
    step: f64,
    /// Unknown of each knot: the velocity there in pixels a step.
    knots: Vec<usize>,
    /// Where the affine part of each frame begins, in seconds, and its first unknown of two: what the
    /// edge of the frame to the right, and that below as far off, moves in a step.
    affine: Vec<(f64, usize)>,
    /// Half the frame width in pixels.
    scale: f64,
}

impl Basis {
    fn new(model: Jitter, input: &Input) -> Self {
        let step = input.period / KNOTS as f64;
        let (begin, end) = (input.stamps[0], input.stamps[input.stamps.len() - 1] + input.readout.time());
        let first = begin - step;
        let count = ((end - first) / step).ceil() as usize + 2;
        let mut basis = Self {
            first,
            step,
            knots: Vec::with_capacity(count),
            affine: Vec::new(),
            scale: input.readout.width() as f64 / 2.0,
        };
        let mut starts = input.stamps.iter().filter(|_| model == Jitter::Affine).peekable();
        for knot in 0..count {
            let time = first + knot as f64 * step;
            while let Some(start) = starts.next_if(|start| **start <= time) {
                basis.affine.push((*start, basis.unknowns()));
            }
            basis.knots.push(basis.unknowns());
        }
        basis
    }

    fn unknowns(&self) -> usize {
        self.knots.len() + 2 * self.affine.len()
    }

    /// How much each unknown moves the point that is at `place` (centred pixels) midway, from one time
    /// to another.
    fn terms(&self, place: Vector2<f64>, start: f64, end: f64) -> Vec<(usize, f64)> {
        let [from, to] = [start, end].map(|time| (time - self.first) / self.step);
        let last = self.knots.len() - 1;
        let reached = (from.min(to).max(0.0) as usize).min(last)..=(from.max(to).ceil() as usize).min(last);
        let knots = reached.map(|knot| {
            let moved = hat_integral(to - knot as f64) - hat_integral(from - knot as f64);
            (self.knots[knot], moved)
        });
        let at = place / self.scale;
        let affine = self.affine.iter().enumerate().flat_map(|(frame, (begin, unknown))| {
            let begin = if frame == 0 { f64::NEG_INFINITY } else { *begin };
            let until = self.affine.get(frame + 1).map_or(f64::INFINITY, |next| next.0);
            let steps = (end.clamp(begin, until) - start.clamp(begin, until)) / self.step;
            [(*unknown, steps * at.x), (unknown + 1, steps * at.y)]
        });
        knots.chain(affine.filter(|term| term.1 != 0.0)).collect()
    }

    fn equation(&self, pair: &TimedPair) -> Equation {
        let midway = (pair.from + pair.to) / 2.0;
        Equation::new(self.terms(midway, pair.start, pair.end), pair.displacement())
    }

    /// What holds the motion smooth, given the number of correspondences.
    fn smoothness(&self, correspondences: usize) -> Vec<Equation> {
        let share = correspondences as f64 / self.knots.len() as f64;
        let same = |a: usize, b: usize, weight: f64| Equation {
            cost: Cost::Squared(weight),
            ..Equation::new([(a, 1.0), (b, -1.0)], Vector2::zeros())
        };
        let knots = self.knots.windows(2).map(|pair| same(pair[0], pair[1], SMOOTHNESS * share));
        let affine = self.affine.windows(2).flat_map(|pair| {
            [0, 1].map(|axis| same(pair[0].1 + axis, pair[1].1 + axis, AFFINE_SMOOTHNESS * share))
        });
        knots.chain(affine).collect()
    }
}

/// The motion of the picture over a run.
#[derive(Debug)]
struct Motion {
    basis: Basis,
    unknowns: Vec<Vector2<f64>>,
}

impl Motion {
    /// `None` where there are no correspondences.
    fn fit(basis: Basis, input: &Input) -> Option<Self> {
        let pairs = (0..input.pairs.len()).flat_map(|k| timed(input, k));
        let mut equations: Vec<_> = pairs.map(|pair| basis.equation(&pair)).collect();
        if equations.is_empty() {
            return None;
        }
        equations.extend(basis.smoothness(equations.len()));
        let unknowns = tukey(&equations, basis.unknowns())?;
        Some(Self { basis, unknowns })
    }

    /// Where a point (centred pixels) seen at one time is at another.
    fn carry(&self, point: Vector2<f64>, start: f64, end: f64) -> Vector2<f64> {
        let mut carried = point;
        // The place midway depends on where the point goes; each round gains some two digits.
        for _ in 0..3 {
            let terms = self.basis.terms((point + carried) / 2.0, start, end);
            let moved: Vector2<f64> =
                terms.iter().map(|(index, factor)| self.unknowns[*index] * *factor).sum();
            carried = point + moved;
        }
        carried
    }
}

/// The integral from −∞ to `x` of the hat that rises from −1 to 0 and falls to 1.
fn hat_integral(x: f64) -> f64 {
    let rising = (x.clamp(-1.0, 0.0) + 1.0).powi(2) / 2.0;
    let falling = (1.0 - x.clamp(0.0, 1.0)).powi(2) / 2.0;
    rising + 0.5 - falling
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::timed::closed_form::*;
    use nalgebra::Rotation2;
    use std::f64::consts::TAU;

    #[test]
    fn a_constant_translation_is_undone() {
        assert_undoes_a_constant_translation(&Jitter::Translation);
        assert_undoes_a_constant_translation(&Jitter::Affine);
    }

    #[test]
    fn without_correspondences_frames_stay() {
        assert_survives_ignorance(&Jitter::Translation);
        assert_survives_ignorance(&Jitter::Affine);
    }

    #[test]
    fn the_integral_of_the_hat() {
        for (x, area) in [(-1.5, 0.0), (-0.5, 0.125), (0.0, 0.5), (0.5, 0.875), (1.0, 1.0), (9.0, 1.0)] {
            assert_eq!(hat_integral(x), area);
        }
    }

    /// Five knots to a cycle could follow it to some 1 %, and it shows from frame to frame with 1.9 times its
    /// amplitude. But errors cost their size and changes of velocity their square, so that the share taken
    /// away falls with the amplitude: by the balance of both at 1 px, a fifth stays at best where a fifth of
    /// the correspondences is wrong.
    #[test]
    fn a_vibration_above_two_cycles_a_frame_is_halved() {
        // 60 Hz at 25 frames/s; at 2 cycles sharp nothing of it would show from frame to frame.
        let path = |t: f64| Vector2::new(1.0, 0.5) * (TAU * 60.0 * t).sin();
        let (flow, inverse) = translation(path);
        for shutter in [SHUTTERS[0], SHUTTERS[1]] {
            let run = Run::translated(shutter, 20, path, 5);
            let (left, moved) = run.left(&Jitter::Translation, &flow, &inverse);
            assert!(left < 0.55 * moved, "{shutter:?}: {left} of {moved} px");
        }
    }

    #[test]
    fn a_turn_takes_the_affine_model() {
        let flow = |p: Vector2<f64>, t: f64| Rotation2::new(0.5 * t) * p;
        let inverse = |p: Vector2<f64>, t: f64| Rotation2::new(-0.5 * t) * p;
        let run = Run::new(SHUTTERS[1], 6, &flow, &inverse, 0);
        let (shifted, moved) = run.left(&Jitter::Translation, &flow, &inverse);
        let (left, _) = run.left(&Jitter::Affine, &flow, &inverse);
        assert!(shifted > 0.5 * moved && left < 0.05 * moved, "{shifted} {left} of {moved} px");
    }
}
