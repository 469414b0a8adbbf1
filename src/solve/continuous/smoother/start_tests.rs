// SPDX-License-Identifier: MIT OR Apache-2.0

//! The first frame of a stream.

use super::film::*;
use super::*;
use crate::solve::random::Random;

/// The confidence in the correction of the first frame of a film that begins so many frames later.
fn first_confidence(film: &Film, late: usize) -> f64 {
    let mut random = Random(late as u64 + 1);
    let mut continuous = Continuous::new(UNKNOWN, SIZE[0], SIZE[1], 1.0);
    let stamps = &regular(late + LOOKAHEAD + 1)[late..];
    for (k, &stamp) in stamps.iter().enumerate() {
        let pair = k.checked_sub(1).map(|last| film.pair(stamps[last], stamp, &mut random));
        push(&mut continuous, pair.as_deref(), stamp);
    }
    settle(&mut continuous).map_or(0.0, |solution| solution.confidence)
}

#[test]
fn the_first_window_nearly_always_finds_the_readout() {
    let film = Film::new(0.8, true);
    let confidences: Vec<f64> = (0..60).map(|late| first_confidence(&film, late)).collect();
    let unknown = confidences.iter().filter(|confidence| **confidence < 0.5).count();
    assert!(unknown <= 1, "{unknown} of {confidences:.2?}");
}
