// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the rectifier has to do with stabilisation: solutions go through the stabiliser, which gives each a placement.

use super::{MOTION_LOOKAHEAD, Rectifier, Settings, Waiting};
use crate::solve::FrameSolution;
use crate::stabilize::{Settled, Target};

/// Longest deviation in seconds.
const MAX_DEVIATION: f64 = 10.0;

impl Settings {
    /// What is asked of the stabiliser.
    pub(super) fn target(&self) -> Target {
        let within = |value: f64, most: f64| if value.is_nan() { 0.0 } else { value.clamp(0.0, most) };
        Target { deviation: within(self.stabilization, MAX_DEVIATION), margin: within(self.margin, 0.5) }
    }
}

impl Rectifier {
    /// Changes [`Settings::stabilization`] and [`Settings::margin`]: the picture goes over to it gradually, and nothing that was
    /// learnt of the camera is lost.
    pub fn set_stabilization(&mut self, stabilization: f64, margin: f64) {
        self.settings.stabilization = stabilization;
        self.settings.margin = margin;
        self.stabilizer.set_target(self.settings.target());
    }

    /// Frames that the motion waits for.
    pub(super) fn motion_lookahead(&self) -> usize {
        let most = if self.stabilizer.is_active() { MOTION_LOOKAHEAD } else { usize::MAX };
        self.settings.lookahead.min(most)
    }

    /// Passes a settled frame on to the stabiliser, or out where nothing is stabilised.
    pub(super) fn pass_on(&mut self, solution: FrameSolution, frame: &Waiting) {
        if !self.stabilizer.is_active() {
            self.solved.push_back(solution);
            return;
        }
        let next = self.waiting.iter().filter(|waiting| !waiting.repeats).map(|waiting| waiting.time);
        let next: Vec<f64> = next.collect();
        let ahead = if frame.repeats {
            Vec::new()
        } else {
            let interval = next.first().map_or(0.0, |next| next - frame.time);
            next.iter().copied().zip(self.engine.increments(interval)).collect()
        };
        let motion = solution.motion.clone();
        let (time, repeats) = (frame.time, frame.repeats);
        self.stabilizer.push(Settled { content: solution, motion: &motion, time, repeats, ahead });
    }

    /// Places the first frame that waits for it; whether there was one.
    pub(super) fn place(&mut self) -> bool {
        let Some((solution, placement)) = self.stabilizer.pop() else { return false };
        let motion = solution.motion.with_placement(placement);
        self.solved.push_back(FrameSolution { motion, ..solution });
        true
    }
}
