//! The sliding window: least E, the recursion in both directions, the final choice.
//!
//! The paper takes the pair of least E of the whole video and runs the recursion from there to both
//! ends. A stream has no whole video; here a frame k is settled when the frames up to k + L are
//! there, L the lookahead:
//!
//! - *initial pair*: the pair of least E (25.6) among those from k to k + L; pairs in which nothing
//!   moved are no candidates;
//! - *backward* (25.9, 25.10): from that pair down to k;
//! - *forward* (25.7, 25.8): from the settled motion of k − 1, over the pair (k − 1, k);
//! - *final choice* (25.4.1.3): of forward, backward and the uniform rotations of the pairs
//!   (k, k + 1) and (k − 1, k), the one of least E as a mean per inlier. E of each is that of the
//!   pair over which it was solved: (k − 1, k) for forward, (k, k + 1) for backward.
//!
//! What was settled long ago does not matter: a step passes an error of the known frame on with the
//! opposite sign and smaller. For a translation the factor is −½ at γ = 1 and −¼ at γ = 0.42, γ = N/N_t.
//! (Had the *known* frame taken the blank, it would be 1 − 3/(2γ), and the recursion would diverge under
//! γ = ¾.) Rotation and translation along the rows are coupled, as both shear the picture. The eigenvalues
//! of a step on a 4 : 3 picture, from its least-squares matrix:
//!
//! | γ | slowest | | fastest |
//! |---|---|---|---|
//! | 1 | −0.91 | −0.50 | −0.30 |
//! | 0.92 | −0.91 | −0.49 | −0.28 |
//! | 0.7 | −0.70 | −0.40 | −0.23 |
//! | 0.42 | −0.36 | −0.24 | −0.14 |
//!
//! Twenty frames leave at most 15 % of an error in the slowest mode, and in practice far less, as the final
//! choice restarts the recursion: from four starts, motions of some 6 px a frame differ after twenty frames
//! by less than 0.1 px a frame at the corners.

use super::link::{Fit, Known, Link, Scratch};
use std::collections::VecDeque;

/// Where a frame's motion comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Origin {
    /// One pair of frames in uniform rotation (25.6).
    Initial,
    /// The recursion from earlier frames (25.7, 25.8).
    Forward,
    /// The recursion from later frames (25.9, 25.10).
    Backward,
    /// The continuous path.
    Continuous,
    /// A duplicate: the motion of the frame it repeats.
    Repeated,
    /// None was found or it is not to be trusted: the frame stays as it is.
    Untouched,
}

impl Origin {
    /// Its name, in lower case.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Initial => "initial",
            Self::Forward => "forward",
            Self::Backward => "backward",
            Self::Continuous => "continuous",
            Self::Repeated => "repeated",
            Self::Untouched => "untouched",
        }
    }
}

/// A motion that a frame may have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// The motion and how it fits.
    pub fit: Fit,
    /// Where it comes from.
    pub origin: Origin,
}

/// A link with its uniform rotation.
#[derive(Debug)]
struct Joint {
    link: Link,
    initial: Fit,
    /// The motion of the link's first frame by the recursion from later frames, and the serial
    /// number of the frame that the recursion started from.
    backward: Option<(u64, Fit)>,
}

/// The frames that wait for their motion, without duplicates.
#[derive(Debug, Default)]
pub struct Window {
    /// One entry a frame: its joint to the next one, where there is one.
    frames: VecDeque<Option<Joint>>,
    /// Serial number of the first frame that waits.
    serial: u64,
    /// Motion of the frame settled last.
    settled: Option<Fit>,
    /// Its joint to the first frame that waits.
    past: Option<Joint>,
    scratch: Scratch,
}

impl Window {
    /// Adds the next frame and its link to the frame pushed before it: `None` at a start or a gap.
    ///
    /// Returns the uniform rotation of the link where there is one to be trusted.
    pub fn push(&mut self, link: Option<Link>) -> Option<Fit> {
        let joint = link.and_then(|link| {
            let initial = link.uniform(&mut self.scratch)?;
            Some(Joint { link, initial, backward: None })
        });
        let initial = joint.as_ref().map(|joint| joint.initial).filter(Fit::is_trusted);
        match self.frames.back_mut() {
            Some(last) => *last = joint,
            None => self.past = joint,
        }
        self.frames.push_back(None);
        initial
    }

    /// Settles the motion of the first frame that waits and lets the frame go; `None` where nothing
    /// that can be trusted was found.
    pub fn settle(&mut self) -> Option<Candidate> {
        let backward = self.backward();
        let forward = self.forward();
        let next = self.frames.front().and_then(Option::as_ref);
        let initial = [next, self.past.as_ref()].map(|joint| joint.map(|joint| joint.initial));
        let best = [
            (backward, Origin::Backward),
            (forward, Origin::Forward),
            (initial[0], Origin::Initial),
            (initial[1], Origin::Initial),
        ]
        .into_iter()
        .filter_map(|(fit, origin)| Some(Candidate { fit: fit?, origin }))
        .filter(|candidate| candidate.fit.is_trusted())
        .min_by(|a, b| a.fit.energy.total_cmp(&b.fit.energy));
        if let Some(joint) = self.frames.pop_front() {
            self.past = joint;
            self.serial += 1;
        }
        self.settled = best.map(|candidate| candidate.fit);
        best
    }

    /// Forgets everything but its buffers.
    pub fn reset(&mut self) {
        self.frames.clear();
        self.settled = None;
        self.past = None;
    }

    /// The first frame's motion from the settled one before it.
    fn forward(&mut self) -> Option<Fit> {
        self.past.as_ref()?.link.sequential_step(Known::First, self.settled?.twist, &mut self.scratch)
    }

    /// The first frame's motion from the initial pair; `None` where it is in that pair itself.
    ///
    /// A pair over which the recursion finds no motion to be trusted is a cut: the initial pair is
    /// then sought before it.
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

    /// The recursion from the pair that begins at frame `start` to the first frame; the index of the
    /// frame before the cut where it comes upon one.
    fn follow_back(&mut self, start: usize) -> Result<Fit, usize> {
        let from = self.serial + start as u64;
        let mut known = self.frames.get(start).and_then(Option::as_ref).ok_or(start)?.initial;
        for (index, joint) in self.frames.iter_mut().enumerate().take(start).rev() {
            let joint = joint.as_mut().ok_or(index)?;
            known = match joint.backward {
                Some((serial, fit)) if serial == from => fit,
                _ => joint
                    .link
                    .sequential_step(Known::Second, known.twist, &mut self.scratch)
                    .filter(Fit::is_trusted)
                    .ok_or(index)?,
            };
            joint.backward = Some((from, known));
        }
        Ok(known)
    }

    /// Index of the frame that begins the pair of least E among the first `end` pairs.
    fn initial_pair(&self, end: usize) -> Option<usize> {
        let joined = self.frames.iter().take(end).map_while(Option::as_ref).enumerate();
        joined
            .filter(|(_, joint)| joint.initial.is_trusted() && !joint.link.is_still())
            .min_by(|(_, a), (_, b)| a.initial.energy.total_cmp(&b.initial.energy))
            .map(|(index, _)| index)
    }
}
