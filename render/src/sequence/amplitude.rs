// SPDX-License-Identifier: MIT OR Apache-2.0

//! How far a camera moves along its path.

use super::settings::{Settings, Strength};
use super::take::Take;
use crate::scene::Scene;
use crate::stats;
use std::ops::Range;
use std::sync::Arc;

/// The amplitude at which the motion has the strength that the settings ask for, over some captures.
///
/// Displacement is nearly proportional to the amplitude, so that repeated proportion settles
/// quickly; the visibility mask and perspective bend it a little.
pub fn of_strength(settings: &Settings, scene: &Arc<Scene>, seed: u64, captures: Range<usize>) -> f64 {
    let target = match settings.strength {
        Strength::Amplitude(amplitude) => return amplitude,
        Strength::Displacement(target) => target,
    };
    let step = settings.width.max(settings.height) / 40;
    let mut amplitude = 1.0;
    for _ in 0..8 {
        let take = Take::new(settings, scene.clone(), seed, amplitude);
        let samples = captures.clone().flat_map(|k| take.capture(settings, k).samples(step));
        let reached = stats::uncorrected(samples).rms;
        if (reached - target).abs() < 1e-3 * target {
            break;
        }
        amplitude *= target / reached.max(1e-6);
    }
    amplitude
}
