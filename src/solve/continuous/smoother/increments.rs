// SPDX-License-Identifier: MIT OR Apache-2.0

//! The motion of the scene from frame to frame.

use super::{AHEAD, Continuous};
use crate::motion::{rounded_homography, scaled};
use nalgebra::Matrix3;

impl Continuous {
    /// Motions of the scene in centred pixels, by the path as of the frame settled last: from the middle of its readout to that
    /// of the next frame, and from there on to the last frame of the window. None where the frame makes no pair with the next.
    pub fn increments(&self) -> impl Iterator<Item = Matrix3<f64>> {
        let leading = self.posterior.leading();
        let posterior = &leading.posterior;
        let homographies = &posterior.trajectory.homographies;
        let own = self.settled.checked_sub(1).filter(|_| leading.has_path() && self.continues);
        let frames = self.frames.iter().skip(own.unwrap_or(self.frames.len()));
        let pairs = frames.map_while(|entry| entry.to_next.as_ref()).take(AHEAD);
        let [width, height] = self.posterior.size;
        pairs.map(move |pair| {
            let [from, to] = pair.stamps.map(|stamp| posterior.block(stamp, 0.5));
            let moved = homographies.until(to) * homographies.back(from);
            rounded_homography(&scaled(&moved, [self.radius; 2]), width, height)
        })
    }
}
