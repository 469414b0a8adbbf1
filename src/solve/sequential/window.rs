// SPDX-License-Identifier: MIT OR Apache-2.0

//! The sliding window of the paper's estimator: initial pair, recursion in both directions, final choice.
//!
//! The paper takes the pair of least E of the whole video and runs the recursion from there to both
//! ends. In a stream, frame k is settled as soon as the frames up to k + L have arrived, L the
//! lookahead:
//!
//! - *initial pair*: the pair of least E (25.6) among those from k to k + L; pairs without motion are
//!   excluded;
//! - *backward* (25.9, 25.10): from that pair down to k;
//! - *forward* (25.7, 25.8): from the settled motion of k − 1, over the pair (k − 1, k);
//! - *final choice* (25.4.1.3): of forward, backward and the uniform rotations of the pairs
//!   (k, k + 1) and (k − 1, k), the one of least E as a mean per inlier. E of each is that of the
//!   pair over which it was solved: (k − 1, k) for forward, (k, k + 1) for backward.
//!
//! The recursion is stable: a step propagates an error of the known frame with the opposite sign and
//! damped. For a translation the factor is −½ at γ = 1 and −¼ at γ = 0.42, γ = N/N_t. (If the *known*
//! frame took the blank, it would be 1 − 3/(2γ), and the recursion would diverge under γ = ¾.) Rotation
//! and translation along the rows are coupled, as both shear the picture. The eigenvalues of a step on a
//! 4 : 3 picture, from its least-squares matrix:
//!
//! | γ | slowest | | fastest |
//! |---|---|---|---|
//! | 1 | −0.91 | −0.50 | −0.30 |
//! | 0.92 | −0.91 | −0.49 | −0.28 |
//! | 0.7 | −0.70 | −0.40 | −0.23 |
//! | 0.42 | −0.36 | −0.24 | −0.14 |
//!
//! After twenty frames at most 15 % of an error in the slowest mode remains, and in practice far less, as the
//! final choice restarts the recursion: from four starts, motions of some 6 px a frame differ after twenty
//! frames by less than 0.1 px a frame at the corners.

use super::link::{Fit, FitBuffers, KnownFrame, Link};
use crate::solve::solution::Origin;
use std::collections::VecDeque;

/// A candidate for the motion of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionCandidate {
    /// The motion and its residual energy.
    pub fit: Fit,
    /// How it was obtained.
    pub origin: Origin,
}

/// A link with the twists solved over it.
#[derive(Debug)]
struct SolvedLink {
    link: Link,
    initial: Fit,
    /// The motion of the link's first frame by the backward recursion, and the serial number of the
    /// frame where the recursion started.
    backward: Option<(u64, Fit)>,
}

/// The frames whose motion is not yet settled, without duplicates.
#[derive(Debug, Default)]
pub struct Window {
    /// One entry a frame: its link to the next one, if there is one.
    frames: VecDeque<Option<SolvedLink>>,
    /// Serial number of the first waiting frame.
    serial: u64,
    /// Motion of the frame settled last.
    settled: Option<Fit>,
    /// Its link to the first waiting frame.
    past: Option<SolvedLink>,
    scratch: FitBuffers,
}

impl Window {
    /// Adds the next frame and its link to the previous one: `None` at a start or a gap.
    ///
    /// Returns the uniform rotation of the link if its confidence is positive.
    pub fn push(&mut self, link: Option<Link>) -> Option<Fit> {
        let solved = link.and_then(|link| {
            let initial = link.uniform(&mut self.scratch)?;
            Some(SolvedLink { link, initial, backward: None })
        });
        let initial = solved.as_ref().map(|solved| solved.initial).filter(Fit::is_trusted);
        match self.frames.back_mut() {
            Some(last) => *last = solved,
            None => self.past = solved,
        }
        self.frames.push_back(None);
        initial
    }

    /// Settles and removes the first waiting frame; `None` if no candidate has a positive confidence.
    pub fn settle(&mut self) -> Option<MotionCandidate> {
        let backward = self.backward();
        let forward = self.forward();
        let next = self.frames.front().and_then(Option::as_ref);
        let initial = [next, self.past.as_ref()].map(|solved| solved.map(|solved| solved.initial));
        let best = [
            (backward, Origin::Backward),
            (forward, Origin::Forward),
            (initial[0], Origin::Initial),
            (initial[1], Origin::Initial),
        ]
        .into_iter()
        .filter_map(|(fit, origin)| Some(MotionCandidate { fit: fit?, origin }))
        .filter(|candidate| candidate.fit.is_trusted())
        .min_by(|a, b| a.fit.energy.total_cmp(&b.fit.energy));
        if let Some(solved) = self.frames.pop_front() {
            self.past = solved;
            self.serial += 1;
        }
        self.settled = best.map(|candidate| candidate.fit);
        best
    }

    /// Clears all state except the buffers.
    pub fn reset(&mut self) {
        self.frames.clear();
        self.settled = None;
        self.past = None;
    }

    /// The first frame's motion by one step from the frame settled last.
    fn forward(&mut self) -> Option<Fit> {
        self.past.as_ref()?.link.sequential_step(KnownFrame::First, self.settled?.twist, &mut self.scratch)
    }

    /// The first frame's motion by the backward recursion from the initial pair; `None` if the frame
    /// belongs to that pair.
    ///
    /// A pair over which the recursion finds no motion of positive confidence counts as a cut: the
    /// initial pair is then searched before it.
    fn backward(&mut self) -> Option<Fit> {
        let mut end = self.frames.len();
        loop {
            let start = self.initial_pair(end)?;
            match self.follow_back(start) {
                Ok(fit) => return (start > 0).then_some(fit),
                Err(cut) => end = cut,
            }
        }
    }

    /// Runs the recursion from the pair that begins at frame `start` to the first frame. The error is
    /// the index of the frame before a cut.
    fn follow_back(&mut self, start: usize) -> Result<Fit, usize> {
        let from = self.serial + start as u64;
        let mut fit = self.frames.get(start).and_then(Option::as_ref).ok_or(start)?.initial;
        for (index, solved) in self.frames.iter_mut().enumerate().take(start).rev() {
            let solved = solved.as_mut().ok_or(index)?;
            fit = match solved.backward {
                Some((serial, fit)) if serial == from => fit,
                _ => solved
                    .link
                    .sequential_step(KnownFrame::Second, fit.twist, &mut self.scratch)
                    .filter(Fit::is_trusted)
                    .ok_or(index)?,
            };
            solved.backward = Some((from, fit));
        }
        Ok(fit)
    }

    /// Index of the frame that begins the pair of least E among the first `end` pairs.
    fn initial_pair(&self, end: usize) -> Option<usize> {
        let joined = self.frames.iter().take(end).map_while(Option::as_ref).enumerate();
        joined
            .filter(|(_, solved)| solved.initial.is_trusted() && !solved.link.is_still())
            .min_by(|(_, a), (_, b)| a.initial.energy.total_cmp(&b.initial.energy))
            .map(|(index, _)| index)
    }
}
