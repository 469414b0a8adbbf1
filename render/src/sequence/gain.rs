// SPDX-License-Identifier: MIT OR Apache-2.0

//! How the brightness of the captures changes.

use crate::scene::Picture;
use serde::Serialize;

/// The gain of a camera that changes from capture to capture; 1 is the exposure of the scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Gain {
    /// The captures between which auto-exposure takes the gain evenly from 1 to `end`.
    pub ramp: [usize; 2],
    /// The gain after the ramp.
    pub end: f32,
    /// A capture that a flash lights, and how many times brighter it is.
    pub flash: Option<(usize, f32)>,
}

impl Gain {
    /// The gain of capture `k`.
    pub fn at(&self, k: usize) -> f32 {
        let [from, to] = self.ramp;
        let share = (k as f32 - from as f32) / (to as f32 - from as f32).max(1.0);
        let flash = self.flash.filter(|(capture, _)| *capture == k).map_or(1.0, |(_, factor)| factor);
        flash * (1.0 + (self.end - 1.0) * share.clamp(0.0, 1.0))
    }

    /// A picture as it comes out of capture `k`, not clipped yet.
    pub fn apply(&self, k: usize, mut picture: Picture) -> Picture {
        let gain = self.at(k);
        picture.colours.as_flattened_mut().iter_mut().for_each(|channel| *channel *= gain);
        picture
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ramps_between_its_ends_and_flashes_once() {
        let gain = Gain { ramp: [2, 6], end: 2.0, flash: Some((8, 1.5)) };
        let gains: Vec<f32> = (0..10).map(|k| gain.at(k)).collect();
        assert_eq!(gains, [1.0, 1.0, 1.0, 1.25, 1.5, 1.75, 2.0, 2.0, 3.0, 2.0]);
    }

    #[test]
    fn multiplies_colours() {
        let gain = Gain { ramp: [0, 1], end: 0.5, flash: None };
        let grey = Picture::new(2, 1, vec![[0.25, 0.5, 1.0]; 2]);
        assert_eq!(gain.apply(0, grey.clone()), grey);
        assert_eq!(gain.apply(1, grey).colours, [[0.125, 0.25, 0.5]; 2]);
    }
}
